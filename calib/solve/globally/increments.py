"""A point from changes of its distance to known points, the distance at the zero unknown: global by bisection.

F = sum ((|P - B| - L - d) / u)^2 over B and L. With a = 1 / (2 L) the squares give, without approximation,
    a (|P|^2 - d^2) + P.b + c - d = e (1 + 2 a d + a e),   e = |P - B| - L - d,
affine in z = (a, b, c) with b = -B / L, c = (|B|^2 - L^2) a and the one condition b'b - 4 a c = 1, which falls away
where the points lie in a plane (the height is free). On an interval of a the bracket is bounded, and a weighted linear
adjustment gives a lower bound: intervals with a bound above F are dropped, the others halved. What is left is a
narrow neighbourhood; once F is convex there wherever it is no worse, a stationary candidate is the minimum.
Source: own; the affine form is that of `problems.base_point.algebraic`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.blocks import Array
from calib.solve.globally.bound import Bound
from calib.solve.globally.ranges import FLAT

LEVELS, WIDEST = 60, 256  # halvings, and intervals that are followed at one level


def bisection_bound(points: ArrayLike, changes: ArrayLike, u: ArrayLike, candidate: ArrayLike, length: float) -> Bound:
    """How far F at a candidate can lie above the least over all points and lengths.

    points: (n, 3) [m]; changes: (n,) [m] of the distance, positive where it grew; u: (n,) [m].
    candidate: (3,) [m]; length: L [m] at the candidate, which should be stationary.
    """
    case = _Case.of(points, changes, u, candidate, length)
    if case is None:
        error = np.linalg.norm(np.asarray(points, float) - candidate, axis=1) - length - np.asarray(changes, float)
        return Bound(0.0, float(np.sum((error / u) ** 2)),
                     "a sum of squares is not negative; the figure of the points bounds no length")
    left = [(case.least(0.0, case.limit), 0.0, case.limit)]
    for _ in range(LEVELS):
        halves = [part for _, low, high in left for part in ((low, 0.5 * (low + high)), (0.5 * (low + high), high))]
        left = [(bound, *part) for part in halves if (bound := case.least(*part)) < case.objective]
        if not left:      # rounding: the candidate's own interval comes out as no better than the candidate
            return Bound(case.objective, case.objective, "bisection of the unknown length")
        lower = case.convex_between(left[0][1], left[-1][2])
        if lower is not None and lower >= min(left)[0]:
            return Bound(lower, case.objective, "bisection of the unknown length, convex in what is left of it")
        if len(left) > WIDEST:      # a candidate that is not the best leaves many intervals
            break
    return Bound(max(min(left)[0], 0.0), case.objective, "bisection of the unknown length")


@dataclass(frozen=True)
class _Case:
    """The readings in the affine form, counted from the candidate, columns scaled to one.

    rows (n, w) = (|P|^2 - d^2, P, 1) / size; error e (n,), its limit `away` where no worse; at: a of the candidate;
    bend (w, w), slope (w,): matrix and half gradient of the condition at the candidate, zero where it falls away.
    """

    rows: Array
    size: Array
    d: Array
    u: Array
    error: Array
    away: Array
    at: float
    limit: float
    bend: Array
    slope: Array

    @property
    def objective(self) -> float:
        return float(np.sum((self.error / self.u) ** 2))

    @staticmethod
    def of(points: ArrayLike, changes: ArrayLike, u: ArrayLike, candidate: ArrayLike, length: float) -> _Case | None:
        p, d, b = (np.asarray(one, float) for one in (points, changes, candidate))
        u = np.broadcast_to(np.asarray(u, float), d.shape)
        error = np.linalg.norm(p - b, axis=1) - length - d
        away = u * np.sqrt(np.sum((error / u) ** 2))
        apart = np.linalg.norm(p[:, None] - p[None, :], axis=2) - np.add.outer(d + away, d + away)
        shortest = 0.5 * float(apart.max())            # two sides of a triangle are not shorter than the third
        if shortest <= 0.0 or length < shortest:
            return None
        middle = p.mean(axis=0)
        _, extent, directions = np.linalg.svd(p - middle, full_matrices=False)
        axes = directions[extent > FLAT * extent[0]]
        rows = np.column_stack([np.sum((p - middle) ** 2, axis=1) - d**2, (p - middle) @ axes.T, np.ones(len(d))])
        size = np.abs(rows).max(axis=0)
        w, at = rows.shape[1], 1.0 / (2.0 * length)
        bend, slope = np.zeros((w, w)), np.zeros(w)
        if len(axes) == 3:
            bend[1:-1, 1:-1] = np.eye(3)
            bend[0, -1] = bend[-1, 0] = -2.0
            base = axes @ (b - middle)
            slope = bend @ np.concatenate([[at], -base / length, [(base @ base - length**2) * at]])
        return _Case(rows / size, size, d, u, error, away, at, 1.0 / (2.0 * shortest), bend / np.outer(size, size),
                     slope / size)

    def least(self, low: float, high: float) -> float:
        """A lower bound on F for a in an interval."""
        bracket = 1.0 + 2.0 * np.maximum(low * self.d, high * self.d) + high * self.away
        weight = 1.0 / (self.u * bracket)
        residual = self.error * (1.0 + 2.0 * self.at * self.d + self.at * self.error) * weight
        ends = np.array([low - self.at, high - self.at]) * self.size[0]
        return _least(self.rows * weight[:, None], residual, ends)

    def convex_between(self, low: float, high: float) -> float | None:
        """A lower bound on F for a in an interval if it is convex there wherever it is no worse; None otherwise."""
        d, away, w = np.abs(self.d), self.away, self.u**-2
        bracket = 1.0 + 2.0 * np.array([low * self.d, high * self.d])
        above, below = bracket.max(axis=0) + 2.0 * high * away, bracket.min(axis=0) - 2.0 * high * away
        if not low <= self.at <= high or below.min() <= 0.0:
            return None
        length, first = np.linalg.norm(self.rows, axis=1), 1.0 / self.size[0]
        by_a = (2.0 * d * away + away**2) / below                          # |de/da| at most
        turn = 2.0 * d + 2.0 * away + 2.0 * high * by_a                    # of the bracket, by a
        second = (2.0 * high / below**3 * length**2 + 2.0 * turn / below**2 * length * first
                  + (2.0 * (d + away) * by_a / below + by_a * turn / below) * first**2)
        straight = np.linalg.eigvalsh((self.rows * (w / above**2)[:, None]).T @ self.rows)[0]
        root = np.sqrt(max(straight, 0.0)) - np.sqrt(np.sum(w * (by_a * first) ** 2))
        here = 1.0 + 2.0 * self.at * self.d + 2.0 * self.at * self.error
        slopes = self.rows / here[:, None]
        slopes[:, 0] -= (2.0 * self.d * self.error + self.error**2) / here * first
        gradient = slopes.T @ (w * self.error)                             # half of that of F
        multiplier = 0.0
        if self.slope.any():
            multiplier = -float(gradient @ self.slope) / float(self.slope @ self.slope)
            gradient = gradient + multiplier * self.slope
        curved = np.sum(w * away * second) + abs(multiplier) * np.linalg.norm(self.bend, 2)
        margin = root**2 - float(curved)                                   # of half the Hessian of F
        if root <= 0.0 or margin <= 0.0:
            return None
        return self.objective - float(gradient @ gradient) / margin


def _least(rows: Array, residual: Array, ends: Array) -> float:
    """The least |residual + rows z|^2 with the first of z between two ends."""
    z = np.linalg.lstsq(rows, -residual, rcond=None)[0]
    if not ends[0] <= z[0] <= ends[1]:
        residual = residual + rows[:, 0] * np.clip(z[0], *ends)
        rows = rows[:, 1:]
        z = np.linalg.lstsq(rows, -residual, rcond=None)[0]
    return float(np.sum((residual + rows @ z) ** 2))
