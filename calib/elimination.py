"""Factors of the normal equations: dense for small problems, many small blocks eliminated for large ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array, Block, Part
from calib.layout import Layout
from calib.unknown import Unknown

RANK_TOLERANCE = 1e-12  # of the singular values of the column-scaled derivatives, relative to the largest
DENSE_SIZE = 250  # unknowns up to which an orthogonal factor of all rows is cheaper than looking for blocks
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Conditions:
    """Linear conditions matrix x = target on the free columns; matrix (m, p), target (m,)."""

    matrix: Array
    target: Array

    @staticmethod
    def none(size: int) -> Conditions:
        """No conditions on `size` columns."""
        return Conditions(np.zeros((0, size)), np.zeros(0))

    def pinned(self, places: Index, values: Array) -> Conditions:
        """The same with the columns `places` set to values."""
        rows = np.zeros((len(places), self.matrix.shape[1]))
        rows[np.arange(len(places)), places] = 1.0
        return Conditions(np.concatenate([self.matrix, rows]), np.concatenate([self.target, values]))


def _null_space(matrix: Array, target: Array) -> tuple[Array, Array]:
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
            self._basis, particular = _null_space(conditions.matrix / self._scale, conditions.target)
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
        block = _gathered(self.matrix, first, second)
        return block * (first >= 0)[:, :, None] * (second >= 0)[:, None, :]


def _gathered(matrix: Array, rows: Index, columns: Index) -> Array:
    """Elements (m, f, g) of a matrix at rows (m, f) and columns (m, g); -1 gathers anything."""
    return matrix.ravel().take(rows[:, :, None] * matrix.shape[1] + columns[:, None, :], mode="wrap")


@dataclass(frozen=True)
class _Sums:
    """Normal equations of one eliminated unknown of m instances with f columns, and the S other free columns.

    inner (m, f, f), cross (m, f, S), outer (S, S): blocks of J'J; pull_inner (m, f), pull_outer (S,): J'r.
    """

    inner: Array
    cross: Array
    outer: Array
    pull_inner: Array
    pull_outer: Array

    @staticmethod
    def of(blocks: Sequence[Block], instance: Index, slot: Index, m: int, f: int, size: int) -> _Sums:
        """Accumulate blocks.

        instance: of every column, m where it is not eliminated; slot: of every column among the others, S where held.
        """
        sums = _Sums(
            np.zeros((m + 1, f, f)),
            np.zeros((m + 1, f, size + 1)),
            np.zeros((size + 1, size + 1)),
            np.zeros((m + 1, f)),
            np.zeros(size + 1),
        )  # the last place takes what is held
        for block in blocks:
            inside = [p for p in block.parts if _is_eliminated(p, instance, m)]
            outside = [p for p in block.parts if not _is_eliminated(p, instance, m)]
            for part in inside:
                mine = instance[part.columns[:, 0]]
                np.add.at(sums.pull_inner, mine, _products(part.jacobian, block.residual[:, :, None])[:, :, 0])
                for other in inside:
                    np.add.at(sums.inner, mine, _products(part.jacobian, other.jacobian))
                for other in outside:
                    places = (mine[:, None] * f + np.arange(f))[:, :, None] * (size + 1) + slot[other.columns][
                        :, None, :
                    ]
                    np.add.at(sums.cross.reshape(-1), places.ravel(), _products(part.jacobian, other.jacobian).ravel())
            for part in outside:
                mine = slot[part.columns]
                np.add.at(sums.pull_outer, mine.ravel(), _products(part.jacobian, block.residual[:, :, None]).ravel())
                for other in outside:
                    _add_pairs(sums.outer, mine, slot[other.columns], _products(part.jacobian, other.jacobian))
        return _Sums(
            sums.inner[:m],
            sums.cross[:m, :, :size],
            sums.outer[:size, :size],
            sums.pull_inner[:m],
            sums.pull_outer[:size],
        )


def _is_eliminated(part: Part, instance: Index, m: int) -> bool:
    return bool(np.any(instance[part.columns[:, 0]] < m))


def _products(left: Array, right: Array) -> Array:
    """Derivatives (n, d, f) and (n, d, g) multiplied row by row: (n, f, g)."""
    return left.transpose(0, 2, 1) @ right


def _add_pairs(matrix: Array, rows: Index, columns: Index, products: Array) -> None:
    """Add products (n, f, g) at rows (n, f) and columns (n, g), summing first what goes to the same places."""
    if not (_run_on(rows) and _run_on(columns)):
        np.add.at(matrix, (rows[:, :, None], columns[:, None, :]), products)
        return
    keys = rows[:, 0] * len(matrix) + columns[:, 0]
    order = np.argsort(keys, kind="stable")
    first = np.flatnonzero(np.diff(keys[order], prepend=-1))
    summed = np.add.reduceat(products.reshape(len(products), -1)[order], first, axis=0)
    chosen = order[first]
    np.add.at(matrix, (rows[chosen][:, :, None], columns[chosen][:, None, :]), summed.reshape(-1, *products.shape[1:]))


def _run_on(places: Index) -> bool:
    """Whether the first place of every row tells the others, as it does unless some of them are held."""
    return bool(np.all(places == places[:, :1] + np.arange(places.shape[1])))


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
        sums = _Sums.of(blocks, instance, slot, m, f, others)
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
            basis, particular = _null_space((conditions.matrix / self._scale)[:, self._outer], conditions.target)
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
            block = _gathered(self._outer_covariance, a, b)
        elif a_inner and not b_inner:
            block = _gathered(self._cross_covariance, a, b)
        elif b_inner and not a_inner:
            block = _gathered(self._cross_covariance, b, a).transpose(0, 2, 1)
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


def sparse_rows(blocks: Sequence[Block], layout: Layout):  # type: ignore[no-untyped-def]
    """All whitened derivatives as one sparse matrix (N, p) over the free columns, and the residuals (N,)."""
    from scipy import sparse

    data, rows, columns, residuals, begin = [], [], [], [], 0
    for block in blocks:
        m, d = block.residual.shape
        numbers = begin + np.arange(m * d).reshape(m, d)
        for part in block.parts:
            place = np.broadcast_to(layout.position[part.columns][:, None, :], part.jacobian.shape)
            row = np.broadcast_to(numbers[:, :, None], part.jacobian.shape)
            kept = (place >= 0).ravel()
            whole = bool(kept.all())
            data.append(part.jacobian.ravel() if whole else part.jacobian.ravel()[kept])
            rows.append(row.ravel() if whole else row.ravel()[kept])
            columns.append(place.ravel() if whole else place.ravel()[kept])
        residuals.append(block.residual.ravel())
        begin += m * d
    shape = (begin, len(layout.free_columns))
    if not data:
        return sparse.csr_matrix(shape), np.concatenate(residuals)
    return sparse.csr_matrix(
        (np.concatenate(data), (np.concatenate(rows), np.concatenate(columns))), shape
    ), np.concatenate(residuals)


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
