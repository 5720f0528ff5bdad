"""One world: axes as lines in space, a level that feels gravity, theodolites that lean a little, and what they read.

Frame, as in section 1 of the paper: origin in T1, X horizontal to the three-axis yaw axis, Y the way the horizontal
circle grows, Z the way the vertical circle grows, so that every sign is the paper's. The paper calls Z up; a theodolite
of the usual make (clockwise circle, zenith angles) has Z down and Y to the right. That choice, `up`, matters only where
the level enters: gravity says which way the yaw axes lean.
"""

from __future__ import annotations

from typing import Any

from casadi import asin, pi, vertcat

from calib import direct, hands_slots_to
from calib.geometry import dot, rotation_about, signed_line_distance, unit
from instruments import level, theodolite
from problems.axis_points import across, upward

# Circles that grow with the azimuth (counter-clockwise about Z) and with the elevation: the frame above is made for it.
AS_READ = (1, -1)


def yaw_direction(tilt: Any, up: Any) -> Any:
    """Direction (3,) of a yaw axis, near Z, from its plumb error (2,) about X and Y, right-handed with Z up [rad]."""
    return vertcat(up * tilt[1], -tilt[0], 1.0)


def _horizon(zero: Any, index: Any) -> Any:
    return vertcat(zero, index + pi / 2)


def _sight(
    line: Any, zero: Any, index: Any, standing: Any, standing_axis: Any, slots: dict[str, Any]
) -> tuple[Any, Any]:
    return theodolite.circles(
        line, 1.0, _horizon(zero, index), AS_READ, standing_axis=lambda plumb: standing_axis(plumb + standing), **slots
    )


@hands_slots_to(level.on_turning_axis)
def level_reading(axis_tilt: Any, azimuth: Any, angle: Any, zero: Any, **slots: Any) -> Any:
    """Level on a yaw axis at one position, its seat turned by an azimuth against X (eq 1) [rad]."""
    return level.on_turning_axis(axis_tilt, angle + azimuth, zero, **slots)


@hands_slots_to(theodolite.circles)
def on_target(
    point: Any, slope: Any, crossing: Any, distance: Any, circle_h: Any, circle_v: Any, angle: Any, zero: Any,
    index: Any, standing: Any, *, offset: Any = direct, standing_axis: Any = direct, **slots: Any
) -> tuple[Any, Any]:
    """Circles of T1 on a target that runs round a nearly horizontal axis.

    point, slope: (2,) y, z of the axis where it passes the yaw axis [m] and its slopes; crossing, distance: of the yaw
    axis and of the target from T1 [m]; circle_h, circle_v: (2,) eccentricity as each circle sees it [m]; angle: of the
    axis; zero, index: readings of the circles along X; standing: (2,) lean of the standing axis [rad]. Slots: `offset`
    ((2,) y, z of the target from the axis [m], may ask for angle) and those of the theodolite. Returns H, V [rad].
    """
    departure = offset(vertcat(across(circle_h, angle), upward(circle_v, angle)), angle=angle)
    reach = distance - crossing
    line = vertcat(distance, *(point[i] + slope[i] * reach + departure[i] for i in range(2)))
    return _sight(line, zero, index, standing, standing_axis, slots)


@hands_slots_to(theodolite.circles)
def on_wire(
    looks: Any, offset: Any, axis_tilt: Any, height: Any, circle: Any, angle: Any, distance: Any, zero: Any,
    standing: Any, up: Any, turns: Any, *, standing_axis: Any = direct, **slots: Any
) -> Any:
    """Horizontal circle of a theodolite on a filament that runs round a yaw axis.

    looks: (2,) direction toward the three-axis yaw axis; offset: (2,) of this yaw axis from that one, at Z = 0 [m];
    axis_tilt: (2,) its plumb error; height: of the pointed place [m]; circle: (2,) eccentricity [m]; distance: to the
    three-axis yaw axis [m]; turns: +1 from X to Y. Returns H [rad].
    """
    lean = yaw_direction(axis_tilt, up)
    left = vertcat(-looks[1], looks[0])
    wire = vertcat(
        offset[0] + height * lean[0] - turns * upward(circle, angle),
        offset[1] + height * lean[1] + across(circle, angle),
    )
    line = vertcat(distance + looks[0] * wire[0] + looks[1] * wire[1], left[0] * wire[0] + left[1] * wire[1], height)
    return _sight(line, zero, 0.0, standing, standing_axis, slots)[0]


# --- the twelve results as geometry of lines; coordinates from the point where X meets the three-axis yaw axis --------


def _line(point: Any, slope: Any) -> tuple[Any, Any]:
    return vertcat(0.0, point[0], point[1]), unit(vertcat(1.0, slope[0], slope[1]))


def _yaw(offset: Any, tilt: Any, up: Any) -> tuple[Any, Any]:
    return vertcat(offset[0], offset[1], 0.0), unit(yaw_direction(tilt, up))


def square(slope: Any, tilt: Any, up: Any) -> Any:
    """Departure of a pitch axis from a right angle with its yaw axis, positive toward Z, items 1 and 6 [rad]."""
    return asin(dot(unit(vertcat(1.0, slope[0], slope[1])), unit(yaw_direction(tilt, up))))


def intersection(point: Any, slope: Any, offset: Any, tilt: Any, up: Any) -> Any:
    """Distance from a yaw axis to a horizontal axis, positive toward Y, items 3, 5 and, reversed, 7 [m]."""
    return signed_line_distance(*_yaw(offset, tilt, up), *_line(point, slope))


def _turned_back(point: Any, slope: Any, offset: Any, tilt: Any, turn_error: Any, up: Any) -> tuple[Any, Any]:
    """The roll axis as it lies when the yaw axis stands where the pitch axis was read."""
    centre, axis = _yaw(offset, tilt, up)
    back = rotation_about(axis, -(pi / 2 + turn_error))
    origin, direction = _line(point, slope)
    return centre + back @ (origin - centre), back @ direction


def square_in_plan(
    pitch: Any, pitch_slope: Any, roll: Any, roll_slope: Any, offset: Any, tilt: Any, turn_error: Any, up: Any
) -> Any:
    """Departure of pitch and roll axis from a right angle, item 2 [rad]."""
    direction = _turned_back(roll, roll_slope, offset, tilt, turn_error, up)[1]
    return asin(dot(_line(pitch, pitch_slope)[1], direction))


def roll_over_pitch(
    pitch: Any, pitch_slope: Any, roll: Any, roll_slope: Any, offset: Any, tilt: Any, turn_error: Any, up: Any
) -> Any:
    """Distance from pitch to roll axis, positive toward Z, item 4 [m]."""
    origin, direction = _line(pitch, pitch_slope)
    return signed_line_distance(origin, -direction, *_turned_back(roll, roll_slope, offset, tilt, turn_error, up))


def pitch_over_pitch(first: Any, first_slope: Any, second: Any, second_slope: Any, offset: Any) -> Any:
    """Height of the second pitch axis, at its yaw axis, over the first, at its own, item 10 [m]."""
    return second[1] + second_slope[1] * offset[0] - first[1]


def axis_point(point: Any, slope: Any, crossing: Any, distance: Any) -> Any:
    """Point y, z of a horizontal axis at a distance from T1 [m]."""
    return point + slope * (distance - crossing)


def raise_of_foot(tilt: Any, place: Any) -> Any:
    """How much to raise a foot so that the yaw axis becomes plumb [m].

    tilt: (2,) plumb error of the axis; place: (2,) x, y of the foot from the axis in the level's frame [m].
    """
    return tilt[1] * place[0] - tilt[0] * place[1]
