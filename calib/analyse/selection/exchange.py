"""Fedorov's exchange: swap a chosen candidate for another as long as that helps.

Source: Fedorov (1972), Theory of Optimal Experiments; Cook and Nachtsheim (1980) for the pass over chosen candidates.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.analyse.selection.greedy import REFACTOR, regularised
from calib.analyse.selection.limits import Limits
from calib.analyse.selection.objective import Objective
from calib.analyse.selection.terms import Determinant, Trace
from calib.blocks import Array

PROMISING = 400      # rows tried first for a swap
SCREENED = 48      # candidates that a pass tries exactly where there are many more
LEAST = 1e-9      # gain of a swap, in the logarithm of the criterion, below which it is rounding


def exchange(objective: Objective, limits: Limits, chosen: Sequence[int], swaps: int = 10_000) -> list[int]:
    """Improve a choice by swaps until none helps.

    chosen: to begin with, within the limits; swaps: at most. Returns the improved choice, sorted.
    """
    term = objective.terms[0]
    if len(objective.terms) == 1 and term.rows.shape[1] == 1 and limits.only_keep and type(term) in (Determinant,
                                                                                                     Trace):
        return _all_swaps(objective, list(chosen), swaps)
    return _pass_by_pass(objective, limits, list(chosen), swaps)


def _all_swaps(objective: Objective, chosen: list[int], swaps: int) -> list[int]:
    """The best of all swaps of single rows, found as one array, again and again.

    Determinant: the swap of i for j multiplies it by (1 - d_i)(1 + d_j) + g_ij^2. Trace: it changes by
    [(d_i - 1) e_j - 2 g_ij k_ij + (1 + d_j) e_i] / [(1 + d_j)(d_i - 1) - g_ij^2], with d = a'Ca, e = a'CWCa,
    g = a_i'C a_j, k = a_i'CWC a_j. Because g^2 <= d_i d_j, a row with d_j <= min d_i never helps the determinant.
    """
    term = objective.terms[0]
    rows, weights = term.rows[:, 0], np.zeros(objective.count)
    weights[chosen] = 1.0
    outer = term.matrix.T @ term.matrix if isinstance(term, Trace) else None
    count = 0
    while count < swaps:
        inverse = regularised(term.information(weights))
        mine = np.flatnonzero(weights)
        others = np.flatnonzero(weights == 0)
        through = rows @ inverse
        d = np.einsum("ij,ij->i", through, rows)
        if outer is None:
            others = others[d[others] > d[mine].min()]
            made = _determinant_swaps(rows, through, d, mine, others, weights, min(REFACTOR, swaps - count))
        else:
            made = _trace_swaps(rows, inverse, outer, weights, min(REFACTOR, swaps - count))
        count += made
        if made < REFACTOR:
            break
    return sorted(np.flatnonzero(weights).tolist())


def _determinant_swaps(rows: Array, through: Array, d: Array, mine: Array, others: Array, weights: Array, most: int
                       ) -> int:
    """Up to `most` best swaps in place; returns how many helped."""
    if not others.size:
        return 0
    mine = mine.copy()
    places = np.concatenate([mine, others])
    k = len(mine)
    # One square of products a_i'C a_j serves all swaps; each swap changes it by two outer products.
    g = through[places] @ rows[places].T
    inside = np.zeros(len(places), dtype=bool)
    inside[:k] = True
    for made in range(most):
        d = np.diag(g)
        i_all, j_all = np.flatnonzero(inside), np.flatnonzero(~inside)
        j_all = j_all[d[j_all] > d[i_all].min()]
        if not j_all.size:
            return made
        ratio = (1.0 - d[i_all])[:, None] * (1.0 + d[j_all])[None, :] + g[np.ix_(i_all, j_all)] ** 2
        place = int(np.argmax(ratio))
        i, j = i_all[place // len(j_all)], j_all[place % len(j_all)]
        if np.log(ratio.flat[place]) < LEAST:
            return made
        inside[i], inside[j] = False, True
        weights[places[i]], weights[places[j]] = 0.0, 1.0
        g = g - np.outer(g[:, j], g[j]) / (1.0 + g[j, j])
        g = g + np.outer(g[:, i], g[i]) / max(1.0 - g[i, i], 1e-12)
    return most


def _trace_swaps(rows: Array, inverse: Array, outer: Array, weights: Array, most: int) -> int:
    """Up to `most` best swaps in place; returns how many helped."""
    trace = float(np.sum(inverse * outer))
    every = np.flatnonzero(weights == 0)
    through = rows[every] @ inverse
    alone = np.einsum("ij,ij->i", through @ outer, through) / (1.0 + np.einsum("ij,ij->i", through, rows[every]))
    # The best swap is nearly always among the rows that help most by themselves; only where it is not are all tried.
    promising = every[np.argsort(-alone)[:PROMISING]]
    for made in range(most):
        mine = np.flatnonzero(weights)
        for others in (promising[weights[promising] == 0], np.flatnonzero(weights == 0)):
            i, j, fall = _best_trace_swap(rows, inverse, outer, mine, others)
            if fall >= LEAST * trace:
                break
        else:
            return made
        weights[i], weights[j] = 0.0, 1.0
        v = inverse @ rows[j]
        inverse = inverse - np.outer(v, v) / (1.0 + float(rows[j] @ v))
        v = inverse @ rows[i]
        inverse = inverse + np.outer(v, v) / max(1.0 - float(rows[i] @ v), 1e-12)
        trace = float(np.sum(inverse * outer))
    return most


def _best_trace_swap(rows: Array, inverse: Array, outer: Array, mine: Array, others: Array) -> tuple[int, int, float]:
    """What goes, what comes, and by how much the trace falls."""
    if not others.size:
        return 0, 0, -np.inf
    going, coming = rows[mine] @ inverse, rows[others] @ inverse
    turned = going @ outer
    d_i, d_j = np.einsum("ij,ij->i", going, rows[mine]), np.einsum("ij,ij->i", coming, rows[others])
    e_i, e_j = np.einsum("ij,ij->i", turned, going), np.einsum("ij,ij->i", coming @ outer, coming)
    g, k = going @ rows[others].T, turned @ coming.T
    below = (d_i - 1.0)[:, None] * (1.0 + d_j)[None, :] - g**2
    rise = (d_i - 1.0)[:, None] * e_j[None, :] - 2.0 * g * k + (1.0 + d_j)[None, :] * e_i[:, None]
    fall = rise / np.minimum(below, -1e-15)
    # Removing i and adding j changes the trace by minus the ratio; the ratio is positive where that helps.
    place = int(np.argmax(fall))
    return int(mine[place // len(others)]), int(others[place % len(others)]), float(fall.flat[place])


def _pass_by_pass(objective: Objective, limits: Limits, chosen: list[int], swaps: int) -> list[int]:
    """Each chosen candidate in turn is taken out and the best one put in its place, until a whole pass changes
    nothing."""
    weights = np.zeros(objective.count)
    weights[chosen] = 1.0
    now, count = _regular_loss(objective, weights), 0
    while count < swaps:
        before = count
        for i in np.flatnonzero(weights):
            weights[i] = 0.0
            open_ones = np.flatnonzero(limits.room(limits.matrix @ weights) & (weights == 0))
            inverses = [regularised(t.information(weights)) for t in objective.terms]
            open_ones = _screened(objective, inverses, open_ones)
            after = objective.after(inverses, open_ones)
            best = int(np.argmin(after))
            if after[best] < now - LEAST and open_ones[best] != i:
                weights[open_ones[best]] = 1.0
                now, count = float(after[best]), count + 1
                # A cheaper candidate may have left room for one more.
                for more in _fill(objective, limits, weights):
                    weights[more] = 1.0
                    now = _regular_loss(objective, weights)
            else:
                weights[i] = 1.0
        if count == before:
            break
    return sorted(np.flatnonzero(weights).tolist())


def _screened(objective: Objective, inverses: list[Array], among: Array) -> Array:
    """Those of many candidates that help most to first order."""
    if len(among) <= 4 * SCREENED:
        return among
    return np.asarray(among[np.argsort(-objective.pull(inverses, among))[:SCREENED]])


def _regular_loss(objective: Objective, weights: Array) -> float:
    inverses = [regularised(t.information(weights)) for t in objective.terms]
    return max(float(t.after(c, np.zeros((1, 1, len(c))))[0]) for t, c in zip(objective.terms, inverses))


def _fill(objective: Objective, limits: Limits, weights: Array) -> list[int]:
    from calib.analyse.selection.greedy import greedy

    if limits.keep is not None and weights.sum() >= limits.keep:
        return []
    return greedy(objective, limits, weights)
