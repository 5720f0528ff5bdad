"""Robust estimation by reweighting: wild readings pull less, or not at all, and the covariance says what is left.

Independent readings are weighed one by one by their residual in units of u; priors and correlated readings count as in
least squares. Sources: Huber (1981), Robust Statistics, sections 7.6 and 7.8; Yang, Antonante, Tzoumas, Carlone (2020),
IEEE Robotics and Automation Letters 5(2), for graduated non-convexity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from calib.blocks import Array
from calib.errors import CalibrationError
from calib.linearisation import Group, Linearisation, linearise
from calib.problem import Problem
from calib.solve.estimate import Estimate, solve
from calib.solve.loss import L1, Huber
from calib.uncertainty import Gaussian
from calib.unknown import Unknown

SMALLEST = 1e-8  # weight of a reading that no longer counts; zero would leave a point without any reading
WILD = 3.29  # residual in units of u beyond which one reading in a thousand lies


@dataclass(frozen=True)
class Truncated:
    """Squares up to a limit and nothing beyond: wild readings are left out, found by graduated non-convexity.

    limit: in units of u.
    """

    limit: float = WILD


@dataclass(frozen=True)
class RobustEstimate:
    """A robust estimate: `estimate` with its last weights as uncertainties, weights {group: (n, dim)} in (0, 1].

    converged, iterations: of the reweighting; value: the loss, in units of u; fit: the declared problem, with the
    stated uncertainties, at the estimate; influence, spread: (N,) slope of the pull of each whitened reading and
    its mean square.
    """

    estimate: Estimate
    weights: Mapping[str, Array]
    converged: bool
    iterations: int
    value: float
    fit: Linearisation
    influence: Array
    spread: Array

    def left_out(self, below: float = 0.5) -> list[tuple[str, int, float]]:
        """Readings that pull with less than a part of their weight: (group, row of the file, weight), least first."""
        rows = {group.name: group.rows for group in self.fit.groups}
        found = [
            (name, int(rows[name][i]), float(weights[i].min()))
            for name, weights in self.weights.items()
            for i in np.flatnonzero(weights.min(axis=1) < below)
        ]
        return sorted(found, key=lambda one: one[2])

    def covariance(self, *what: object) -> tuple[tuple[str, ...], Array]:
        """Labels (k,) and covariance (k, k), SI, of unknowns or quantities, if all but the wild readings are as stated.

        A^-1 B A^-1 with A the slope of the pull and B its mean square.
        """
        functions = self.fit.functions(*what)
        rows, _ = self.fit.rows
        basis = self.fit.conditions.basis
        inner = rows @ basis
        slope = inner.T @ (self.influence[:, None] * inner)
        try:
            spread = np.linalg.solve(slope, basis.T @ self.fit.free_part(functions.derivatives).T)
        except np.linalg.LinAlgError:
            raise CalibrationError(
                f"{self.fit.name}: too few readings are left to say how certain the robust estimate is; look at "
                "left_out(), and add readings"
            ) from None
        pull = inner.T @ (self.spread[:, None] * inner)
        return functions.labels, spread.T @ pull @ spread


def robust(
    problem: Problem,
    loss: Huber | L1 | Truncated | None = None,
    start: Estimate | Mapping[Unknown, object] | None = None,
    iterations: int = 300,
    tolerance: float = 1e-7,
) -> RobustEstimate:
    """Estimate with a loss that wild readings cannot dominate.

    problem: as declared; loss: Huber() if not given, L1(), or Truncated(); start: as of `solve`; iterations: of the
    reweighting at most; tolerance: change of residuals, in units of u, at which it stops.
    Returns a RobustEstimate. Raises what `solve` raises.
    """
    loss = loss or Huber()
    estimate = solve(problem, start=start)
    u = {group.name: group.weighting.u for group in linearise(estimate).groups if _single(group)}
    standardised = _standardised(estimate, u)
    size = _largest(standardised)
    convexity = loss.limit**2 / max(2.0 * size**2 - loss.limit**2, 1e-12) if isinstance(loss, Truncated) else 0.0
    converged, weights = False, {name: np.ones_like(value) for name, value in u.items()}
    done = 0
    while done < iterations and not converged:
        done += 1
        weights = {name: _weight(loss, r, convexity) for name, r in standardised.items()}
        changed = {name: Gaussian.standard(u[name] / np.sqrt(weights[name])) for name in u}
        estimate = solve(problem.with_uncertainty(changed), start=estimate)
        before, standardised = standardised, _standardised(estimate, u)
        change = max((float(np.abs(standardised[n] - before[n]).max()) for n in u), default=0.0)
        settled = all(np.all((w < 1e-6) | (w > 1 - 1e-6)) for w in weights.values())
        if change <= tolerance and (not isinstance(loss, Truncated) or settled or convexity > 1e6):
            converged = True
        convexity *= 1.4
    fit = linearise(problem, {unknown: unknown.show(estimate.values[unknown]) for unknown in problem.unknowns})
    slopes, spreads = zip(*(_pull(loss, group, weights) for group in fit.groups), strict=True)
    value = float(sum(_loss(loss, r).sum() for r in standardised.values()))
    return RobustEstimate(
        estimate, weights, converged, done, value, fit, np.concatenate(slopes), np.concatenate(spreads)
    )


def _single(group: Group) -> bool:
    """Whether a group has independent readings and is no prior."""
    return not group.is_prior and all(m.matrix.ndim == 2 and m.rows.shape[1] == 1 for m in group.weighting.whitening)


def _standardised(estimate: Estimate, u: Mapping[str, Array]) -> dict[str, Array]:
    return {name: estimate.residuals[name] / u[name] for name in u}


def _largest(standardised: Mapping[str, Array]) -> float:
    return max((float(np.abs(r).max()) for r in standardised.values()), default=0.0)


def _weight(loss: Huber | L1 | Truncated, r: Array, convexity: float) -> Array:
    size = np.abs(r)
    if isinstance(loss, Huber):
        return np.minimum(1.0, loss.threshold / np.maximum(size, 1e-12))
    if isinstance(loss, L1):
        return np.minimum(1.0, 1e-4 / np.maximum(size, 1e-7))
    upper = (convexity + 1) / convexity * loss.limit**2
    lower = convexity / (convexity + 1) * loss.limit**2
    between = loss.limit * math.sqrt(convexity * (convexity + 1)) / np.maximum(size, 1e-12) - convexity
    return np.clip(np.where(size**2 >= upper, 0.0, np.where(size**2 <= lower, 1.0, between)), SMALLEST, 1.0)


def _loss(loss: Huber | L1 | Truncated, r: Array) -> Array:
    size = np.abs(r)
    if isinstance(loss, Huber):
        inside = np.minimum(size, loss.threshold)
        return inside * (size - 0.5 * inside)
    return size if isinstance(loss, L1) else 0.5 * np.minimum(size, loss.limit) ** 2


def _pull(loss: Huber | L1 | Truncated, group: Group, weights: Mapping[str, Array]) -> tuple[Array, Array]:
    """Slope of the pull of each whitened reading of a group, and its mean square, for Gaussian errors of stated u."""
    if group.name not in weights:
        count = sum(block.residual.size for block in group.whitened)
        return np.ones(count), np.ones(count)
    r = np.concatenate([np.abs(block.residual).ravel() for block in group.whitened])
    if isinstance(loss, L1):
        return np.where(r <= WILD, math.sqrt(2.0 / math.pi), 0.0), np.ones(len(r))
    limit = loss.threshold if isinstance(loss, Huber) else loss.limit
    inside = r <= limit
    within = erf(limit / math.sqrt(2.0))
    edge = 2.0 * limit * math.exp(-0.5 * limit**2) / math.sqrt(2.0 * math.pi)
    if isinstance(loss, Huber):
        return inside * 1.0, np.where(inside, 1.0 - edge / within, limit**2)
    return inside * (1.0 - edge / within), inside * (1.0 - edge / within)
