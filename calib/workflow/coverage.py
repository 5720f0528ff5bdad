"""Coverage under simulation: how often stated intervals hold the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.analyse.covariance import covariance
from calib.blocks import Array
from calib.linearisation import linearise
from calib.problem import Problem
from calib.solve.estimate import Estimate, simulate, solve

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

    truth: values to simulate from; seeds: one for each repetition. Results are the scalar quantities of the problem
    and the free scalar unknowns that are vectors.
    Returns the Coverage. Source: JCGM 101:2008, 8 (validation by repeated simulation).
    """
    problem = truth.problem
    names, true = _results(problem, truth)
    errors, failures = [], 0
    for seed in seeds:
        estimate = solve(simulate(problem, truth, seed), start=truth)
        if not estimate.certificate.passed:
            failures += 1
            continue
        fit = linearise(estimate)
        c = covariance(fit, *names)
        errors.append((c.values - true) / c.u)
    return Coverage(covariance(linearise(truth), *names).names, np.array(errors), failures)


def _results(problem: Problem, truth: Estimate) -> tuple[list, Array]:
    fit = linearise(truth)
    chosen: list = list(problem.quantities)
    chosen += [u for u in problem.unknowns if u.kind == "vector" and fit.layout.free[fit.layout.span(u)].all()]
    return chosen, covariance(fit, *chosen).values
