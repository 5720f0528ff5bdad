"""Choices to begin with: greedy, backward, rounded from a relaxation; each as large as asked for and within limits."""

from __future__ import annotations

import numpy as np

from calib.analyse.selection.exchange import exchange
from calib.analyse.selection.greedy import backward, greedy, regularised
from calib.analyse.selection.limits import Limits
from calib.analyse.selection.objective import Objective
from calib.blocks import Array

MANY = 2000      # candidates up to which a search may also go backward


def completed(objective: Objective, limits: Limits, chosen: list[int]) -> list[int]:
    """A choice as large as asked for: where other limits stopped one early, the nearest to it that is.

    Raises nothing: without any such choice the one given comes back.
    """
    if limits.keep is None or len(chosen) >= limits.keep:
        return chosen
    wish = np.zeros(objective.count)
    wish[chosen] = 2.0 - np.arange(len(chosen)) / max(len(chosen), 1)
    weights = np.minimum(wish, 1.0)
    gain = objective.pull([regularised(t.information(weights)) for t in objective.terms], np.arange(objective.count))
    wish += 0.5 * gain / max(float(gain.max()), 1e-300) * (weights == 0)
    found = limits.nearest(wish)
    return chosen if found is None else found


def improved(objective: Objective, limits: Limits, chosen: list[int]) -> list[int]:
    """An exchange, where that does not end in a choice that hides what is asked for."""
    found = exchange(objective, limits, chosen)
    return found if objective.loss(found) < objective.loss(chosen) else chosen


def first_choice(objective: Objective, limits: Limits) -> list[int]:
    """Greedy; where that hides something asked for, with exchange; where that does, too, backward."""
    easier = objective.stand_in
    chosen = completed(easier, limits, greedy(easier, limits))
    if not np.isfinite(objective.loss(chosen)):
        chosen = exchange(easier, limits, chosen)
    if not np.isfinite(objective.loss(chosen)) and objective.count <= MANY:
        chosen = improved(easier, limits, completed(easier, limits, backward(easier, limits)))
    return chosen


def exchanged(objective: Objective, limits: Limits, chosen: list[int]) -> list[int]:
    """The best that exchanges make of a choice, first of what stands in for the criterion."""
    if not objective.single:
        chosen = improved(objective.stand_in, limits, chosen)
    return improved(objective, limits, chosen)


def rounded(objective: Objective, limits: Limits, weights: Array, lower: Array | None = None,
            upper: Array | None = None) -> list[int]:
    """The candidates with the largest weights (n,) that fit, lower ones in any case and others than upper ones not;
    then exchange. It may hide what is asked for."""
    taken = np.zeros(objective.count) if lower is None else lower.copy()
    used = limits.matrix @ taken
    for i in np.argsort(-weights, kind="stable"):
        may = upper is None or upper[i] > 0.5
        if may and taken[i] < 0.5 and np.all(used + limits.matrix[:, i] <= limits.most + 1e-9):
            taken[i] = 1.0
            used = used + limits.matrix[:, i]
    return exchange(objective, limits, completed(objective, limits, np.flatnonzero(taken).tolist()), 200)


def better(objective: Objective, limits: Limits, *choices: list[int]) -> list[int]:
    """The best of several choices, among those that are as large as asked for and within the limits."""
    fitting = [c for c in choices if limits.meets(c)]
    return min(fitting or choices, key=objective.loss)
