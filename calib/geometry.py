"""Vectors, rotations, transforms and lines; every function takes CasADi expressions and NumPy numbers alike.

A vector is a column of three: a CasADi (3, 1) or a NumPy (3,); where a docstring says (..., 3), NumPy rows may be
stacked.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from .errors import InputError

_SYMBOLIC = (ca.SX, ca.MX, ca.DM)


def _is_symbolic(*values: Any) -> bool:
    return any(isinstance(value, _SYMBOLIC) for value in values)


def _mathematics(*values: Any) -> Any:
    return ca if _is_symbolic(*values) else np


def _parts(vector: Any) -> tuple[Any, Any, Any]:
    """The three components, along the last axis for NumPy."""
    if isinstance(vector, _SYMBOLIC):
        return vector[0], vector[1], vector[2]
    if isinstance(vector, (list, tuple)):
        return vector[0], vector[1], vector[2]
    vector = np.asarray(vector, dtype=float)
    return vector[..., 0], vector[..., 1], vector[..., 2]


def column(*components: Any) -> Any:
    """Components as one vector: a CasADi column where any of them is an expression, else NumPy (..., count)."""
    if _is_symbolic(*components):
        return ca.vertcat(*components)
    return np.stack(np.broadcast_arrays(*components), axis=-1).astype(float)


def matrix(rows: Any) -> Any:
    """A matrix from nested rows of scalars: CasADi where any of them is an expression, else NumPy."""
    entries = [entry for row in rows for entry in row]
    if _is_symbolic(*entries):
        return ca.vertcat(*(ca.horzcat(*row) for row in rows))
    return np.array(rows, dtype=float)


def _plain(value: Any) -> Any:
    """A NumPy operand as a CasADi constant, so that `@` between the two is a CasADi product."""
    return value if isinstance(value, _SYMBOLIC) else ca.DM(np.asarray(value, dtype=float))


def product(left: Any, right: Any) -> Any:
    """Matrix product of a matrix with a matrix or a vector, either of which may be symbolic."""
    if _is_symbolic(left, right):
        return ca.mtimes(_plain(left), _plain(right))
    return np.asarray(left, dtype=float) @ np.asarray(right, dtype=float)


def dot(a: Any, b: Any) -> Any:
    """Scalar product of two vectors of one length, (dim,) or for numbers (..., dim)."""
    a, b = (column(*v) if isinstance(v, (list, tuple)) else v for v in (a, b))
    if _is_symbolic(a, b):
        return ca.dot(_plain(a), _plain(b))
    return np.sum(np.asarray(a, dtype=float) * np.asarray(b, dtype=float), axis=-1)


def cross(a: Any, b: Any) -> Any:
    """Vector product of two vectors (..., 3)."""
    (ax, ay, az), (bx, by, bz) = _parts(a), _parts(b)
    return column(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def norm(vector: Any) -> Any:
    """Length of a vector, (dim,) or for numbers (..., dim); it has no derivative at the zero vector."""
    square = dot(vector, vector)
    return _mathematics(square).sqrt(square)


def unit(vector: Any) -> Any:
    """The unit vector along a vector, (dim,) or (..., dim). Raises InputError for numbers of length zero."""
    length = norm(vector)
    if _is_symbolic(vector):
        return vector / length
    if np.any(length == 0.0):
        raise InputError("a vector of length zero has no direction: give two different points or a non-zero direction")
    return np.asarray(vector, dtype=float) / np.asarray(length)[..., None]


def skew(vector: Any) -> Any:
    """The 3x3 matrix S with S @ b = cross(vector, b)."""
    x, y, z = _parts(vector)
    return matrix([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_x(angle: Any) -> Any:
    """Rotation matrix (3, 3) about x by an angle [rad]."""
    of = _mathematics(angle)
    c, s = of.cos(angle), of.sin(angle)
    return matrix([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_y(angle: Any) -> Any:
    """Rotation matrix (3, 3) about y by an angle [rad]."""
    of = _mathematics(angle)
    c, s = of.cos(angle), of.sin(angle)
    return matrix([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rotation_z(angle: Any) -> Any:
    """Rotation matrix (3, 3) about z by an angle [rad]."""
    of = _mathematics(angle)
    c, s = of.cos(angle), of.sin(angle)
    return matrix([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_about(axis: Any, angle: Any) -> Any:
    """Rotation matrix (3, 3) about an axis through the origin.

    axis: unit vector (3,); angle: [rad], right-handed. Source: Rodrigues' formula.
    """
    of = _mathematics(angle)
    x, y, z = _parts(axis)
    c, s = of.cos(angle), of.sin(angle)
    v = 1.0 - c
    return matrix([[c + x * x * v, x * y * v - z * s, x * z * v + y * s],
                   [y * x * v + z * s, c + y * y * v, y * z * v - x * s],
                   [z * x * v - y * s, z * y * v + x * s, c + z * z * v]])


def small_rotation(vector: Any) -> Any:
    """An exact rotation (3, 3) whose first order is the rotation vector.

    vector: (3,) [rad]; the rotation turns by 2 atan(|vector|/2) about it. Rational; the identity with derivative
    skew(e_i) at zero. Source: Cayley's map.
    """
    x, y, z = _parts(vector)
    xx, yy, zz = x * x / 2.0, y * y / 2.0, z * z / 2.0
    xy, xz, yz = x * y / 2.0, x * z / 2.0, y * z / 2.0
    scale = 1.0 / (1.0 + (xx + yy + zz) / 2.0)
    return matrix([[1.0 - (yy + zz) * scale, (xy - z) * scale, (xz + y) * scale],
                   [(xy + z) * scale, 1.0 - (xx + zz) * scale, (yz - x) * scale],
                   [(xz - y) * scale, (yz + x) * scale, 1.0 - (xx + yy) * scale]])


def small_rotation_vector(rotation: Any) -> Any:
    """The vector (3,) [rad] whose `small_rotation` is the rotation (3, 3); not defined for half a turn."""
    scale = 2.0 / (1.0 + rotation[0, 0] + rotation[1, 1] + rotation[2, 2])
    return column((rotation[2, 1] - rotation[1, 2]) * scale, (rotation[0, 2] - rotation[2, 0]) * scale,
                  (rotation[1, 0] - rotation[0, 1]) * scale)


def rotation_vector(rotation: Any) -> Any:
    """The rotation vector (3,) [rad] of a rotation matrix (3, 3): axis times angle.

    Numbers: any rotation up to half a turn. Expressions: smooth, for rotations of less than half a turn (priors).
    """
    if _is_symbolic(rotation):
        vector = small_rotation_vector(rotation)
        square = dot(vector, vector) / 4.0
        near = square < 1e-3
        # atan(x)/x near zero as a series in x^2; the branch not taken must stay differentiable, hence the 1
        series = 1.0 - square * (1 / 3 - square * (1 / 5 - square * (1 / 7 - square * (1 / 9 - square / 11))))
        root = ca.sqrt(ca.if_else(near, 1.0, square))
        return vector * ca.if_else(near, series, ca.atan(root) / root)
    w, x, y, z = _quaternion(np.asarray(rotation, dtype=float))
    half_sine = np.sqrt(x * x + y * y + z * z)
    scale = 2.0 * np.arctan2(half_sine, w) / half_sine if half_sine > 0.0 else 2.0
    return scale * np.array([x, y, z])


def _quaternion(r: np.ndarray) -> np.ndarray:
    """Unit quaternion (w, x, y, z) with w >= 0, from the largest of its four squares (Shepperd 1978)."""
    squares = np.array([1.0 + r[0, 0] + r[1, 1] + r[2, 2], 1.0 + r[0, 0] - r[1, 1] - r[2, 2],
                        1.0 - r[0, 0] + r[1, 1] - r[2, 2], 1.0 - r[0, 0] - r[1, 1] + r[2, 2]])
    wx, wy, wz = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    xy, xz, yz = r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1]
    largest = int(np.argmax(squares))
    row = np.array([[squares[0], wx, wy, wz], [wx, squares[1], xy, xz],
                    [wy, xy, squares[2], yz], [wz, xz, yz, squares[3]]])[largest]
    quaternion = row / np.sqrt(row @ row)
    return quaternion if quaternion[0] >= 0.0 else -quaternion


def rotation_from_rpy(roll: Any, pitch: Any, yaw: Any) -> Any:
    """Rotation (3, 3) Rz(yaw) Ry(pitch) Rx(roll), angles [rad]."""
    return product(rotation_z(yaw), product(rotation_y(pitch), rotation_x(roll)))


def rpy_from_rotation(rotation: Any) -> Any:
    """Roll, pitch, yaw (3,) [rad] of a rotation Rz Ry Rx (3, 3); at a pitch of 90 degrees only roll -+ yaw is known."""
    atan2, cos, sin = (ca.atan2, ca.cos, ca.sin) if _is_symbolic(rotation) else (np.arctan2, np.cos, np.sin)
    yaw = atan2(rotation[1, 0], rotation[0, 0])
    # with any yaw at the pole, roll and pitch of what is left make up for it: the three give the rotation back
    along = cos(yaw) * rotation[0, 0] + sin(yaw) * rotation[1, 0]
    across = [cos(yaw) * rotation[1, i] - sin(yaw) * rotation[0, i] for i in (1, 2)]
    return column(atan2(-across[1], across[0]), atan2(-rotation[2, 0], along), yaw)


def orthonormal_frame(direction: Any) -> np.ndarray:
    """A right-handed orthonormal frame (3, 3) of numbers whose third column is the direction.

    direction: (3,), any length but zero. Raises InputError for length zero. Source: Duff et al. 2017, J. Comput. Graph.
    Techniques 6(1), equation 3.
    """
    x, y, z = unit(np.asarray(direction, dtype=float))
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.array([[1.0 + sign * x * x * a, b, x], [sign * b, sign + y * y * a, y], [-sign * x, -y, z]])


def move_direction(frame: Any, local: Any) -> Any:
    """A unit vector (3,) near the third column of a frame.

    frame: (3, 3) orthonormal; local: (2,) [rad] along the first two columns, exact to first order (stereographic).
    """
    a, b = local[0], local[1]
    quarter = (a * a + b * b) / 4.0
    scale = 1.0 / (1.0 + quarter)
    return product(frame, column(a * scale, b * scale, (1.0 - quarter) * scale))


def local_direction(frame: Any, direction: Any) -> Any:
    """The two local components (2,) [rad] that `move_direction` turns into a unit direction (3,)."""
    x, y, z = _parts(product(frame.T, direction))
    return column(2.0 * x / (1.0 + z), 2.0 * y / (1.0 + z))


def polar_from_cartesian(point: Any) -> Any:
    """Range, azimuth (x towards y) and zenith angle (from z), (..., 3) [m, rad, rad], of a point (..., 3) [m]."""
    atan2, sqrt = (ca.atan2, ca.sqrt) if _is_symbolic(point) else (np.arctan2, np.sqrt)
    x, y, z = _parts(point)
    level = x * x + y * y
    return column(sqrt(level + z * z), atan2(y, x), atan2(sqrt(level), z))


def cartesian_from_polar(distance: Any, azimuth: Any, zenith: Any) -> Any:
    """Point (..., 3) [m] at a distance [m], azimuth [rad] from x towards y and zenith angle [rad] from z."""
    of = _mathematics(azimuth, zenith)
    level = distance * of.sin(zenith)
    return column(level * of.cos(azimuth), level * of.sin(azimuth), distance * of.cos(zenith))


def foot_on_line(point: Any, origin: Any, direction: Any) -> Any:
    """Foot (3,) of the perpendicular from a point (3,) to the line through origin (3,) along a unit direction (3,)."""
    return origin + direction * dot(point - origin, direction)


def distance_to_line(point: Any, origin: Any, direction: Any) -> Any:
    """Distance (not negative) of a point (3,) from the line through origin (3,) along a unit direction (3,)."""
    return norm(cross(point - origin, direction))


def common_perpendicular(origin_a: Any, direction_a: Any, origin_b: Any, direction_b: Any) -> tuple[Any, Any]:
    """The two feet of the common perpendicular of two lines.

    origin_*: (3,) points; direction_*: (3,), any length. Returns the foot on a (3,) and the foot on b (3,).
    Raises InputError for parallel lines of numbers.
    """
    across = cross(direction_a, direction_b)
    square = dot(across, across)
    if not _is_symbolic(square) and square <= 1e-30 * dot(direction_a, direction_a) * dot(direction_b, direction_b):
        raise InputError("the two lines are parallel and have no single common perpendicular: give lines that cross")
    between = origin_b - origin_a
    along_a = dot(cross(between, direction_b), across) / square
    along_b = dot(cross(between, direction_a), across) / square
    return origin_a + direction_a * along_a, origin_b + direction_b * along_b


def signed_line_distance(origin_a: Any, direction_a: Any, origin_b: Any, direction_b: Any) -> Any:
    """Distance from line a to line b, positive where b lies on the side of cross(direction_a, direction_b)."""
    return dot(origin_b - origin_a, unit(cross(direction_a, direction_b)))


def signed_distance_to_plane(point: Any, origin: Any, normal: Any) -> Any:
    """Distance of a point (3,) from the plane through origin (3,), positive along the unit normal (3,)."""
    return dot(point - origin, normal)


def wrap(value: Any, period: Any) -> Any:
    """The value less whole periods, within half a period of zero; its derivative is that of the value."""
    of = _mathematics(value, period)
    return value - period * of.floor(value / period + 0.5)


@dataclass(frozen=True, eq=False)
class Transform:
    """A rigid motion `a_from_b`: point in a = rotation @ point in b + translation.

    rotation: (3, 3); translation: (3,) [m]. `a_from_b @ point` moves a point (numbers: (..., 3)),
    `a_from_b @ b_from_c` chains, `a_from_b.inverse()` is b_from_a.
    """

    rotation: Any
    translation: Any

    @staticmethod
    def identity() -> Transform:
        """The transform that moves nothing."""
        return Transform(np.eye(3), np.zeros(3))

    def __matmul__(self, other: Any) -> Any:
        if isinstance(other, Transform):
            return Transform(product(self.rotation, other.rotation),
                             product(self.rotation, other.translation) + self.translation)
        if _is_symbolic(self.rotation, self.translation, other):
            return product(self.rotation, other) + self.translation
        return np.asarray(other, dtype=float) @ np.asarray(self.rotation).T + self.translation

    def turn(self, direction: Any) -> Any:
        """A direction (3,) of b seen from a: rotated, not moved."""
        return product(self.rotation, direction)

    def inverse(self) -> Transform:
        """b_from_a of an a_from_b."""
        return Transform(self.rotation.T, -product(self.rotation.T, self.translation))
