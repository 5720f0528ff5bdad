"""Rows: one list of scalar instructions, run once with NumPy vectors over all rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
CHUNK = 4096  # rows at a time: the work vectors of a few hundred instructions then stay in the cache

_erf = np.vectorize(math.erf, otypes=[float])


def _remainder(x: Any, y: Any) -> Any:
    """x less the nearest whole multiple of y, exact as in C: `fmod` is, and folding it back by y is."""
    part, size = np.fmod(x, y), np.abs(y)
    odd = np.abs(np.fmod(x, 2.0 * y)) >= size
    beyond = (2.0 * np.abs(part) > size) | ((2.0 * np.abs(part) == size) & odd)
    return np.where(beyond, part - np.copysign(y, part), part)


def _copysign_sign(x: Any) -> Any:
    return np.sign(x)


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
    "SIGN": _copysign_sign,
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


def _operations() -> dict[int, Callable[..., Any]]:
    table = {**_UNARY, **_BINARY}
    return {getattr(ca, f"OP_{name}"): function for name, function in table.items() if hasattr(ca, f"OP_{name}")}


_OPERATION = _operations()
_BINARY_CODES = {getattr(ca, f"OP_{name}") for name in _BINARY if hasattr(ca, f"OP_{name}")}


class Program:
    """A CasADi SX function as a list of NumPy operations over rows.

    inputs: column vectors, in order; output: one column vector. Called with one number or (n,) array for each scalar
    input it returns (outputs, n).
    """

    def __init__(self, inputs: Sequence[ca.SX], output: ca.SX):
        function = ca.Function("rows", list(inputs), [output])
        offsets = np.concatenate([[0], np.cumsum([i.shape[0] for i in inputs])]).astype(int)
        self.inputs, self.outputs = int(offsets[-1]), output.shape[0]
        self._work = function.sz_w()
        self._constants: list[tuple[int, float]] = []
        self._loads: list[tuple[int, int]] = []
        steps: list[tuple[int, Callable[..., Any] | None, int, int]] = []
        for k in range(function.n_instructions()):
            code, ins, outs = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
            if code == ca.OP_CONST:
                steps.append((outs[0], None, -1, len(self._constants)))
                self._constants.append((outs[0], function.instruction_constant(k)))
            elif code == ca.OP_INPUT:
                steps.append((outs[0], None, -2, int(offsets[ins[0]]) + ins[1]))
            elif code == ca.OP_OUTPUT:
                steps.append((outs[1], None, -3, ins[0]))
            elif code in _OPERATION:
                steps.append((outs[0], _OPERATION[code], ins[0], ins[1] if code in _BINARY_CODES else -1))
            else:
                raise NotImplementedError(f"CasADi operation {code} is not known to the row back end")
        self._steps = steps

    def __len__(self) -> int:
        return len(self._steps)

    def __call__(self, inputs: Sequence[Any], n: int) -> Array:
        result = np.empty((self.outputs, n))
        with np.errstate(all="ignore"):  # a value that is not finite is found and named where it matters
            for begin in range(0, n, CHUNK):
                rows = slice(begin, min(begin + CHUNK, n))
                self._run([x[rows] if np.ndim(x) else x for x in inputs] if n > CHUNK else inputs, result[:, rows])
        return result

    def _run(self, inputs: Sequence[Any], result: Array) -> None:
        work: list[Any] = [None] * (self._work + 1)
        constants = self._constants
        for out, operation, a, b in self._steps:
            if operation is not None:
                work[out] = operation(work[a]) if b < 0 else operation(work[a], work[b])
            elif a == -2:
                work[out] = inputs[b]
            elif a == -3:
                result[out] = work[b]
            else:
                work[out] = np.float64(constants[b][1])
