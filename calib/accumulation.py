"""Sums of products of rows, and the compiled loops that add to them and that weigh rows by what comes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib.blocks import Array, Index
from calib.compiled import LEVERAGES, SUMS, VALUES, Shape, fused_rows, parts_of, run_side_by_side
from calib.pattern import Raw, Source, Stream
from calib.rows import Program


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


def _kinds(feeds: Sequence[tuple[Array, Index | None]]) -> tuple[tuple[str, int], ...]:
    """Kind and width of each argument."""
    return tuple(("indexed" if index is not None else "shared" if len(numbers) == 1 else "own", numbers.shape[1])
                 for numbers, index in feeds)


def _shape(source: Source, stream: Stream) -> Shape | None:
    """What a compiled loop over a stream is written for; None where it does not pay or cannot be."""
    raw, mixing = source.raw, source.whitening[stream.mixing]
    if raw is None or mixing.matrix.ndim != 2 or not np.array_equal(mixing.rows[:, 0], np.arange(len(raw.readings))):
        return None
    return Shape(raw.program.instructions, _kinds(raw.feeds), raw.readings.shape[1], raw.periods, raw.given,
                 tuple(c.shape[1] for c in source.columns), tuple(a for _, a in stream.inside),
                 tuple(a for _, a in stream.outside), tuple((p.first, p.second) for p in stream.pairs))


def _rows(raw: Raw, weights: Array, stream: Stream, begin: int, end: int) -> dict[str, Array | list[Array | None]]:
    """What every loop reads of some rows of a stream."""
    return {"blocks": stream.blocks[begin:end], "bases": [f[0] for f in raw.feeds],
            "indices": [f[1] for f in raw.feeds], "weights": weights, "owner": stream.owner[begin:end],
            "places": stream.places[:, begin:], "index": [p.index[begin:end] for p in stream.pairs]}


def accumulate_compiled(sums: Sums, source: Source, stream: Stream) -> bool:
    """Add the rows of a stream by a compiled loop; False where it does not pay or cannot be done so."""
    raw, shape = source.raw, _shape(source, stream)
    if raw is None or shape is None:
        return False
    loop, weights = fused_rows(shape, SUMS), np.ascontiguousarray(source.whitening[stream.mixing].matrix)
    shares = []
    for begin, end in pairwise(parts_of(len(stream.blocks), len(raw.program), stream.owner)):
        totals = [np.zeros((len(p.rows), p.rows.shape[1], p.columns.shape[1])) for p in stream.pairs]
        pulls = [np.zeros(p.rows.shape) for p in stream.pairs if p.first == p.second]
        shares.append((begin, end, totals, pulls, np.zeros(1)))

    def run(share: tuple[int, int, list[Array], list[Array], Array]) -> None:
        begin, end, totals, pulls, objective = share
        loop(end - begin, stream.places.shape[1], sums.coupling.shape[1], {
            **_rows(raw, weights, stream, begin, end), "readings": raw.readings, "inner": sums.inner,
            "pull": sums.pull_inner, "coupling": sums.coupling, "totals": totals, "pulls": pulls,
            "objective": objective})

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


def leverages_compiled(source: Source, streams: Sequence[Stream], half: Array, inner: Array, coupling: Array,
                       outer: Array) -> Array | None:
    """Diagonal (n, dim) of J C J' of the whitened readings of a source; None where no compiled loop goes through them.

    streams: of the source; C is half' inner half (m, f, f) of eliminated instances, -half' coupling (f, nnz + 1) of
    them with outer columns, and outer (S + 1, S + 1); the last places are those of what is held, and zero.
    """
    shapes = [_shape(source, stream) for stream in streams]
    raw = source.raw
    if raw is None or not all(shapes):
        return None
    found = np.zeros(raw.readings.shape)
    for shape, stream in zip(shapes, streams, strict=True):
        assert shape is not None
        loop, weights = fused_rows(shape, LEVERAGES), np.ascontiguousarray(source.whitening[stream.mixing].matrix)
        totals = [outer[p.rows[:, :, None], p.columns[:, None, :]] for p in stream.pairs]

        def run(share: tuple[int, int], loop=loop, weights=weights, stream=stream, totals=totals) -> None:
            loop(share[1] - share[0], stream.places.shape[1], coupling.shape[1], {
                **_rows(raw, weights, stream, *share), "inner": inner, "coupling": coupling, "totals": totals,
                "half": half, "found": found})

        run_side_by_side(run, list(pairwise(parts_of(len(stream.blocks), len(raw.program), stream.owner))))
    return found


def predicted_compiled(program: Program, feeds: Sequence[tuple[Array, Index | None]], n: int) -> Array:
    """Outputs (n, dim) of a program by a compiled loop that gathers by itself; feeds: as of Raw."""
    found, rows = np.empty((n, program.outputs)), np.arange(n)
    shape = Shape(program.instructions, _kinds(feeds), program.outputs, (None,) * program.outputs, True, (), (), (), ())
    loop = fused_rows(shape, VALUES)

    def run(share: tuple[int, int]) -> None:
        loop(share[1] - share[0], 0, 0, {"blocks": rows[slice(*share)], "bases": [f[0] for f in feeds],
                                         "indices": [f[1] for f in feeds], "found": found})

    run_side_by_side(run, list(pairwise(parts_of(n, len(program), rows[:0]))))
    return found
