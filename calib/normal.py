"""Normal equations accumulated while rows are evaluated: the derivatives of a large problem are never stored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.accumulation import Sums, accumulate_compiled
from calib.blocks import Array, Block, Index, Mixing
from calib.coupling import Coupling
from calib.layout import Layout
from calib.pattern import PIECE, Pattern, Source, Stream


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations of m eliminated instances with f columns each, and the S other free columns.

    inner (m, f, f), coupling (m, f, S), outer (S, S): blocks of J'J; pull_inner (m, f), pull_outer (S,): J'r;
    objective: v'Pv.
    """

    pattern: Pattern
    inner: Array
    coupling: Coupling
    outer: Array
    pull_inner: Array
    pull_outer: Array
    objective: float

    @staticmethod
    def of(sources: Sequence[Source], pattern: Pattern, left: object = None) -> NormalEquations:
        """Evaluate and accumulate all rows; left: equations that are of no more use, whose coupling is written over:
        memory that is there costs less than new."""
        m, f, others = len(pattern.inner), pattern.freedom, len(pattern.outer)
        if isinstance(left, NormalEquations) and left.pattern is pattern:
            coupling = left.coupling.values
            coupling[:] = 0.0
        else:
            coupling = np.zeros((f, len(pattern.columns) + 1))
        sums = Sums(np.zeros((m, f, f)), coupling, np.zeros((others + 1, others + 1)), np.zeros((m, f)),
                    np.zeros(others + 1))
        for stream in pattern.streams:
            source = sources[stream.source]
            if not accumulate_compiled(sums, source, stream):
                _accumulate(sums, source, stream)
        for k in range(f):  # below the diagonal only what compiled loops have added is there
            sums.inner[:, :k, k] = sums.inner[:, k, :k]
        return NormalEquations(pattern, sums.inner, Coupling(pattern.first, pattern.columns, sums.coupling, others),
                               sums.outer[:others, :others], sums.pull_inner, sums.pull_outer[:others], sums.objective)

    def _free(self, inner: Array, outer: Array) -> Array:
        whole = np.empty(self.pattern.size)
        whole[self.pattern.inner.ravel()], whole[self.pattern.outer] = inner.ravel(), outer
        return whole

    @property
    def pull(self) -> Array:
        """J'r (p,)."""
        return self._free(self.pull_inner, self.pull_outer)

    @property
    def squares(self) -> Array:
        """Diagonal of J'J (p,)."""
        return self._free(np.einsum("mff->mf", self.inner), np.diag(self.outer))

    def along(self, step: Array) -> float:
        """step' J'J step, of a step (p,)."""
        inner, outer = step[self.pattern.inner], step[self.pattern.outer]
        crossed = self.coupling.times(outer[:, None])[:, :, 0]
        own = np.einsum("mf,mfg,mg->", inner, self.inner, inner)
        return float(own + 2 * np.vdot(inner, crossed) + outer @ self.outer @ outer)


def _accumulate(sums: Sums, source: Source, stream: Stream) -> None:
    mixing = source.whitening[stream.mixing]
    step = max(1, PIECE // mixing.rows.shape[1])
    outer = [np.zeros((p.rows.shape[1], p.columns.shape[1], len(p.rows))) for p in stream.pairs]
    pulls = [np.zeros((p.rows.shape[1], len(p.rows))) for p in stream.pairs if p.first == p.second]
    for begin in range(0, len(stream.blocks), step):
        here = slice(begin, begin + step)
        residual, derivatives = whitened(source, mixing, stream.blocks[here])
        sums.objective += float(np.vdot(residual, residual))
        outside = [derivatives[j, a] for j, a in stream.outside]
        if stream.inside:
            mine = sum((derivatives[key] for key in stream.inside[1:]), derivatives[stream.inside[0]])
            _inside(sums, stream, here, mine, outside, residual)
        for pair, total in zip(stream.pairs, outer, strict=True):
            index, many = pair.index[here], total.shape[2]
            products = np.einsum("adc,bdc->abc", outside[pair.first], outside[pair.second])
            for row, of_row in zip(total, products, strict=True):
                for cell, product in zip(row, of_row, strict=True):
                    cell += np.bincount(index, product, many) if many > 1 else product.sum()
            if pair.first == pair.second:
                for cell, pull in zip(pulls[pair.first], np.einsum("adc,dc->ac", outside[pair.first], residual),
                                      strict=True):
                    cell += np.bincount(index, pull, many) if many > 1 else pull.sum()
    sums.add_outer(stream, [t.transpose(2, 0, 1) for t in outer], [p.T for p in pulls])


def _inside(sums: Sums, stream: Stream, here: slice, mine: Array, outside: list[Array], residual: Array) -> None:
    """Add products with the eliminated columns, derivatives mine (f, d, c), of some blocks of a stream."""
    owner, places = stream.owner[here], stream.places[:, here]
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    met = owner[starts]
    square = np.add.reduceat(np.einsum("kdc,ldc->klc", mine, mine), starts, axis=2)
    sums.inner[met] += square.transpose(2, 0, 1)
    sums.pull_inner[met] += np.add.reduceat(np.einsum("kdc,dc->kc", mine, residual), starts, axis=1).T
    if outside:
        crossed = np.einsum("kdc,odc->koc", mine, np.concatenate(outside))
        for plane, products in zip(sums.coupling, crossed, strict=True):
            if stream.alone:
                plane[places] += products
            else:
                np.add.at(plane, places, products)


def whitened(source: Source, mixing: Mixing, blocks: Index) -> tuple[Array, dict[tuple[int, int], Array]]:
    """Whitened residuals (d, c) of some blocks (c,) of a row operation, and derivatives (f, d, c) for each
    (row of the block, argument)."""
    rows, matrix = mixing.rows[blocks], mixing.matrix[blocks]
    if matrix.ndim == 2:
        weight = np.ascontiguousarray(matrix.T)
        residual, derivatives = source.evaluate(rows[:, 0])
        return weight * residual, {(0, a): weight * one for a, one in enumerate(derivatives)}
    k = rows.shape[1]
    residual, derivatives = source.evaluate(rows.ravel())
    dim = len(residual)
    weights = [matrix[:, :, j * dim : (j + 1) * dim] for j in range(k)]
    mixed = sum(np.einsum("mde,em->dm", w, residual[:, j::k]) for j, w in enumerate(weights))
    return np.asarray(mixed), {(j, a): np.einsum("mde,fem->fdm", w, one[:, :, j::k])
                               for j, w in enumerate(weights) for a, one in enumerate(derivatives)}


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
