"""Pattern: which small blocks of unknowns are eliminated, and where the products of every row go.

It depends on what rows touch, not on numbers: a solve makes it once. Instances of one unknown are eliminated, as many
as no block of rows ties together; the others, and those that a condition holds, stay in the outer columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array, Index, Mixing
from calib.layout import Layout
from calib.rows import Program
from calib.unknown import Unknown

Places = NDArray[np.int32]
PIECE = 4096  # rows at a time: their derivatives and products then stay in the cache
TIED = 8  # instances in one block of rows, beyond which none of them is eliminated


def pieces(n: int, width: int = 1) -> Iterator[Index]:
    """Numbers 0 to n, some at a time: less where each stands for several rows."""
    step = max(1, PIECE // width)
    for begin in range(0, n, step):
        yield np.arange(begin, min(begin + step, n))


def _distinct(keys: Index) -> Index:
    """Sorted distinct numbers."""
    ordered = np.sort(keys)
    return ordered[np.diff(ordered, prepend=-1) != 0]


@dataclass(frozen=True)
class Raw:
    """What a compiled loop reads to evaluate rows by itself.

    program; feeds: for each argument its numbers (one, of every instance, or of every row) and the instances (n,) of
    the rows where it is an unknown of several; readings (n, dim), or the residuals where `given`; periods of each.
    """

    program: Program
    feeds: tuple[tuple[Array, Index | None], ...]
    readings: Array
    given: bool
    periods: tuple[float | None, ...]


@dataclass(frozen=True)
class Source:
    """Rows of one group of readings, as normal equations take them.

    columns: (n, f) of each argument; whitening; evaluate: of chosen rows (c,) the residuals (dim, c) and for each
    argument the derivatives (f, dim, c); raw: where a compiled loop pays.
    """

    columns: tuple[Index, ...]
    whitening: tuple[Mixing, ...]
    evaluate: Callable[[Index], tuple[Array, list[Array]]]
    raw: Raw | None = None


@dataclass(frozen=True)
class Pair:
    """Products of two outer arguments of a stream: the pair of units of each block (M,), and the outer slots of the
    units of each pair, (P, f) and (P, g), beyond the last where held."""

    first: int
    second: int
    index: Places
    rows: Index
    columns: Index


@dataclass(frozen=True)
class Stream:
    """Blocks of rows that touch alike, in the order of the eliminated instances that they touch.

    source, mixing: where the rows come from; blocks (M,); inside, outside: (row of the block, argument) whose columns
    are eliminated and are not; owner (M,): the eliminated instance, where there is one; places (O, M): where the
    products with outer columns stand in the coupling; alone: whether every place is met once; pairs.
    """

    source: int
    mixing: int
    blocks: Index
    inside: tuple[tuple[int, int], ...]
    outside: tuple[tuple[int, int], ...]
    owner: Index
    places: Places
    alone: bool
    pairs: tuple[Pair, ...]


class Pattern:
    """Where the columns and rows of a problem stand in its normal equations.

    sources: what rows touch; layout: the columns; taken: boolean (p,), free columns that a condition holds.
    freedom: columns of an eliminated instance; inner (m, freedom), outer (S,): places among the free columns;
    first (m + 1,), columns (nnz,): outer slots that each eliminated instance is coupled with; streams.
    """

    def __init__(self, sources: Sequence[Source], layout: Layout, taken: NDArray[np.bool_]):
        self.size = len(layout.free_columns)
        touched = [_touched(s, w) for s in sources for w in s.whitening]
        instances, unknown = _eliminated(touched, layout, taken)
        self.freedom = 1 if unknown is None else unknown.freedom
        begin = 0 if unknown is None else layout.offset[unknown]
        mine = begin + instances[:, None] * self.freedom + np.arange(self.freedom)
        self.inner = layout.position[mine]
        is_outer = np.ones(self.size, dtype=bool)
        is_outer[self.inner.ravel()] = False
        self.outer = np.flatnonzero(is_outer)
        m, others = len(instances), len(self.outer)
        self._owner = np.full(layout.size, m)
        self._owner[mine] = np.arange(m)[:, None]
        self._slot = np.full(layout.size, others)
        self._slot[layout.free_columns[self.outer]] = np.arange(others)
        self._units(layout)
        self.first, self.columns = np.zeros(m + 1, dtype=np.int64), np.zeros(0, dtype=np.int64)
        numbers = [(s, w) for s, source in enumerate(sources) for w in range(len(source.whitening))]
        plain = [one for (s, w), t in zip(numbers, touched, strict=True)
                 for one in self._streams(s, w, t, len(sources[s].whitening[w].rows))]
        self._couple(plain, touched, numbers)
        self.streams = tuple(self._placed(one, touched[numbers.index((one.source, one.mixing))]) for one in plain)

    def _units(self, layout: Layout) -> None:
        """Outer columns of one instance stand together: its unit, and the place of every column within it."""
        freedom = np.repeat([u.freedom for u in layout.unknowns], [u.count for u in layout.unknowns])
        self._unit = np.repeat(np.arange(len(freedom)), freedom)
        there = self._slot < len(self.outer)
        before: Index = np.cumsum(there) - there
        starts = np.flatnonzero(np.diff(self._unit, prepend=-1))
        self._within = np.where(there, before - before[starts][self._unit], -1)
        self._width = np.add.reduceat(there, starts) if len(starts) else np.zeros(0, dtype=np.int64)
        self._start = np.minimum(before[starts], max(len(self.outer) - 1, 0))

    def _streams(self, source: int, mixing: int, touched: list[list[Index]], many: int) -> list[Stream]:
        """The `many` blocks of one row operation, split by which of their arguments are eliminated."""
        m = len(self.inner)
        names = [(j, a) for j, arguments in enumerate(touched) for a in range(len(arguments))]
        firsts = [c[:, 0] for arguments in touched for c in arguments]
        seen = [bool((self._slot[c] < len(self.outer)).any()) for arguments in touched for c in arguments]
        inside = np.array([self._owner[f] < m for f in firsts]).reshape(len(firsts), many)
        uniform = bool(np.all(inside == inside[:, :1]))
        kinds, kind = (inside[:, :1], None) if uniform else np.unique(inside, axis=1, return_inverse=True)
        found = []
        for number, which in enumerate(kinds.T):
            blocks = np.arange(many) if kind is None else np.flatnonzero(kind.ravel() == number)
            inner = [k for k in range(len(names)) if which[k]]
            owner = self._owner[firsts[inner[0]][blocks]] if inner else np.zeros(0, dtype=np.int64)
            if inner:
                order = np.argsort(owner, kind="stable")
                blocks, owner = blocks[order], owner[order]
            outer = tuple(names[k] for k in range(len(names)) if not which[k] and seen[k])
            found.append(Stream(source, mixing, blocks, tuple(names[k] for k in inner), outer, owner,
                                np.zeros((0, 0), dtype=np.int32), True, ()))
        return found

    def _keys(self, stream: Stream, touched: list[list[Index]]) -> list[Index]:
        """For each outer argument a number that tells instance and unit together."""
        units = len(self._width)
        return [stream.owner * units + self._unit[touched[j][a][stream.blocks, 0]] for j, a in stream.outside]

    def _couple(self, streams: Sequence[Stream], touched: list, numbers: list) -> None:
        """Find which outer units each eliminated instance meets."""
        keys = [k for s in streams if s.inside
                for k in self._keys(s, touched[numbers.index((s.source, s.mixing))])]
        self._met = _distinct(np.concatenate(keys)) if keys else np.zeros(0, dtype=np.int64)
        owner, unit = np.divmod(self._met, max(len(self._width), 1))
        width = self._width[unit]
        self._begin = np.concatenate([[0], np.cumsum(width)])
        self.first = np.concatenate([[0], np.cumsum(np.bincount(owner, width, len(self.inner)))]).astype(np.int64)
        inside = np.arange(self._begin[-1]) - np.repeat(self._begin[:-1], width)
        self.columns = np.repeat(self._start[unit], width) + inside

    def _placed(self, stream: Stream, touched: list[list[Index]]) -> Stream:
        """The stream with the places of its products."""
        places, dump = [], len(self.columns)
        if stream.inside:
            for (j, a), key in zip(stream.outside, self._keys(stream, touched), strict=True):
                within = self._within[touched[j][a][stream.blocks]].T
                begin = self._begin[np.searchsorted(self._met, key)]
                places.append(np.where(within >= 0, begin + within, dump).astype(np.int32))
        every = np.ascontiguousarray(np.concatenate(places)) if places else np.zeros((0, len(stream.blocks)), np.int32)
        kept = every[every < dump]
        alone = not kept.size or bool(np.bincount(kept).max() <= 1)
        pairs, many = [], len(self._width)
        for s, (j, a) in enumerate(stream.outside):
            for t, (k, b) in enumerate(stream.outside[s:], s):
                rows, columns = touched[j][a][stream.blocks], touched[k][b][stream.blocks]
                units = self._unit[rows[:, 0]]
                if s == t:  # no need to sort: there are not many units
                    chosen = np.full(many, -1)
                    chosen[units] = np.arange(len(units))
                    index = (np.cumsum(chosen >= 0) - 1)[units]
                    chosen = chosen[chosen >= 0]
                else:
                    _, chosen, index = np.unique(units * many + self._unit[columns[:, 0]], return_index=True,
                                                 return_inverse=True)
                pairs.append(Pair(s, t, index.ravel().astype(np.int32), self._slot[rows[chosen]],
                                  self._slot[columns[chosen]]))
        return Stream(stream.source, stream.mixing, stream.blocks, stream.inside, stream.outside, stream.owner, every,
                      alone, tuple(pairs))


def _touched(source: Source, mixing: Mixing) -> list[list[Index]]:
    """Columns (M, f) of each argument of each row of the blocks of a row operation."""
    return [[c[mixing.rows[:, j]] for c in source.columns] for j in range(mixing.rows.shape[1])]


def _eliminated(touched: Sequence[list[list[Index]]], layout: Layout, taken: NDArray[np.bool_]
                ) -> tuple[Index, Unknown | None]:
    """The unknown that gives most columns to eliminate, and its instances that no block of rows ties together."""
    best, chosen, most = np.zeros(0, dtype=np.int64), None, 0
    whole = layout.free.copy()
    whole[layout.free_columns[taken]] = False
    for unknown in layout.unknowns:
        span = layout.span(unknown)
        good: NDArray[np.bool_] = np.all(whole[span].reshape(unknown.count, unknown.freedom), axis=1)
        if unknown.count < 2 or good.sum() * unknown.freedom <= most:
            continue
        edges = []
        for rows in touched:
            mine = [(c[:, 0] - span.start) // unknown.freedom for arguments in rows for c in arguments
                    if len(c) and span.start <= c[0, 0] < span.stop]
            apart = [m for m in mine[1:] if not np.array_equal(m, mine[0])]
            if len(apart) >= TIED:
                good[np.unique(np.concatenate(mine))] = False
            elif apart:
                edges += [np.stack([a, b], axis=1)[a != b] for i, a in enumerate(mine) for b in mine[:i]]
        kept = np.flatnonzero(_independent(good, np.concatenate(edges)) if edges else good)
        if len(kept) * unknown.freedom > most:
            best, chosen, most = kept, unknown, len(kept) * unknown.freedom
    return best, chosen


def _independent(good: NDArray[np.bool_], edges: Index) -> NDArray[np.bool_]:
    """Instances among the good ones of which no two share an edge (e, 2); those with few edges come first."""
    edges = np.unique(np.sort(edges[good[edges].all(axis=1)], axis=1), axis=0)
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    degree = np.bincount(both[:, 0], minlength=len(good))
    first = np.concatenate([[0], np.cumsum(degree)])
    kept = good.copy()
    for one in np.argsort(degree, kind="stable").tolist():
        if kept[one] and degree[one]:
            kept[both[first[one] : first[one + 1], 1]] = False
    return kept


def pattern_of(sources: Sequence[Source], layout: Layout, taken: NDArray[np.bool_]) -> Pattern:
    """The pattern of sources, made once for the same columns, row operations and free columns that conditions take."""
    operations = [m.rows for s in sources for m in s.whitening]
    whole = [len(r) and r.shape[1] == 1 and bool(np.all(r[:, 0] == np.arange(len(r)))) for r in operations]
    key = (taken.tobytes(), tuple(tuple(id(c) for c in s.columns) for s in sources),
           tuple(len(r) if w else r.tobytes() for r, w in zip(operations, whole, strict=True)))
    known = layout.patterns
    if key not in known:
        while len(known) > 3:
            known.pop(next(iter(known)))
        # the columns are kept with the pattern, so that no other arrays can take their identity
        known[key] = Pattern(sources, layout, taken), [s.columns for s in sources]
    return known[key][0]
