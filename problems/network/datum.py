"""The datum of a network: what fixes position, turn and scale where no reading does.

Fixed points are held; points with a covariance are readings of their coordinates; a free network keeps its constrained
points, as a whole, nearest to where they were said to be (inner constraints). All give the same estimable quantities.
Source: Meissl (1962), inner constraints; Baarda (1973), S-transformations.
"""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib import Constraint, Problem, Unknown, linearise, solve


class Nearest:
    """Condition that points are, as a whole, nearest to given positions: coefficients (k, m, d) of their shifts [m]."""

    def __init__(self, coefficients: NDArray[Any], given: NDArray[Any]):
        self.coefficients, self.given = coefficients, given
        kind = inspect.Parameter.POSITIONAL_ONLY
        self.__signature__ = inspect.Signature([inspect.Parameter(f"point_{i}", kind) for i in range(len(given))])
        self.__name__ = "nearest"

    def __call__(self, *points: Any) -> list[Any]:
        shifts = [point - place for point, place in zip(points, self.given, strict=True)]
        return [
            sum(float(c) * shift[j] for row, shift in zip(one, shifts, strict=True) for j, c in enumerate(row) if c)
            for one in self.coefficients
        ]


def inner_constraints(problem: Problem, point: Unknown, chosen: NDArray[np.bool_]) -> Problem:
    """The problem with as many conditions as its readings leave free, on the coordinates of the chosen points.

    point: unknown of all points, at the positions to stay nearest to; chosen: (count, parts) coordinates that count.
    Returns the problem itself where the readings leave nothing free.
    """
    fit = linearise(problem)
    if not fit.factor.defect or not chosen.any():
        return problem
    span = fit.layout.span(point)
    null = np.zeros((fit.layout.size, fit.factor.defect))
    null[fit.layout.free_columns] = fit.factor.null
    shifts = np.where(chosen.ravel()[:, None], null[span], 0.0)
    left, lengths, _ = np.linalg.svd(shifts, full_matrices=False)
    kept = left[:, lengths > 1e-9 * lengths[0]].T.reshape(-1, point.count, point.freedom)
    involved = np.flatnonzero(chosen.any(axis=1))
    given = point.ambient[involved]
    # A solver meets a condition to a thousandth of its tolerance, and large coordinates are rounded to some nm.
    tolerance = max(1e-7, 2e4 * np.finfo(float).eps * float(np.abs(given).max()))
    datum = Constraint(
        "datum",
        Nearest(kept[:, involved], given),
        *(point[int(i)] for i in involved),
        tolerance=tolerance,
        unit="m",
    )
    return Problem(
        problem.observations, (*problem.constraints, datum), problem.quantities, name=problem.name
    ).hold(*_held(problem, point))


def _held(problem: Problem, point: Unknown) -> list[Any]:
    mask = problem.is_held(point)
    return [point[np.flatnonzero(mask[:, j])].part(part) for j, part in enumerate(point.parts) if mask[:, j].any()]


def settled(problem: Problem, point: Unknown) -> NDArray[Any]:
    """Adjusted coordinates (count, parts) of all points of a problem [m]."""
    return np.reshape(solve(problem)[point], (point.count, point.freedom))
