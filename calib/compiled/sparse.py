"""Compiled loops over many small blocks of which each meets few of the other columns (calib.coupling)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

ARGUMENTS = ("begin", "end", "far", "others", "first", "columns", "half", "values", "matrix", "out")


class _Text:
    """Lines of LLVM IR with names of their own."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._count = 0

    def value(self, text: str) -> str:
        """Name of the value of an expression."""
        self._count += 1
        self.lines.append(f"  %v{self._count} = {text}")
        return f"%v{self._count}"

    def at(self, base: str, *offset: str, kind: str = "double") -> str:
        """Address of the element at a product of two numbers and a third, or at one."""
        place = offset[0] if len(offset) == 1 else self.value(
            f"add i64 {self.value(f'mul i64 {offset[0]}, {offset[1]}')}, {offset[2]}")
        return self.value(f"getelementptr {kind}, ptr {base}, i64 {place}")

    def load(self, base: str, *offset: str, kind: str = "double") -> str:
        """The element there."""
        return self.value(f"load {kind}, ptr {self.at(base, *offset, kind=kind)}, align 8")

    def dot(self, left: Sequence[str], right: Sequence[str]) -> str:
        """Sum of products."""
        total = self.value(f"fmul contract double {left[0]}, {right[0]}")
        for a, b in zip(left[1:], right[1:], strict=True):
            total = self.value(f"fadd contract double {total}, {self.value(f'fmul contract double {a}, {b}')}")
        return total

    def loop(self, name: str, begin: str, end: str, body: Callable[[str], None]) -> None:
        """A loop over whole numbers, which may be empty."""
        self.lines += [f"  br label %{name}_start", f"{name}_start:", f"  br label %{name}_head", f"{name}_head:",
                       f"  %{name} = phi i64 [ {begin}, %{name}_start ], [ %{name}_next, %{name}_last ]",
                       f"  %{name}_more = icmp slt i64 %{name}, {end}",
                       f"  br i1 %{name}_more, label %{name}_body, label %{name}_done", f"{name}_body:"]
        body(f"%{name}")
        self.lines += [f"  br label %{name}_last", f"{name}_last:", f"  %{name}_next = add i64 %{name}, 1",
                       f"  br label %{name}_head", f"{name}_done:"]

    def function(self) -> str:
        """The function `rows` with these lines."""
        numbers, pointers = ARGUMENTS[:4], ARGUMENTS[4:]
        given = ", ".join([f"i64 %{a}" for a in numbers] + [f"ptr %{a}" for a in pointers])
        return "\n".join([f"define void @rows({given}) #0 {{", "entry:", *self.lines, "  ret void", "}",
                          "attributes #0 = { nounwind }", ""])


def _entries(text: _Text, block: str) -> tuple[str, str]:
    after = text.value(f"add i64 {block}, 1")
    return text.load("%first", block, kind="i64"), text.load("%first", after, kind="i64")


def mapped(freedom: int) -> str:
    """LLVM IR that multiplies every block (f, .) of values from the left by its matrix of half (m, f, f), into out."""
    text = _Text()

    def block(i: str) -> None:
        square = text.value(f"mul i64 {i}, {freedom * freedom}")
        half = [[text.load("%half", text.value(f"add i64 {square}, {k * freedom + j}")) for j in range(freedom)]
                for k in range(freedom)]

        def entry(e: str) -> None:
            values = [text.load("%values", "%far", str(j), e) for j in range(freedom)]
            for k in range(freedom):
                place = text.at("%out", "%far", str(k), e)
                text.lines.append(f"  store double {text.dot(half[k], values)}, ptr {place}, align 8")
        text.loop("e", *_entries(text, i), entry)
    text.loop("i", "%begin", "%end", block)
    return text.function()


def square(freedom: int) -> str:
    """LLVM IR that adds to out (S, S), on and below the diagonal, the square of values."""
    text = _Text()

    def block(i: str) -> None:
        begin, end = _entries(text, i)

        def row(a: str) -> None:
            mine = [text.load("%values", "%far", str(k), a) for k in range(freedom)]
            line = text.at("%out", text.value(f"mul i64 {text.load('%columns', a, kind='i64')}, %others"))
            after = text.value(f"add i64 {a}, 1")

            def column(b: str) -> None:
                theirs = [text.load("%values", "%far", str(k), b) for k in range(freedom)]
                place = text.at(line, text.load("%columns", b, kind="i64"))
                there = text.value(f"load double, ptr {place}, align 8")
                total = text.value(f"fadd double {there}, {text.dot(mine, theirs)}")
                text.lines.append(f"  store double {total}, ptr {place}, align 8")
            text.loop("b", begin, after, column)
        text.loop("a", begin, end, row)
    text.loop("i", "%begin", "%end", block)
    return text.function()


def sampled(freedom: int) -> str:
    """LLVM IR that puts into out the values times a symmetric matrix (S, S), where values are."""
    text = _Text()

    def block(i: str) -> None:
        begin, end = _entries(text, i)

        def clear(e: str) -> None:
            for k in range(freedom):
                text.lines.append(f"  store double 0.0, ptr {text.at('%out', '%far', str(k), e)}, align 8")

        def row(a: str) -> None:
            line = text.at("%matrix", text.value(f"mul i64 {text.load('%columns', a, kind='i64')}, %others"))
            mine = [text.load("%values", "%far", str(k), a) for k in range(freedom)]

            def column(b: str) -> None:  # no sum waits for the one before
                weight = text.load(line, text.load("%columns", b, kind="i64"))
                for k, number in enumerate(mine):
                    place = text.at("%out", "%far", str(k), b)
                    there = text.value(f"load double, ptr {place}, align 8")
                    product = text.value(f"fmul contract double {weight}, {number}")
                    total = text.value(f"fadd contract double {there}, {product}")
                    text.lines.append(f"  store double {total}, ptr {place}, align 8")
            text.loop("b", begin, end, column)
        text.loop("e", begin, end, clear)
        text.loop("a", begin, end, row)
    text.loop("i", "%begin", "%end", block)
    return text.function()
