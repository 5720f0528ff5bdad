"""Solve a job and ask everything of it that a report shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import Any

import numpy as np

from calib import units
from calib.analyse.budget import Budget, budgets
from calib.analyse.components import VarianceComponents, variance_components
from calib.analyse.covariance import Covariance, covariance, of_instances
from calib.analyse.estimability import Estimability, estimability
from calib.analyse.reliability import Reliability, reliability
from calib.analyse.shapes import scene
from calib.errors import CalibrationError, InputError
from calib.job import Job
from calib.linearisation import Functions, Linearisation, linearise
from calib.problem import Problem
from calib.scene import Scene
from calib.solve.downweight import RobustLoss
from calib.solve.estimate import Estimate, solve
from calib.solve.method import Method
from calib.solve.robust import RobustEstimate, robust
from calib.unknown import Unknown
from calib.workflow.conformity import Conformity, judge
from calib.workflow.knowledge import named, with_priors
from calib.workflow.shown import values_by_label

BUDGETS = 40     # results up to which a budget is split; beyond that a table of budgets is read by nobody
INSEPARABLE = 0.999      # correlation of two unknowns from which on a report speaks of it
REPEATS = 12     # instances up to which an unknown nobody named is reported; foot points and poses are not results
TOGETHER = 600   # scalars of unknowns that nobody named whose joint covariance is reported


@dataclass(frozen=True)
class Coverage:
    """Effective degrees of freedom of an uncertainty from variance components, and its factor k for 95%."""

    dof: float
    k: float


@dataclass(frozen=True)
class HeldOut:
    """A gap on readings that the estimate did not use, before and after the identification, in the unit named."""

    quantity: str
    before: float
    after: float
    unit: str


@dataclass(frozen=True)
class Solution:
    """A solved job with its analyses.

    results: the requested quantities with their covariance; results_vc, coverage: the same with estimated variance
    components; u_of: u (SI) of every unknown, (count, freedom), not a number where held; including: the results with
    the excluded rows back in; remarks, advice: sentences of the problem module: what no reading shows, what to adjust;
    weak: what the readings hardly tell apart; heldout: gaps on readings that were not used; scene: as the problem
    declares it or as it follows from its unknowns; absent: labels of scalars that stand for nothing, such as the height
    of a plane point; tables: of the problem module, {name: lines}, each line {column with its unit: value}; robust:
    how readings were weighed, where a robust loss was asked for.
    """

    job: Job
    problem: Problem
    estimate: Estimate
    fit: Linearisation
    results: Covariance
    u_of: dict[Unknown, np.ndarray]
    reliability: Reliability
    estimability: Estimability
    budgets: tuple[Budget, ...]
    components: VarianceComponents | None
    components_refused: str
    results_vc: Covariance | None
    coverage: tuple[Coverage, ...] = ()
    conformities: tuple[Conformity, ...] = ()
    including: Covariance | None = None
    including_refused: str = ""
    remarks: tuple[str, ...] = ()
    weak: tuple[str, ...] = ()
    heldout: tuple[HeldOut, ...] = ()
    advice: tuple[str, ...] = ()
    named_by_key: tuple[str, ...] = ()
    scene: Scene = field(default_factory=lambda: Scene(()))
    absent: frozenset[str] = frozenset()
    tables: Mapping[str, list[dict[str, Any]]] = field(default_factory=dict)
    robust: RobustEstimate | None = None

    @property
    def displayed(self) -> list[tuple[str, float | None, float, str]]:
        """(name, value, u, unit) of the results in display units; no value for the two small angles of a direction."""
        readable: dict[str, float | None] = {}
        for unknown in self.fit.layout.unknowns:
            if unknown.kind != "vector":
                readable.update(values_by_label(self.fit, unknown))
        found: list[tuple[str, float | None, float, str]] = []
        for name, value, u, unit in self.results.displayed:
            own = readable.get(name, value)
            if name in readable and own is not None:
                own = float(units.from_si(own, unit))
            found.append((name, None if own is None else float(own), float(u), unit))
        return found


def declared(job: Job, module: ModuleType) -> Problem:
    """The problem of a job, with its prior knowledge.

    job: as read; module: the problem module that it names.
    return: the problem.
    raises InputError for a key that nobody asked for, or a name that is not in the problem.
    """
    problem = module.from_job(job)
    for section in ("options", "instruments", "known"):
        job.settings.table(section)
    job.refuse_unknown_keys()
    return with_priors(problem, job.priors)


def solved(job: Job, module: ModuleType, method: Method, loss: RobustLoss | None = None) -> Solution:
    """Solve a job and analyse the estimate.

    job: as read; module: the problem module that it names; method: how to solve; loss: a robust one instead of squares.
    return: the solution.
    raises InputError, MethodRefusal or RankDefect where there is none.
    """
    problem = declared(job, module)
    wanted = requested(problem, job.quantities, job.report.where("quantities"))
    weighed, estimate = _estimated(problem, method, loss)
    fit = linearise(estimate)
    results = covariance(fit, *wanted)
    components, refused = _components(fit) if weighed is None else (
        None, "a robust loss bounds the very scatter that they are about")
    rescaled = components.rescaled(fit) if components else None
    including, why = _including(job, module, method, loss)
    return Solution(
        job=job,
        problem=problem,
        estimate=estimate,
        fit=fit,
        results=results,
        u_of=_uncertainties(fit),
        reliability=reliability(fit if weighed is None else weighed.fit),
        estimability=estimability(fit),
        budgets=_budgets(fit, wanted) if weighed is None else (),
        components=components,
        components_refused=refused,
        results_vc=covariance(rescaled, *wanted) if rescaled else None,
        coverage=_coverages(rescaled, components, wanted) if rescaled and components else (),
        conformities=_conformities(job, results),
        including=including,
        including_refused=why,
        remarks=tuple(module.remarks(job)) if hasattr(module, "remarks") else (),
        weak=_weak(problem, results),
        heldout=tuple(HeldOut(*one) for one in module.heldout(job, estimate)) if hasattr(module, "heldout") else (),
        advice=tuple(module.advice(fit)) if hasattr(module, "advice") and weighed is None else (),
        named_by_key=tuple(getattr(module, "named_by_key", ())),
        absent=frozenset(module.absent(job)) if hasattr(module, "absent") else frozenset(),
        tables=module.result_tables(fit) if hasattr(module, "result_tables") else {},
        scene=module.scene(job, estimate) if hasattr(module, "scene") else scene(fit),
        robust=weighed,
    )


def _estimated(problem: Problem, method: Method, loss: RobustLoss | None) -> tuple[RobustEstimate | None, Estimate]:
    """The estimate, and how its readings were weighed where a robust loss was asked for."""
    if loss is None:
        return None, solve(problem, method)
    found = robust(problem, loss)
    message = found.estimate.message if found.converged else \
        f"the weights of the readings still changed after {found.iterations} rounds"
    return found, replace(
        found.estimate, problem=problem, fit=found.robust_fit, iterations=found.iterations, message=message,
        method=f"{found.estimate.method}, reweighted", converged=found.converged and found.estimate.converged)


def _uncertainties(fit: Linearisation) -> dict[Unknown, np.ndarray]:
    """Standard uncertainty of every free scalar, in SI; not a number where it is held."""
    found = {}
    for unknown in fit.layout.unknowns:
        free = fit.layout.free[fit.layout.span(unknown)].reshape(unknown.count, unknown.freedom)
        variances = np.diagonal(of_instances(fit, unknown), axis1=1, axis2=2)
        found[unknown] = np.where(free, np.sqrt(variances), np.nan)
    return found


def _components(fit: Linearisation) -> tuple[VarianceComponents | None, str]:
    try:
        return variance_components(fit), ""
    except CalibrationError as error:
        return None, str(error)


def _weak(problem: Problem, results: Covariance) -> tuple[str, ...]:
    """Pairs of unknowns that the readings hardly tell apart, as sentences; derived results follow others by nature."""
    labels = {label for unknown in problem.unknowns for label in unknown.labels}
    own = [i for i, name in enumerate(results.names) if name in labels]
    correlation = np.abs(results.correlation[np.ix_(own, own)])
    pairs = np.argwhere(np.triu(correlation, 1) > INSEPARABLE)
    return tuple(
        f"The readings hardly tell {results.names[own[i]]} from {results.names[own[j]]} (correlation of size "
        f"{correlation[i, j]:.5f}): readings over a wider range, or a prior on one of them, would."
        for i, j in pairs[:5])


def _budgets(fit: Linearisation, wanted: Sequence[Any]) -> tuple[Budget, ...]:
    """The budget of each scalar result, up to a number that somebody would read."""
    every = fit.functions(*wanted)
    return budgets(fit, Functions(every.labels[:BUDGETS], every.units[:BUDGETS], every.values[:BUDGETS],
                                  every.derivatives[:BUDGETS]))


def _coverages(rescaled: Linearisation, components: VarianceComponents, wanted: Sequence[Any]) -> tuple[Coverage, ...]:
    """Welch-Satterthwaite: JCGM 100:2008, G.4; what is stated counts as known with certainty."""
    from scipy.special import stdtrit

    dof_of = {group: float(dof) for groups, dof in zip(components.groups, components.dof) for group in groups}
    found = []
    for one in _budgets(rescaled, wanted):
        spread = sum(line.u**4 / dof_of[line.label] for line in one.contributions if line.label in dof_of)
        dof = one.u**4 / spread if spread > 0 else np.inf
        found.append(Coverage(dof, float(stdtrit(dof, 0.975)) if np.isfinite(dof) else 1.96))
    return tuple(found)


def _including(
    job: Job, module: ModuleType, method: Method, loss: RobustLoss | None
) -> tuple[Covariance | None, str]:
    if not job.exclude:
        return None, ""
    whole = job.including_excluded()
    try:
        problem = with_priors(module.from_job(whole), whole.priors)
        wanted = requested(problem, job.quantities, job.report.where("quantities"))
        return covariance(linearise(_estimated(problem, method, loss)[1]), *wanted), ""
    except CalibrationError as error:
        return None, str(error)


def _conformities(job: Job, results: Covariance) -> tuple[Conformity, ...]:
    found = []
    for tolerance in job.tolerances:
        if tolerance.quantity not in results.names:
            near = units.near_matches(tolerance.quantity, list(results.names))
            hint = f"did you mean '{near[0]}'? " if near else ""
            raise InputError(f"{tolerance.where}: '{tolerance.quantity}' is not among the results; {hint}There are: "
                             f"{', '.join(results.names)}")
        index = results.names.index(tolerance.quantity)
        if units.dimension(results.units[index]) != units.dimension(tolerance.unit):
            raise InputError(f"{tolerance.where}: the tolerance is in {tolerance.unit}, the result in "
                             f"{results.units[index]}; correct the unit")
        value, u = results[tolerance.quantity]
        found.append(judge(tolerance.quantity, tolerance.unit, value, u, tolerance.lower, tolerance.upper))
    return tuple(found)



def requested(problem: Problem, names: Sequence[str], where: str) -> list[Any]:
    """What a report is about: the named quantities and unknowns, or, where none is named, all that do not repeat often,
    or else the first instances of those that do.

    names: of [report] quantities; where: place in the job, for the message.
    return: selections, unknowns and quantities.
    raises InputError where a name is not in the problem.
    """
    if names:
        return [named(problem, name, where) for name in names]
    unknowns = [one for one in problem.unknowns if one.count <= REPEATS and not problem.is_held(one).all()]
    few = [*(one for one in problem.quantities if one.n <= REPEATS), *unknowns]
    many = [one for one in problem.unknowns if not problem.is_held(one).all()]
    shown = TOGETHER // max(sum(one.freedom for one in many), 1)
    return few or [one if one.count <= shown else one[np.arange(shown)] for one in many]
