"""Start values of a base point by linear least squares, the counting sense, and what the target points cannot show.

With |P - B| = L + sense d, squaring gives d^2 - |P|^2 = -2 P.B - 2 (sense L) d + (|B|^2 - L^2), linear in B, sense L
and the last bracket. A length is positive, so the sign of `sense L` is the counting sense of the instrument.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputError
from calib.geometry import orthonormal_frame

Array = NDArray[np.float64]
FLAT = 1e-6                 # extent across, as a share of the whole, below which points lie on a line or in a plane


@dataclass(frozen=True)
class Span:
    """Where target points extend: centre (3,), axes (rank, 3) that they fill, blank (3 - rank, 3) that they do not."""

    centre: Array
    axes: Array
    blank: Array
    extent: float

    @staticmethod
    def of(points: Array) -> Span:
        """The span of points (n, 3). Raises InputError where all stand at one point."""
        centre = points.mean(axis=0)
        _, sizes, directions = np.linalg.svd(np.vstack([points - centre, np.zeros((3, 3))]), full_matrices=False)
        if sizes[0] <= 1e-9:
            raise InputError(f"all {len(points)} target points stand at one position, where a tracking interferometer "
                             "shows nothing of its base point; move the reflector along a line of some length")
        rank = int(np.sum(sizes > FLAT * sizes[0]))
        blank = directions[rank:]
        if rank == 1:                                     # any two directions across the line will do
            blank = orthonormal_frame(directions[0]).T[:2]
        signs = np.sign(blank[np.arange(len(blank)), np.abs(blank).argmax(axis=1)])
        return Span(centre, directions[:rank], blank * signs[:, None], float(sizes[0]))

    @property
    def rank(self) -> int:
        """1 for a line, 2 for a plane, 3 for a volume."""
        return len(self.axes)


@dataclass(frozen=True)
class Begin:
    """Start values of one tracker: base point (3,) [m], path at the zero of each of its zeroings (m,) [m]."""

    base_point: Array
    lengths: Array


def signed_curvature(points: Array, readings: Array) -> tuple[float, float]:
    """sense/(2 L) [1/m] and its u, from the readings (n,) [m] of one zeroing on points (n, 3) [m]; L: mean path.

    Dividing the squared equation by 2 L leaves the reading, which carries the error, alone on one side:
    d = - P.B/(sense L) - sense/(2 L) (d^2 - |P|^2) + constant, with d and P counted from their means.
    """
    span, change = Span.of(points), readings - readings.mean()
    offset = points - span.centre
    bend = np.sum(offset**2, axis=1) - change**2
    value, u = _least_squares(np.column_stack([bend, np.ones(len(points)), offset @ span.axes.T]), change)
    return float(value[0]), float(u[0])


def counting_sense(points: Array, readings: Array) -> float:
    """The counting sense that readings (n,) on points (n, 3) [m] show: +1 lengthening, -1 shortening, 0 undecided."""
    value, u = signed_curvature(points, readings)
    return float(np.sign(value)) if abs(value) > 8.0 * u else 0.0


def begin(points: Array, readings: Array, zeroing: NDArray, sense: float, *, approximate: Array | None = None,
          absolute: bool = False, name: str = "tracker") -> Begin:
    """Start values of the base point of one tracker.

    points: (n, 3) [m]; readings: (n,) [m]; zeroing: (n,) 0 to m - 1; sense: +1 or -1, as declared.
    approximate: (3,) [m], taken as it is where given; absolute: the readings are whole lengths; name: for messages.
    Return: base point and lengths; where the points lie in a plane or line, the base point on its negative side.
    Raises InputError where the readings contradict the sense or all points stand at one position.
    """
    groups = [np.flatnonzero(zeroing == k) for k in range(int(zeroing.max()) + 1)]
    if not absolute and approximate is not None:
        _check_sense_about(np.linalg.norm(points - approximate, axis=1), readings, groups, sense, name)
    for i in groups if not absolute and approximate is None else ():
        _check_sense(points[i], readings[i], sense, name)
    base = _base_point(points, readings, groups, absolute) if approximate is None else np.asarray(approximate, float)
    excess = np.linalg.norm(points - base, axis=1) - sense * readings
    return Begin(base, np.array([0.0 if absolute else excess[i].mean() for i in groups]))


def _check_sense_about(
    path: Array, readings: Array, groups: Sequence[NDArray[np.int64]], sense: float, name: str
) -> None:
    """Refuse a counting sense with which the readings (n,) run against the paths (n,) to an approximate base point.

    All zeroings together: along a short line across the path an approximate point may have the sign wrong.
    """
    change, read = (np.concatenate([one[i] - one[i].mean() for i in groups]) for one in (path, readings))
    if change @ read * np.sign(sense) < -0.9 * np.linalg.norm(change) * np.linalg.norm(read):
        is_now, should = _senses(sense)
        raise InputError(f"{name}: wrong counting sense: counts = \"{is_now}\", but the readings fall where the path "
                         f"to the stated base point grows; set counts = \"{should}\", or correct the base point")


def _senses(sense: float) -> tuple[str, str]:
    """The words for a counting sense and for the other one."""
    return ("lengthening", "shortening") if sense > 0 else ("shortening", "lengthening")


def _check_sense(points: Array, readings: Array, sense: float, name: str) -> None:
    """Refuse a counting sense that the readings contradict beyond doubt."""
    if np.ptp(points, axis=0).max() == 0.0 or counting_sense(points, readings) != -np.sign(sense):
        return
    value, u = signed_curvature(points, readings)
    length = np.sign(sense) / (2.0 * value)
    is_now, should = _senses(sense)
    raise InputError(
        f"{name}: wrong counting sense: counts = \"{is_now}\" says that the readings grow with a {is_now} path, but "
        f"then the mean path comes out as {1e3 * length:.2f} mm (u = {1e3 * abs(length * u / value):.2f} mm), and no "
        f"path is shorter than nothing. The readings grow with a {should} path; set counts = \"{should}\"")


def _base_point(points: Array, readings: Array, groups: list[NDArray], absolute: bool) -> Array:
    """The base point (3,) from the linear fit of all zeroings together."""
    span, count = Span.of(points), len(groups)
    offset, change, member = points - span.centre, np.array(readings, float), np.zeros((len(points), count))
    for k, i in enumerate(groups):
        member[i, k] = 1.0
        change[i] -= 0.0 if absolute else change[i].mean()
    columns = [-2.0 * offset @ span.axes.T, member] + ([] if absolute else [-2.0 * change[:, None] * member])
    value, _ = _least_squares(np.hstack(columns), change**2 - np.sum(offset**2, axis=1))
    inside, brackets, paths = np.split(value, [span.rank, span.rank + count])
    base = span.centre + inside @ span.axes
    if span.rank == 3:
        return base
    # |B|^2 - L^2 of the zeroing with the longest way gives the height above the line or plane
    best = int(np.argmax([np.ptp(points[i], axis=0).max() for i in groups]))
    square = brackets[best] + (0.0 if absolute else paths[best] ** 2) - inside @ inside
    return base - np.sqrt(max(square, (0.05 * span.extent) ** 2)) * span.blank[-1]


def _least_squares(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Solution of least norm in scaled columns, and its u from the scatter, infinite where that says nothing."""
    size = np.linalg.norm(matrix, axis=0)
    size[size == 0.0] = 1.0
    left, sizes, directions = np.linalg.svd(matrix / size, full_matrices=False)
    kept = sizes > 1e-11 * sizes[0]
    inverse = directions[kept].T / sizes[kept]
    value = inverse @ (left[:, kept].T @ right)
    spare = len(right) - int(kept.sum())
    if spare < 3:
        return value / size, np.full(len(value), np.inf)
    residual = right - matrix / size @ value
    u = np.sqrt(residual @ residual / spare * np.sum(inverse**2, axis=1))
    u[np.sum(directions[~kept] ** 2, axis=0) > 1e-6] = np.inf
    return value / size, u / size


