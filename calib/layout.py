"""Layout: where the local coordinates of every unknown stand among the columns, and which of them are free."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array
from calib.unknown import Unknown


class Layout:
    """Columns of all unknowns, free and held, instance by instance.

    unknowns: in column order; held: {unknown: boolean (count, freedom)}.
    size: number of columns; free: boolean (size,); position: (size,) place among the free columns, -1 where held.
    """

    def __init__(self, unknowns: Sequence[Unknown], held: Mapping[Unknown, NDArray[np.bool_]]):
        self.unknowns = tuple(unknowns)
        sizes = [u.count * u.freedom for u in self.unknowns]
        starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        self.offset = {u: int(s) for u, s in zip(self.unknowns, starts, strict=False)}
        self.size = int(starts[-1])
        self.free = np.ones(self.size, dtype=bool)
        for unknown, mask in held.items():
            if unknown in self.offset:
                self.free[self.span(unknown)] = ~mask.ravel()
        self.position = np.where(self.free, np.cumsum(self.free) - 1, -1)
        self.free_columns = np.flatnonzero(self.free)
        self.patterns: dict[object, Any] = {}  # made by calib.pattern, which a solve asks for at every step

    def span(self, unknown: Unknown) -> slice:
        """Columns of an unknown."""
        begin = self.offset[unknown]
        return slice(begin, begin + unknown.count * unknown.freedom)

    def any_free(self, unknown: Unknown, index: NDArray[np.int64]) -> bool:
        """Whether anything of the instances index (n,) is free."""
        free: NDArray[np.bool_] = np.any(self.free[self.span(unknown)].reshape(unknown.count, unknown.freedom), axis=1)
        return bool(free[index].any())

    def columns(self, unknown: Unknown, index: NDArray[np.int64]) -> NDArray[np.int64]:
        """Columns (n, freedom) of the instances index (n,)."""
        return self.offset[unknown] + index[:, None] * unknown.freedom + np.arange(unknown.freedom)

    def label(self, column: int) -> str:
        """Name of the scalar in a column."""
        unknown, instance, part = self.place(column)
        return unknown.label(instance, part)

    def unit(self, column: int) -> str:
        """Display unit of the scalar in a column."""
        unknown, _, part = self.place(column)
        return unknown.units[part]

    def place(self, column: int) -> tuple[Unknown, int, int]:
        """Unknown, instance and part of a column."""
        for unknown in self.unknowns:
            span = self.span(unknown)
            if span.start <= column < span.stop:
                return unknown, *divmod(column - span.start, unknown.freedom)
        raise IndexError(column)

    def start(self) -> dict[Unknown, Array]:
        """Stored start values of all unknowns."""
        return {u: u.ambient for u in self.unknowns}

    def move(self, values: Mapping[Unknown, Array], step: Array) -> dict[Unknown, Array]:
        """Values moved by a step over all columns."""
        return {u: u.move(values[u], step[self.span(u)].reshape(u.count, u.freedom)) for u in self.unknowns}

    def bounds(self, values: Mapping[Unknown, Array]) -> tuple[Array, Array]:
        """Room (size,) down to the lower and up to the upper bound of every column, infinite where there is none."""
        lower, upper = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        for u in self.unknowns:
            if u.kind == "vector":
                lower[self.span(u)] = (u.lower - values[u]).ravel()
                upper[self.span(u)] = (u.upper - values[u]).ravel()
        return lower, upper
