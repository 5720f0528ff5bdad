"""Stated uncertainty of survey readings: a constant, a part that grows with length, and centring of both ends.

Source: ISO 17123-3 and -4 for what makers state; centring as in Ghilani (2010), Adjustment Computations, chapter 7.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib import Gaussian


def of_lengths(constant: ArrayLike, per_metre: float = 0.0, centring: float = 0.0) -> Gaussian:
    """Uncertainty of distances and of heights: constant + per_metre L, and centring, added in squares [m].

    constant: number or (n,) [m]; per_metre: of the reading (1e-6 is 1 ppm); centring: of both ends together [m].
    """
    if per_metre == 0.0:
        return Gaussian.standard(np.hypot(constant, centring))
    return Gaussian.depending(
        lambda reading: np.hypot(np.asarray(constant) + per_metre * np.abs(reading[:, 0]), centring)
    )


def of_sights(constant: ArrayLike, station_centring: float = 0.0, target_centring: float = 0.0) -> Gaussian:
    """Uncertainty of directions, azimuths and zenith angles: of the circle, and of both ends seen across the sight.

    constant: number or (n,) [rad]; centring of instrument and target across the sight [m].
    """
    across = float(np.hypot(station_centring, target_centring))
    if across == 0.0:
        return Gaussian.standard(constant)
    return Gaussian.depending(lambda station, target: np.hypot(constant, across / _length(station, target)))


def of_angles(constant: ArrayLike, station_centring: float = 0.0, target_centring: float = 0.0) -> Gaussian:
    """Uncertainty of angles between two sights; the instrument is off centre for both by the same shift.

    constant: number or (n,) [rad]; centring of instrument and targets in each of x and y [m].
    """
    if station_centring == 0.0 and target_centring == 0.0:
        return Gaussian.standard(constant)

    def stated(station: Any, back: Any, target: Any) -> Any:
        first, second, between = _length(station, back), _length(station, target), _length(back, target)
        targets = target_centring**2 * (first**-2.0 + second**-2.0)
        return np.sqrt(np.asarray(constant) ** 2 + targets + (station_centring * between / (first * second)) ** 2)

    return Gaussian.depending(stated)


def _length(a: Any, b: Any) -> Any:
    return np.maximum(np.hypot(b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]), 1e-6)
