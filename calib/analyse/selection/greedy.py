"""Greedy choice: again and again the candidate that helps most, by rank-one updates where rows are single."""

from __future__ import annotations

import numpy as np

from calib.analyse.selection.limits import Limits
from calib.analyse.selection.objective import Objective
from calib.analyse.selection.terms import Determinant, OfFunctions, Trace
from calib.blocks import Array

# Before anything is known an inverse information needs a start; relative to all information together. No reported
# number contains it.
RIDGE = 1e-10
REFACTOR = 25


def greedy(objective: Objective, limits: Limits, given: Array | None = None) -> list[int]:
    """Candidates in the order in which a greedy choice takes them, until the limits allow no more.

    given: (n,) one where a candidate is taken already.
    """
    term = objective.terms[0]
    if len(objective.terms) == 1 and term.rows.shape[1] == 1 and type(term) in (Determinant, Trace):
        return _by_rank_one(objective, limits, given)
    return _by_groups(objective, limits, given)


def regularised(information: Array) -> Array:
    """Inverse of an information that may be singular, with the ridge of an algorithm that starts from nothing."""
    inverse = np.linalg.inv(information + RIDGE * np.eye(len(information)))
    return np.asarray(0.5 * (inverse + inverse.T))


def backward(objective: Objective, limits: Limits) -> list[int]:
    """All candidates less, again and again, the one whose loss matters least, until the limits hold.

    Finds choices where a forward search sees no gain before many candidates are together.
    """
    weights = np.ones(objective.count)
    while not limits.allow(weights):
        inside = np.flatnonzero(weights)
        losses = []
        for term in objective.terms:
            # Removing rows is adding them with the sign of their information turned round.
            inverse = regularised(term.information(weights))
            rows = term.rows[inside]
            seen = rows @ inverse
            within = (1.0 + RIDGE) * np.eye(rows.shape[1]) - seen @ rows.transpose(0, 2, 1)
            if isinstance(term, OfFunctions):
                through = seen @ term.functions.T
                more = through.transpose(0, 2, 1) @ np.linalg.solve(within, through)
                losses.append(term.of_covariance(term.functions @ inverse @ term.functions.T + more))
            else:
                losses.append(-np.log(np.maximum(np.linalg.det(within), RIDGE)))
        weights[inside[int(np.argmin(np.max(losses, axis=0)))]] = 0.0
    return np.flatnonzero(weights).tolist()


def _by_groups(objective: Objective, limits: Limits, given: Array | None) -> list[int]:
    weights = np.zeros(objective.count) if given is None else given.astype(float).copy()
    order: list[int] = []
    while True:
        open_ones = np.flatnonzero(limits.room(limits.matrix @ weights) & (weights == 0))
        if not open_ones.size:
            return order
        inverses = [regularised(t.information(weights)) for t in objective.terms]
        best = int(open_ones[int(np.argmin(_per_cost(objective, limits, inverses, open_ones)))])
        weights[best] = 1.0
        order.append(best)


def _per_cost(objective: Objective, limits: Limits, inverses: list[Array], among: Array) -> Array:
    """Losses after each candidate; where a budget limits, what they gain for their cost, negative."""
    after = objective.after(inverses, among)
    if limits.keep is not None:
        return after
    now = max(float(t.after(c, np.zeros((1, 1, len(c))))[0]) for t, c in zip(objective.terms, inverses))
    return -(now - after) / np.maximum(limits.matrix[0, among], 1e-12 * limits.most[0])


def _by_rank_one(objective: Objective, limits: Limits, given: Array | None) -> list[int]:
    term = objective.terms[0]
    rows = term.rows[:, 0]
    weights = np.zeros(len(rows)) if given is None else given.astype(float).copy()
    used = limits.matrix @ weights
    order: list[int] = []
    outer = term.matrix.T @ term.matrix if isinstance(term, Trace) else None
    inverse = regularised(term.information(weights))
    leverage, pull = _leverages(rows, inverse, outer)
    while True:
        allowed = limits.room(used) & (weights == 0)
        if not allowed.any():
            return order
        gain = leverage if pull is None else pull / (1.0 + leverage)
        if limits.keep is None:
            gain = gain / np.maximum(limits.matrix[0], 1e-12 * limits.most[0])
        best = int(np.argmax(np.where(allowed, gain, -np.inf)))
        weights[best] = 1.0
        order.append(best)
        used = used + limits.matrix[:, best]
        if len(order) % REFACTOR == 0:
            inverse = regularised(term.information(weights))
            leverage, pull = _leverages(rows, inverse, outer)
            continue
        v = inverse @ rows[best] / np.sqrt(1.0 + leverage[best])
        seen = rows @ v
        if outer is not None and pull is not None:
            turned = inverse @ (outer @ v)
            pull = pull - 2.0 * seen * (rows @ turned) + seen**2 * float(v @ outer @ v)
        inverse = inverse - np.outer(v, v)
        leverage = leverage - seen**2


def _leverages(rows: Array, inverse: Array, outer: Array | None) -> tuple[Array, Array | None]:
    """a'Ca of each row, and a'CWCa where the criterion has a W."""
    through = rows @ inverse
    leverage = np.einsum("ij,ij->i", through, rows)
    return leverage, None if outer is None else np.einsum("ij,ij->i", through @ outer, through)
