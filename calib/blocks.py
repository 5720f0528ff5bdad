"""Rows of residuals and derivatives as arrays: the form in which everything travels from models to analyses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Part:
    """Derivatives (m, d, f) of m blocks of d numbers with respect to f columns each; columns (m, f)."""

    columns: Index
    jacobian: Array


@dataclass(frozen=True)
class Block:
    """m blocks of d numbers: rows (m, k) they come from, residual (m, d), and the parts of their derivatives."""

    rows: Index
    residual: Array
    parts: tuple[Part, ...]

    def times(self, step: Array) -> Array:
        """Derivatives times a step over all columns: (m, d)."""
        change = np.zeros(self.residual.shape)
        for part in self.parts:
            change += np.einsum("mdf,mf->md", part.jacobian, step[part.columns])
        return change

    def dense(self, position: Index, size: int) -> Array:
        """Derivatives as a matrix (m d, size); position maps every column to its place, -1 where it is left out."""
        m, d = self.residual.shape
        matrix = np.zeros((m, d, size))
        for part in self.parts:
            for f in range(part.columns.shape[1]):
                place = position[part.columns[:, f]]
                kept = np.flatnonzero(place >= 0)
                if kept.size:
                    matrix[kept, :, place[kept]] += part.jacobian[kept, :, f]  # a row meets a place once per (part, f)
        return matrix.reshape(m * d, size)


@dataclass(frozen=True)
class Mixing:
    """A sparse row operation: block i is matrix[i] times the readings of rows[i].

    rows: (m, k) source rows; matrix: (m, d, k*dim), or (m, d) where it is diagonal and k is 1.
    """

    rows: Index
    matrix: Array

    def apply(self, residual: Array, parts: Sequence[Part]) -> Block:
        """Mix the residuals (n, dim) and the derivatives of n rows."""
        k, dim = self.rows.shape[1], residual.shape[1]
        if self.matrix.ndim == 2:
            whole = len(self.rows) == len(residual)  # the usual case: every row in order, nothing to gather
            pick = slice(None) if whole else self.rows[:, 0]
            return Block(
                self.rows,
                self.matrix * residual[pick],
                tuple(Part(p.columns[pick], self.matrix[:, :, None] * p.jacobian[pick]) for p in parts),
            )
        source = residual[self.rows].reshape(len(self.rows), k * dim)
        mixed = np.einsum("mde,me->md", self.matrix, source)
        result = []
        for p in parts:
            columns = p.columns[self.rows]
            if np.all(columns == columns[:, :1]):  # an unknown that the rows of a block share is one part, not k
                jacobian = p.jacobian[self.rows].reshape(len(self.rows), k * dim, columns.shape[2])
                result.append(Part(columns[:, 0], self.matrix @ jacobian))
                continue
            for j in range(k):
                weight = self.matrix[:, :, j * dim : (j + 1) * dim]
                result.append(Part(columns[:, j], weight @ p.jacobian[self.rows[:, j]]))
        return Block(self.rows, mixed, tuple(result))
