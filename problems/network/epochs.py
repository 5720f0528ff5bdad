"""Comparison of two epochs of a network: which points moved (congruence test).

Points count as one rigid figure until the test says otherwise; then the point whose leaving explains most is taken out,
and the rest is tested again. The answer does not depend on the datum of either epoch.
Source: Pelzer (1971), Zur Analyse geodaetischer Deformationsmessungen; Niemeier (2008), Ausgleichungsrechnung, 13.3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from calib import Linearisation, Unknown, covariance, linearise, solve
from calib.errors import InputError
from problems.network.declare import declare, declare_free
from problems.network.survey import ADJUSTED, CONSTRAINED, FIXED, Survey

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Step:
    """One test: the points taken as stable, the test quantity, its degrees of freedom and the probability of more."""

    stable: tuple[str, ...]
    quantity: float
    dof: int
    p_value: float


@dataclass(frozen=True)
class Congruence:
    """What moved between two epochs.

    points; parts; shift (n, d), u (n, d) [m]: second less first, in the datum of the stable points; stable, moved:
    keys; steps: the tests in order.
    """

    points: tuple[str, ...]
    parts: tuple[str, ...]
    shift: Array
    u: Array
    stable: tuple[str, ...]
    moved: tuple[str, ...]
    steps: tuple[Step, ...]

    def sentences(self) -> list[str]:
        """What moved, in words."""
        if not self.moved:
            return [f"No point moved (p = {self.steps[-1].p_value:.2g} for {len(self.stable)} points as one figure)."]
        return [
            f"Point '{key}' moved by " + ", ".join(
                f"{part} {1e3 * s:+.2f} mm (u {1e3 * u:.2f})" for part, s, u in
                zip(self.parts, self.shift[self.points.index(key)], self.u[self.points.index(key)], strict=True))
            for key in self.moved
        ]


def congruence(first: Survey, second: Survey, level: float = 0.01) -> Congruence:
    """Find the points that moved between two epochs.

    first, second: surveys with positions, of the same marks (others are ignored); level: of each test.
    Returns the points that moved, with their shifts in the datum of those that did not.
    Raises InputError where the epochs share too few points, or leave a different datum open.
    """
    if first.parts != second.parts:
        raise InputError(f"the first epoch has coordinates {first.parts}, the second {second.parts}; compare epochs of "
                         "the same kind")
    epochs = [_free_epoch(survey, first) for survey in (first, second)]
    (one, point_one, null), (two, point_two, other) = epochs
    keys = tuple(k for k in point_one.keys if k in point_two.keys and _adjusted(first, second, k))
    if null.shape[1] != other.shape[1]:
        raise InputError(f"the readings of the first epoch leave {null.shape[1]} directions of the datum open, those "
                         f"of the second {other.shape[1]}; without the same datum their points cannot be compared")
    size = len(first.parts)
    places = [np.concatenate([np.arange(size) + size * point.keys.index(key) for key in keys])
              for point in (point_one, point_two)]
    if len(keys) * size <= null.shape[1]:
        raise InputError(f"the epochs share {len(keys)} adjusted point(s), too few to compare; measure more of the "
                         "marks again")
    a, b = covariance(one, point_one), covariance(two, point_two)
    shift = b.values[places[1]] - a.values[places[0]]
    spread = a.matrix[np.ix_(places[0], places[0])] + b.matrix[np.ix_(places[1], places[1])]
    return _localised(keys, first.parts, shift, spread, null[places[0]], level)


def _adjusted(first: Survey, second: Survey, key: str) -> bool:
    return all(FIXED not in (s.points[key].plane, s.points[key].height) for s in (first, second))


def _free_epoch(survey: Survey, like: Survey) -> tuple[Linearisation, Unknown, Array]:
    """An epoch in a free datum over its adjusted points: linearisation, its points, what the readings leave open."""

    def role(old: str) -> str:
        return CONSTRAINED if old == ADJUSTED else old

    start = {key: like.points[key].position for key in survey.points if key in like.points}
    placed = survey.placed(start).points
    points = {key: replace(p, plane=role(p.plane), height=role(p.height)) for key, p in placed.items()}
    free = replace(survey, points=points)
    fit = linearise(solve(declare(free)))
    open_datum = linearise(declare_free(free))
    point = next(u for u in fit.layout.unknowns if u.name == "point")
    own = next(u for u in open_datum.layout.unknowns if u.name == "point")
    null = np.zeros((open_datum.layout.size, open_datum.factor.defect))
    if open_datum.factor.defect:
        null[open_datum.layout.free_columns] = open_datum.factor.null
    return fit, point, null[open_datum.layout.span(own)]


def _localised(
    keys: tuple[str, ...], parts: str, shift: Array, spread: Array, null: Array, level: float
) -> Congruence:
    size, stable, steps = len(parts), list(keys), []
    while True:
        step = _tested(keys, stable, size, shift, spread, null)
        steps.append(step)
        enough = (len(stable) - 1) * size > null.shape[1]
        if step.p_value >= level or not enough:
            break
        without = [_tested(keys, [k for k in stable if k != key], size, shift, spread, null) for key in stable]
        stable.pop(int(np.argmin([one.quantity - 2.0 * one.dof for one in without])))
    moved_shift, moved_spread = _in_datum_of(keys, stable, size, shift, spread, null)
    u = np.sqrt(np.maximum(np.diag(moved_spread), 0.0)).reshape(-1, size)
    moved = tuple(key for key in keys if key not in stable)
    return Congruence(keys, tuple(parts), moved_shift.reshape(-1, size), u, tuple(stable), moved, tuple(steps))


def _in_datum_of(
    keys: tuple[str, ...], stable: list[str], size: int, shift: Array, spread: Array, null: Array
) -> tuple[Array, Array]:
    """Shifts and their covariance with the datum on the stable points (S-transformation; Baarda, 1973)."""
    inside = np.repeat(np.isin(keys, stable), size)
    chosen = null * inside[:, None]
    change = np.eye(len(shift)) - null @ np.linalg.pinv(chosen.T @ null) @ chosen.T
    return change @ shift, change @ spread @ change.T


def _tested(
    keys: tuple[str, ...], stable: list[str], size: int, shift: Array, spread: Array, null: Array
) -> Step:
    """Whether the stable points form one rigid figure in both epochs; stated uncertainties, so chi-squared."""
    moved, matrix = _in_datum_of(keys, stable, size, shift, spread, null)
    inside = np.repeat(np.isin(keys, stable), size)
    dof = int(inside.sum()) - int(np.linalg.matrix_rank(null[inside])) if null.shape[1] else int(inside.sum())
    values, axes = np.linalg.eigh(matrix[np.ix_(inside, inside)])
    strongest = np.argsort(values)[len(values) - dof :]
    along = axes[:, strongest].T @ moved[inside]
    quantity = float(np.sum(along**2 / values[strongest]))
    return Step(tuple(stable), quantity, dof, float(chdtrc(dof, quantity)))
