"""Two-way positioning of a rotary table by ISO 230-2: the figures A, E, M, R and B with their uncertainty.

A deviation is the angle read less the angle commanded. The systematic figures are functions of the mean deviation at
each position and direction and come from a declared problem; those of the scatter come from the runs themselves.
Source: ISO 230-2:2014, Determination of accuracy and repeatability of positioning of numerically controlled axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import Gaussian, Observations, Problem, Quantity, Unknown
from calib.errors import InputError

Array = NDArray[np.float64]


def deviation_of_cell(cell: Any, mean: Any) -> Any:
    """The deviation [rad] of one position and direction; cell: (k,) one at its place, else zero; mean: (k,) [rad]."""
    return ca.dot(cell, mean)


def declare(command: ArrayLike, measured: ArrayLike, direction: ArrayLike, u: ArrayLike | Gaussian,
            rows: ArrayLike | None = None) -> Problem:
    """Two-way readings: a mean deviation for every position and direction, and the systematic figures of ISO 230-2.

    command, measured: (n,) [rad]; direction: (n,), +1 or -1; u: standard uncertainty of a reading [rad] or Gaussian.
    Quantities E, M, B and the reversal of each position; those of the scatter, A and R, are in `figures`.
    Source: ISO 230-2:2014, clause 3.
    """
    data = sort(command, measured, direction)
    m, positions = len(data.position), [f"{np.degrees(p):.6g}" for p in data.position]
    mean = Unknown("mean", data.mean.T.ravel(), unit="arcsec",
                   parts=[f"{p} {way}" for way in ("up", "down") for p in positions])
    place = np.searchsorted(data.position, np.asarray(command, float)) + m * (np.asarray(direction, float) < 0.0)
    seen = Observations(deviation_of_cell, np.eye(2 * m)[place], mean, group="table", unit="arcsec", u=u, rows=rows,
                        readings=np.asarray(measured, float) - np.asarray(command, float), components=("deviation",))
    quantities = [
        Quantity("E", lambda mean: ca.mmax(mean) - ca.mmin(mean), mean, unit="arcsec"),
        Quantity("M", lambda mean: (ca.mmax(mean[:m] + mean[m:]) - ca.mmin(mean[:m] + mean[m:])) / 2.0, mean,
                 unit="arcsec"),
        Quantity("B", lambda mean: ca.mmax(ca.fabs(mean[:m] - mean[m:])), mean, unit="arcsec"),
        Quantity("reversal", lambda mean: mean[:m] - mean[m:], mean, unit="arcsec", parts=positions)]
    return Problem([seen], quantities=quantities, name="two-way positioning by ISO 230-2")


@dataclass(frozen=True)
class Figure:
    """One figure of ISO 230-2: value and standard uncertainty [rad]; `at` says which positions decide it."""

    name: str
    value: float
    u: float
    at: str


@dataclass(frozen=True)
class TwoWay:
    """Deviations sorted by position and direction, with their statistics [rad].

    position: (m,); mean, spread: (m, 2), mean deviation and sample standard deviation approached upwards and downwards.
    runs: number of runs n in each direction.
    """

    position: Array
    mean: Array
    spread: Array
    runs: int

    @property
    def reversal(self) -> Array:
        """Reversal value B_i of each position (m,): upwards less downwards."""
        return self.mean[:, 0] - self.mean[:, 1]

    @property
    def repeatability(self) -> Array:
        """Two-way repeatability R_i of each position (m,)."""
        return np.max([2.0 * self.spread.sum(axis=1) + np.abs(self.reversal), *(4.0 * self.spread.T)], axis=0)


def sort(command: ArrayLike, measured: ArrayLike, direction: ArrayLike) -> TwoWay:
    """Sort two-way readings by position and direction.

    command, measured: (n,) [rad]; direction: (n,), +1 or -1.
    Raises InputError where a position lacks a direction or the numbers of runs differ or are below two.
    Source: ISO 230-2:2014, clause 3.
    """
    command, direction = np.asarray(command, float), np.asarray(direction, float)
    deviation = np.asarray(measured, float) - command
    position = np.unique(command)
    cells = [[deviation[(command == p) & (np.sign(direction) == d)] for d in (1.0, -1.0)] for p in position]
    counts = np.array([[len(cell) for cell in row] for row in cells])
    if counts.min() < 2 or counts.min() != counts.max():
        worst = np.unravel_index(np.argmin(counts), counts.shape)
        raise InputError(f"position {np.degrees(position[worst[0]]):g} deg has {counts[worst]} runs "
                         f"{'upwards' if worst[1] == 0 else 'downwards'}, others have {counts.max()}; ISO 230-2 needs "
                         "the same number, two or more (the standard asks five), at every position and both ways")
    return TwoWay(position, np.array([[c.mean() for c in row] for row in cells]),
                  np.array([[c.std(ddof=1) for c in row] for row in cells]), int(counts.max()))


def figures(data: TwoWay) -> tuple[Figure, ...]:
    """The figures A, E, M, R, B of two-way data, with the u that the scatter of the runs gives them [rad].

    The u belongs to the positions that decided the figure; that these were chosen because they are extreme makes the
    figure itself too large on average. Source: ISO 230-2:2014, clause 3; u of a spread: s/sqrt(2(n - 1)).
    """
    mean, spread, n = data.mean, data.spread, data.runs
    u_mean, u_spread = spread / np.sqrt(n), spread / np.sqrt(2.0 * (n - 1))
    reversal, centre = np.abs(data.reversal), mean.mean(axis=1)
    u_reversal = np.hypot(*u_mean.T)
    upper, lower = mean + 2.0 * spread, mean - 2.0 * spread
    u_limit = np.hypot(u_mean, 2.0 * u_spread)
    b = int(np.argmax(reversal))
    r = int(np.argmax(data.repeatability))
    u_both = np.hypot(u_reversal[r], 2.0 * np.hypot(*u_spread[r]))
    one_way = 4.0 * spread[r].max() >= 2.0 * spread[r].sum() + reversal[r]
    return (_range("A", upper, lower, u_limit, data), _range("E", mean, mean, u_mean, data),
            _range("M", centre[:, None], centre[:, None], u_reversal[:, None] / 2.0, data),
            Figure("R", float(data.repeatability[r]), float(4.0 * u_spread[r].max() if one_way else u_both),
                   _place(data, r)),
            Figure("B", float(reversal[b]), float(u_reversal[b]), _place(data, b)))


def _range(name: str, high: Array, low: Array, u: Array, data: TwoWay) -> Figure:
    top, bottom = np.unravel_index(np.argmax(high), high.shape), np.unravel_index(np.argmin(low), low.shape)
    return Figure(name, float(high[top] - low[bottom]), float(np.hypot(u[top], u[bottom])),
                  f"{_place(data, top[0])} and {_place(data, bottom[0])}")


def _place(data: TwoWay, i: int) -> str:
    return f"{np.degrees(data.position[i]):g} deg"
