"""The printed formulas of the five-axis paper, one function each, for numbers and for derived quantities alike.

Signs are the paper's own: y = L tan(H - H0) and z = L tan(V - V0) grow as the circles grow. Lengths and angles in SI,
or lengths in any one unit throughout where nothing but lengths goes in.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from casadi import atan, sqrt, tan, vertcat


class Line(NamedTuple):
    """A nearly horizontal line through two points, as eq (8)-(10) print it: first point and differences."""

    x: Any
    y: Any
    z: Any
    dx: Any
    dy: Any
    dz: Any

    def at(self, x: Any) -> tuple[Any, Any]:
        """Coordinates y, z of the line at a distance x from the theodolite."""
        share = (x - self.x) / self.dx
        return self.y + share * self.dy, self.z + share * self.dz


def line_through(first: tuple[Any, Any, Any], second: tuple[Any, Any, Any]) -> Line:
    """The line through two points (x, y, z), eq (8)-(10)."""
    return Line(*first, *(b - a for a, b in zip(first, second)))


def off_the_sight(distance: Any, reading: Any, zero: Any) -> Any:
    """Departure L tan(reading - zero) from the line of sight of reading `zero`, sections 4 and 5.1."""
    return distance * tan(reading - zero)


def axis_point(distance: Any, horizontal: Any, vertical: Any, yaw: Any, index: Any) -> tuple[Any, Any, Any]:
    """Axis point (x, y, z) behind a target, section 5.1.

    distance: from the theodolite [m]; horizontal, vertical: fitted centres [rad]; yaw: horizontal reading on the
    three-axis yaw axis [rad]; index: vertical reading of a horizontal line of sight [rad].
    """
    return distance, off_the_sight(distance, horizontal, yaw), off_the_sight(distance, vertical, index)


def parallelism(plumb_three: Any, plumb_two: Any) -> Any:
    """Difference of the two plumb errors, x, y, and their parallelism, eq (3), (3,) [rad]."""
    x, y = plumb_two[0] - plumb_three[0], plumb_two[1] - plumb_three[1]
    return vertcat(x, y, sqrt(x * x + y * y))


def out_of_square(pitch: Line) -> Any:
    """Perpendicularity of a horizontal axis and a plumb yaw axis, section 5.2 [rad]."""
    return atan(pitch.dz / pitch.dx)


def out_of_square_in_plan(roll: Line, pitch: Line) -> Any:
    """Perpendicularity of roll and pitch axis after a yaw turn of 90 degrees, section 5.2 [rad]."""
    return atan(roll.dy / roll.dx) - atan(pitch.dy / pitch.dx)


def mean_slope(near: Any, far: Any, near_distance: Any, far_distance: Any) -> Any:
    """Perpendicularity p from two small vertical angles, eq (14) [rad]."""
    return (far_distance * far - near_distance * near) / (far_distance - near_distance)


def intersection(near: Any, far: Any, near_distance: Any, far_distance: Any, crossing: Any) -> Any:
    """Intersection I from two small angles, eq (15), in the unit of the distances.

    near, far: angles from the yaw axis to the axis points, horizontal although section 6 uses the letter of the
    vertical ones [rad].
    """
    slope = mean_slope(near, far, near_distance, far_distance)
    return slope * (crossing - near_distance) + near_distance * near
