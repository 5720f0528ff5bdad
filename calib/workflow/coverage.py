"""Coverage under simulation: how often stated intervals hold the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.analyse.covariance import considered, covariance
from calib.blocks import Array
from calib.linearisation import Linearisation, linearise
from calib.problem import Problem
from calib.solve.estimate import Estimate, simulate, solve
from calib.system import System
from calib.unknown import Unknown

NINETY_FIVE = 1.959963984540054  # k of a 95 % interval of a normal distribution


@dataclass(frozen=True)
class Coverage:
    """Standardised errors (trials, k) of named results over simulated repetitions; failures: solves without
    certificate."""

    names: tuple[str, ...]
    errors: Array
    failures: int

    @property
    def covered(self) -> Array:
        """Share (k,) of repetitions whose 95 % interval holds the truth."""
        return np.mean(np.abs(self.errors) <= NINETY_FIVE, axis=0)

    @property
    def spread(self) -> Array:
        """True spread over stated u (k,): 1 where u is right."""
        return np.sqrt(np.mean(self.errors**2, axis=0))


def coverage(truth: Estimate, seeds: Sequence[int]) -> Coverage:
    """Simulate readings of a problem at an estimate taken as the truth, solve each, and standardise the errors.

    truth: values to simulate from; seeds: one for each repetition. Results are the quantities of the problem and the
    unknowns that are free. Held quantities with a prior are drawn from it for the readings, and the
    estimation goes on believing their nominal values.
    Returns the Coverage. Source: JCGM 101:2008, 8 (validation by repeated simulation).
    """
    problem, system = truth.problem, System(truth.problem)
    fit = linearise(truth)
    results = _results(problem, fit)
    held = considered(fit)
    errors, failures = [], 0
    for seed in seeds:
        seen = truth.values
        if held.columns:
            step = np.zeros(fit.layout.size)
            draw = np.random.default_rng([seed, 1]).multivariate_normal(np.zeros(len(held.columns)), held.covariance)
            step[list(held.columns)] = draw
            seen = fit.layout.move(truth.values, step)
        simulated = simulate(problem, {u: u.show(v) for u, v in seen.items()}, seed)
        if held.columns:
            simulated = simulated.with_readings(_as_stated(problem, simulated, fit))
        estimate = solve(simulated, start=truth)
        if not estimate.certificate.passed:
            failures += 1
            continue
        u = covariance(linearise(estimate), *results).u
        errors.append(np.concatenate([_error(system, r, estimate, seen) for r in results]) / u)
    return Coverage(fit.functions(*results).labels, np.array(errors), failures)


def _as_stated(problem: Problem, simulated: Problem, fit: Linearisation) -> dict[str, Array]:
    """Readings of the priors of held quantities as they were stated, those of free ones as they were drawn."""
    readings = {}
    for before, after, group in zip(problem.observations, simulated.observations, fit.groups, strict=True):
        if group.is_prior and before.readings is not None and after.readings is not None:
            readings[group.name] = np.where(group.counted[:, None], after.readings, before.readings)
    return readings


def _results(problem: Problem, fit: Linearisation) -> list[Any]:
    chosen: list[Any] = list(problem.quantities)
    chosen += [u for u in problem.unknowns if fit.layout.free[fit.layout.span(u)].all()]
    return chosen


def _error(system: System, result: Any, estimate: Estimate, seen: Mapping[Unknown, Array]) -> Array:
    """Estimate less truth of a quantity, or of an unknown in its local coordinates."""
    if isinstance(result, Unknown):
        return result.difference(estimate.values[result], seen[result]).ravel()
    return (system.result(result, estimate.values)[0] - system.result(result, seen)[0]).ravel()
