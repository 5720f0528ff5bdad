"""Scalar instructions written as LLVM IR, on vectors of rows; no operation is rounded otherwise than CasADi does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np


class Instruction(NamedTuple):
    """One scalar instruction: CasADi's name of the operation, the slot it writes, and what it reads.

    INPUT reads scalar input `first`, CONST is `value`, OUTPUT writes slot `first` to scalar output `out`; all others
    read the slots `first` and `second`.
    """

    name: str
    out: int
    first: int = -1
    second: int = -1
    value: float = 0.0


def needed(instructions: Sequence[Instruction], begin: int) -> list[Instruction]:
    """Those instructions without which the outputs from a number on would not be."""
    live: set[int] = set()
    found = []
    for step in reversed(instructions):
        if step.name == "OUTPUT":
            if step.out < begin:
                continue
        elif step.out not in live:
            continue
        else:
            live.remove(step.out)
        found.append(step)
        if step.name not in ("INPUT", "CONST"):
            live.update(slot for slot in (step.first, step.second) if slot >= 0)
    return found[::-1]


_ARITHMETIC = {"ADD": "fadd", "SUB": "fsub", "MUL": "fmul", "DIV": "fdiv"}
_INTRINSIC = {"SQRT": "sqrt", "FABS": "fabs", "FLOOR": "floor", "CEIL": "ceil", "COPYSIGN": "copysign"}
_COMPARISON = {"LT": "olt", "LE": "ole", "EQ": "oeq", "NE": "une"}
LIBRARY = {
    **{name.upper(): name for name in ("exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "erf", "sinh",
                                       "cosh", "tanh", "asinh", "acosh", "atanh", "log1p", "expm1", "pow", "fmod",
                                       "remainder", "atan2", "hypot")},
    "CONSTPOW": "pow",
}
ATTRIBUTES = """attributes #0 = { nounwind }
attributes #1 = { nounwind willreturn memory(none) }"""
_TWO = {"pow", "fmod", "remainder", "atan2", "hypot"}


