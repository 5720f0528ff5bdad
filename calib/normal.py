"""Normal equations accumulated from blocks of rows: many small blocks of one unknown, and the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.blocks import Array, Block, Index, Part
from calib.layout import Layout


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations of one eliminated unknown of m instances with f columns, and the S other free columns.

    inner (m, f, f), cross (m, f, S), outer (S, S): blocks of J'J; pull_inner (m, f), pull_outer (S,): J'r.
    """

    inner: Array
    cross: Array
    outer: Array
    pull_inner: Array
    pull_outer: Array

    @staticmethod
    def of(blocks: Sequence[Block], instance: Index, slot: Index, m: int, f: int, size: int) -> NormalEquations:
        """Accumulate blocks.

        instance: of every column, m where it is not eliminated; slot: of every column among the others, S where held.
        """
        sums = NormalEquations(
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
        return NormalEquations(
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
