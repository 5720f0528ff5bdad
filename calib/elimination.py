"""Elimination: many small blocks leave the normal equations of a large problem before the rest is factored."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from calib.blocks import Array, Block, Index
from calib.factor import RANK_TOLERANCE, Conditions, DenseFactor, gathered, null_space
from calib.layout import Layout
from calib.normal import NormalEquations
from calib.unknown import Unknown

DENSE_SIZE = 250  # unknowns up to which an orthogonal factor of all rows is cheaper than looking for blocks


class EliminatedFactor:
    """Normal equations with the many small independent blocks of one unknown eliminated; attributes as DenseFactor."""

    def __init__(
        self,
        blocks: Sequence[Block],
        layout: Layout,
        unknown: Unknown | None,
        conditions: Conditions,
        damping: Array | None = None,
    ):
        self.size = len(layout.free_columns)
        inside = np.zeros(self.size, dtype=bool)
        self._count, self._freedom = 0, 1
        if unknown is not None:
            places = layout.position[layout.span(unknown)].reshape(unknown.count, unknown.freedom)
            places = places[np.all(places >= 0, axis=1)]
            inside[places.ravel()] = True
            self._count, self._freedom = places.shape
        self._inner, self._outer = np.flatnonzero(inside), np.flatnonzero(~inside)
        self._slot = np.empty(self.size, dtype=np.int64)
        self._slot[self._inner], self._slot[self._outer] = np.arange(len(self._inner)), np.arange(len(self._outer))
        self._is_inner = inside
        m, f, others = self._count, self._freedom, len(self._outer)
        free = layout.position >= 0
        instance, slot = np.full(layout.size, m), np.full(layout.size, others)
        mine = free.copy()
        mine[free] = inside
        instance[mine] = self._slot[layout.position[mine]] // f
        slot[free & ~mine] = self._slot[layout.position[free & ~mine]]
        sums = NormalEquations.of(blocks, instance, slot, m, f, others)
        squares = np.empty(self.size)
        squares[self._inner], squares[self._outer] = np.einsum("mff->mf", sums.inner).ravel(), np.diag(sums.outer)
        springs = np.zeros(self.size) if damping is None else damping
        self._scale = np.sqrt(squares + springs)
        self._scale = np.where(self._scale > 0, self._scale, 1.0)
        springs = springs / self._scale**2
        wide, narrow = self._scale[self._outer], self._scale[self._inner].reshape(m, f)
        normal = sums.outer / np.outer(wide, wide) + np.diag(springs[self._outer])
        target = sums.pull_outer / wide
        self._defective = np.zeros(0, dtype=np.int64)
        self._weak_axes: list[Array] = []
        small = sums.inner / (narrow[:, :, None] * narrow[:, None, :])
        small += springs[self._inner].reshape(m, f, 1) * np.eye(f)
        lengths, axes = np.linalg.eigh(small)
        weak = lengths <= RANK_TOLERANCE * np.maximum(lengths[:, -1:], 1e-300)
        self._defective = np.flatnonzero(weak.any(axis=1))
        inverse_root = np.where(weak, 0.0, 1 / np.sqrt(np.where(weak, 1.0, lengths)))
        self._half = inverse_root[:, :, None] * axes.transpose(0, 2, 1)  # (m, f, f), half N half' = identity
        self._weak_axes = [axes[i][:, weak[i]] for i in self._defective]
        self._coupled = (self._half / narrow[:, None, :]) @ sums.cross / wide
        flat = self._coupled.reshape(m * f, -1)
        self._inner_target = (self._half @ (sums.pull_inner / narrow)[:, :, None])[:, :, 0]
        normal -= flat.T @ flat
        target -= flat.T @ self._inner_target.ravel()
        self._finish(normal, target, conditions)

    def _finish(self, normal: Array, target: Array, conditions: Conditions) -> None:
        basis, particular = None, np.zeros(len(self._outer))
        if len(conditions.target):
            basis, particular = null_space((conditions.matrix / self._scale)[:, self._outer], conditions.target)
            target = basis.T @ (target - normal @ particular)
            normal = basis.T @ normal @ basis
        values, axes = np.linalg.eigh(normal) if len(normal) else (np.zeros(0), np.zeros((0, 0)))
        largest = values[-1] if len(values) else 1.0
        strong = values > RANK_TOLERANCE * max(largest, 1e-300)
        self.rank = int(strong.sum()) + self._count * self._freedom - sum(a.shape[1] for a in self._weak_axes)
        self.condition = (
            float(np.sqrt(largest / values[0]))
            if len(values) and strong.all()
            else (1.0 if not len(values) else np.inf)
        )
        reduced = axes[:, strong] / np.sqrt(values[strong])
        self._reduced_root = reduced if basis is None else basis @ reduced  # covariance of outer = root root'
        weak = axes[:, ~strong]
        self._reduced_null = weak if basis is None else basis @ weak
        outer_step = self._reduced_root @ (reduced.T @ target) + particular
        step = np.zeros(self.size)
        step[self._outer] = outer_step
        if self._count:
            inner = self._inner_target - self._coupled @ outer_step
            step[self._inner] = np.einsum("mji,mj->mi", self._half, inner).ravel()
        self.step = step / self._scale
        parts = (
            float(np.linalg.norm(reduced.T @ target)),
            float(np.linalg.norm(self._inner_target)) if self._count else 0.0,
        )
        self.decrement = float(np.hypot(*parts))
        self.defect = self._reduced_null.shape[1] + sum(a.shape[1] for a in self._weak_axes)

    @cached_property
    def _inner_root(self) -> Array:
        """(m, f, rank) root of the part of the eliminated covariance that comes through the outer unknowns, signed."""
        return -np.einsum("mji,mjs->mis", self._half, self._coupled @ self._reduced_root)

    @cached_property
    def null(self) -> Array:
        """Directions (p, defect) that change no reading and break no condition."""
        columns = []
        for k in range(self._reduced_null.shape[1]):
            direction = np.zeros(self.size)
            direction[self._outer] = self._reduced_null[:, k]
            if self._count:
                direction[self._inner] = -np.einsum(
                    "mji,mj->mi", self._half, self._coupled @ self._reduced_null[:, k]
                ).ravel()
            columns.append(direction)
        for i, axes in zip(self._defective, self._weak_axes if self._count else [], strict=True):
            for axis in axes.T:
                direction = np.zeros(self.size)
                direction[self._inner[i * self._freedom : (i + 1) * self._freedom]] = axis
                columns.append(direction)
        return (np.array(columns).reshape(-1, self.size) / self._scale).T

    def _mapped(self, functions: Array) -> tuple[Array, Array]:
        """Functions (k, p) through the outer root (k, rank) and through the inner blocks (k, m f)."""
        scaled = functions / self._scale
        through = scaled[:, self._outer] @ self._reduced_root
        own = np.zeros((len(functions), 0))
        if self._count:
            inner = scaled[:, self._inner].reshape(len(functions), self._count, self._freedom)
            through = through + np.einsum("kmf,mfs->ks", inner, self._inner_root)
            own = np.einsum("kmf,mgf->kmg", inner, self._half).reshape(len(functions), -1)
        return through, own

    def covariance(self, functions: Array) -> Array:
        """Covariance (k, k) of linear functions (k, p) of the free columns."""
        through, own = self._mapped(functions)
        return through @ through.T + own @ own.T

    def solve(self, right: Array) -> Array:
        """Inverse normal matrix times right (p, k)."""
        through, own = self._mapped(right.T)
        solution = np.zeros_like(right)
        solution[self._outer] = self._reduced_root @ through.T
        if self._count:
            inner = np.einsum("mfs,ks->mfk", self._inner_root, through)
            inner += np.einsum("mgf,kmg->mfk", self._half, own.reshape(right.shape[1], self._count, self._freedom))
            solution[self._inner] = inner.reshape(-1, right.shape[1])
        return solution / self._scale[:, None]

    @cached_property
    def _full_root(self) -> Array:
        """(p, rank) root of the covariance that comes through the outer unknowns, in scaled columns."""
        root = np.zeros((self.size, self._reduced_root.shape[1]))
        root[self._outer] = self._reduced_root
        if self._count:
            root[self._inner] = self._inner_root.reshape(-1, root.shape[1])
        return root

    @cached_property
    def _outer_covariance(self) -> Array:
        return self._reduced_root @ self._reduced_root.T

    @cached_property
    def _cross_covariance(self) -> Array:
        return self._inner_root.reshape(len(self._inner), -1) @ self._reduced_root.T

    @cached_property
    def _inner_covariance(self) -> Array:
        return self._inner_root @ self._inner_root.transpose(0, 2, 1) + self._half.transpose(0, 2, 1) @ self._half

    def between(self, first: Index, second: Index) -> Array:
        """Covariances (m, f, g) of free columns first (m, f) with second (m, g); -1 stands for a held column."""
        a_inner, b_inner = self._is_inner[first[first >= 0][0]], self._is_inner[second[second >= 0][0]]
        a, b = np.where(first >= 0, self._slot[first], 0), np.where(second >= 0, self._slot[second], 0)
        if not a_inner and not b_inner:
            block = gathered(self._outer_covariance, a, b)
        elif a_inner and not b_inner:
            block = gathered(self._cross_covariance, a, b)
        elif b_inner and not a_inner:
            block = gathered(self._cross_covariance, b, a).transpose(0, 2, 1)
        elif first.shape == second.shape and np.array_equal(a, b):
            block = self._inner_covariance[a[:, 0] // self._freedom]
        else:
            root = self._full_root
            block = root[first] @ root[second].transpose(0, 2, 1)
            same = (a[:, 0] // self._freedom) == (b[:, 0] // self._freedom)
            own = self._half.transpose(0, 2, 1) @ self._half
            block[same] += own[a[same, 0] // self._freedom]
        scaled = block / (self._scale[first][:, :, None] * self._scale[second][:, None, :])
        return scaled * (first >= 0)[:, :, None] * (second >= 0)[:, None, :]

    @cached_property
    def matrix(self) -> Array:
        """Covariance (p, p) of all free columns; only sensible where p is moderate."""
        return self.covariance(np.eye(self.size))


Factor = DenseFactor | EliminatedFactor


def _eliminable(blocks: Sequence[Block], layout: Layout, conditions: Conditions) -> Unknown | None:
    """The unknown with the most columns of which no block of rows touches two instances and no condition any."""
    best, most = None, 0
    for unknown in layout.unknowns:
        span = layout.span(unknown)
        free = layout.free[span].reshape(unknown.count, unknown.freedom)
        if unknown.count < 2 or not np.all(free.all(axis=1) | ~free.any(axis=1)):
            continue
        size = int(free.sum())
        if size <= most or (
            len(conditions.target) and np.any(conditions.matrix[:, layout.position[span][free.ravel()]])
        ):
            continue
        alone = True
        for block in blocks:
            touching = [p.columns[:, 0] for p in block.parts if span.start <= p.columns[0, 0] < span.stop]
            alone = alone and all(np.array_equal(touching[0], other) for other in touching[1:])
        if alone:
            best, most = unknown, size
    return best


def factorise(blocks: Sequence[Block], layout: Layout, conditions: Conditions, damping: Array | None = None) -> Factor:
    """Factor the normal equations of whitened rows: dense where small, else with blocks eliminated.

    blocks: whitened residuals and derivatives; layout: their columns; conditions: on the free columns.
    damping: (p,) added to the diagonal of the normal matrix, or None.
    """
    size = len(layout.free_columns)
    if size <= DENSE_SIZE:
        rows = [b.dense(layout.position, size) for b in blocks]
        return DenseFactor(
            np.concatenate(rows), np.concatenate([b.residual.ravel() for b in blocks]), conditions, damping
        )
    return EliminatedFactor(blocks, layout, _eliminable(blocks, layout, conditions), conditions, damping)