class Writer:
    """LLVM IR of straight-line code on vectors of rows."""

    def __init__(self, lanes: int):
        self.lanes, self.type = lanes, f"<{lanes} x double>"
        self.mask = f"<{lanes} x i1>"
        self.lines: list[str] = []
        self.declared: dict[str, str] = {}
        self._count = 0

    def value(self, text: str) -> str:
        """Name of the value of an expression."""
        self._count += 1
        self.lines.append(f"  %v{self._count} = {text}")
        return f"%v{self._count}"

    def constant(self, number: float) -> str:
        """The same number in every lane, written by its bits."""
        bits = np.float64(number).view(np.uint64)
        return "<" + ", ".join([f"double 0x{int(bits):016X}"] * self.lanes) + ">"

    def intrinsic(self, name: str, *given: str) -> str:
        """A vector function that is exact or correctly rounded."""
        full, kinds = f"llvm.{name}.v{self.lanes}f64", ", ".join([self.type] * len(given))
        self.declared[full] = f"declare {self.type} @{full}({kinds})"
        return self.value(f"call {self.type} @{full}({', '.join(f'{self.type} {g}' for g in given)})")

    def library(self, name: str, *given: str) -> str:
        """A function of the C library, lane by lane."""
        self.declared[name] = f"declare double @{name}({', '.join(['double'] * len(given))}) #1"
        result = "poison"
        for lane in range(self.lanes):
            picked = [self.value(f"extractelement {self.type} {g}, i32 {lane}") for g in given]
            one = self.value(f"call double @{name}({', '.join(f'double {p}' for p in picked)}) #1")
            result = self.value(f"insertelement {self.type} {result}, double {one}, i32 {lane}")
        return result

    def compare(self, how: str, a: str, b: str) -> str:
        """A mask."""
        return self.value(f"fcmp {how} {self.type} {a}, {b}")

    def choose(self, mask: str, a: str, b: str) -> str:
        """a where the mask is true, else b."""
        return self.value(f"select {self.mask} {mask}, {self.type} {a}, {self.type} {b}")

    def logic(self, how: str, a: str, b: str) -> str:
        """Two masks joined by `and` or `or`."""
        return self.value(f"{how} {self.mask} {a}, {b}")

    def operation(self, name: str, a: str, b: str) -> str:
        """Value of an operation of CasADi; b is not looked at where it has one operand."""
        zero, one = self.constant(0.0), self.constant(1.0)
        if name in _ARITHMETIC:
            return self.value(f"{_ARITHMETIC[name]} {self.type} {a}, {b}")
        if name in _INTRINSIC:
            return self.intrinsic(_INTRINSIC[name], a, b) if name == "COPYSIGN" else self.intrinsic(_INTRINSIC[name], a)
        if name in _COMPARISON:
            return self.choose(self.compare(_COMPARISON[name], a, b), one, zero)
        if name in LIBRARY:
            return self.library(LIBRARY[name], a, b) if LIBRARY[name] in _TWO else self.library(LIBRARY[name], a)
        if name == "ASSIGN":
            return a
        if name == "NEG":
            return self.value(f"fneg {self.type} {a}")
        if name == "SQ":
            return self.value(f"fmul {self.type} {a}, {a}")
        if name == "TWICE":
            return self.value(f"fadd {self.type} {a}, {a}")
        if name == "INV":
            return self.value(f"fdiv {self.type} {one}, {a}")
        if name == "NOT":
            return self.choose(self.compare("oeq", a, zero), one, zero)
        if name in ("AND", "OR"):
            both = self.logic(name.lower(), self.compare("une", a, zero), self.compare("une", b, zero))
            return self.choose(both, one, zero)
        if name == "IF_ELSE_ZERO":
            return self.choose(self.compare("une", a, zero), b, zero)
        if name in ("FMIN", "FMAX"):  # a number wins over one that is not, as in C
            first = self.compare("ole" if name == "FMIN" else "oge", a, b)
            return self.choose(self.logic("or", first, self.compare("uno", b, b)), a, b)
        if name == "SIGN":
            positive = self.choose(self.compare("ogt", a, zero), one, a)
            signed = self.choose(self.compare("olt", a, zero), self.constant(-1.0), positive)
            return self.choose(self.compare("oeq", a, zero), zero, signed)
        raise NotImplementedError(f"CasADi operation {name} is not known to the compiled back end")

    def run(self, instructions: Sequence[Instruction], load: Callable[[int], str], store: Callable[[int, str], None]
            ) -> None:
        """Write instructions; load: value of a scalar input; store: takes the value of a scalar output."""
        slots: dict[int, str] = {}
        for step in instructions:
            if step.name == "CONST":
                slots[step.out] = self.constant(step.value)
            elif step.name == "INPUT":
                slots[step.out] = load(step.first)
            elif step.name == "OUTPUT":
                store(step.out, slots[step.first])
            else:
                slots[step.out] = self.operation(step.name, slots[step.first], slots.get(step.second, ""))


def intermediate(instructions: Sequence[Instruction], lanes: int) -> str:
    """LLVM IR of `rows(begin, end, inputs, strides, outputs, stride)`, which runs instructions on vectors of rows.

    instructions: in order; lanes: rows in a vector, which divides end - begin. inputs: pointers to columns, each with
    stride 1, or 0 for a scalar repeated `lanes` times; outputs: the first output of row 0, `stride` numbers apart.
    """
    writer = Writer(lanes)

    def load(number: int) -> str:
        place = writer.value(f"getelementptr ptr, ptr %inputs, i64 {number}")
        column = writer.value(f"load ptr, ptr {place}, align 8")
        where = writer.value(f"getelementptr i64, ptr %strides, i64 {number}")
        offset = writer.value(f"mul i64 %row, {writer.value(f'load i64, ptr {where}, align 8')}")
        first = writer.value(f"getelementptr double, ptr {column}, i64 {offset}")
        return writer.value(f"load {writer.type}, ptr {first}, align 8")

    def store(number: int, value: str) -> None:
        offset = writer.value(f"add i64 %row, {writer.value(f'mul i64 %stride, {number}')}")
        place = writer.value(f"getelementptr double, ptr %outputs, i64 {offset}")
        writer.lines.append(f"  store {writer.type} {value}, ptr {place}, align 8")

    writer.run(instructions, load, store)
    return "\n".join([
        "define void @rows(i64 %begin, i64 %end, ptr %inputs, ptr %strides, ptr %outputs, i64 %stride) #0 {",
        "entry:", "  br label %head", "head:",
        "  %row = phi i64 [ %begin, %entry ], [ %next, %body ]",
        "  %more = icmp slt i64 %row, %end", "  br i1 %more, label %body, label %done",
        "body:", *writer.lines, f"  %next = add i64 %row, {lanes}", "  br label %head",
        "done:", "  ret void", "}", *sorted(writer.declared.values()), ATTRIBUTES, "",
    ])
