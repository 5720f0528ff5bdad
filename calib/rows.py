"""Rows: one list of scalar instructions, run once over all rows, by NumPy on vectors or compiled (calib.compiled)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from calib.compiled import CompiledRows, Instruction, pays

Array = NDArray[Any]
CHUNK = 4096  # rows at a time: the work vectors of a few hundred instructions then stay in the cache

_erf = np.vectorize(math.erf, otypes=[float])


def _remainder(x: Any, y: Any) -> Any:
    """x less the nearest whole multiple of y, exact as in C: `fmod` is, and folding it back by y is."""
    part, size = np.fmod(x, y), np.abs(y)
    odd = np.abs(np.fmod(x, 2.0 * y)) >= size
    beyond = (2.0 * np.abs(part) > size) | ((2.0 * np.abs(part) == size) & odd)
    return np.where(beyond, part - np.copysign(y, part), part)


_UNARY: dict[str, Callable[..., Any]] = {
    "ASSIGN": lambda x: x,
    "NEG": np.negative,
    "EXP": np.exp,
    "LOG": np.log,
    "SQRT": np.sqrt,
    "SQ": lambda x: x * x,
    "TWICE": lambda x: 2.0 * x,
    "SIN": np.sin,
    "COS": np.cos,
    "TAN": np.tan,
    "ASIN": np.arcsin,
    "ACOS": np.arccos,
    "ATAN": np.arctan,
    "NOT": lambda x: np.equal(x, 0.0) * 1.0,
    "FLOOR": np.floor,
    "CEIL": np.ceil,
    "FABS": np.abs,
    "SIGN": np.sign,
    "ERF": _erf,
    "INV": lambda x: 1.0 / x,
    "SINH": np.sinh,
    "COSH": np.cosh,
    "TANH": np.tanh,
    "ASINH": np.arcsinh,
    "ACOSH": np.arccosh,
    "ATANH": np.arctanh,
    "LOG1P": np.log1p,
    "EXPM1": np.expm1,
}
_BINARY: dict[str, Callable[..., Any]] = {
    "ADD": np.add,
    "SUB": np.subtract,
    "MUL": np.multiply,
    "DIV": np.divide,
    "POW": np.power,
    "CONSTPOW": np.power,
    "LT": lambda x, y: np.less(x, y) * 1.0,
    "LE": lambda x, y: np.less_equal(x, y) * 1.0,
    "EQ": lambda x, y: np.equal(x, y) * 1.0,
    "NE": lambda x, y: np.not_equal(x, y) * 1.0,
    "AND": lambda x, y: np.logical_and(x, y) * 1.0,
    "OR": lambda x, y: np.logical_or(x, y) * 1.0,
    "FMOD": np.fmod,
    "REMAINDER": _remainder,
    "COPYSIGN": np.copysign,
    "IF_ELSE_ZERO": lambda condition, x: np.where(condition, x, 0.0),
    "FMIN": np.fmin,
    "FMAX": np.fmax,
    "ATAN2": np.arctan2,
    "HYPOT": np.hypot,
}


_OPERATIONS = {**_UNARY, **_BINARY}
_NAMES = {getattr(ca, f"OP_{name}"): name for name in _OPERATIONS if hasattr(ca, f"OP_{name}")}
_EVALUATIONS = 10  # how often a solve is taken to come back with the same rows


def instructions_of(function: ca.Function) -> list[Instruction]:
    """The scalar instructions of a CasADi SX function with one column as output; inputs are counted through.

    Raises NotImplementedError for an operation that no back end knows.
    """
    offsets = np.concatenate([[0], np.cumsum([function.nnz_in(i) for i in range(function.n_in())])]).astype(int)
    found = []
    identity, reads, writes = function.instruction_id, function.instruction_input, function.instruction_output
    for k in range(function.n_instructions()):
        code, ins, outs = identity(k), reads(k), writes(k)
        if code == ca.OP_CONST:
            found.append(Instruction("CONST", outs[0], value=function.instruction_constant(k)))
        elif code == ca.OP_INPUT:
            found.append(Instruction("INPUT", outs[0], int(offsets[ins[0]]) + ins[1]))
        elif code == ca.OP_OUTPUT:
            found.append(Instruction("OUTPUT", outs[1], ins[0]))
        elif code in _NAMES:
            name = _NAMES[code]
            found.append(Instruction(name, outs[0], ins[0], ins[1] if name in _BINARY else -1))
        else:
            raise NotImplementedError(f"CasADi operation {code} is not known to the row back end")
    return found


class Program:
    """A CasADi SX function as a list of operations over rows, run by NumPy or compiled where that pays.

    inputs: column vectors, in order; output: one column vector. Called with one number or (n,) array for each scalar
    input it returns (outputs, n).
    """

    def __init__(self, inputs: Sequence[ca.SX], output: ca.SX):
        function = ca.Function("rows", list(inputs), [output])
        self.inputs, self.outputs = sum(i.shape[0] for i in inputs), output.shape[0]
        self._work = function.sz_w()
        self.instructions = tuple(instructions_of(function))
        self._steps = [_step(instruction) for instruction in self.instructions]

    def __len__(self) -> int:
        return len(self._steps)

    def __call__(self, inputs: Sequence[Any], n: int) -> Array:
        return self.run(inputs, n, compiled=self.pays(n))

    def pays(self, n: int) -> bool:
        """Whether a solve with n such rows is better off with the compiled program."""
        return pays(len(self._steps), _EVALUATIONS * n)

    @cached_property
    def compiled(self) -> CompiledRows:
        """The same instructions, compiled."""
        return CompiledRows(self.instructions, self.outputs)

    def run(self, inputs: Sequence[Any], n: int, compiled: bool) -> Array:
        """Outputs (outputs, n), by the back end that the caller has chosen for all its calls."""
        if compiled:
            return self.compiled(inputs, n)
        result = np.empty((self.outputs, n))
        with np.errstate(all="ignore"):  # a value that is not finite is found and named where it matters
            for begin in range(0, n, CHUNK):
                rows = slice(begin, min(begin + CHUNK, n))
                self._run([x[rows] if np.ndim(x) else x for x in inputs] if n > CHUNK else inputs, result[:, rows])
        return result

    def _run(self, inputs: Sequence[Any], result: Array) -> None:
        work: list[Any] = [None] * (self._work + 1)
        for operation, out, a, b, constant in self._steps:
            if operation is _input:
                work[out] = inputs[a]
            elif operation is _output:
                result[out] = work[a]
            elif operation is _constant:
                work[out] = constant
            else:
                work[out] = operation(work[a]) if b < 0 else operation(work[a], work[b])


def _input() -> None: ...


def _output() -> None: ...


def _constant() -> None: ...


_FUNCTIONS: dict[str, Callable[..., Any]] = {**_OPERATIONS, "INPUT": _input, "OUTPUT": _output, "CONST": _constant}


def _step(one: Instruction) -> tuple[Callable[..., Any], int, int, int, Any]:
    """An instruction with its function, which is looked up once."""
    name, out, first, second, value = one
    return _FUNCTIONS[name], out, first, second, np.float64(value) if name == "CONST" else None
