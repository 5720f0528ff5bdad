"""Run one declared problem under all methods and formulations, and put the answers on common ground."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calib.errors import CalibrationError
from calib.linearisation import linearise
from calib.problem import Problem
from calib.solve.certificate import Certificate
from calib.solve.convex import Convex
from calib.solve.estimate import Estimate, simulate, solve
from calib.solve.gauss_newton import GaussNewton
from calib.solve.globally.bound import Bound
from calib.solve.ipopt import ExactHessian, GaussNewtonHessian, Ipopt
from calib.solve.loss import L1, Huber, LeastSquares, MinimumZone
from calib.solve.method import Method
from calib.system import System
from calib.workflow.compare.again import Again, again, from_anywhere
from calib.workflow.compare.answer import Placed, Wanted, placed, results, said_by
from calib.workflow.compare.formulation import ClosedForm, Formulation, Global, Redeclared
from calib.workflow.compare.starts import Starts, region, starts
from calib.workflow.compare.study import NOISES, Performance, study

DECLARED = "declared problem"
PATIENCE = 100      # iterations after which a random start counts as failed
STATED, DRAWN, NOT_KNOWN = "stated uncertainties", "simulation", "not known"


@dataclass(frozen=True)
class Effort:
    """How much is tried: starts, draws for u where no formula gives it, seed, seconds for the starts of each, and
    trials of a study under each noise (0: no study)."""

    starts: int = 200
    draws: int = 100
    seed: int = 1
    seconds: float = 10.0
    trials: int = 0


@dataclass(frozen=True)
class Compared:
    """One line of a comparison: a formulation under a method, or the sentence why it refuses.

    values, u, difference: {result: SI}, the difference in units of the reference's u; u_from: where u comes from.
    objective: v'Pv of the declared problem at this answer, None with `note` why. seconds; memory: peak bytes of Python
    and NumPy. starts, bound: where they apply. study: under each noise, where it was asked for.
    """

    formulation: str
    method: str
    accepted: bool
    why: str
    values: Mapping[str, float] = field(default_factory=dict)
    u: Mapping[str, float] = field(default_factory=dict)
    u_from: str = ""
    difference: Mapping[str, float] = field(default_factory=dict)
    objective: float | None = None
    certificate: Certificate | None = None
    converged: bool = False
    iterations: int | None = None
    seconds: float | None = None
    memory: int | None = None
    starts: Starts | None = None
    bound: Bound | None = None
    study: tuple[Performance, ...] = ()
    note: str = ""
    source: str = ""


@dataclass(frozen=True)
class Comparison:
    """All lines; the first accepted one of least squares is the reference. wanted: names and units of the results."""

    problem: Problem
    wanted: Wanted
    lines: tuple[Compared, ...]
    reference: Compared | None

    @property
    def refused(self) -> tuple[Compared, ...]:
        """Lines that were refused."""
        return tuple(line for line in self.lines if not line.accepted)


def methods() -> dict[str, Method]:
    """Every method by the name a comparison gives it."""
    return {
        "Gauss-Newton": GaussNewton(), "IPOPT, exact Hessian": Ipopt(ExactHessian()),
        "IPOPT, Gauss-Newton Hessian": Ipopt(GaussNewtonHessian()), "convex, least squares": Convex(LeastSquares()),
        "convex, Huber": Convex(Huber()), "convex, L1": Convex(L1()), "convex, minimum zone": Convex(MinimumZone()),
    }


def compare(declared: Problem, what: Sequence[Any], formulations: Mapping[str, Formulation], effort: Effort = Effort(),
            start_region: Mapping[str, float] | None = None, step: Callable[[], None] = lambda: None,
            under: Mapping[str, Method] | None = None) -> Comparison:
    """Compare formulations and methods on one declared problem.

    what: results to compare, of the declared problem; formulations: {name: formulation}; effort: how much is tried.
    start_region: {unknown: half-width, SI} or None; step: called after each line; under: methods by name, all where
    None. Returns the comparison; what does not accept the problem has a line that says why.
    """
    wanted = Wanted.of(declared, what)
    reference, estimate = None, None
    lines: list[Compared] = []
    for name, method in (under or methods()).items():
        line, found = _by_method(declared, wanted, DECLARED, name, method, estimate, effort)
        if reference is None and line.accepted and line.converged and method.least_squares:
            reference, estimate = line, found
        lines.append(line)
        step()
    for name, formulation in formulations.items():
        if estimate is None:
            lines.append(_refused(name, "", "the declared problem has no estimate to compare with"))
        else:
            lines.append(_by_formulation(declared, wanted, name, formulation, estimate, effort))
        step()
    if reference is not None and estimate is not None:
        lines = [_with_difference(line, reference) for line in lines]
        if effort.starts:
            lines = list(_with_starts(lines, formulations, declared, estimate, effort, start_region))
        if effort.trials:
            lines = _with_study(lines, formulations, wanted, reference, estimate, effort, step)
    return Comparison(declared, wanted, tuple(lines), _same(lines, reference))


def _same(lines: Sequence[Compared], reference: Compared | None) -> Compared | None:
    return next((line for line in lines if reference is not None and line.formulation == reference.formulation
                 and line.method == reference.method), None)


def _refused(name: str, method: str, why: str, source: str = "") -> Compared:
    return Compared(name, method, False, why, source=source)


def _measured(run: Callable[[], Any]) -> tuple[Any, float, int]:
    """What a call returns, its seconds, and the peak of its memory, found in a second call."""
    begun = time.perf_counter()
    found = run()
    seconds = time.perf_counter() - begun
    tracemalloc.start()
    try:
        run()
        memory = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    return found, seconds, memory


def _by_method(declared: Problem, wanted: Wanted, name: str, label: str, method: Method, around: Estimate | None,
               effort: Effort) -> tuple[Compared, Estimate | None]:
    """The declared problem under one method."""
    try:
        why = method.refusal(System(declared))
        if why is not None:
            return _refused(name, label, why), None
        estimate, seconds, memory = _measured(lambda: solve(declared, method))
        values, u = results(linearise(estimate), wanted)
    except CalibrationError as error:
        return _refused(name, label, str(error)), None
    u_from = STATED
    if not method.least_squares:
        around = estimate if around is None else around
        u, u_from = _u_by_drawing(around, effort, values, again(method, wanted, around))
    line = Compared(name, label, True, "", values, u, u_from, {}, estimate.objective, estimate.certificate,
                    estimate.converged, estimate.iterations, seconds, memory, note="" if estimate.converged
                    else estimate.message)
    return line, estimate


def _by_formulation(declared: Problem, wanted: Wanted, name: str, formulation: Formulation, around: Estimate,
                    effort: Effort) -> Compared:
    source = getattr(formulation, "source", "")
    try:
        if isinstance(formulation, ClosedForm):
            return _closed(declared, wanted, name, formulation, around, effort)
        if isinstance(formulation, Global):
            return _global(declared, wanted, name, formulation)
        problem = formulation.declare(declared) if isinstance(formulation, Redeclared) else formulation
        estimate, seconds, memory = _measured(lambda: solve(problem))
        values, u = results(linearise(estimate), wanted)
        values = {key: value for key, value in values.items() if u[key] > 0.0}  # what it holds is no result of it
    except CalibrationError as error:
        method = {ClosedForm: "closed form", Global: "global"}.get(type(formulation), "Gauss-Newton")
        return _refused(name, method, str(error), source)
    u_from = STATED
    if isinstance(formulation, Redeclared):
        u, u_from = _u_by_drawing(around, effort, values, again(formulation, wanted, around))
    at = placed(declared, said_by(estimate, [one.name for one in declared.unknowns]), around)
    return Compared(name, "Gauss-Newton", True, "", values, u, u_from, {}, at.objective, estimate.certificate,
                    estimate.converged, estimate.iterations, seconds, memory,
                    note=_said(at) if estimate.converged else estimate.message, source=source)


def _closed(declared: Problem, wanted: Wanted, name: str, formulation: ClosedForm, around: Estimate,
            effort: Effort) -> Compared:
    said, seconds, memory = _measured(lambda: formulation.values(declared))
    at = placed(declared, said, around)
    if at.fit is None:
        return _refused(name, "closed form", at.why, formulation.source)

    values = results(at.fit, wanted)[0]
    u, u_from = _u_by_drawing(around, effort, values, again(formulation, wanted, around))
    return Compared(name, "closed form", True, "", values, u, u_from, {}, at.objective, None, True, None, seconds,
                    memory, note=_said(at), source=formulation.source)


def _said(at: Placed) -> str:
    """What of the declared problem an answer says, in a remark."""
    return f"v'Pv with its {', '.join(at.held)} held, the rest of the declared problem free" if at.held else at.why


def _global(declared: Problem, wanted: Wanted, name: str, formulation: Global) -> Compared:
    def run() -> tuple[Estimate, Bound]:
        estimate = from_anywhere(declared, formulation)
        return estimate, formulation.bound(estimate)
    (estimate, bound), seconds, memory = _measured(run)
    values, u = results(linearise(estimate), wanted)
    return Compared(name, "global", True, "", values, u, STATED, {}, estimate.objective, estimate.certificate,
                    estimate.converged, estimate.iterations, seconds, memory, bound=bound, note=bound.sentence,
                    source=formulation.source)


def _u_by_drawing(around: Estimate, effort: Effort, values: Mapping[str, float],
                  run: Again) -> tuple[dict[str, float], str]:
    """Standard deviation of results over readings drawn around an estimate with the stated uncertainties."""
    samples: list[list[float]] = []
    for draw in range(effort.draws):
        try:
            found = run(simulate(around.problem, around, effort.seed + draw))
        except CalibrationError:
            continue
        if all(name in found for name in values):
            samples.append([found[name] for name in values])
    if len(samples) < 2:
        return {}, NOT_KNOWN
    u = np.std(np.array(samples), axis=0, ddof=1)
    failed = f", {effort.draws - len(samples)} of them failed" if len(samples) < effort.draws else ""
    return dict(zip(values, u.tolist(), strict=True)), f"{DRAWN}, {effort.draws} draws{failed}"


def _with_difference(line: Compared, reference: Compared) -> Compared:
    return replace(line, difference={
        name: (value - reference.values[name]) / reference.u[name] for name, value in line.values.items()
        if name in reference.values and reference.u.get(name, 0.0) > 0.0})


def _with_starts(lines: Sequence[Compared], formulations: Mapping[str, Formulation], declared: Problem,
                 best: Estimate, effort: Effort, start_region: Mapping[str, float] | None) -> Iterable[Compared]:
    """The lines of iterative methods with their success from random starts."""
    by_name = methods()
    where = region(best, start_region)
    for line in lines:
        other = formulations.get(line.formulation)
        if not line.accepted or line.method not in by_name or isinstance(by_name[line.method], Convex):
            yield line
            continue
        problem, its, around = declared, where, best
        if line.formulation != DECLARED:
            problem = other.declare(declared) if isinstance(other, Redeclared) else other  # type: ignore[assignment]
            around = solve(problem)
            its = region(around)
        if not around.converged:
            yield line
            continue
        method = replace(by_name[line.method], iterations=PATIENCE)  # type: ignore[type-var]
        yield replace(line, starts=starts(problem, method, around, its, effort.starts, effort.seed, effort.seconds))


def _with_study(lines: Sequence[Compared], formulations: Mapping[str, Formulation], wanted: Wanted,
                reference: Compared, truth: Estimate, effort: Effort, step: Callable[[], None]) -> list[Compared]:
    """The lines with their performance under simulation. Of the methods that minimise squares one stands for all."""
    by_name = methods()
    runs: dict[tuple[str, str], Again] = {}
    for line in lines:
        other = formulations.get(line.formulation)
        if isinstance(other, Global):
            continue    # the declared problem again, from another start
        if line.accepted and other is not None:
            runs[line.formulation, line.method] = again(other, wanted, truth)
        elif line.accepted and (line.method == reference.method or not by_name[line.method].least_squares):
            runs[line.formulation, line.method] = again(by_name[line.method], wanted, truth)
    found = study(truth, reference.u, reference.values, runs, effort.trials, effort.seed, NOISES, step)
    return [replace(line, study=found.get((line.formulation, line.method), ())) for line in lines]
