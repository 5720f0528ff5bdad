"""Compiled rows: the instructions of a row program in machine code, and when they are used.

The library that compiles, llvmlite, is a wheel and optional (`pip install "calibration-framework[fast]"`); without it
NumPy runs the same instructions. Functions are those of the C library, as in CasADi, whose digits are met exactly;
NumPy brings its own, whose last digit may differ.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from calib.compiled import sparse
from calib.compiled.fused import LEVERAGES, POINTERS, SUMS, VALUES, Shape
from calib.compiled.intermediate import Instruction
from calib.errors import CalibrationError

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

    from calib.compiled.machine import Compiler

__all__ = ["LEVERAGES", "SUMS", "VALUES", "CompiledRows", "Instruction", "Shape", "available", "fused_rows", "parts_of",
           "pays", "row_back_end", "run_side_by_side", "sparse", "sparse_loop", "threads"]

Array = NDArray[Any]
T = TypeVar("T")
SPENT = 4.0e8  # scalar operations that NumPy does while the compiler is loaded
SPENT_EACH = 1.0e5  # rows that NumPy does while one instruction is compiled
THREAD_WORK = 4.0e6  # scalar operations that are worth a thread of their own
_chosen: str | None = None


def available() -> bool:
    """Whether rows can be compiled here: llvmlite is installed and knows this processor."""
    from calib.compiled.machine import compiler  # costs time, which a small problem does not have

    return compiler() is not None


@contextmanager
def row_back_end(name: str) -> Iterator[None]:
    """Run rows by one back end in a `with` block, whatever CALIB_ROWS says.

    name: "numpy", "compiled", or "automatic" (compiled where it is available and the rows repay the compiler).
    Raises CalibrationError for another name, and where compiled rows are asked for and cannot be had.
    """
    global _chosen
    before, _chosen = _chosen, name
    try:
        _wanted()
        yield
    finally:
        _chosen = before


def _wanted() -> str:
    name = _chosen or os.environ.get("CALIB_ROWS") or "automatic"
    if name not in ("numpy", "compiled", "automatic"):
        raise CalibrationError(f"the row back end '{name}' does not exist; CALIB_ROWS is numpy, compiled or automatic.")
    if name == "compiled" and not available():
        raise CalibrationError(
            "compiled rows are asked for (CALIB_ROWS), but llvmlite is not installed or does not know this machine; "
            'install it by pip install "calibration-framework[fast]", or set CALIB_ROWS=automatic.'
        )
    return name


def pays(instructions: int, rows: float) -> bool:
    """Whether to run a program compiled, by the choice of the caller or else by size alone.

    instructions: its length; rows: how many rows it will be run over in all. The answer depends on nothing that
    happened before, so that the same call gives the same digits.
    """
    name = _wanted()
    if name == "automatic":
        return rows * instructions > SPENT + SPENT_EACH * instructions and available()
    return name == "compiled"


def threads() -> int:
    """Threads for large row counts: CALIB_THREADS, else one for each processor that this process may use."""
    stated = os.environ.get("CALIB_THREADS", "")
    if stated.isdigit() and int(stated) > 0:
        return int(stated)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class CompiledRows:
    """A compiled row program; called as NumPy's is, and safe to call from several threads.

    instructions: in order; outputs: number of scalar outputs.
    Raises CalibrationError where rows cannot be compiled here.
    """

    def __init__(self, instructions: Sequence[Instruction], outputs: int):
        self._compiler = here = _compiler()  # whose memory holds the code
        self._kernel, self._lanes = here.kernel(instructions), here.lanes
        self._size, self._outputs = len(instructions), outputs

    def __call__(self, inputs: Sequence[Any], n: int) -> Array:
        """Outputs (outputs, n) of one number or (n,) array for each scalar input."""
        lanes = self._lanes
        if 0 < n < lanes:  # one vector: the last row stands in for those that are not there
            padded = [np.concatenate([x, np.repeat(x[-1:], lanes - n)]) if np.ndim(x) else x for x in inputs]
            return np.ascontiguousarray(self(padded, lanes)[:, :n])
        result = np.empty((self._outputs, n))
        if n == 0:
            return result
        columns = [np.ascontiguousarray(x, dtype=np.float64) if np.ndim(x) else None for x in inputs]
        scalars = np.repeat([0.0 if np.ndim(x) else float(x) for x in inputs], lanes)  # a vector of each, no column
        begin = scalars.__array_interface__["data"][0]
        places = np.array([begin + 8 * lanes * k if c is None else c.__array_interface__["data"][0]
                           for k, c in enumerate(columns)], dtype=np.uint64)
        strides = np.array([c is not None for c in columns], dtype=np.int64)
        out = result.__array_interface__["data"][0]

        def run(first: int, last: int) -> None:
            whole = first + (last - first) // lanes * lanes
            arguments = (places.ctypes.data, strides.ctypes.data, out, n)
            self._kernel(first, whole, *arguments)
            if whole < last:  # the last vector once more, shifted to end with the last row
                self._kernel(last - lanes, last, *arguments)

        parts = min(threads(), int(n * self._size / THREAD_WORK), n // lanes) if n * self._size >= THREAD_WORK else 1
        if parts <= 1 or threading.current_thread() is not threading.main_thread():
            run(0, n)
        else:
            ends = np.linspace(0, n // lanes, parts + 1).astype(int) * lanes
            ends[-1] = n
            list(_pool().map(run, ends[:-1].tolist(), ends[1:].tolist()))
        return result


@lru_cache(maxsize=64)
def fused_rows(shape: Shape, task: str) -> FusedRows:
    """The compiled loop of a shape for a task (SUMS, LEVERAGES or VALUES), written once."""
    return FusedRows(shape, task)


class FusedRows:
    """A compiled loop over rows that uses their derivatives at once; safe to call from several threads.

    shape, task: what it is written for. Raises CalibrationError where rows cannot be compiled here.
    """

    def __init__(self, shape: Shape, task: str):
        self._compiler = _compiler()  # whose memory holds the code
        self._loop, self._pointers = self._compiler.loop(shape, task), POINTERS[task]

    def __call__(self, count: int, far: int, wide: int, arrays: Mapping[str, Array | Sequence[Array | None]]) -> None:
        """Go through `count` rows; arrays: for each pointer an array, or several, contiguous in their rows."""
        kept, places = [], []
        for name in self._pointers:
            given = arrays[name]
            if not isinstance(given, np.ndarray):
                given = np.array([0 if a is None else _address(a) for a in given] or [0], dtype=np.uint64)
                kept.append(given)
            places.append(_address(given))
        self._loop(count, far, wide, *places)


@lru_cache(maxsize=64)
def _sparse(kind: Callable[[int], str], freedom: int) -> tuple[Compiler, Callable[..., None]]:
    here = _compiler()
    return here, here.sparse(kind, freedom)


def sparse_loop(kind: Callable[[int], str], numbers: Sequence[int], arrays: Mapping[str, Array], freedom: int) -> None:
    """Run a loop of calib.compiled.sparse with its NUMBERS and those of its POINTERS that it needs."""
    _, run = _sparse(kind, freedom)
    run(*numbers, *[_address(arrays[name]) if name in arrays else 0 for name in sparse.POINTERS])


def _address(array: Array) -> int:
    # a loop would read what is not its own
    if array.size and array.shape[-1] > 1 and array.strides[-1] != array.itemsize:
        raise ValueError(f"an array of {array.shape} has rows that do not lie one number beside the other.")
    return int(array.__array_interface__["data"][0])


def _compiler() -> Compiler:
    from calib.compiled.machine import compiler

    here = compiler()
    if here is None:
        raise CalibrationError("rows cannot be compiled: llvmlite is not installed or does not know this machine.")
    return here


def parts_of(rows: int, instructions: int, owner: Array) -> list[int]:
    """Ends of the parts of rows that threads take, the first 0; owner: no part ends between two rows of one."""
    many = min(threads(), int(rows * instructions / THREAD_WORK))
    if many <= 1 or threading.current_thread() is not threading.main_thread():
        return [0, rows]
    ends = np.linspace(0, rows, many + 1).astype(int)[1:-1]
    if len(owner):
        ends = np.searchsorted(owner, owner[ends])
    return [0, *np.unique(ends[(ends > 0) & (ends < rows)]).tolist(), rows]


def run_side_by_side(run: Callable[[T], None], shares: Sequence[T]) -> None:
    """Run shares of work, each in a thread where there are several."""
    if len(shares) == 1:
        run(shares[0])
    else:
        list(_pool().map(run, shares))


@cache
def _pool() -> ThreadPoolExecutor:
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(threads(), thread_name_prefix="rows")
