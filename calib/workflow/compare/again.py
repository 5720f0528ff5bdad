"""A method or formulation run again on other readings of the same problem: for u by simulation and for studies."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from calib.errors import CalibrationError
from calib.problem import Problem
from calib.solve.estimate import Estimate, solve
from calib.solve.method import Method
from calib.workflow.compare.answer import Wanted, placed, results
from calib.workflow.compare.formulation import ClosedForm, Formulation, Global, Redeclared

Again = Callable[[Problem], Mapping[str, float]]


def again(formulation: Formulation | Method, wanted: Wanted, around: Estimate) -> Again:
    """What a formulation, or a method on the declared problem, makes of other readings.

    wanted: results; around: an estimate of the declared problem, where what an answer leaves open starts from.
    Returns a function of the declared problem with other readings: {result: SI}, which raises CalibrationError where
    the readings are not taken, and gives nothing where an answer does not determine a result.
    """

    def solved(problem: Problem, method: Method | None = None) -> Mapping[str, float]:
        estimate = solve(problem, method)
        if not estimate.converged:
            raise CalibrationError(estimate.message)
        return results(estimate.fit, wanted)[0]

    def closed(problem: Problem, form: ClosedForm) -> Mapping[str, float]:
        at = placed(problem, form.values(problem), around)
        return {} if at.fit is None else results(at.fit, wanted)[0]

    if isinstance(formulation, ClosedForm):
        return lambda problem: closed(problem, formulation)
    if isinstance(formulation, Redeclared):
        return lambda problem: solved(formulation.declare(problem))
    if isinstance(formulation, Global):
        return lambda problem: results(from_anywhere(problem, formulation).fit, wanted)[0]
    if isinstance(formulation, Problem):
        return lambda problem: solved(with_readings_of(formulation, problem))
    return lambda problem: solved(problem, formulation)


def from_anywhere(problem: Problem, formulation: Global) -> Estimate:
    """The declared problem solved from the start that a global formulation finds."""
    begin = {problem.select(key): value for key, value in formulation.begin(problem).items()}
    return solve(problem, None, {key.unknown: value for key, value in begin.items()})


def with_readings_of(other: Problem, drawn: Problem) -> Problem:
    """Another declaration of the same readings with those of a drawn problem.

    Raises CalibrationError where a group of its readings is no group of the drawn problem, row for row.
    """
    there = {one.group: one.readings for one in drawn.observations}
    mine = {}
    for one in other.observations:
        its = there.get(one.group)
        if one.readings is None:
            continue
        if its is None or its.shape != one.readings.shape:
            raise CalibrationError(f"its readings '{one.group}' are not those of the declared problem, row for row, so "
                                   "that it cannot be run on drawn ones")
        mine[one.group] = its
    return other.with_readings(mine)
