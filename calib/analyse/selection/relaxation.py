"""Convex relaxation: weights between 0 and 1 instead of a choice, by an interior point on those that are undecided.

Of many candidates all but a few hundred are plainly in or out; Newton steps are taken on the rest, then every
candidate is looked at again. The bound is computed apart from the solver, at the weights where it stopped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.analyse.selection.interior import Smooth, front_of, interior, inverse_of
from calib.analyse.selection.limits import Limits
from calib.analyse.selection.objective import Objective
from calib.analyse.selection.terms import Support
from calib.blocks import Array

WORKING = 500      # candidates that may be undecided at once
ROUNDS = 40


@dataclass(frozen=True)
class Relaxed:
    """Weights (n,) of the relaxation, the bound of the loss that holds for every choice, and the linear function that
    proves it."""

    weights: Array
    bound: float
    support: Support


def relax(objective: Objective, limits: Limits, start: Array, lower: Array | None = None, upper: Array | None = None,
          tolerance: float = 1e-7, target: float = np.inf) -> Relaxed:
    """Solve the relaxation and bound every choice.

    objective; limits; start: (n,) a feasible choice with regular information; lower, upper: (n,) of the weights (0 and
    1); tolerance: of the gap in the logarithm of the criterion; target: stop as soon as the bound exceeds it.
    Returns the best bound found with the weights it was found at.
    """
    n = objective.count
    lower = np.zeros(n) if lower is None else lower
    upper = np.ones(n) if upper is None else upper
    weights, best = _inside(limits, start, lower, upper), None
    price = np.zeros(len(limits.most))
    undecided = _first(objective, limits, weights, lower, upper)
    decided = lower.copy()
    if len(undecided) < int((upper > lower).sum()):
        decided, weights = _decide(limits, lower, upper, undecided, weights)
    else:
        weights = _loosened(limits, weights, undecided)
    if not isinstance(front_of(objective, weights, undecided), Smooth):
        # A worst value far from all its pieces is nearer to the path than any choice.
        weights[undecided] = 0.5
        weights = _loosened(limits, weights, undecided)
    for _ in range(ROUNDS):
        weights, price, front = interior(objective, limits, weights, undecided, 0.1 * tolerance)
        support = front.support
        bound = support.bound(limits, lower, upper)
        if best is None or bound > best.bound:
            best = Relaxed(weights, bound, support)
        if front.loss - bound <= tolerance or bound > target:
            break
        # Relative gains: those of the linear function over its value here.
        gain = support.gain / (support.constant + float(support.gain @ weights))
        reduced = gain - limits.matrix.T @ price
        outside = np.setdiff1d(np.flatnonzero(upper > lower), undecided, assume_unique=True)
        wrong = outside[np.where(decided[outside] > 0.5, -reduced[outside], reduced[outside]) > 0.0]
        if not wrong.size:
            break
        wrong = wrong[np.argsort(-np.abs(reduced[wrong]))][: WORKING // 2]
        settled = undecided[(weights[undecided] < 1e-6) & (reduced[undecided] < 0)
                            | (weights[undecided] > 1 - 1e-6) & (reduced[undecided] > 0)]
        surplus = len(undecided) + len(wrong) - WORKING
        if surplus > 0 and settled.size:
            gone = settled[np.argsort(-np.abs(reduced[settled]))][:surplus]
            decided[gone] = np.round(weights[gone])
            weights = weights.copy()
            weights[gone] = decided[gone]
            undecided = np.setdiff1d(undecided, gone, assume_unique=True)
        undecided = np.union1d(undecided, wrong)
        weights = _loosened(limits, weights, undecided)
    assert best is not None
    return best


def _inside(limits: Limits, start: Array, lower: Array, upper: Array) -> Array:
    """Weights strictly between their bounds and within the limits, near a choice."""
    free = upper > lower
    room = limits.most - limits.matrix @ lower
    spread = limits.matrix @ free.astype(float)
    inside = np.where(free, 0.9 * np.clip(start, 0.0, 1.0), lower)
    left = limits.most - limits.matrix @ inside
    binding = (spread > 0) & (room > 0)
    share = min(0.09, 0.5 * float(np.min(left[binding] / spread[binding], initial=0.18)))
    return np.where(free, inside + share * (1.0 - np.clip(start, 0.0, 1.0)), lower)


def _first(objective: Objective, limits: Limits, weights: Array, lower: Array, upper: Array) -> NDArray[np.int64]:
    """The candidates of which it is least plain whether they are in or out."""
    free = np.flatnonzero(upper > lower)
    if len(free) <= WORKING:
        return free
    gain = objective.pull([inverse_of(t.information(weights)) for t in objective.terms], free)
    start = weights[free] > 0.5
    if start.sum() < WORKING // 2:
        # All of the starting choice is undecided, with the best of the rest.
        others = np.flatnonzero(~start)
        best = others[np.argsort(-gain[others])][: WORKING - int(start.sum())]
        return np.sort(free[np.concatenate([np.flatnonzero(start), best])])
    middle = np.sort(gain)[::-1][int(start.sum()) - 1]
    return np.sort(free[np.argsort(np.abs(np.log(gain / middle)))[:WORKING]])


def _decide(limits: Limits, lower: Array, upper: Array, undecided: NDArray[np.int64], weights: Array
            ) -> tuple[Array, Array]:
    """Candidates outside the working set at 0 or 1, and weights that stay strictly within the limits."""
    decided = np.where(weights > 0.5, upper, lower)
    decided[undecided] = 0.0
    moved = decided.copy()
    moved[undecided] = weights[undecided]
    return decided, _loosened(limits, moved, undecided)


def _loosened(limits: Limits, weights: Array, undecided: NDArray[np.int64]) -> Array:
    """Undecided weights a little inside their bounds and limits, the others as they are."""
    weights = weights.copy()
    fixed = weights.copy()
    fixed[undecided] = 0.0
    room = limits.most - limits.matrix @ fixed
    inside = np.clip(weights[undecided], 1e-3, 1.0 - 1e-3)
    used = limits.matrix[:, undecided] @ inside
    tight = used > 0
    shrink = min(1.0, 0.995 * float(np.min(room[tight] / used[tight], initial=2.0)))
    weights[undecided] = inside * shrink
    return weights
