"""Two-way positioning of a rotary table by ISO 230-2: the figures A, E, M, R and B with their uncertainty.

A deviation is the angle read less the angle commanded. Every position and direction of approach has a mean deviation
and a spread; the figures are functions of these, so their uncertainty and correlation follow.
Source: ISO 230-2:2014, Determination of accuracy and repeatability of positioning of numerically controlled axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import Observations, Problem, Quantity, Unknown, prior
from calib.errors import InputError

Array = NDArray[np.float64]


# --- the figures, for m positions: first m approached upwards, then m downwards ------------------------------------


def deviation_of_cell(cell: Any, mean: Any) -> Any:
    """The deviation [rad] of one position and direction; cell: (2m,) one at its place, else zero; mean: (2m,) [rad]."""
    return ca.dot(cell, mean)


def reversal(mean: Any) -> Any:
    """Reversal value B_i of each position (m,) [rad]: mean (2m,) upwards less downwards."""
    half = mean.shape[0] // 2
    return mean[:half] - mean[half:]


def largest_reversal(mean: Any) -> Any:
    """Reversal value B [rad] of the axis: the largest magnitude."""
    return ca.mmax(ca.fabs(reversal(mean)))


def mean_range(mean: Any) -> Any:
    """Range M [rad] of the mean two-way deviations."""
    half = mean.shape[0] // 2
    middle = (mean[:half] + mean[half:]) / 2.0
    return ca.mmax(middle) - ca.mmin(middle)


def systematic_deviation(mean: Any) -> Any:
    """Two-way systematic deviation E [rad]: the range of all means."""
    return ca.mmax(mean) - ca.mmin(mean)


def accuracy(mean: Any, spread: Any) -> Any:
    """Two-way accuracy A [rad]: from the lowest mean less two spreads to the highest mean plus two spreads."""
    return ca.mmax(mean + 2.0 * spread) - ca.mmin(mean - 2.0 * spread)


def repeatability(mean: Any, spread: Any) -> Any:
    """Two-way repeatability R [rad]: the largest of 4 s of one direction, and of 2 s of both and the reversal."""
    half = mean.shape[0] // 2
    both = 2.0 * (spread[:half] + spread[half:]) + ca.fabs(reversal(mean))
    return ca.fmax(ca.mmax(both), ca.mmax(4.0 * spread))


# --- the declaration ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TwoWay:
    """Runs sorted by position and direction: position (m,) [rad], mean and spread (m, 2) [rad] upwards and downwards.

    runs: number of runs n in each direction; spread: sample standard deviation over them.
    """

    position: Array
    mean: Array
    spread: Array
    runs: int


def start(command: ArrayLike, measured: ArrayLike, direction: ArrayLike) -> TwoWay:
    """Means and spreads of two-way readings.

    command, measured: (n,) [rad]; direction: (n,), +1 or -1.
    Raises InputError where a position lacks a direction, or the numbers of runs differ or are below two.
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


def declare(command: ArrayLike, measured: ArrayLike, direction: ArrayLike, u: float,
            rows: ArrayLike | None = None) -> Problem:
    """Two-way readings with the quantities A, E, M, R, B and `reversal` of each position.

    command, measured: (n,) [rad]; direction: (n,), +1 or -1; u: standard uncertainty of one reading, that is its
    repeatability [rad]; rows: (n,) row numbers of the file. The spread of n runs is known to u/sqrt(2(n - 1)) and, for
    Gaussian readings, independent of their mean. That the deciding positions were chosen because they are extreme
    makes the figures too large on average; `montecarlo` shows by how much.
    """
    data = start(command, measured, direction)
    m, positions = len(data.position), [f"{np.degrees(p):.6g}" for p in data.position]
    parts = [f"{p} {way}" for way in ("up", "down") for p in positions]
    mean = Unknown("mean", data.mean.T.ravel(), unit="arcsec", parts=parts)
    spread = Unknown("spread", data.spread.T.ravel(), unit="arcsec", parts=parts)
    place = np.searchsorted(data.position, np.asarray(command, float)) + m * (np.asarray(direction, float) < 0.0)
    seen = Observations(deviation_of_cell, np.eye(2 * m)[place], mean, group="table", unit="arcsec", u=u, rows=rows,
                        readings=np.asarray(measured, float) - np.asarray(command, float), components=("deviation",))
    scatter = prior(spread, data.spread.T.ravel(), u / np.sqrt(2.0 * (data.runs - 1)), name="spread of the runs")
    quantities = [Quantity("A", accuracy, mean, spread, unit="arcsec"),
                  Quantity("E", systematic_deviation, mean, unit="arcsec"),
                  Quantity("M", mean_range, mean, unit="arcsec"),
                  Quantity("R", repeatability, mean, spread, unit="arcsec"),
                  Quantity("B", largest_reversal, mean, unit="arcsec"),
                  Quantity("reversal", reversal, mean, unit="arcsec", parts=positions)]
    return Problem([seen, scatter], quantities=quantities, name="two-way positioning by ISO 230-2")
