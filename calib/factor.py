"""The dense factor of the normal equations: orthogonal, within the null space of linear conditions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.blocks import Array, Index

RANK_TOLERANCE = 1e-12  # of the singular values of the column-scaled derivatives, relative to the largest


@dataclass(frozen=True)
class Conditions:
    """Linear conditions matrix x = target on the free columns; matrix (m, p), target (m,)."""

    matrix: Array
    target: Array

    @staticmethod
    def none(size: int) -> Conditions:
        """No conditions on `size` columns."""
        return Conditions(np.zeros((0, size)), np.zeros(0))

    @property
    def basis(self) -> Array:
        """Directions (p, q) that keep the conditions: all of them where there is none."""
        return null_space(self.matrix, self.target)[0] if len(self.target) else np.eye(self.matrix.shape[1])

    def pinned(self, places: Index, values: Array) -> Conditions:
        """The same with the columns `places` set to values."""
        rows = np.zeros((len(places), self.matrix.shape[1]))
        rows[np.arange(len(places)), places] = 1.0
        return Conditions(np.concatenate([self.matrix, rows]), np.concatenate([self.target, values]))


def null_space(matrix: Array, target: Array) -> tuple[Array, Array]:
    """Basis (p, q) of the null space of conditions, and the smallest solution (p,) that comes nearest to their
    target."""
    size = np.linalg.norm(matrix, axis=1)
    size[size == 0] = 1.0
    left, values, right = np.linalg.svd(matrix / size[:, None])
    rank = int(np.sum(values > RANK_TOLERANCE * max(values[0], 1e-300))) if len(values) else 0
    particular = right[:rank].T @ ((left[:, :rank].T @ (target / size)) / values[:rank])
    return right[rank:].T, particular


class DenseFactor:
    """Orthogonal factor of all whitened derivatives within the null space of the conditions.

    derivatives (N, p); residual (N,); conditions; damping: (p,) added to the diagonal of the normal matrix, or None.
    step: (p,) least-squares step, which is `particular` (p,) to meet the conditions plus `root` times `pull` (rank,);
    decrement: its size in units of u; null: (p, defect) directions that change no reading; condition: of the scaled
    derivatives.
    """

    def __init__(self, derivatives: Array, residual: Array, conditions: Conditions, damping: Array | None = None):
        self.size = derivatives.shape[1]
        scale = np.sqrt(np.einsum("ij,ij->j", derivatives, derivatives) + (0.0 if damping is None else damping))
        self._scale = np.where(scale > 0, scale, 1.0)
        scaled = derivatives / self._scale
        self._basis, particular = None, np.zeros(self.size)
        if len(conditions.target):
            self._basis, particular = null_space(conditions.matrix / self._scale, conditions.target)
            residual = residual - scaled @ particular
            scaled = scaled @ self._basis
        width = scaled.shape[1]
        stacked = np.column_stack([scaled, residual])
        if damping is not None:
            springs = np.diag(np.sqrt(damping) / self._scale)
            springs = springs if self._basis is None else springs @ self._basis
            stacked = np.concatenate([stacked, np.column_stack([springs, np.zeros(self.size)])])
        corner = np.asarray(np.linalg.qr(stacked, mode="r")) if len(stacked) > width + 1 else stacked
        left, self._values, self._right = np.linalg.svd(corner[:, :width], full_matrices=True)
        largest = self._values[0] if len(self._values) else 1.0
        self.rank = int(np.sum(self._values > RANK_TOLERANCE * max(largest, 1e-300)))
        self.pull = left[:, : self.rank].T @ corner[:, width]
        self.particular = particular / self._scale
        with np.errstate(over="ignore", invalid="ignore"):  # a column that has all but faded may ask for any step
            self.step = self.particular + self.root @ self.pull
        self.decrement = float(np.linalg.norm(self.pull))
        self.defect = width - self.rank
        self.condition = (
            float(largest / self._values[-1])
            if len(self._values) == width > 0 and not self.defect
            else (np.inf if self.defect else 1.0)
        )

    @cached_property
    def root(self) -> Array:
        """Matrix (p, rank) whose product with its transpose is the covariance of the free columns."""
        inner = self._right[: self.rank].T / self._values[: self.rank]
        outer = inner if self._basis is None else self._basis @ inner
        return outer / self._scale[:, None]

    @cached_property
    def null(self) -> Array:
        """Directions (p, defect) that change no reading and break no condition, in scaled columns' natural units."""
        inner = self._right[self.rank :].T
        return (inner if self._basis is None else self._basis @ inner) / self._scale[:, None]

    @cached_property
    def matrix(self) -> Array:
        """Covariance (p, p) of the free columns (of the estimable part where there is a defect)."""
        return self.root @ self.root.T

    def covariance(self, functions: Array) -> Array:
        """Covariance (k, k) of linear functions (k, p) of the free columns."""
        mapped = functions @ self.root
        return mapped @ mapped.T

    def solve(self, right: Array) -> Array:
        """Inverse normal matrix times right (p, k)."""
        return self.root @ (self.root.T @ right)

    def between(self, first: Index, second: Index) -> Array:
        """Covariances (m, f, g) of free columns first (m, f) with second (m, g); -1 stands for a held column."""
        block = gathered(self.matrix, first, second)
        return block * (first >= 0)[:, :, None] * (second >= 0)[:, None, :]


def gathered(matrix: Array, rows: Index, columns: Index) -> Array:
    """Elements (m, f, g) of a matrix at rows (m, f) and columns (m, g); -1 gathers anything."""
    return matrix.ravel().take(rows[:, :, None] * matrix.shape[1] + columns[:, None, :], mode="wrap")
