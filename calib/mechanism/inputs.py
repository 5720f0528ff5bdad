"""A look at positions and poses before they are used: limits, degrees for radians, joints that never move,
quaternions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import InputError
from calib.mechanism.axis import Array
from calib.units import degree


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
        radians = values[:, j] * degree
        if axis.is_rotary and abs(worst) > 7.0 and np.all((radians > lower - slack) & (radians < upper + slack)):
            raise InputError(f"{start}axis '{axis.name}' goes to {worst:.4g} rad, beyond its limits {lower:.4g} .. "
                             f"{upper:.4g} rad; "
                             f"divided by 57.3 all values are within: these are degrees given as radians. Say the unit "
                             "(positions = \"deg\"), or convert them.")
        raise InputError(f"{start}row {numbers[outside[0]]}: axis '{axis.name}' is at {values[outside[0], j]:.5g} "
                         f"{axis.unit}, outside "
                         f"its limits {lower:.5g} .. {upper:.5g} ({len(outside)} of {len(values)} rows are); check "
                         "the order and the unit of the columns, or widen the limits.")


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
