"""Start values of a base point by linear least squares, the counting sense, and what the target points cannot show.

With |P - B| = L + sense d, squaring gives d^2 - |P|^2 = -2 P.B - 2 (sense L) d + (|B|^2 - L^2), linear in B, sense L
and the last bracket. A length is positive, so the sign of `sense L` is the counting sense of the instrument.
"""

from __future__ import annotations

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


@dataclass(frozen=True)
class Squares:
    """The linear fit: components of B in the span, the brackets |B|^2 - L^2, and sense L of each zeroing with its u."""

    span: Span
    inside: Array
    brackets: Array
    signed: Array
    u_signed: Array

    @staticmethod
    def of(points: Array, readings: Array, zeroing: NDArray, absolute: bool) -> Squares:
        """The fit to readings (n,) [m] on points (n, 3) [m] in zeroings (n,) 0 to m - 1."""
        span, count = Span.of(points), int(zeroing.max()) + 1
        offset, groups = points - span.centre, np.eye(count)[zeroing]
        columns = [-2.0 * offset @ span.axes.T, groups] + ([] if absolute else [-2.0 * readings[:, None] * groups])
        matrix = np.hstack(columns)
        size = np.linalg.norm(matrix, axis=0)
        size[size == 0.0] = 1.0
        value, u = _least_squares(matrix / size, readings**2 - np.sum(offset**2, axis=1))
        value, u = value / size, u / size
        inside, brackets, signed = np.split(value, [span.rank, span.rank + count])
        nothing = np.zeros(count)
        return Squares(span, inside, brackets, *((nothing, nothing) if absolute else (signed, u[span.rank + count:])))

    @property
    def sense(self) -> Array:
        """The counting sense of each zeroing (m,): +1 or -1 where it is beyond doubt, else 0."""
        return np.where(np.abs(self.signed) > 6.0 * self.u_signed, np.sign(self.signed), 0.0)

    def base_point(self) -> Array:
        """The base point (3,) [m]; where the points lie in a plane or line, on its negative side."""
        span, best = self.span, int(np.argmin(self.u_signed))     # the length that is known best gives the height
        base = span.centre + self.inside @ span.axes
        if span.rank == 3:
            return base
        square = self.brackets[best] + self.signed[best]**2 - self.inside @ self.inside
        return base - np.sqrt(max(square, (0.05 * span.extent)**2)) * span.blank[-1]


def begin(points: Array, readings: Array, zeroing: NDArray, sense: float, *, approximate: Array | None = None,
          absolute: bool = False, name: str = "tracker") -> Begin:
    """Start values of the base point of one tracker.

    points: (n, 3) [m]; readings: (n,) [m]; zeroing: (n,) 0 to m - 1; sense: +1 or -1, as declared.
    approximate: (3,) [m], taken as it is where given; absolute: the readings are whole lengths; name: for messages.
    Return: base point and lengths. Raises InputError where the readings contradict the sense or show nothing.
    """
    squares = Squares.of(points, readings, zeroing, absolute)
    if not absolute and np.any(squares.sense == -np.sign(sense)):
        wrong = int(np.flatnonzero(squares.sense == -np.sign(sense))[0])
        length, u = squares.signed[wrong] * np.sign(sense), squares.u_signed[wrong]
        is_now, should = ("lengthening", "shortening") if sense > 0 else ("shortening", "lengthening")
        raise InputError(
            f"{name}: wrong counting sense: counts = \"{is_now}\" says that the readings grow with a {is_now} path, "
            f"but then the path at the zero of the reading comes out as {1e3 * length:.3f} mm (u = {1e3 * u:.3f} mm), "
            f"and no path is shorter than nothing. The readings grow with a {should} path; set counts = \"{should}\"")
    base = squares.base_point() if approximate is None else np.asarray(approximate, float)
    distance = np.linalg.norm(points - base, axis=1) - sense * readings
    count = int(zeroing.max()) + 1
    return Begin(base, np.zeros(count) if absolute else np.array([distance[zeroing == k].mean() for k in range(count)]))


def counting_sense(points: Array, readings: Array) -> float:
    """The counting sense that readings (n,) on points (n, 3) [m] show: +1 lengthening, -1 shortening, 0 undecided."""
    return float(Squares.of(points, readings, np.zeros(len(points), int), absolute=False).sense[0])


def _least_squares(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Solution of least norm, and its standard uncertainties from the scatter (infinite where none is left over)."""
    left, sizes, directions = np.linalg.svd(matrix, full_matrices=False)
    kept = sizes > 1e-11 * sizes[0]
    inverse = directions[kept].T / sizes[kept]
    value = inverse @ (left[:, kept].T @ right)
    spare = len(right) - int(kept.sum())
    if spare < 1:
        return value, np.full(len(value), np.inf)
    residual = right - matrix @ value
    u = np.sqrt(residual @ residual / spare * np.sum(inverse**2, axis=1))
    unseen = np.sum(directions[~kept]**2, axis=0) > 1e-6
    u[unseen] = np.inf
    return value, u


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
