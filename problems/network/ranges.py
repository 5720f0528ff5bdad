"""Approximate coordinates from ranges alone: classical scaling of distances, completed where they were not read.

Instruments that read ranges from an unknown base point with an unknown dead path are points with a distance too few.
Sources: Torgerson (1952), Psychometrika 17, for scaling; Marquardt (1963) for the descent; Takatsuji et al. (1998),
Measurement Science and Technology 9, for how many ranges place instruments and targets together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib import Gaussian
from calib.errors import InputError
from problems.network.survey import Array, Survey

ATTEMPTS = 30       # placements that are tried where the first ones do not fit
ENOUGH = 6          # of them where the best is good, though not as good as the stated uncertainty lets expect
GOOD = 2e-3         # misfit of the ranges, relative to their mean, that a right placement reaches
EXPECTED = 5.0      # times the stated uncertainty: a misfit that needs no better placement
STEPS = 60          # of one descent
STIFF = 1e8         # damping at which a descent is over
TURNED = 60         # points up to which each is tried on the other side of its neighbours
FREE = (0.3, 0.8, 0.1, 1.6, 4.0)     # dead paths that are tried first, in units of what the ranges differ by


@dataclass(frozen=True)
class Ranges:
    """Ranges between places i and j (n,): what was read (n,) [m]; of (n,): which dead path is added, -1 for none;
    offsets (k + 1,) [m]: the dead paths and a zero."""

    i: np.ndarray
    j: np.ndarray
    read: Array
    of: np.ndarray
    offsets: Array

    @property
    def lengths(self) -> Array:
        """Distances (n,) [m]."""
        return np.asarray(self.read + self.offsets[self.of])

    def misfit(self, place: Array) -> Array:
        """By how much places (m, dim) miss the ranges (n,) [m]."""
        return np.asarray(np.linalg.norm(place[self.i] - place[self.j], axis=1) - self.lengths)


def scaled(survey: Survey, known: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Positions (3,) of all points that ranges join, laid onto those that are known.

    Distances that were not read are completed from those that were; the result is improved by least squares, and
    mirrored where that fits the known points better.
    Raises InputError naming a point that no range joins to the others.
    """
    dim = 3 if "z" in survey.parts else 2
    pairs = _pairs(survey)
    keys = list(dict.fromkeys(k for a, b, *_ in pairs for k in (a, b)))
    place = {key: i for i, key in enumerate(keys)}
    fixed = [k for k in keys if k in known and np.isfinite(known[k][:dim]).all()]
    pairs += [(a, b, float(np.linalg.norm(known[a][:dim] - known[b][:dim])), "")
              for i, a in enumerate(fixed) for b in fixed[i + 1 :] if not np.array_equal(known[a], known[b])]
    i, j = np.array([[place[a], place[b]] for a, b, *_ in pairs]).T
    with_dead_path = list(dict.fromkeys(path for *_, path in pairs if path))
    of = np.array([with_dead_path.index(path) if path else -1 for *_, path in pairs])
    ranges = Ranges(i, j, np.array([v for *_, v, _ in pairs]), of, np.zeros(len(with_dead_path) + 1))
    _all_joined(ranges, keys)
    found = _fitted(ranges, len(keys), dim, _stated(survey))
    anchors = [place[k] for k in fixed]
    if anchors:
        found = _laid(found, anchors, np.array([known[k][:dim] for k in fixed]))
    return {k: np.concatenate([p, [np.nan] * (3 - dim)]) if k not in fixed else known[k]
            for k, p in zip(keys, found, strict=True) if k in survey.points}


def _pairs(survey: Survey) -> list[tuple[str, str, float, str]]:
    """(place, place, range, name of its dead path or "") of all ranges; an instrument is a place of its own."""
    pairs = [(a, b, float(v), "") for batch in survey.every_batch if batch.values is not None
             for a, b, v in zip(*(k.tolist() for k in batch.ends), batch.values[:, 0], strict=True)]
    for one in survey.ranging:
        if one.readings is not None:
            names, targets = (np.asarray(k).astype(str).tolist() for k in (one.instrument, one.target))
            values = one.counts * np.asarray(one.readings, float)
            pairs += [(f"interferometer {name}", target, float(v), name)
                      for name, target, v in zip(names, targets, values, strict=True)]
    return pairs


def _all_joined(ranges: Ranges, keys: Sequence[str]) -> None:
    whole = _shortest(replace(ranges, read=np.ones(len(ranges.read)), offsets=0.0 * ranges.offsets), len(keys))
    if not np.isfinite(whole).all():
        alone = [k for k, far in zip(keys, np.isinf(whole[0]), strict=True) if far]
        raise InputError(f"no chain of ranges joins {', '.join(repr(k) for k in alone[:5])} to '{keys[0]}'; add ranges "
                         "between the two parts")


