"""Scalar LLVM IR: elements in memory, sums of products."""

from __future__ import annotations

from collections.abc import Sequence

from calib.compiled.intermediate import Writer


class Scalars:
    """Scalar code among the lines of a writer."""

    def __init__(self, writer: Writer):
        self.value, self.lines = writer.value, writer.lines

    def whole(self, operation: str, a: str | int, b: str | int) -> str:
        """Sum, difference or product of whole numbers."""
        return self.value(f"{operation} i64 {a}, {b}")

    def at(self, base: str, *offset: str | int, kind: str = "double") -> str:
        """Address of the element at a number, or at a product of two numbers and a third."""
        place = offset[0] if len(offset) == 1 else self.whole("add", self.whole("mul", *offset[:2]), offset[2])
        return self.value(f"getelementptr {kind}, ptr {base}, i64 {place}")

    def load(self, base: str, *offset: str | int, kind: str = "double") -> str:
        """The element there; a whole number of 32 bits is widened."""
        size = {"i32": 4}.get(kind, 8)
        found = self.value(f"load {kind}, ptr {self.at(base, *offset, kind=kind)}, align {size}")
        return self.value(f"zext i32 {found} to i64") if kind == "i32" else found

    def store(self, number: str, base: str, *offset: str | int) -> None:
        """Put a number there."""
        self.lines.append(f"  store double {number}, ptr {self.at(base, *offset)}, align 8")

    def add(self, number: str, base: str, *offset: str | int) -> None:
        """Add a number to the element there."""
        place = self.at(base, *offset)
        there = self.value(f"load double, ptr {place}, align 8")
        self.lines.append(f"  store double {self.value(f'fadd double {there}, {number}')}, ptr {place}, align 8")

    def sum(self, total: str, left: str, right: str) -> str:
        """A sum and a product more."""
        return self.value(f"fadd contract double {total}, {self.value(f'fmul contract double {left}, {right}')}")

    def dot(self, left: Sequence[str], right: Sequence[str]) -> str:
        """Sum of products."""
        total = self.value(f"fmul contract double {left[0]}, {right[0]}")
        for a, b in zip(left[1:], right[1:], strict=True):
            total = self.sum(total, a, b)
        return total
