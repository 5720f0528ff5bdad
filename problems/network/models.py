"""Models of survey readings between points with any of the coordinates x, y and z.

A point has the coordinates of its network: (x, y), (z) or (x, y, z); a plane reading uses the first two, a height the
last. `sense` is +1 where readings of circles and the axes x, y turn the same way, else -1; `north` is the angle from
the axis x to north in the sense of the circles. Slots: `distance`, `circle`, `zenith`, `height`, `inclination`, `bar`,
and `standpoint`, the place where the instrument really stands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from casadi import atan2, sqrt

from calib import direct


def _across(station: Any, target: Any) -> tuple[Any, Any, Any]:
    x, y = target[0] - station[0], target[1] - station[1]
    return x, y, sqrt(x**2 + y**2)


def _upwards(station: Any, target: Any, station_height: Any, target_height: Any) -> Any:
    return target[-1] + target_height - station[-1] - station_height


def _steepness(station: Any, target: Any, length: Any) -> Any:
    """Tangent of the elevation of a target; none in a plane network."""
    return (target[2] - station[2]) / length if station.shape[0] == 3 else 0.0


def _bearing(station: Any, target: Any, sense: Any) -> Any:
    """Angle [rad] from the axis x to a target in the sense of the circles."""
    x, y, _ = _across(station, target)
    return atan2(sense * y, x)


def horizontal_distance(station: Any, target: Any, *, distance: Any = direct, standpoint: Any = direct) -> Any:
    """Distance in the plane [m]; station, target: points [m]."""
    length = _across(standpoint(station), target)[2]
    return distance(length, length=length)


def slope_distance(
    station: Any, target: Any, station_height: Any, target_height: Any, *, distance: Any = direct,
    standpoint: Any = direct
) -> Any:
    """Distance in space [m] between instrument and target, each at its height above its point [m]."""
    station = standpoint(station)
    length = sqrt(
        _across(station, target)[2] ** 2 + _upwards(station, target, station_height, target_height) ** 2
    )
    return distance(length, length=length)


def direction(station: Any, target: Any, orientation: Any, sense: Any, *, circle: Any = direct,
              standpoint: Any = direct) -> Any:
    """Reading of a horizontal circle [rad]; orientation: angle from the axis x to its zero [rad]."""
    station = standpoint(station)
    length = _across(station, target)[2]
    return circle(_bearing(station, target, sense) - orientation, length=length,
                  steepness=_steepness(station, target, length))


def angle(station: Any, back: Any, target: Any, sense: Any, *, circle: Any = direct,
          standpoint: Any = direct) -> Any:
    """Horizontal angle [rad] from the point `back` to the target."""
    station = standpoint(station)
    turned = _bearing(station, target, sense) - _bearing(station, back, sense)
    return circle(turned, length=_across(station, target)[2])


def azimuth(station: Any, target: Any, sense: Any, north: Any, *, circle: Any = direct,
            standpoint: Any = direct) -> Any:
    """Horizontal angle [rad] from north to the target."""
    station = standpoint(station)
    return circle(_bearing(station, target, sense) - north, length=_across(station, target)[2])


def zenith_angle(station: Any, target: Any, station_height: Any, target_height: Any, *, zenith: Any = direct) -> Any:
    """Angle [rad] from the zenith to the line between instrument and target, each at its height [m]."""
    length = _across(station, target)[2]
    up = _upwards(station, target, station_height, target_height)
    return zenith(atan2(length, up), length=sqrt(length**2 + up**2))


def elevation_angle(station: Any, target: Any, station_height: Any, target_height: Any, *,
                    inclination: Any = direct) -> Any:
    """Inclination [rad] of the line from instrument to target against the horizontal, positive upwards."""
    length = _across(station, target)[2]
    up = _upwards(station, target, station_height, target_height)
    return inclination(atan2(up, length), length=sqrt(length**2 + up**2))


def bar_length(station: Any, target: Any, *, bar: Any = direct) -> Any:
    """Calibrated length [m] between two marks of a scale bar."""
    length = sqrt(_across(station, target)[2] ** 2 + _upwards(station, target, 0.0, 0.0) ** 2)
    return bar(length, length=length)


def height_difference(station: Any, target: Any, *, height: Any = direct) -> Any:
    """Height of the target above the station [m]."""
    up = target[-1] - station[-1]
    return height(up, rise=up)


def vector(station: Any, target: Any, station_height: Any, target_height: Any) -> Any:
    """Coordinate differences (3,) [m] between antenna and antenna, each at its height [m]."""
    return [target[0] - station[0], target[1] - station[1], _upwards(station, target, station_height, target_height)]


def coordinates(station: Any) -> Any:
    """All three coordinates [m] of a point."""
    return [station[0], station[1], station[2]]


def plane_coordinates(station: Any) -> Any:
    """Coordinates x and y [m] of a point."""
    return [station[0], station[1]]


def height(station: Any) -> Any:
    """Height z [m] of a point."""
    return station[-1]


@dataclass(frozen=True)
class Kind:
    """A kind of reading: its model, what the model takes, and which coordinates it needs.

    model; takes: names of its arguments after the points; points: 1 (one point), 2 or 3 (with a backsight);
    components: names where there are several; needs: "xy", "z" or "xyz"; angular: whether it is an angle.
    """

    model: Callable[..., Any]
    points: int
    takes: tuple[str, ...] = ()
    components: tuple[str, ...] = ("",)
    needs: str = "xy"
    angular: bool = False

    @property
    def period(self) -> float | None:
        """Full turn [rad] of an angle."""
        return 2.0 * np.pi if self.angular else None


HEIGHTS = ("station_height", "target_height")
KINDS = {
    "distance": Kind(horizontal_distance, 2),
    "slope distance": Kind(slope_distance, 2, HEIGHTS, needs="xyz"),
    "direction": Kind(direction, 2, ("orientation", "sense"), angular=True),
    "angle": Kind(angle, 3, ("sense",), angular=True),
    "azimuth": Kind(azimuth, 2, ("sense", "north"), angular=True),
    "zenith angle": Kind(zenith_angle, 2, HEIGHTS, needs="xyz", angular=True),
    "inclination": Kind(elevation_angle, 2, HEIGHTS, needs="xyz", angular=True),
    "scale bar": Kind(bar_length, 2, needs="xyz"),
    "height difference": Kind(height_difference, 2, needs="z"),
    "vector": Kind(vector, 2, HEIGHTS, ("dx", "dy", "dz"), "xyz"),
    "coordinates": Kind(coordinates, 1, (), ("x", "y", "z"), "xyz"),
    "plane coordinates": Kind(plane_coordinates, 1, (), ("x", "y")),
    "height": Kind(height, 1, (), ("z",), "z"),
}