def turning_coordinate(points: Array, base_point: Array) -> str:
    """The coordinate that changes most while a base point (3,) [m] turns about the one line of points (n, 3) [m].

    Return: "x", "y" or "z"; empty where the points are not on one line.
    """
    span = Span.of(points)
    if span.rank != 1:
        return ""
    return "xyz"[int(np.abs(np.cross(span.axes[0], base_point - span.centre)).argmax())]


def unseen(points: Array) -> tuple[str, ...]:
    """What no reading on target points (n, 3) [m] can show of a base point, in words; empty where all is seen.

    Raises InputError where all points stand at one position.
    """
    span = Span.of(points)
    if span.rank == 3:
        return ()
    if span.rank == 1:
        return (f"All target points lie on one line along {_direction(span.axes[0])}: the readings show where along it "
                "the base point lies and how far off it, but not in which direction; turning the base point about that "
                "line changes no reading. A second line that is not parallel to the first shows it.",)
    normal = span.blank[0]
    level = float(span.centre @ normal)
    axis = _axis(normal)
    plane = f"{axis} = {_millimetres(level)}" if axis else f"with normal {_direction(normal)}"
    sign = f"the sign of {axis} is" if axis and abs(level) < 1e-9 else "the side of the plane is"
    return (f"All target points lie in the plane {plane}: the mirror image of the base point in that plane gives the "
            f"same readings, so {sign} not observable. The start value chooses the side; a target point off the plane, "
            "or knowing on which side the tracker stands, decides.",)


def _axis(direction: Array) -> str:
    found = int(np.abs(direction).argmax())
    return "xyz"[found] if abs(direction[found]) > 1 - 1e-9 else ""


def _direction(direction: Array) -> str:
    return _axis(direction) or "(" + ", ".join(f"{c:.4f}" for c in direction) + ")"


def _millimetres(value: float) -> str:
    text = f"{1e3 * value:.4f}".rstrip("0").rstrip(".")
    return "0" if text in ("0", "-0") else f"{text} mm"
