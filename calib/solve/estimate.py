"""Solve a declared problem; the estimate is one frozen type whatever the method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.blocks import Array
from calib.defect import defect_in_words, together
from calib.effect import Effect
from calib.errors import CalibrationError, DeclarationError, RankDefect
from calib.linearisation import Linearisation, linearise_system
from calib.observations import Quantity
from calib.problem import Problem
from calib.solve.certificate import Certificate, certify
from calib.solve.gauss_newton import GaussNewton
from calib.solve.method import Method
from calib.system import System
from calib.unknown import Unknown

STILL = 1e-9  # relative change of uncertainties that depend on the estimate at which they stand still


@dataclass(frozen=True)
class Estimate:
    """The answer to a problem: `estimate[unknown]`, `estimate[quantity]` and `estimate[effect]` are values in SI.

    problem; method, converged, iterations, message: how it was found; certificate: what was verified apart from the
    method; fit: the linearisation there, on which every analysis stands.
    """

    problem: Problem
    method: str
    converged: bool
    iterations: int
    message: str
    certificate: Certificate
    fit: Linearisation

    def __getitem__(self, what: Any) -> Any:
        if isinstance(what, Quantity):
            value = System(self.problem).result(what, self.values)[0]
            if what.n == 1 and not what.named_keys:
                return float(value[0, 0]) if value.shape[1] == 1 else value[0]
            return value[:, 0] if value.shape[1] == 1 else value
        if isinstance(what, Effect):
            attached = self.problem.attached_effect(what)
            stored = self.values[attached.unknown]
            return stored.copy() if attached.keys else stored[0].copy()
        if isinstance(what, str):
            return self[self._named(what)]
        selection = self.problem.select(what)
        unknown = selection.unknown
        if selection.index is None and selection.parts is None:
            return unknown.show(self.values[unknown])
        stored = self.values[unknown] if selection.index is None else self.values[unknown][selection.index]
        if unknown.kind != "vector":
            raise DeclarationError(f"ask for whole values of '{unknown.name}'; it is a {unknown.kind}.")
        return stored if selection.parts is None else stored[..., list(selection.parts)]

    def _named(self, name: str) -> Any:
        for quantity in self.problem.quantities:
            if quantity.name == name:
                return quantity
        return self.problem.select(name)

    @property
    def values(self) -> Mapping[Unknown, Array]:
        """Stored values of all unknowns."""
        return self.fit.values

    @property
    def objective(self) -> float:
        """v'Pv."""
        return self.fit.objective

    @property
    def dof(self) -> int:
        """Degrees of freedom."""
        return self.fit.dof

    @property
    def predicted(self) -> Mapping[str, Array]:
        """{group: predicted readings (n, dim)}, SI."""
        return {g.name: g.predicted for g in self.fit.groups}

    @property
    def residuals(self) -> Mapping[str, Array]:
        """{group: reading - predicted (n, dim)}, SI."""
        return {g.name: g.residual for g in self.fit.groups}

    @property
    def variance_factor(self) -> float:
        """v'Pv divided by the degrees of freedom; not a number where there are none."""
        return self.objective / self.dof if self.dof > 0 else float("nan")

    @property
    def p_value(self) -> float | None:
        """Probability of a larger v'Pv if model and stated uncertainties hold; None without degrees of freedom."""
        if self.dof <= 0:
            return None
        from scipy.special import gammaincc

        return float(gammaincc(self.dof / 2, self.objective / 2))


def solve(
    problem: Problem, method: Method | None = None, start: Estimate | Mapping[Any, Any] | None = None
) -> Estimate:
    """Estimate the unknowns of a problem.

    problem: what was declared; method: GaussNewton() if not given; start: an earlier Estimate, or {unknown: value}.
    Returns an Estimate with its certificate; it says so where the method did not converge.
    Raises MethodRefusal where the method does not take the problem, RankDefect where a direction changes no reading.
    """
    method = method or GaussNewton()
    system = System(problem)
    method.accept(system)
    if not len(system.layout.free_columns):
        raise CalibrationError(f"{problem.name}: everything is held; free what you want to estimate.")
    values = start_values(system, start)
    outcome = method.minimise(system, values)
    iterations = outcome.iterations
    for _ in range(20 if system.depends else 0):
        if not outcome.converged:
            break
        before = [w.u for w in system.weightings(values)]
        values = outcome.values
        after = [w.u for w in system.weightings(values)]
        if max(float(np.max(np.abs(a / b - 1))) for a, b in zip(after, before, strict=True)) <= STILL:
            break
        outcome = method.minimise(system, values)
        iterations += outcome.iterations
    fit = linearise_system(system, outcome.values)
    if fit.factor.defect:
        fewer = (
            ""
            if sum(g.size for g in fit.groups) >= len(system.layout.free_columns)
            else (f" ({sum(g.size for g in fit.groups)} readings for {len(system.layout.free_columns)} unknowns)")
        )
        sentences = defect_in_words(system.layout, fit.factor.null, fit.sizes)
        raise RankDefect(
            f"{problem.name}: {fit.factor.defect} direction(s) of the unknowns cannot be known{fewer}: "
            + together(sentences)
            + ".",
            directions=sentences,
        )
    certificate = certify(system, outcome.values, fit, outcome.gap, method.least_squares)
    return Estimate(problem, method.name, outcome.converged, iterations, outcome.message, certificate, fit)


def start_values(system: System, start: Estimate | Mapping[Any, Any] | None) -> dict[Unknown, Array]:
    """Stored start values: declared ones, overridden by an earlier estimate or by {unknown: value}."""
    values = dict(system.layout.start())
    if isinstance(start, Estimate):
        values.update({u: v for u, v in start.values.items() if u in values})
    elif start is not None:
        for what, value in start.items():
            unknown = system.problem.select(what).unknown
            values[unknown] = unknown.store(value)
    return values


def predict(problem: Problem, values: Estimate | Mapping[Any, Any] | None = None) -> dict[str, Array]:
    """Predicted readings of every group, {group: (n, dim)} in SI.

    values: an Estimate, {unknown: value}, or None for the start values.
    """
    system = System(problem)
    stored = start_values(system, values)
    return {t.bound.name: t.predict(stored) for t in system.terms}


def simulate(problem: Problem, values: Estimate | Mapping[Any, Any] | None, seed: int, noise: bool = True) -> Problem:
    """The same problem with readings drawn from the declared model.

    values: truth, as for `predict`; seed: of the errors; noise: whether errors are drawn (priors draw them too).
    """
    system = System(problem)
    stored = start_values(system, values)
    generator = np.random.default_rng(seed)
    readings = {}
    for term, weighting in zip(system.terms, system.weightings(stored), strict=True):
        errors = weighting.draw(generator) if noise else 0.0
        readings[term.bound.group] = term.predict(stored) + errors
    return problem.with_readings(readings)
