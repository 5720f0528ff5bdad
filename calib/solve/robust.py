"""Robust estimation by reweighting: wild readings pull less, or not at all, and the covariance says what is left.

Readings are weighed one by one by their residual in units of u, correlated ones given the others of their block (see
`downweight`); priors count as in least squares. Source: Huber (1981), Robust Statistics, sections 7.6 and 7.8.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from calib.blocks import Array, Block, Index, Mixing
from calib.elimination import Factor
from calib.linearisation import Linearisation, linearise
from calib.normal import sparse_rows
from calib.problem import Problem
from calib.solve.downweight import Alike, RobustLoss, Truncated, gaussian, wild_below
from calib.solve.estimate import Estimate, solve
from calib.solve.loss import Huber
from calib.unknown import Unknown

TOGETHER = 50  # instances whose covariances are computed at a time


class SandwichFactor:
    """A^-1 B A^-1 in the place of a covariance: A the slope of all pulls, B their mean square.

    slope: factor of A; spread: rows (N, p) of a root of B. Attributes as DenseFactor.
    """

    def __init__(self, slope: Factor, spread: Any):
        self._slope, self._spread = slope, spread
        self.rank, self.defect, self.condition = slope.rank, slope.defect, slope.condition

    @property
    def null(self) -> Array:
        """Directions that change no reading that still counts."""
        return self._slope.null

    def solve(self, right: Array) -> Array:
        """A^-1 times right (p, k)."""
        return self._slope.solve(right)

    def covariance(self, functions: Array) -> Array:
        """Covariance (k, k) of linear functions (k, p) of the free columns."""
        mapped = self._spread @ self._slope.solve(np.asarray(functions).T)
        return np.asarray(mapped.T @ mapped)

    def between(self, first: Index, second: Index) -> Array:
        """Covariances (m, f, g) of free columns first (m, f) with second (m, g); -1 stands for a held column."""
        found = np.empty((*first.shape, second.shape[1]))
        for begin in range(0, len(first), TOGETHER):
            a, b = (self._mapped(columns[begin : begin + TOGETHER]) for columns in (first, second))
            found[begin : begin + TOGETHER] = np.einsum("nmf,nmg->mfg", a, b)
        return found

    def _mapped(self, columns: Index) -> Array:
        """Rows (N, m, f) whose products are the covariances of free columns (m, f); zero for a held one."""
        unit = np.zeros((columns.size, self._spread.shape[1]))
        there = np.flatnonzero(columns.ravel() >= 0)
        unit[there, columns.ravel()[there]] = 1.0
        return np.asarray(self._spread @ self._slope.solve(unit.T)).reshape(-1, *columns.shape)


@dataclass(frozen=True)
class RobustFit(Linearisation):
    """The declared problem at a robust estimate: residuals and stated uncertainties as declared, and the covariance of
    the estimate where all but the wild readings are as stated.

    slopes: the same with the slope of its pull as the weight of each reading; spread: rows of a root of the mean square
    of all pulls, over the free columns; weighed: v'Pv with the last weights; wild: scalar readings that are.
    """

    slopes: Linearisation
    spread: Any
    weighed: float
    wild: int

    @property
    def blocks(self) -> list[Block]:
        """Rows whose squares are the slopes: what is held is considered with them."""
        return self.slopes.blocks

    @cached_property
    def factor(self) -> Any:
        """Covariance of the robust estimate."""
        return SandwichFactor(self.slopes.factor, self.spread)

    @property
    def objective(self) -> float:  # type: ignore[override]
        """v'Pv with the last weights."""
        return self.weighed

    @property
    def dof(self) -> int:  # type: ignore[override]
        """Readings that are not wild, less the rank."""
        return sum(g.size for g in self.groups) - self.wild - self.factor.rank

    @property
    def sizes(self) -> Array:  # type: ignore[override]
        """Size (p,) of each free column."""
        return self.slopes.sizes


