"""Convex relaxation: weights between 0 and 1 instead of a choice, by an interior point on those that are undecided.

Of many candidates all but a few hundred are plainly in or out; Newton steps are taken on the rest, then every
candidate is looked at again. The bound is computed apart from the solver, at the weights where it stopped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.analyse.selection.limits import Limits
from calib.analyse.selection.objective import Nearby, Objective
from calib.blocks import Array

WORKING = 500      # candidates that may be undecided at once
SHARPNESS = (8.0, 64.0, 512.0)
ROUNDS = 40
STEPS = 60
NEAREST = 1e-13      # of a weight to its bounds


@dataclass(frozen=True)
class Relaxed:
    """Weights (n,) of the relaxation, the bound of the loss that holds for every choice, and relative gains there."""

    weights: Array
    bound: float
    near: Nearby


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
    for sharpness in SHARPNESS if objective.sharp else (1.0,):
        weights, found = _at_sharpness(objective, limits, weights, lower, upper, sharpness, tolerance, target)
        if best is None or found.bound > best.bound:
            best = found
        if best.bound > target:
            break
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


def _at_sharpness(objective: Objective, limits: Limits, weights: Array, lower: Array, upper: Array, sharpness: float,
                  tolerance: float, target: float) -> tuple[Array, Relaxed]:
    best: Relaxed | None = None
    price = np.zeros(len(limits.most))
    undecided = _first(objective, limits, weights, lower, upper, sharpness)
    decided = lower.copy()
    if len(undecided) < int((upper > lower).sum()):
        decided, weights = _decide(limits, lower, upper, undecided, weights)
    else:
        weights = _loosened(limits, weights, undecided)
    for _ in range(ROUNDS):
        weights, price = _interior(objective, limits, weights, undecided, sharpness, 0.1 * tolerance)
        near = objective.near(weights, sharpness)
        bound = near.bound(weights, limits, lower, upper)
        if best is None or bound > best.bound:
            best = Relaxed(weights, bound, near)
        gap = near.bound(weights, limits, weights, weights) - bound
        if gap <= tolerance or bound > target:
            break
        reduced = near.gain - limits.matrix.T @ price
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
    return weights, best  # type: ignore[return-value]


def _first(objective: Objective, limits: Limits, weights: Array, lower: Array, upper: Array, sharpness: float
           ) -> NDArray[np.int64]:
    """The candidates of which it is least plain whether they are in or out."""
    free = np.flatnonzero(upper > lower)
    if len(free) <= WORKING:
        return free
    gain = objective.near(weights, sharpness).gain[free]
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


def _interior(objective: Objective, limits: Limits, weights: Array, undecided: NDArray[np.int64], sharpness: float,
              tolerance: float) -> tuple[Array, Array]:
    """Primal-dual interior point on the undecided weights, the others kept; returns weights and prices of limits."""
    weights, matrix = weights.copy(), limits.matrix[:, undecided]
    w = weights[undecided]
    fixed = weights.copy()
    fixed[undecided] = 0.0
    room = limits.most - limits.matrix @ fixed
    slack = np.maximum(room - matrix @ w, 1e-12)
    near = objective.near(weights, sharpness)
    active = np.any(matrix > 0, axis=1)
    mu = 0.1 / max(len(w), 1)
    price = np.where(active, mu / slack, 0.0)
    low, high = mu / w, mu / (1.0 - w)
    total = 2 * len(w) + int(active.sum())
    for _ in range(STEPS):
        gain = near.gain[undecided]
        complementarity = float((w @ low + (1.0 - w) @ high + slack @ price) / total)
        dual = -gain + matrix.T @ price - low + high
        if complementarity * total < tolerance and np.max(np.abs(dual), initial=0.0) < tolerance:
            break
        aim = 0.15 * complementarity
        normal = near.curvature(undecided)
        normal[np.diag_indices(len(w))] += low / w + high / (1.0 - w)
        normal += matrix.T @ (matrix * (price / slack)[:, None])
        right = gain - matrix.T @ (np.where(active, aim / slack, 0.0)) + aim / w - aim / (1.0 - w)
        move = _solve(normal, right)
        use = matrix @ move
        d_price = np.where(active, (aim - slack * price + price * use) / slack, 0.0)
        d_low = (aim - w * low - low * move) / w
        d_high = (aim - (1.0 - w) * high + high * move) / (1.0 - w)
        step = min(1.0, 0.99 * min(_largest_step(w, move), _largest_step(1.0 - w, -move),
                                   _largest_step(slack, -use)))
        other = min(1.0, 0.99 * min(_largest_step(price, d_price), _largest_step(low, d_low),
                                    _largest_step(high, d_high)))
        while True:
            trial = weights.copy()
            trial[undecided] = w + step * move
            try:
                ahead = objective.near(trial, sharpness)
            except np.linalg.LinAlgError:
                ahead = None
            # Far from the centre of the path a full step may overshoot: the objective must not rise steeply.
            if ahead is not None and ahead.loss <= near.loss + 2.0:
                break
            step *= 0.5
            if step < 1e-6:
                return weights, price
        weights, near = trial, ahead
        w = np.clip(weights[undecided], NEAREST, 1.0 - NEAREST)
        slack = np.maximum(slack - step * use, 1e-14)
        price, low, high = price + other * d_price, low + other * d_low, high + other * d_high
    return weights, price


def _solve(normal: Array, right: Array) -> Array:
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    scale = 1.0 / np.sqrt(np.diag(normal))
    scaled = normal * scale[:, None] * scale[None, :]
    try:
        return np.asarray(scale * cho_solve(cho_factor(scaled), scale * right))
    except LinAlgError:
        scaled[np.diag_indices(len(scaled))] += 1e-10
        return np.asarray(scale * np.linalg.lstsq(scaled, scale * right, rcond=1e-12)[0])


def _largest_step(value: Array, change: Array) -> float:
    falling = change < 0
    return float(np.min(-value[falling] / change[falling], initial=np.inf))
