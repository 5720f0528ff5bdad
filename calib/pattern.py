"""Pattern: which small blocks of unknowns are eliminated, and where the products of every row go.

It depends on what rows touch, not on numbers: a solve makes it once. Instances of one unknown are eliminated, as many
as no block of rows ties together; the others, and those that a condition holds, stay in the outer columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array, Index, Mixing
from calib.layout import Layout
from calib.rows import Program
from calib.unknown import Unknown

Places = NDArray[np.int32]
PIECE = 4096  # rows at a time: their derivatives and products then stay in the cache
TIED = 8  # instances in one block of rows, beyond which none of them is eliminated


def pieces(n: int, width: float = 1) -> Iterator[Index]:
    """Numbers 0 to n, some at a time: less where each stands for several rows."""
    step = max(1, int(PIECE / width))
    for begin in range(0, n, step):
        yield np.arange(begin, min(begin + step, n))


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
    products with outer columns stand in the coupling, at `beyond` where held; pairs.
    """

    source: int
    mixing: int
    blocks: Index
    inside: tuple[tuple[int, int], ...]
    outside: tuple[tuple[int, int], ...]
    owner: Index
    places: Places
    beyond: int
    pairs: tuple[Pair, ...]

    @cached_property
    def alone(self) -> bool:
        """Whether every place is met once, but that of what is held."""
        met = np.bincount(self.places.ravel(), minlength=self.beyond)[: self.beyond]
        return not met.size or bool(met.max() <= 1)


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
        self.first, self.columns = np.zeros(m + 1, dtype=np.int64), np.zeros(0, dtype=np.int32)
        numbers = [(s, w) for s, source in enumerate(sources) for w in range(len(source.whitening))]
        plain = [one for (s, w), t in zip(numbers, touched, strict=True)
                 for one in self._streams(s, w, t, len(sources[s].whitening[w].rows))]
        theirs = [touched[numbers.index((one.source, one.mixing))] for one in plain]
        keys = [[one.owner * len(self._width) + self._unit[t[j][a][one.blocks]] for j, a in one.outside]
                if one.inside else [] for one, t in zip(plain, theirs, strict=True)]
        met = iter(self._couple([k for some in keys for k in some]))
        self.streams = tuple(
            self._placed(one, [c.shape[1] for c in sources[one.source].columns], t, [next(met) for _ in some])
            for one, t, some in zip(plain, theirs, keys, strict=True))

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
        firsts = [c for arguments in touched for c in arguments]
        seen = [bool(self._width[self._unit[c]].any()) for c in firsts]
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
                                np.zeros((0, 0), dtype=np.int32), 0, ()))
        return found

    def _couple(self, keys: Sequence[Index]) -> list[Places]:
        """Find which outer units each eliminated instance meets, and for each number that tells both (and is taken out
        of its list) where their products begin."""
        met, which = _ranked(keys)
        owner, unit = np.divmod(met, max(len(self._width), 1))
        width = self._width[unit]
        begin = np.concatenate([[0], np.cumsum(width)])
        self.first = np.concatenate([[0], np.cumsum(np.bincount(owner, width, len(self.inner)))]).astype(np.int64)
        inside = np.arange(begin[-1]) - np.repeat(begin[:-1], width)
        self.columns = (np.repeat(self._start[unit], width) + inside).astype(np.int32)
        return [begin.astype(np.int32)[one] for one in which]

    def _placed(self, stream: Stream, freedoms: list[int], touched: list[list[Index]], begins: list[Places]) -> Stream:
        """The stream with the places of its products; begins: of those of each outer argument."""
        outside = [(touched[j][a][stream.blocks], freedoms[a]) for j, a in stream.outside]
        beyond, wide = len(self.columns), [f for _, f in outside if stream.inside]
        every = np.empty((sum(wide), len(stream.blocks)), dtype=np.int32)
        for (first, freedom), begin, end in zip(outside, begins, np.cumsum(wide), strict=False):
            for k, row in enumerate(every[end - freedom : end]):
                within = self._within[first + k]
                np.add(begin, within, out=row)
                row[within < 0] = beyond
        pairs, many = [], len(self._width)
        for s, (mine, freedom) in enumerate(outside):
            for t, (other, more) in enumerate(outside[s:], s):
                units = self._unit[mine]
                if s == t:  # no need to sort: there are not many units
                    chosen = np.full(many, -1)
                    chosen[units] = np.arange(len(units))
                    index = (np.cumsum(chosen >= 0) - 1)[units]
                    chosen = chosen[chosen >= 0]
                else:
                    _, chosen, index = np.unique(units * many + self._unit[other], return_index=True,
                                                 return_inverse=True)
                pairs.append(Pair(s, t, index.ravel().astype(np.int32),
                                  self._slot[mine[chosen][:, None] + np.arange(freedom)],
                                  self._slot[other[chosen][:, None] + np.arange(more)]))
        return replace(stream, places=every, beyond=beyond, pairs=tuple(pairs))


def _ranked(keys: Sequence[Index]) -> tuple[Index, list[Index]]:
    """Sorted distinct numbers, and for each of several arrays which of these they are."""
    if not keys:
        return np.zeros(0, dtype=np.int64), []
    every = np.concatenate(keys)
    order = np.argsort(every, kind="stable")  # rows mostly come in order, of which this sort makes use
    ordered = every[order]
    new = np.diff(ordered, prepend=-1) != 0
    which = np.empty(len(every), dtype=np.int32)
    which[order] = np.cumsum(new, dtype=np.int32) - 1
    return ordered[new], np.split(which, np.cumsum([len(k) for k in keys])[:-1])


def _touched(source: Source, mixing: Mixing) -> list[list[Index]]:
    """First column (M,) of each argument of each row of the blocks of a row operation; the others follow it."""
    return [[c[:, 0][rows] for c in source.columns] for rows in mixing.rows.T]


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
            mine = [(c - span.start) // unknown.freedom for arguments in rows for c in arguments
                    if len(c) and span.start <= c[0] < span.stop]
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
