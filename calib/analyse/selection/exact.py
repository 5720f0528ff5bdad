"""Exact choice: every subset where there are few, branch and bound where the relaxation proves enough."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, islice
from math import comb
from time import perf_counter

import numpy as np

from calib.analyse.selection.exchange import exchange
from calib.analyse.selection.greedy import RIDGE, backward, greedy
from calib.analyse.selection.limits import Limits
from calib.analyse.selection.objective import Objective
from calib.analyse.selection.relaxation import Relaxed, relax
from calib.analyse.selection.terms import Determinant
from calib.blocks import Array

CHUNK = 20_000
MANY = 2000      # candidates up to which a search may also go backward


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
    """A choice, the loss that no choice falls below, and how many nodes were looked at."""

    chosen: list[int]
    bound: float
    nodes: int


def branch_and_bound(objective: Objective, limits: Limits, chosen: list[int], nodes: int, seconds: float,
                     tolerance: float) -> Searched:
    """Search with a proof: relaxations of ever smaller sets of choices, until no part can hold a better one.

    chosen: a choice to begin with; nodes, seconds: at most; tolerance: gap in the logarithm of the criterion that
    counts as none. A candidate is fixed where the bound at the very weights of the relaxation shows that the other
    way round cannot beat the best choice known.
    """
    begin, n = perf_counter(), objective.count
    best, loss = sorted(chosen), objective.loss(chosen)
    root = _node(objective, limits, np.zeros(n), np.ones(n), loss - tolerance)
    open_nodes: list[tuple[float, int, Array, Array, Relaxed]] = []
    count = 1
    if root is not None:
        heapq.heappush(open_nodes, (root.bound, 0, np.zeros(n), np.ones(n), root))
    while open_nodes and count < nodes and perf_counter() - begin < seconds:
        bound, _, lower, upper, relaxed = heapq.heappop(open_nodes)
        if bound >= loss - tolerance:
            continue
        found = _rounded(objective, limits, relaxed.weights, lower, upper)
        if found is not None and (value := objective.loss(found)) < loss:
            best, loss = found, value
        lower, upper = _fixed_by_cost(relaxed, limits, lower, upper, loss - tolerance)
        free = upper > lower
        if not free.any():
            continue
        place = int(np.argmin(np.where(free, np.abs(relaxed.weights - 0.5), np.inf)))
        for side in (1.0, 0.0):
            low, high = lower.copy(), upper.copy()
            low[place] = high[place] = side
            low, high = _implied(limits, low, high)
            if not limits.allow(low):
                continue
            count += 1
            leaf = _leaf(limits, low, high)
            if leaf is not None:
                value = objective.loss(leaf)
                if value < loss:
                    best, loss = leaf, value
                continue
            child = _node(objective, limits, low, high, loss - tolerance)
            if child is not None:
                heapq.heappush(open_nodes, (max(child.bound, bound), count, low, high, child))
    # Parts that were closed could be better than the best choice by no more than the tolerance.
    return Searched(best, min([one[0] for one in open_nodes] + [loss - tolerance]), count)


def _node(objective: Objective, limits: Limits, lower: Array, upper: Array, target: float) -> Relaxed | None:
    """Relaxation of a part; None where it cannot hold anything better than the target."""
    start = _start(objective, limits, lower, upper)
    try:
        relaxed = relax(objective, limits, start, lower, upper, tolerance=1e-6, target=target)
    except np.linalg.LinAlgError:      # what is left of this part is singular
        if any(isinstance(term, Determinant) for term in objective.terms):
            return None
        # A little more information bounds the part from below, and what is asked for may still be seen.
        more = Objective(tuple(replace(t, fixed=t.fixed + RIDGE * np.eye(len(t.fixed))) for t in objective.terms))
        relaxed = relax(more, limits, start, lower, upper, tolerance=1e-6, target=target)
    return None if relaxed.bound >= target else relaxed


def _start(objective: Objective, limits: Limits, lower: Array, upper: Array) -> Array:
    free = upper > lower
    room = limits.most - limits.matrix @ lower
    spread = limits.matrix[:, free].sum(axis=1)
    share = min(0.5, 0.5 * float(np.min(room[spread > 0] / spread[spread > 0], initial=1.0)))
    return np.where(free, share, lower)


def _implied(limits: Limits, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Candidates that no longer fit are out; where all that is left is needed for the number, it is in."""
    room = limits.room(limits.matrix @ lower)
    upper = np.where((upper > lower) & ~room, lower, upper)
    return lower, upper


def _leaf(limits: Limits, lower: Array, upper: Array) -> list[int] | None:
    """The only choice left, if one: more information never harms, so where all that is open fits, all is taken."""
    if limits.allow(upper):
        return np.flatnonzero(upper > 0.5).tolist()
    return None


def _rounded(objective: Objective, limits: Limits, weights: Array, lower: Array, upper: Array) -> list[int] | None:
    taken = lower.copy()
    used = limits.matrix @ taken
    for i in np.argsort(-weights):
        if upper[i] > 0.5 and taken[i] < 0.5 and np.all(used + limits.matrix[:, i] <= limits.most + 1e-9):
            taken[i] = 1.0
            used = used + limits.matrix[:, i]
    found = np.flatnonzero(taken > 0.5).tolist()
    return exchange(objective, limits, found, 200) if np.isfinite(objective.loss(found)) else None


def _fixed_by_cost(relaxed: Relaxed, limits: Limits, lower: Array, upper: Array, target: float
                   ) -> tuple[Array, Array]:
    """Reduced-cost fixing where only the number is limited, with gains and bound at the same weights."""
    if not limits.only_keep:
        return lower, upper
    gain = relaxed.near.gain
    free = np.flatnonzero(upper > lower)
    left = round(float(limits.most[0] - lower.sum()))
    if not 0 < left < len(free):
        return lower, upper
    order = free[np.argsort(-gain[free])]
    inside, outside = order[:left], order[left:]
    here = relaxed.near.bound(relaxed.weights, limits, lower, upper)
    level = here + np.log1p(float(gain[inside].sum() + gain @ lower - gain @ relaxed.weights))
    # To beat the target the tangent must reach exp(level - target) - 1.
    needed = np.exp(level - target) - 1.0
    have = float(gain[inside].sum() + gain @ lower - gain @ relaxed.weights)
    lower, upper = lower.copy(), upper.copy()
    lower[inside[have - gain[inside] + gain[outside[0]] < needed]] = 1.0
    upper[outside[have + gain[outside] - gain[inside[-1]] < needed]] = 0.0
    return lower, upper


def improved(objective: Objective, limits: Limits, chosen: list[int]) -> list[int]:
    """An exchange, where that does not end in a choice that hides what is asked for."""
    found = exchange(objective, limits, chosen)
    return found if objective.loss(found) < objective.loss(chosen) else chosen


def begun(objective: Objective, limits: Limits, relaxed: Relaxed | None, found: list[int] | None = None) -> list[int]:
    """The best of greedy with exchange (or what was found already) and of the rounded relaxation with exchange."""
    if found is None:
        found = exchange(objective, limits, greedy(objective, limits))
    if not np.isfinite(objective.loss(found)) and objective.count <= MANY:
        found = improved(objective, limits, backward(objective, limits))
    if relaxed is None:
        return found
    n = objective.count
    other = _rounded(objective, limits, relaxed.weights, np.zeros(n), np.ones(n))
    return other if other is not None and objective.loss(other) < objective.loss(found) else found
