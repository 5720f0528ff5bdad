"""Elimination: many small independent blocks leave the normal equations of a large problem before the rest is
factored."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import cached_property

import numpy as np

from calib.accumulation import leverages_compiled
from calib.blocks import Array, Block, Index
from calib.coupling import Coupling
from calib.factor import RANK_TOLERANCE, Conditions, DenseFactor, gathered, null_space
from calib.layout import Layout
from calib.normal import NormalEquations
from calib.pattern import Source

SURE = 1e3  # how far from the tolerance of the rank a bound on the smallest eigenvalue settles it
DENSE_SIZE = 250  # unknowns up to which an orthogonal factor of all rows is cheaper than looking for blocks


class EliminatedFactor:
    """Normal equations with the many small independent blocks of one unknown eliminated; attributes as DenseFactor.

    equations; conditions: on columns that are not eliminated; damping: (p,) added to the diagonal, or None.
    """

    def __init__(self, equations: NormalEquations, conditions: Conditions, damping: Array | None = None):
        self._pattern = pattern = equations.pattern
        self.size = pattern.size
        m, f = pattern.inner.shape
        self._slot, self._is_inner = np.empty(self.size, dtype=np.int64), np.zeros(self.size, dtype=bool)
        self._slot[pattern.outer] = np.arange(len(pattern.outer))
        self._slot[pattern.inner], self._is_inner[pattern.inner] = np.arange(m)[:, None], True
        springs = np.zeros(self.size) if damping is None else damping
        scale = np.sqrt(equations.squares + springs)
        scale = np.where(scale > 0, scale, 1.0)
        self._wide, narrow = scale[pattern.outer], scale[pattern.inner].reshape(m, f)
        small = equations.inner / (narrow[:, :, None] * narrow[:, None, :])
        small += (springs[pattern.inner].reshape(m, f) / narrow**2)[:, :, None] * np.eye(f)
        half, self._weak = _roots(small)
        self._half = half / narrow[:, None, :]  # (m, f, f), half N half' = identity
        self._weak = {i: axes / narrow[i][:, None] for i, axes in self._weak.items()}
        self._coupled = equations.coupling.mapped(self._half)
        self._inner_target = np.einsum("mfg,mg->mf", self._half, equations.pull_inner)
        square, pull = self._coupled.squared(self._inner_target)
        normal = equations.outer + np.diag(springs[pattern.outer]) - square
        self._finish(normal / np.outer(self._wide, self._wide), (equations.pull_outer - pull) / self._wide, conditions)

    def _finish(self, normal: Array, target: Array, conditions: Conditions) -> None:
        basis, particular = None, np.zeros(len(self._wide))
        if len(conditions.target):
            matrix = conditions.matrix[:, self._pattern.outer] / self._wide
            basis, particular = null_space(matrix, conditions.target)
            target = basis.T @ (target - normal @ particular)
            normal = basis.T @ normal @ basis
        self._normal = normal
        reduced, none = _outer_root(normal)
        weak = sum(a.shape[1] for a in self._weak.values())
        self.rank = reduced.shape[1] + self._pattern.inner.size - weak
        mine = reduced if basis is None else basis @ reduced
        self._root = mine / self._wide[:, None]  # covariance of outer = root root'
        hidden = none if basis is None else basis @ none
        self._outer_null = hidden / self._wide[:, None]
        pull = reduced.T @ target
        outer_step = (mine @ pull + particular) / self._wide
        self.step = self._whole(self._inner_target - self._coupled.times(outer_step[:, None])[:, :, 0], outer_step)
        self.decrement = float(np.hypot(np.linalg.norm(pull), np.linalg.norm(self._inner_target)))
        self.defect = self._outer_null.shape[1] + weak

    @cached_property
    def condition(self) -> float:
        """Of the scaled derivatives that are left when the blocks are eliminated; infinite with a defect among them."""
        if self._outer_null.shape[1] or not len(self._normal):
            return np.inf if self._outer_null.shape[1] else 1.0
        values = np.linalg.eigvalsh(self._normal)
        return float(np.sqrt(values[-1] / values[0]))

    def _whole(self, inner: Array, outer: Array) -> Array:
        """A step (p,) of outer columns and of inner ones (m, f) that stand before their own root."""
        step = np.empty(self.size)
        step[self._pattern.outer] = outer
        step[self._pattern.inner] = np.einsum("mgf,mg->mf", self._half, inner)
        return step

    @cached_property
    def null(self) -> Array:
        """Directions (p, defect) that change no reading and break no condition."""
        columns = [self._whole(-self._coupled.times(d[:, None])[:, :, 0], d) for d in self._outer_null.T]
        for i, axes in self._weak.items():
            for axis in axes.T:
                direction = np.zeros(self.size)
                direction[self._pattern.inner[i]] = axis
                columns.append(direction)
        return np.array(columns).reshape(-1, self.size).T

    def _mapped(self, functions: Array) -> tuple[Array, Array]:
        """Functions (k, p) through the outer root (k, rank) and through the inner blocks (m, f, k)."""
        own = np.einsum("mgf,kmf->mgk", self._half, functions[:, self._pattern.inner])
        outer = functions[:, self._pattern.outer] - self._coupled.transposed_times(own).T
        return outer @ self._root, own

    def covariance(self, functions: Array) -> Array:
        """Covariance (k, k) of linear functions (k, p) of the free columns."""
        through, own = self._mapped(functions)
        flat = own.reshape(own.shape[0] * own.shape[1], len(functions))
        return through @ through.T + flat.T @ flat

    def solve(self, right: Array) -> Array:
        """Inverse normal matrix times right (p, k)."""
        through, own = self._mapped(right.T)
        outer = self._root @ through.T
        own = own - self._coupled.times(outer)
        return np.stack([self._whole(own[:, :, k], outer[:, k]) for k in range(right.shape[1])], axis=1)

    @cached_property
    def _outer_covariance(self) -> Array:
        return self._root @ self._root.T

    @cached_property
    def _within(self) -> tuple[Coupling, Array]:
        """What the outer covariance adds: with the outer columns that rows have in common, and (m, f, f) of inner
        columns with the identity; both stand before their own root."""
        within, squares = self._coupled.within(self._outer_covariance)
        return within, squares + np.eye(self._pattern.freedom)

    @cached_property
    def _eliminated_covariance(self) -> tuple[Array, Coupling]:
        """Covariance (m, f, f) of inner columns, and that with the outer columns which rows have in common."""
        (within, middle), turned = self._within, self._half.transpose(0, 2, 1)
        return turned @ middle @ self._half, within.mapped(-turned)

    def leverages(self, source: Source, number: int) -> Array | None:
        """Diagonal (n, dim) of J C J' of the whitened readings of a source, the `number`th of the pattern; None where
        no compiled loop goes through them."""
        within, middle = self._within
        return leverages_compiled(source, [s for s in self._pattern.streams if s.source == number], self._half, middle,
                                  within.values, np.pad(self._outer_covariance, (0, 1)))

    def _dense_cross(self, owner: Index) -> Array:
        """Covariance (n, f, S) of eliminated instances (n,) with all outer columns."""
        rows = self._coupled.rows(owner) @ self._outer_covariance
        return np.asarray(-np.einsum("ngf,ngs->nfs", self._half[owner], rows))

    def between(self, first: Index, second: Index) -> Array:
        """Covariances (n, f, g) of free columns first (n, f) with second (n, g); -1 stands for a held column.

        A row of first, and of second, belongs to one instance of one unknown.
        """
        kinds = [(c[:, 0] >= 0) & self._is_inner[c[:, 0]] for c in (first, second)]
        kind = 2 * kinds[0] + kinds[1]
        if len(kind) and np.all(kind == kind[0]):
            return self._alike(first, second, int(kind[0]))
        result = np.zeros((*first.shape, second.shape[1]))
        for one in np.unique(kind).tolist():
            rows = np.flatnonzero(kind == one)
            result[rows] = self._alike(first[rows], second[rows], one)
        return result

    def _alike(self, first: Index, second: Index, kind: int) -> Array:
        """The same where all rows of first are eliminated (kind 2 or 3) or none, and so of second (1 or 3)."""
        a, b = (np.where(c >= 0, self._slot[c], 0) for c in (first, second))
        if kind == 3:
            block = self._between_inner(a[:, 0], b[:, 0])
        elif kind == 2:
            block = self._between_inner_and_outer(a[:, 0], b, second >= 0)
        elif kind == 1:
            block = self._between_inner_and_outer(b[:, 0], a, first >= 0).transpose(0, 2, 1)
        else:
            block = gathered(self._outer_covariance, a, b)
        held = (first < 0).any() or (second < 0).any()
        return block * (first >= 0)[:, :, None] * (second >= 0)[:, None, :] if held else block

    def _between_inner(self, first: Index, second: Index) -> Array:
        same = first == second
        if same.all():
            return self._eliminated_covariance[0][first]
        apart = np.flatnonzero(~same)
        block = self._eliminated_covariance[0][first]
        left, right = self._dense_cross(first[apart]), self._coupled.rows(second[apart])
        block[apart] = -np.einsum("nfs,ngs,ngh->nfh", left, right, self._half[second[apart]], optimize=True)
        return block

    def _between_inner_and_outer(self, owner: Index, slots: Index, known: Array) -> Array:
        cross = self._eliminated_covariance[1]
        places = cross.places(owner, slots)
        block = cross.at(owner, places)
        apart = np.flatnonzero(((places < 0) & known).any(axis=1))
        if len(apart):
            block = block.copy()
            rows = self._dense_cross(owner[apart])
            block[apart] = np.take_along_axis(rows, np.broadcast_to(slots[apart][:, None, :], (
                len(apart), rows.shape[1], slots.shape[1])), axis=2)
        return block

    @cached_property
    def matrix(self) -> Array:
        """Covariance (p, p) of all free columns; only sensible where p is moderate."""
        return self.covariance(np.eye(self.size))


Factor = DenseFactor | EliminatedFactor


def _outer_root(normal: Array) -> tuple[Array, Array]:
    """Matrix (S, rank) whose product with its transpose is the inverse of a normal matrix (S, S), and the axes (S,
    defect) along which that vanishes."""
    if not len(normal):
        return normal, normal
    with suppress(np.linalg.LinAlgError):
        root = np.linalg.inv(np.linalg.cholesky(normal)).T
        # No eigenvalue is beyond the trace, none below this norm: the axes are looked for only where that is in doubt.
        if SURE * RANK_TOLERANCE * np.trace(normal) * np.vdot(root, root) < 1.0:
            return root, normal[:, :0]
    values, axes = np.linalg.eigh(normal)
    strong = values > RANK_TOLERANCE * max(values[-1], 1e-300)
    return axes[:, strong] / np.sqrt(values[strong]), axes[:, ~strong]


def _roots(small: Array) -> tuple[Array, dict[int, Array]]:
    """Matrices half (m, f, f) with half N half' = identity, of symmetric N (m, f, f) with ones on the diagonal; the
    axes (f, k) along which some of them vanish, and half with them."""
    m, f, _ = small.shape
    entries = np.ascontiguousarray(small.transpose(1, 2, 0))
    lower, half, volume = np.zeros_like(entries), np.zeros_like(entries), np.ones(m)
    for j in range(f):
        pivot = entries[j, j] - sum((lower[j, k] ** 2 for k in range(j)), np.zeros(m))
        volume *= np.maximum(pivot, 0.0)
        lower[j, j] = np.sqrt(np.maximum(pivot, 1e-300))
        for i in range(j + 1, f):
            lower[i, j] = (entries[i, j] - sum(lower[i, k] * lower[j, k] for k in range(j))) / lower[j, j]
    for j in range(f):
        half[j, j] = 1.0 / lower[j, j]
        for i in range(j + 1, f):
            half[i, j] = -sum(lower[i, k] * half[k, j] for k in range(j, i)) / lower[i, i]
    found, weak = np.ascontiguousarray(half.transpose(2, 0, 1)), {}
    # No eigenvalue is beyond f, so that the volume bounds the smallest: only the doubtful ones are looked at.
    doubtful = np.flatnonzero(~(volume > 10.0 * RANK_TOLERANCE * float(f) ** f))
    if len(doubtful):
        lengths, axes = np.linalg.eigh(small[doubtful])
        none = lengths <= RANK_TOLERANCE * np.maximum(lengths[:, -1:], 1e-300)
        roots = np.where(none, 0.0, 1 / np.sqrt(np.where(none, 1.0, lengths)))
        found[doubtful] = roots[:, :, None] * axes.transpose(0, 2, 1)
        weak = {int(i): axes[k][:, none[k]] for k, i in enumerate(doubtful) if none[k].any()}
    return found, weak


def factorise(blocks: Sequence[Block], layout: Layout, conditions: Conditions, damping: Array | None = None
              ) -> DenseFactor:
    """Factor the normal equations of whitened rows of a small problem.

    blocks: whitened residuals and derivatives; layout: their columns; conditions: on the free columns.
    damping: (p,) added to the diagonal of the normal matrix, or None.
    """
    size = len(layout.free_columns)
    rows = [b.dense(layout.position, size) for b in blocks]
    return DenseFactor(np.concatenate(rows), np.concatenate([b.residual.ravel() for b in blocks]), conditions, damping)