def _stated(survey: Survey) -> float:
    """Root mean square [m] of the stated uncertainties, as far as they are known without positions."""
    squares: list[Any] = []
    stated: list[tuple[Any, Any]] = [(one.u, one.readings) for one in survey.batches]
    stated += [(one.u, one.readings) for one in survey.ranging]
    for u, readings in stated:
        values = np.zeros((0, 1)) if readings is None else np.asarray(readings, float).reshape(-1, 1)
        if isinstance(u, Gaussian) and set(u.needs) <= {"reading"}:
            u = u.weighting(len(values), 1, "ranges", lambda name, values=values: values).u    # type: ignore[misc]
        if not isinstance(u, Gaussian):
            squares.append(np.square(np.broadcast_to(np.ravel(u), (len(values),))))
    return float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else 0.0


def _shortest(ranges: Ranges, count: int) -> Array:
    """Lengths (count, count) of the shortest paths; a pair that was read twice has its mean."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import shortest_path

    ends = (np.minimum(ranges.i, ranges.j), np.maximum(ranges.i, ranges.j))
    graph = coo_matrix((ranges.lengths, ends), (count, count)).tocsr()
    if graph.nnz < len(ranges.read):
        graph.data /= coo_matrix((np.ones(len(ranges.read)), ends), graph.shape).tocsr().data
    return np.asarray(shortest_path(graph, directed=False))


def _completions(ranges: Ranges, count: int) -> list[Array]:
    """All distances, where they were not read between the limits that a third point sets: their sum along the shortest
    path, their largest difference (points far from those that read them lie near one another), and the mean."""
    whole = _shortest(ranges, count)
    known = np.full((count, count), np.nan)
    known[ranges.i, ranges.j] = known[ranges.j, ranges.i] = ranges.lengths
    at_least = np.zeros((count, count))
    for third in known:
        np.fmax(at_least, np.abs(third[:, None] - third), out=at_least)
    nearest = np.where(np.isfinite(known) | np.eye(count, dtype=bool), whole, at_least)
    return [whole, nearest, 0.5 * (whole + nearest)]


def _guessed(ranges: Ranges, attempt: int, generator: np.random.Generator) -> Ranges:
    """The ranges with dead paths that leave every distance positive."""
    if len(ranges.offsets) == 1:
        return ranges
    paths = range(len(ranges.offsets) - 1)
    lowest = np.array([float(ranges.read[ranges.of == k].min()) for k in paths])
    highest = np.array([float(ranges.read[ranges.of == k].max()) for k in paths])
    differing = float((highest - lowest).max())
    share = np.full(len(lowest), FREE[attempt]) if attempt < len(FREE) else generator.uniform(0.05, 2.0, len(lowest))
    return replace(ranges, offsets=np.append(share * differing - lowest, 0.0))


def _fitted(ranges: Ranges, count: int, dim: int, stated: float) -> Array:
    """The placement that misses the ranges least, of the scaled one and of others where that is caught in a fold.

    A figure folded over in its own space can unfold in a space of more dimensions, and is flattened again.
    """
    generator = np.random.default_rng(0)             # further attempts, the same every time
    best, smallest = np.zeros((count, dim)), np.inf
    completions: list[Array] = []
    for attempt in range(ATTEMPTS):
        tried = _guessed(ranges, attempt, generator)
        if not completions or len(ranges.offsets) > 1:
            completions = _completions(tried, count)
        size = dim + (attempt // len(completions)) % 3
        start = _classical(completions[attempt % len(completions)], min(size, count - 1))
        if attempt == 0 and (direct := _of_two_sets(tried, count)) is not None and dim == 3:
            start = direct
        if attempt >= 3 * len(completions):
            spread = start.std() if attempt % 2 else float(tried.lengths.mean())
            start = start + generator.normal(scale=0.3 * spread, size=start.shape)
        unfolded, between = _descended(start, tried)
        axes = np.linalg.svd(unfolded - unfolded.mean(axis=0), full_matrices=False)[2][:dim]
        place, between = _descended(unfolded @ axes.T, between)
        if (miss := _miss(place, between)) >= GOOD and count <= TURNED:
            place, between = _unfolded(place, between)
            miss = _miss(place, between)
        if miss < smallest and (between.lengths > 0.0).all():
            best, smallest = place, miss
        if smallest * float(between.lengths.mean()) < EXPECTED * stated or (smallest < GOOD and attempt >= ENOUGH):
            break
    return best


def _miss(place: Array, ranges: Ranges) -> float:
    """Root mean square of the misfits, relative to the mean range."""
    return float(np.sqrt(np.mean(ranges.misfit(place) ** 2)) / np.abs(ranges.lengths).mean())


def _unfolded(place: Array, ranges: Ranges) -> tuple[Array, Ranges]:
    """The placement with points, one after the other, on the other side of the points they are read from, as long as
    the ranges then fit better."""
    smallest, better = _miss(place, ranges), True
    while better and smallest > GOOD:
        better = False
        for k in range(len(place)):
            around = place[np.concatenate([ranges.j[ranges.i == k], ranges.i[ranges.j == k]])]
            middle = around.mean(axis=0)
            across = np.linalg.svd(around - middle, full_matrices=True)[2][-1]
            other = place.copy()
            other[k] -= 2.0 * ((place[k] - middle) @ across) * across
            other, changed = _descended(other, ranges)
            miss = _miss(other, changed)
            if miss < 0.99 * smallest:
                place, ranges, smallest, better = other, changed, miss, True
    return place, ranges


def _classical(distances: Array, dim: int) -> Array:
    n = len(distances)
    centring = np.eye(n) - 1.0 / n
    values, axes = np.linalg.eigh(-0.5 * centring @ distances**2 @ centring)
    return np.asarray(axes[:, -dim:] * np.sqrt(np.maximum(values[-dim:], 0.0)))


def _of_two_sets(ranges: Ranges, count: int) -> Array | None:
    """Places (count, 3) where every place of one set is read from every place of another, and from none of its own;
    None where that is not so or the readings are too few for it.

    The doubly centred squares have rank three; their factors are the places but for one linear map, which follows from
    the ranges of the first place of the smaller set. Source: Crocco, Del Bue, Murino (2012), IEEE Transactions on
    Signal Processing 60(2).
    """
    ends = [np.unique(ranges.i), np.unique(ranges.j)]
    whole = len(ends[0]) * len(ends[1]) == len(ranges.read) and len(ends[0]) + len(ends[1]) == count
    if np.isin(ends[0], ends[1]).any() or not whole:
        return None
    few, many = sorted(ends, key=len)
    if len(few) < 4 or len(many) < 10:
        return None
    square = np.full((count, count), np.nan)
    square[ranges.i, ranges.j] = square[ranges.j, ranges.i] = ranges.lengths**2
    squares = square[np.ix_(few, many)]
    if not np.isfinite(squares).all():
        return None
    left, sizes, right = np.linalg.svd(-0.5 * (squares[1:, 1:] - squares[1:, :1] - squares[:1, 1:] + squares[0, 0]))
    x, y = left[:, :3] * np.sqrt(sizes[:3]), right[:3].T * np.sqrt(sizes[:3])
    # |p|^2 = (y + v)' G (y + v) from the first of the few, less that of the first of the many: linear in G and G v.
    pairs = [(a, b) for a in range(3) for b in range(a + 1)]
    rows = np.column_stack([*(y[:, a] * y[:, b] * (1.0 if a == b else 2.0) for a, b in pairs), 2.0 * y])
    found = np.linalg.lstsq(rows, squares[0, 1:] - squares[0, 0], rcond=None)[0]
    metric = np.zeros((3, 3))
    for (a, b), value in zip(pairs, found[:6], strict=True):
        metric[a, b] = metric[b, a] = value
    values, axes = np.linalg.eigh(metric)
    if not np.isfinite(found).all() or values[-1] <= 0.0:
        return None
    values = np.maximum(values, 1e-6 * values[-1])      # errors of the ranges may leave no metric
    root = (axes * np.sqrt(values)).T
    shift = np.linalg.solve((axes * values) @ axes.T, found[6:])
    place = np.zeros((count, 3))
    place[many] = (np.vstack([np.zeros(3), y]) + shift) @ root.T
    place[few[1:]] = x @ np.linalg.inv(root)
    return place


def _descended(place: Array, ranges: Ranges) -> tuple[Array, Ranges]:
    """Places and dead paths with a smaller sum of squared misfits, by damped least squares."""
    (n, dim), rows, paths = place.shape, np.arange(len(ranges.read)), len(ranges.offsets) - 1
    tiny, damping, miss = 1e-12 * float(np.abs(ranges.read).max()), 1e-3, ranges.misfit(place)
    for _ in range(STEPS):
        apart = place[ranges.i] - place[ranges.j]
        unit = apart / np.maximum(np.linalg.norm(apart, axis=1), tiny)[:, None]
        slope = np.zeros((len(rows), n, dim))
        slope[rows, ranges.i], slope[rows, ranges.j] = unit, -unit
        added = -(ranges.of[:, None] == np.arange(paths)).astype(float)
        whole = np.column_stack([slope.reshape(len(rows), -1), added])
        normal, right = whole.T @ whole, -whole.T @ miss
        scale, before = np.diag(np.diag(normal) + 1e-12), float(miss @ miss)
        while damping < STIFF:
            step = np.linalg.solve(normal + damping * scale, right)
            moved = place + step[: n * dim].reshape(n, dim)
            changed = replace(ranges, offsets=ranges.offsets + np.append(step[n * dim :], 0.0))
            after = changed.misfit(moved)
            if after @ after < before:
                break
            damping *= 4.0
        else:
            break
        place, ranges, miss, damping = moved, changed, after, max(damping / 5.0, 1e-12)
        if before - miss @ miss < 1e-10 * before or miss @ miss < len(rows) * (1e3 * tiny) ** 2:
            break
    return place - place.mean(axis=0), ranges


def _laid(place: Array, anchors: list[int], target: Array) -> Array:
    """Turned, mirrored where that is better, and shifted onto anchors (Kabsch)."""
    own, middle = place[anchors], target.mean(axis=0)
    left, _, right = np.linalg.svd((own - own.mean(axis=0)).T @ (target - middle))
    return np.asarray((place - own.mean(axis=0)) @ (left @ right) + middle)
