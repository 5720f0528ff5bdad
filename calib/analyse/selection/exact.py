"""Exact choice: every subset where there are few, branch and bound where the relaxation proves enough."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, islice
from math import comb
from time import perf_counter

import numpy as np

from calib.analyse.selection.floors import Checked
from calib.analyse.selection.greedy import RIDGE
from calib.analyse.selection.limits import Limits
from calib.analyse.selection.objective import Objective
from calib.analyse.selection.relaxation import Relaxed, relax
from calib.analyse.selection.starts import rounded
from calib.analyse.selection.terms import Determinant
from calib.blocks import Array

CHUNK = 20_000


def subsets(limits: Limits, count: int) -> int:
    """How many subsets an exhaustive search looks at."""
    return comb(count, limits.keep) if limits.keep is not None else 2**count


def enumerated(objective: Objective, limits: Limits) -> Iterator[tuple[Array, Array]]:
    """Subsets (b, k) within the limits and their losses (b,), chunk by chunk."""
    n = objective.count
    sizes = [limits.keep] if limits.keep is not None else list(range(1, n + 1))
    for size in sizes:
        every = combinations(range(n), size)
        while block := list(islice(every, max(1, CHUNK // size))):
            choices = np.array(block, dtype=np.int64)
            if not limits.only_keep:
                used = limits.matrix[:, choices].sum(axis=2)
                choices = choices[np.all(used <= limits.most[:, None] + 1e-9, axis=0)]
            if len(choices):
                yield choices, objective.losses(choices)


def exhaustive(objective: Objective, limits: Limits) -> list[int]:
    """The best of all subsets within the limits; empty where none lets everything asked for be known."""
    best, found = np.inf, []
    for choices, losses in enumerated(objective, limits):
        place = int(np.argmin(losses))
        if losses[place] < best:
            best, found = float(losses[place]), choices[place].tolist()
    return found


@dataclass(frozen=True)
class Searched:
    """A choice (None where there is none, proven if the bound is infinite), the loss that no choice falls below, and
    how many nodes were looked at."""

    chosen: list[int] | None
    bound: float
    nodes: int


def branch_and_bound(objective: Objective, limits: Limits, chosen: list[int] | None, nodes: int, seconds: float,
                     tolerance: float, checked: Checked | None = None) -> Searched:
    """Search with a proof: relaxations of ever smaller sets of choices, until no part can hold a better one.

    chosen: a choice to begin with, if one is known; nodes, seconds: at most; tolerance: gap in the logarithm of the
    criterion that counts as none; checked: floors that a choice must meet. A candidate is fixed where the linear
    function that bounds a part shows that the other way round cannot beat the best choice known, and where floors that
    more readings only help fail with all readings that are left.
    """
    begin, n = perf_counter(), objective.count
    best, loss = chosen, np.inf if chosen is None else objective.loss(chosen)
    part = _narrowed(limits, checked, np.zeros(n), np.ones(n))
    root = None if part is None else _node(objective, limits, *part, loss - tolerance)
    open_nodes: list[tuple[float, int, Array, Array, Relaxed]] = []
    count = 1
    if part is not None and root is not None:
        heapq.heappush(open_nodes, (root.bound, 0, *part, root))
    while open_nodes and count < nodes and perf_counter() - begin < seconds:
        bound, _, lower, upper, relaxed = heapq.heappop(open_nodes)
        if bound >= loss - tolerance:
            continue
        found = rounded(objective, limits, relaxed.weights, lower, upper)
        if _fits(limits, checked, found) and (value := objective.loss(found)) < loss:
            best, loss = found, value
        lower, upper = _fixed_by_cost(relaxed, limits, lower, upper, loss - tolerance)
        free = upper > lower
        if free.any():
            place = int(np.argmin(np.where(free, np.abs(relaxed.weights - 0.5), np.inf)))
            halves = [(side, place) for side in (1.0, 0.0)]
        else:
            halves = [(lower[0], 0)]      # one choice is left
        for side, place in halves:
            low, high = lower.copy(), upper.copy()
            low[place] = high[place] = side
            narrowed = _narrowed(limits, checked, low, high)
            if narrowed is None:
                continue
            count += 1
            low, high = narrowed
            leaf = np.flatnonzero(high > 0.5).tolist()
            # More information never harms: where all that is open fits, all is taken, unless a floor forbids it.
            if limits.meets(leaf):
                if _fits(limits, checked, leaf):
                    value = objective.loss(leaf)
                    if value < loss:
                        best, loss = leaf, value
                    continue
                if limits.keep is not None or not (high > low).any():
                    continue
            child = _node(objective, limits, low, high, loss - tolerance)
            if child is not None:
                heapq.heappush(open_nodes, (max(child.bound, bound), count, low, high, child))
    # Parts that were closed could be better than the best choice by no more than the tolerance.
    return Searched(best, min([one[0] for one in open_nodes] + [loss - tolerance]), count)


def _fits(limits: Limits, checked: Checked | None, chosen: list[int]) -> bool:
    return limits.meets(chosen) and (checked is None or checked.margin(chosen).excess <= 0.0)


def _narrowed(limits: Limits, checked: Checked | None, lower: Array, upper: Array) -> tuple[Array, Array] | None:
    """A part without the candidates that no longer fit or can no longer meet the floors; None where it is empty."""
    room = limits.room(limits.matrix @ lower)
    upper = np.where((upper > lower) & ~room, lower, upper)
    if checked is not None:
        upper = np.minimum(upper, checked.possible(upper > 0.5))
        if np.any(lower > upper):
            return None
    if not limits.allow(lower) or upper.sum() < limits.exactly:
        return None
    if limits.exactly and upper.sum() == limits.exactly:
        return (upper, upper) if limits.allow(upper) else None
    return lower, upper


def _node(objective: Objective, limits: Limits, lower: Array, upper: Array, target: float) -> Relaxed | None:
    """Relaxation of a part; None where it cannot hold anything better than the target."""
    start = _start(limits, lower, upper)
    try:
        relaxed = relax(objective, limits, start, lower, upper, tolerance=1e-6, target=target)
    except np.linalg.LinAlgError:      # what is left of this part is singular
        if any(isinstance(term, Determinant) for term in objective.terms):
            return None
        # A little more information bounds the part from below, and what is asked for may still be seen.
        more = Objective(tuple(replace(t, fixed=t.fixed + RIDGE * np.eye(len(t.fixed))) for t in objective.terms))
        relaxed = relax(more, limits, start, lower, upper, tolerance=1e-6, target=target)
    return None if relaxed.bound >= target else relaxed


def _start(limits: Limits, lower: Array, upper: Array) -> Array:
    free = upper > lower
    room = limits.most - limits.matrix @ lower
    spread = limits.matrix[:, free].sum(axis=1)
    share = min(0.5, 0.5 * float(np.min(room[spread > 0] / spread[spread > 0], initial=1.0)))
    return np.where(free, share, lower)


def _fixed_by_cost(relaxed: Relaxed, limits: Limits, lower: Array, upper: Array, target: float
                   ) -> tuple[Array, Array]:
    """Reduced-cost fixing where only the number is limited: by the linear function above exp(-loss)."""
    free = np.flatnonzero(upper > lower)
    if not limits.only_keep or not free.size:
        return lower, upper
    gain, left = relaxed.support.gain, round(float(limits.most[0] - lower.sum()))
    if not 0 < left < len(free):
        return lower, upper
    order = free[np.argsort(-gain[free])]
    inside, outside = order[:left], order[left:]
    have = relaxed.support.constant + float(gain[inside].sum() + gain @ lower)
    needed = float(np.exp(-target))      # a part reaches it or holds nothing better
    lower, upper = lower.copy(), upper.copy()
    lower[inside[have - gain[inside] + gain[outside[0]] < needed]] = 1.0
    upper[outside[have + gain[outside] - gain[inside[-1]] < needed]] = 0.0
    return lower, upper
