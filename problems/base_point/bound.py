"""What proves that a base point is the global one: bounds over all base points and lengths, for each tracker.

Source: `calib.solve.globally.increments` where the length at the zero is sought, `calib.solve.globally.ranges` where
the readings are whole lengths.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from calib import Estimate, Problem
from calib.errors import InputError
from calib.solve.globally import ranges
from calib.solve.globally.bound import Bound, best
from calib.solve.globally.increments import bisection_bound
from calib.workflow.compare.formulation import Global
from problems.base_point.algebraic import Span
from problems.base_point.lines import Lines


def of_readings(lines: Lines, sense: float) -> Global:
    """The global formulation of readings along lines whose coordinates are exact; sense: +1 or -1."""
    def begin(declared: Problem) -> dict[str, Any]:
        if not _absolute(declared) or len(np.unique(lines.tracker)) > 1 or Span.of(lines.points).rank < 3:
            return {}
        readings = sense * np.asarray(declared.observations[0].readings, float).ravel()
        return {"base_point": ranges.squared_ranges(lines.points, readings, lines.u)}
    return Global(begin, lambda estimate: bound(estimate, lines, sense), "Beck, Stoica, Li 2008; own bisection")


def bound(estimate: Estimate, lines: Lines, sense: float) -> Bound:
    """The bound on v'Pv, the sum over the trackers; arguments as above.

    Raises InputError where the coordinates are adjusted or weigh with the base point, or a tracker has two zeroings.
    """
    problem = estimate.problem
    if any(o.group == "coordinates" for o in problem.observations):
        raise InputError("the coordinates are adjusted too: each is an unknown of its own, for which there is no bound")
    if any(o.uncertainty.needs for o in problem.observations):
        raise InputError("the uncertainty depends on the base point, so that v'Pv is not one function to be bounded")
    names = np.char.strip(np.char.add(np.char.add(lines.tracker.astype(str), " "), lines.zeroing.astype(str)))
    zeroings, zeroing = np.unique(names, return_inverse=True)
    if len(zeroings) > len(np.unique(lines.tracker)):
        raise InputError("several zeroings of one tracker share its base point, for which there is no bound")
    base = np.reshape(estimate["base_point"], (-1, 3))
    lengths = np.ravel(estimate["start_length"])
    found = []
    for k in range(len(zeroings)):
        i = np.flatnonzero(zeroing == k)
        group = estimate.fit.groups[k]
        readings, u = sense * np.asarray(group.readings, float).ravel(), np.asarray(group.weighting.u, float).ravel()
        found.append(_of_one(problem, lines.points[i], readings, u, base[k], float(lengths[k])))
    lower, objective = sum(one.lower for one in found), sum(one.objective for one in found)
    return Bound(lower, objective, found[0].proof)


def _of_one(problem: Problem, points: np.ndarray, readings: np.ndarray, u: np.ndarray, base: np.ndarray,
            length: float) -> Bound:
    if _absolute(problem):
        return best(ranges.convexity_bound(points, readings, u, base),
                    ranges.relaxation_bound(points, readings, u, base))
    return bisection_bound(points, readings, u, base, length)


def _absolute(problem: Problem) -> bool:
    return bool(problem.is_held(problem.select("start_length").unknown).all())
