"""Stated uncertainty of survey readings: a constant, a part that grows with length, centring of both ends, pointing.

Source: ISO 17123-3 and -4 for what makers state; centring and pointing as in Ghilani (2010), Adjustment Computations,
chapter 7.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
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


@dataclass(frozen=True)
class Sight:
    """What spoils a sight beside the circle, added in squares.

    station_centring, target_centring: of both ends across the sight [m]; pointing: at the target, as a length there
    [m], so that it is pointing / distance; aiming: pointing as an angle [rad], and aiming_per_metre [rad/m] of a sight
    that shimmers; per_metre: the circle's own u grows by it with the length [rad/m].
    """

    station_centring: float = 0.0
    target_centring: float = 0.0
    pointing: float = 0.0
    aiming: float = 0.0
    aiming_per_metre: float = 0.0
    per_metre: float = 0.0

    def circle(self, constant: ArrayLike, length: Any) -> Any:
        """Square [rad^2] of what does not come from the ends of a sight of some length [m]."""
        return (np.asarray(constant) + self.per_metre * length) ** 2 + self.aiming**2 + (
            self.aiming_per_metre * length) ** 2

    @property
    def at_target(self) -> float:
        """Square [m^2] of what the target contributes across the sight."""
        return self.target_centring**2 + self.pointing**2


def of_sights(
    constant: ArrayLike, station_centring: float = 0.0, target_centring: float = 0.0, pointing: float = 0.0, *,
    inclined: bool = False, **more: float,
) -> Gaussian:
    """Uncertainty of directions, azimuths, zenith angles and inclinations: sqrt(circle^2 + ends^2 / length^2).

    constant: number or (n,) [rad]; the rest as of `Sight`; inclined: whether the length of the sight in space counts
    (vertical angles), not that in the plane.
    """
    sight = Sight(station_centring, target_centring, pointing, **more)
    if sight == Sight():
        return Gaussian.standard(constant)
    across = sight.station_centring**2 + sight.at_target

    def at(length: Any) -> Any:
        return np.sqrt(sight.circle(constant, length) + across / length**2)

    def level(station: Any, target: Any) -> Any:
        return at(_length(station, target))

    def steep(station: Any, target: Any, station_height: Any, target_height: Any) -> Any:
        up = target[:, 2] + target_height[:, 0] - station[:, 2] - station_height[:, 0]
        return at(np.hypot(_length(station, target), up))

    return Gaussian.depending(steep if inclined else level)


def of_angles(
    constant: ArrayLike, station_centring: float = 0.0, target_centring: float = 0.0, pointing: float = 0.0,
    **more: float,
) -> Gaussian:
    """Uncertainty of angles between two sights; the instrument is off centre for both by the same shift.

    constant: number or (n,) [rad]; the rest as of `Sight`, for both sights in squares; the circle's own grows with the
    longer.
    """
    sight = Sight(station_centring, target_centring, pointing, **more)
    if sight == Sight():
        return Gaussian.standard(constant)

    def stated(station: Any, back: Any, target: Any) -> Any:
        first, second, between = _length(station, back), _length(station, target), _length(back, target)
        aimed = replace(sight, per_metre=0.0).circle(0.0, first) + sight.circle(constant, np.maximum(first, second))
        ends = sight.at_target * (first**-2.0 + second**-2.0)
        return np.sqrt(aimed + ends + (sight.station_centring * between / (first * second)) ** 2)

    return Gaussian.depending(stated)


def _length(a: Any, b: Any) -> Any:
    return np.maximum(np.hypot(b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]), 1e-6)
