"""Sums of products of rows, and the compiled loop that adds to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib.blocks import Array
from calib.compiled import Shape, fused_rows, parts_of, run_side_by_side
from calib.pattern import Source, Stream


@dataclass
class Sums:
    """What rows add to: inner (m, f, f), coupling (f, nnz + 1), outer (S + 1, S + 1), pull_inner (m, f), pull_outer
    (S + 1,), and v'Pv. The last place of columns takes what is held."""

    inner: Array
    coupling: Array
    outer: Array
    pull_inner: Array
    pull_outer: Array
    objective: float = 0.0

    def add_outer(self, stream: Stream, totals: Sequence[Array], pulls: Sequence[Array]) -> None:
        """Add the products (P, f, g) of each pair of outer arguments and the pulls (P, f) of each argument."""
        for pair, total in zip(stream.pairs, totals, strict=True):
            rows, columns = pair.rows[:, :, None], pair.columns[:, None, :]
            np.add.at(self.outer, (rows, columns), total)
            if pair.first == pair.second:
                np.add.at(self.pull_outer, pair.rows, pulls[pair.first])
            else:
                np.add.at(self.outer, (columns.transpose(0, 2, 1), rows.transpose(0, 2, 1)), total.transpose(0, 2, 1))


def accumulate_compiled(sums: Sums, source: Source, stream: Stream) -> bool:
    """Add the rows of a stream by a compiled loop; False where it does not pay or cannot be done so."""
    raw, mixing = source.raw, source.whitening[stream.mixing]
    if raw is None or mixing.matrix.ndim != 2 or not np.array_equal(mixing.rows[:, 0], np.arange(len(raw.readings))):
        return False
    inside, outside = tuple(a for _, a in stream.inside), tuple(a for _, a in stream.outside)
    kinds = tuple(("indexed" if index is not None else "shared" if len(numbers) == 1 else "own", numbers.shape[1])
                  for numbers, index in raw.feeds)
    shape = Shape(raw.program.instructions, kinds, raw.readings.shape[1], raw.periods, raw.given,
                  tuple(c.shape[1] for c in source.columns), inside, outside,
                  tuple((p.first, p.second) for p in stream.pairs))
    loop, weights = fused_rows(shape), np.ascontiguousarray(mixing.matrix)
    ends = parts_of(len(stream.blocks), len(raw.program), stream.owner)
    shares = []
    for begin, end in pairwise(ends):
        totals = [np.zeros((len(p.rows), p.rows.shape[1], p.columns.shape[1])) for p in stream.pairs]
        pulls = [np.zeros(p.rows.shape) for p in stream.pairs if p.first == p.second]
        shares.append((begin, end, totals, pulls, np.zeros(1)))

    def run(share: tuple[int, int, list[Array], list[Array], Array]) -> None:
        begin, end, totals, pulls, objective = share
        loop(end - begin, stream.places.shape[1], sums.coupling.shape[1], {
            "blocks": stream.blocks[begin:end], "bases": [f[0] for f in raw.feeds],
            "indices": [f[1] for f in raw.feeds], "readings": raw.readings, "weights": weights,
            "owner": stream.owner[begin:end], "places": stream.places[:, begin:], "inner": sums.inner,
            "pull": sums.pull_inner, "coupling": sums.coupling, "index": [p.index[begin:end] for p in stream.pairs],
            "totals": totals, "pulls": pulls, "objective": objective})

    run_side_by_side(run, shares)
    if not np.isfinite(sum(share[4][0] for share in shares)):
        source.evaluate(stream.blocks)  # raises the sentence that names row and model
    for _, _, totals, pulls, objective in shares:
        for pair, total in zip(stream.pairs, totals, strict=True):
            if pair.first == pair.second:  # the loop adds below the diagonal only
                for k in range(total.shape[1]):
                    total[:, :k, k] = total[:, k, :k]
        sums.add_outer(stream, totals, pulls)
        sums.objective += float(objective[0])
    return True
