"""A look at positions and poses before they are used: limits, degrees for radians, joints that never move,
quaternions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import InputError
from calib.mechanism.axis import Array
from calib.units import degree

UNLIKE = 0.02       # of the extent of the points: more than errors of manufacture


def checked_positions(mechanism: Any, positions: ArrayLike, rows: ArrayLike | None = None, where: str = "",
                      slack: float = 1e-3) -> Array:
    """Positions (n, axes) after a look at them.

    mechanism; positions: (n, axes) [rad or m]; rows: (n,) numbers in the data file; where: the file, for messages;
    slack: how far a limit may be passed [rad or m] (a recorded position is noisy).
    Raises InputError for a wrong number of columns, values that are not finite or outside limits (with a word where
    degrees seem to be given as radians), and positions in which at most one axis of several ever moves.
    """
    values = np.asarray(positions, float)
    axes, start = mechanism.axes, f"{where}: " if where else ""
    if values.ndim != 2 or values.shape[1] != len(axes):
        found = values.shape[1] if values.ndim == 2 else values.ndim
        raise InputError(f"{start}positions have {found} columns, '{mechanism.name}' has {len(axes)} axes "
                         f"({', '.join(a.name for a in axes)}); give one column for each, in this order.")
    numbers = np.arange(1, len(values) + 1) if rows is None else np.asarray(rows)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        raise InputError(f"{start}row {numbers[bad[0][0]]}: the position of '{axes[bad[0][1]].name}' is no number; "
                         "mend or leave out that row.")
    _within_limits(axes, values, numbers, start, slack)
    moving = np.flatnonzero(np.ptp(values, axis=0) > 1e-6)
    if len(values) > 1 and len(axes) > 1 and len(moving) < 2:
        one = f"only '{axes[moving[0]].name}' moves" if len(moving) else "no axis moves"
        raise InputError(f"{start}{one} in all {len(values)} poses, so that the other axes stay unknown; add poses in "
                         "which each axis moves.")
    return values


def _within_limits(axes: Any, values: Array, numbers: NDArray, start: str, slack: float) -> None:
    for j, axis in enumerate(axes):
        lower, upper = axis.limits
        outside = np.flatnonzero((values[:, j] < lower - slack) | (values[:, j] > upper + slack))
        if not len(outside):
            continue
        worst = values[outside[np.argmax(np.abs(values[outside, j]))], j]
        # what a unit that was forgotten would make of it: (factor, least size, its name)
        factor, least, forgotten = (degree, 7.0, "degrees given as radians") if axis.is_rotary else (
            1e-3, 10.0, "millimetres given as metres")
        smaller = values[:, j] * factor
        if abs(worst) > least and np.all((smaller > lower - slack) & (smaller < upper + slack)):
            raise InputError(f"{start}axis '{axis.name}' goes to {worst:.4g} {axis.unit}, beyond its limits "
                             f"{lower:.4g} .. {upper:.4g} {axis.unit}; divided by {1 / factor:.4g} all values are "
                             f"within: these are {forgotten}. Say the unit (in the header of the column, or positions "
                             "= \"deg\" for joint files), or convert them.")
        raise InputError(f"{start}row {numbers[outside[0]]}: axis '{axis.name}' is at {values[outside[0], j]:.5g} "
                         f"{axis.unit}, outside "
                         f"its limits {lower:.5g} .. {upper:.5g} ({len(outside)} of {len(values)} rows are); check "
                         "the order and the unit of the columns, or widen the limits.")


def unlike_the_mechanism(mechanism: Any, frame: str, positions: ArrayLike, names: Any, points: ArrayLike, where: str
                         ) -> None:
    """Raise InputError where measured points miss the nominal mechanism by more than errors of manufacture do.

    Arguments as of `calib.mechanism.start.place_of_points`; where: the file. What would mend it is looked for and
    named: degrees given as radians, an axis that turns or moves the other way.
    """
    from calib.mechanism.start import misfit_of_points
    values, measured = np.asarray(positions, float), np.asarray(points, float)
    enough = UNLIKE * float(np.sqrt(np.mean(np.sum((measured - measured.mean(axis=0)) ** 2, axis=1))))
    found = misfit_of_points(mechanism, frame, values, names, measured)
    if found < enough:
        return
    rotary = np.array([axis.is_rotary for axis in mechanism.axes])
    tries = [("the angles are degrees given as radians", np.where(rotary, values * degree, values))]
    for i, axis in enumerate(mechanism.axes):
        only = np.arange(len(rotary)) == i
        tries.append((f"the axis '{axis.name}' counts the other way", values * np.where(only, -1.0, 1.0)))
        if axis.is_rotary:
            said = f"the angles of '{axis.name}' are degrees given as radians"
            tries.append((said, values * np.where(only, degree, 1.0)))
    said, best = min(((words, misfit_of_points(mechanism, frame, tried, names, measured))
                      for words, tried in tries), key=lambda item: item[1])
    cure = (f"it would be {best * 1e3:.3g} mm if {said}. Correct that." if best < 0.2 * found else
            "check signs, order and units of the columns, and the names of the points.")
    raise InputError(f"{where}: the points miss the mechanism as it is designed by {found * 1e3:.3g} mm (rms); {cure}")


def other_quaternion_order(misfit: float, misfit_of_other: float, where: str) -> None:
    """Raise InputError where poses fit the mechanism only with quaternions read in the other order.

    misfit, misfit_of_other: rms angle [rad] by which the poses miss the mechanism with the order as given and with the
    other one; where: the file.
    """
    if misfit > 5 * degree and misfit_of_other < 0.2 * misfit:
        raise InputError(f"{where}: the orientations miss the mechanism by {misfit / degree:.0f} degrees, with the "
                         "scalar at the "
                         f"other end of the quaternion by {misfit_of_other / degree:.1f}: the quaternions are in the "
                         "other order. Name the columns qw, qx, qy, qz, or set quaternions = \"xyzw\" or \"wxyz\".")
