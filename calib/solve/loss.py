"""Losses of whitened residuals: what a convex method minimises, and what proves that it did."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array

ON_THE_EDGE = 1e-6     # how near, in units of u, an interior point comes to a residual that is zero or largest


@dataclass(frozen=True)
class Dual:
    """Where multipliers of the residuals may lie: fixed values (N,), and a range low, high (N,) where low < high."""

    value: Array
    low: Array
    high: Array
    total: float | None = None      # what their magnitudes add up to at most, where that is limited


class Loss(ABC):
    """A convex function of whitened residuals (N,), in units of u."""

    separates_correlated = True     # whether the answer depends on the choice of whitening for correlated readings

    @abstractmethod
    def value(self, residual: Array) -> float:
        """The loss."""

    @abstractmethod
    def expression(self, residual: Any) -> Any:
        """The loss of a CVXPY expression."""

    @abstractmethod
    def conjugate(self, multiplier: Array) -> float:
        """The convex conjugate at multipliers (N,) within the reach of `dual`."""

    @abstractmethod
    def dual(self, residual: Array) -> Dual:
        """Multipliers that may belong to residuals."""

    @abstractmethod
    def holding(self, residual: Array) -> NDArray[np.bool_]:
        """Which residuals (N,) hold the answer: where they pin all unknowns, there is no other of the same loss."""

    @abstractmethod
    def reach(self, value: float, count: int) -> float:
        """How far the predictions of all `count` readings can lie from those of any point that is not worse."""

    @abstractmethod
    def refined(self, derivatives: Array, residual: Array) -> Array:
        """The step (q,) from a nearly best point, with derivatives (N, q) of the predictions, to the best one."""


@dataclass(frozen=True)
class LeastSquares(Loss):
    """Half the sum of squares: the adjustment that every other method gives."""

    separates_correlated = False

    def value(self, residual: Array) -> float:
        return 0.5 * float(residual @ residual)

    def expression(self, residual: Any) -> Any:
        import cvxpy
        return 0.5 * cvxpy.sum_squares(residual)

    def conjugate(self, multiplier: Array) -> float:
        return 0.5 * float(multiplier @ multiplier)

    def dual(self, residual: Array) -> Dual:
        return Dual(residual, residual, residual)

    def holding(self, residual: Array) -> NDArray[np.bool_]:
        return np.ones(len(residual), dtype=bool)

    def reach(self, value: float, count: int) -> float:
        return 2.0 * np.sqrt(2.0 * value)

    def refined(self, derivatives: Array, residual: Array) -> Array:
        return np.asarray(np.linalg.lstsq(derivatives, residual, rcond=None)[0], float)


@dataclass(frozen=True)
class Huber(Loss):
    """Squares up to a threshold, straight beyond it: readings far off pull, but not in proportion.

    threshold: in units of u. Source: Huber 1964, Annals of Mathematical Statistics 35.
    """

    threshold: float = 1.345

    def value(self, residual: Array) -> float:
        inside = np.minimum(np.abs(residual), self.threshold)
        return float(np.sum(inside * (np.abs(residual) - 0.5 * inside)))

    def expression(self, residual: Any) -> Any:
        import cvxpy
        return 0.5 * cvxpy.sum(cvxpy.huber(residual, self.threshold))

    def conjugate(self, multiplier: Array) -> float:
        return 0.5 * float(multiplier @ multiplier)

    def dual(self, residual: Array) -> Dual:
        pull = np.clip(residual, -self.threshold, self.threshold)
        return Dual(pull, pull, pull)

    def holding(self, residual: Array) -> NDArray[np.bool_]:
        return np.abs(residual) < self.threshold

    def reach(self, value: float, count: int) -> float:
        return 2.0 * (value / self.threshold + 0.5 * count * self.threshold)

    def refined(self, derivatives: Array, residual: Array) -> Array:
        step = np.zeros(derivatives.shape[1])
        for _ in range(20):                      # Newton steps on a piecewise quadratic: exact once the pieces stay
            moved = residual - derivatives @ step
            inside = derivatives[np.abs(moved) < self.threshold]
            pull = derivatives.T @ np.clip(moved, -self.threshold, self.threshold)
            change = np.linalg.lstsq(inside.T @ inside, pull, rcond=None)[0]
            step = step + change
            if float(np.abs(derivatives @ change).max(initial=0.0)) <= 1e-13:
                break
        return step


@dataclass(frozen=True)
class L1(Loss):
    """The sum of magnitudes: as many readings as unknowns are met exactly, wild ones hardly matter."""

    def value(self, residual: Array) -> float:
        return float(np.abs(residual).sum())

    def expression(self, residual: Any) -> Any:
        import cvxpy
        return cvxpy.norm1(residual)

    def conjugate(self, multiplier: Array) -> float:
        return 0.0

    def dual(self, residual: Array) -> Dual:
        met, sign = self.holding(residual), np.sign(residual)
        return Dual(np.where(met, 0.0, sign), np.where(met, -1.0, sign), np.where(met, 1.0, sign))

    def holding(self, residual: Array) -> NDArray[np.bool_]:
        return np.abs(residual) <= ON_THE_EDGE

    def reach(self, value: float, count: int) -> float:
        return 2.0 * value

    def refined(self, derivatives: Array, residual: Array) -> Array:
        met = self.holding(residual)
        return np.asarray(np.linalg.lstsq(derivatives[met], residual[met], rcond=None)[0], float)


@dataclass(frozen=True)
class MinimumZone(Loss):
    """The largest magnitude: the zone of form standards (Chebyshev); priors count as readings."""

    def value(self, residual: Array) -> float:
        return float(np.abs(residual).max())

    def expression(self, residual: Any) -> Any:
        import cvxpy
        return cvxpy.norm_inf(residual)

    def conjugate(self, multiplier: Array) -> float:
        return 0.0

    def dual(self, residual: Array) -> Dual:
        sign = np.where(self.holding(residual), np.sign(residual), 0.0)
        return Dual(np.zeros_like(residual), np.minimum(sign, 0.0), np.maximum(sign, 0.0), total=1.0)

    def holding(self, residual: Array) -> NDArray[np.bool_]:
        return np.abs(residual) >= self.value(residual) - ON_THE_EDGE

    def reach(self, value: float, count: int) -> float:
        return 2.0 * value * float(np.sqrt(count))

    def refined(self, derivatives: Array, residual: Array) -> Array:
        largest = self.holding(residual)
        sign = np.sign(residual[largest])
        # all largest residuals are one half-width: unknowns are the step and its change
        system = np.column_stack([sign[:, None] * derivatives[largest], np.ones(len(sign))])
        return np.asarray(np.linalg.lstsq(system, np.abs(residual[largest]), rcond=None)[0][:-1], float)