@dataclass(frozen=True)
class RobustEstimate:
    """A robust estimate: `estimate` with its last weights as uncertainties, weights {group: (n, dim)} in (0, 1].

    loss; converged, iterations: of the reweighting; value: the loss, in units of u; fit: the declared problem, with
    the stated uncertainties, at the estimate; robust_fit: the same, whose covariance is that of the robust estimate.
    """

    loss: RobustLoss
    estimate: Estimate
    weights: Mapping[str, Array]
    converged: bool
    iterations: int
    value: float
    fit: Linearisation
    robust_fit: RobustFit

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

        A^-1 B A^-1 with A the slope of the pull and B its mean square. `analyse.covariance(robust_fit, ...)` also
        considers what is held with a prior.
        """
        functions = self.robust_fit.functions(*what)
        return functions.labels, self.robust_fit.factor.covariance(self.robust_fit.free_part(functions.derivatives))


def robust(
    problem: Problem,
    loss: RobustLoss | None = None,
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
    blocks = {group.name: Alike.of(group.weighting, group.name) for group in estimate.fit.groups if not group.is_prior}
    u = {group.name: group.weighting.u for group in estimate.fit.groups if not group.is_prior}
    added = {name: np.zeros_like(one) for name, one in u.items()}
    weights = {name: np.ones_like(one) for name, one in u.items()}
    size = max((b.largest(b.gather(estimate.residuals[name])) for name, own in blocks.items() for b in own),
               default=0.0)
    convexity = loss.limit**2 / max(2.0 * size**2 - loss.limit**2, 1e-12) if isinstance(loss, Truncated) else 0.0
    converged, done = False, 0
    while done < iterations and not converged:
        done += 1
        for name, own in blocks.items():
            for block in own:
                found = block.errors(loss, block.gather(estimate.residuals[name]), block.gather(added[name]), convexity)
                block.scatter(added[name], found[0])
                block.scatter(weights[name], found[1])
        changed = {name: gaussian(own, added[name]) for name, own in blocks.items()}
        before = estimate.residuals
        estimate = solve(problem.with_uncertainty(changed), start=estimate)
        change = max((float(np.abs((estimate.residuals[n] - before[n]) / u[n]).max()) for n in u), default=0.0)
        settled = all(np.all((w < 1e-6) | (w > 1 - 1e-6)) for w in weights.values())
        if change <= tolerance and (not isinstance(loss, Truncated) or settled or convexity > 1e6):
            converged = True
        convexity *= 1.4
    fit = linearise(problem, {unknown: unknown.show(estimate.values[unknown]) for unknown in problem.unknowns})
    value = sum(b.loss(loss, *(b.gather(one[name]) for one in (estimate.residuals, added, weights)))
                for name, own in blocks.items() for b in own)
    return RobustEstimate(loss, estimate, weights, converged, done, float(value), fit,
                          _robust_fit(loss, fit, blocks, weights, estimate.objective))


def _robust_fit(
    loss: RobustLoss, fit: Linearisation, blocks: Mapping[str, tuple[Alike, ...]], weights: Mapping[str, Array],
    weighed: float,
) -> RobustFit:
    """The linearisation whose covariance is that of the estimate."""
    groups, spread = [], []
    for group in fit.groups:
        mixings: tuple[Mixing, ...] = group.weighting.whitening
        mean = mixings
        if group.name in blocks:
            pulls = [b.pulls(loss, b.gather(group.residual), b.gather(weights[group.name])) for b in blocks[group.name]]
            mixings, mean = (tuple(one) for one in zip(*pulls, strict=True))
        groups.append(replace(group, weighting=replace(group.weighting, whitening=mixings)))
        spread += [mixing.apply(group.residual, group.parts) for mixing in mean]
    own = {name: getattr(fit, name) for name in Linearisation.__dataclass_fields__}
    wild = sum(int(np.sum(one < wild_below(loss))) for one in weights.values())
    return RobustFit(**own, slopes=replace(fit, groups=tuple(groups)), spread=sparse_rows(spread, fit.layout)[0],
                     weighed=weighed, wild=wild)
