"""Tables of Denavit and Hartenberg, modified and with Hayati's angle for parallel axes: read into a mechanism and back.

standard:  frame i = frame i-1 . Rz(theta) Tz(d) Tx(a) Rx(alpha)            (Denavit and Hartenberg 1955)
modified:  frame i = frame i-1 . Rx(alpha) Tx(a) Rz(theta) Tz(d)            (Craig 1986; alpha, a of the link before)
Hayati:    frame i = frame i-1 . Rz(theta) Tx(a) Rx(alpha) Ry(beta)         (Hayati 1983, for nearly parallel axes: no
d)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib import geometry
from calib.errors import DeclarationError, InputError
from calib.geometry import Transform
from calib.mechanism.axis import Array, Axis, Frame, Linear, Rotary
from calib.mechanism.chain import Mechanism

# rad: below it the common perpendicular of two axes is worse known than where they are (d ~ offset/angle)
PARALLEL = 0.02


@dataclass(frozen=True)
class Row:
    """One axis of a table.

    name; theta, alpha: [rad], d, a: [m] (theta or d is the value at position zero); beta: Hayati's angle [rad], None
    where the row is a plain one; is_rotary; limits [rad or m].
    """

    name: str
    theta: float
    d: float
    a: float
    alpha: float
    beta: float | None = None
    is_rotary: bool = True
    limits: tuple[float, float] = (-np.inf, np.inf)


@dataclass(frozen=True)
class Table:
    """Rows from the base to the tip with base_from_first (before the first row) and last_from_tip (after the last)."""

    rows: tuple[Row, ...]
    base: Transform
    tip: Transform


def _motion(turn: Array, shift: Sequence[float]) -> Transform:
    return Transform(np.asarray(turn, float), np.asarray(shift, float))


def _about_z(theta: float, d: float) -> Transform:
    return _motion(geometry.rotation_z(theta), (0, 0, d))


def _about_x(alpha: float, a: float) -> Transform:
    return _motion(geometry.rotation_x(alpha), (a, 0, 0))


def from_standard(name: str, rows: Sequence[Row], base: Transform | None = None,
                  tip: Transform | None = None) -> Mechanism:
    """The mechanism of a standard table (rows with beta are Hayati's); its last frame is `tip`.

    base: base_from_first; tip: last_from_tip. Raises DeclarationError for a table without rows.
    """
    here = base or Transform.identity()
    axes: list[Any] = []
    for row in rows:
        axes.append(_axis(row, here, axes))
        if row.beta is None:
            here = here @ _about_z(row.theta, row.d) @ _about_x(row.alpha, row.a)
        else:
            here = (here @ _about_z(row.theta, 0.0) @ _about_x(row.alpha, row.a)
                    @ _motion(geometry.rotation_y(row.beta), (0, 0, 0)))
    return _closed(name, axes, here @ (tip or Transform.identity()))


def from_modified(name: str, rows: Sequence[Row], base: Transform | None = None,
                  tip: Transform | None = None) -> Mechanism:
    """The mechanism of a modified table; its last frame is `tip`. Arguments as of `from_standard`."""
    here = base or Transform.identity()
    axes: list[Any] = []
    for row in rows:
        here = here @ _about_x(row.alpha, row.a)
        axes.append(_axis(row, here, axes))
        here = here @ _about_z(row.theta, row.d)
    return _closed(name, axes, here @ (tip or Transform.identity()))


def _axis(row: Row, here: Transform, axes: Sequence[Axis]) -> Axis:
    kind = Rotary if row.is_rotary else Linear
    return kind(row.name, here.rotation[:, 2], here.translation, axes[-1].name if axes else None, row.limits,
                here.rotation)


def _closed(name: str, axes: Sequence[Axis], tip: Transform) -> Mechanism:
    if not axes:
        raise DeclarationError(f"the table of '{name}' has no rows; give one for each axis.")
    return Mechanism(name, axes, [Frame("tip", tip.translation, tip.rotation, axes[-1].name)])


def standard(mechanism: Mechanism, frame: str = "tip") -> Table:
    """The standard table of the axes between base and frame; where two axes are nearly parallel the row is Hayati's.

    Its base and tip transforms hold what four parameters a row cannot. Raises InputError where it cannot (an axis
    nearly perpendicular to its parallel-type predecessor cannot happen; a linear axis nearly parallel to the next has
    no place).
    """
    path = mechanism.path(frame)
    if not path:
        raise InputError(f"frame '{frame}' is carried by no axis; name a frame behind the axes.")
    start = _first_frame(path)
    here, rows = start, []
    for axis, following in zip(path, [*path[1:], None], strict=True):
        row, here = (_last(axis, here) if following is None else _between(axis, following, here))
        rows.append(row)
    return Table(tuple(rows), start, here.inverse() @ mechanism.frame(frame).home)


def modified(mechanism: Mechanism, frame: str = "tip") -> Table:
    """The modified table of the axes between base and frame; exact for any geometry, however nearly parallel.

    Raises InputError where two neighbouring axes are so nearly parallel, yet not parallel, that `d` exceeds a
    kilometre: use `standard`, which writes Hayati's row there.
    """
    path = mechanism.path(frame)
    if not path:
        raise InputError(f"frame '{frame}' is carried by no axis; name a frame behind the axes.")
    start = _first_frame(path)
    here, rows, alpha, a = start, [], 0.0, 0.0
    for axis, following in zip(path, [*path[1:], None], strict=True):
        row, after = _last(axis, here) if following is None else _between(axis, following, here, hayati=False)
        rows.append(Row(row.name, row.theta, row.d, a, alpha, None, row.is_rotary, row.limits))
        alpha, a = row.alpha, row.a
        here = after
    return Table(tuple(rows), start, here.inverse() @ mechanism.frame(frame).home)


def _first_frame(path: Sequence[Axis]) -> Transform:
    """A frame with z along the first axis at its point: the columns of its reference, turned so that z is the axis."""
    first = path[0]
    reference, z = np.asarray(first.reference), np.asarray(first.direction)
    x = reference[:, (first.along + 1) % 3]
    return Transform(np.stack([x, np.cross(z, x), z], axis=1), np.asarray(first.through))


def _between(axis: Axis, following: Axis, here: Transform, hayati: bool = True) -> tuple[Row, Transform]:
    """The row from an axis, whose frame is `here` (z along it), to the following one, and the frame of that."""
    local = here.inverse()
    direction, point = local.turn(np.asarray(following.direction)), local @ np.asarray(following.through)
    sine = float(np.hypot(direction[0], direction[1]))
    if hayati and sine < PARALLEL:
        return _hayati(axis, direction, point, here)
    if sine < 1e-9:
        theta, d = float(np.arctan2(point[1], point[0])) if np.hypot(*point[:2]) > 1e-12 else 0.0, 0.0
        a, alpha = float(np.hypot(point[0], point[1])), 0.0 if direction[2] > 0 else np.pi
    else:
        # x along the common perpendicular; of its two senses the one nearer to the present x
        across = np.array([-direction[1], direction[0]]) / sine
        across = across if across[0] > -1e-9 else -across
        foot, _ = geometry.common_perpendicular(np.zeros(3), np.array([0.0, 0.0, 1.0]), point, direction)
        theta, d = float(np.arctan2(across[1], across[0])), float(foot[2])
        a = float(across @ (point[:2] - direction[:2] * (direction[:2] @ point[:2]) / sine ** 2))
        alpha = float(np.arctan2(across[0] * direction[1] * -1.0 + across[1] * direction[0], direction[2]))
        if abs(d) > 1e3:
            raise InputError(f"the axes '{axis.name}' and '{following.name}' are parallel to {sine:.1e} rad, and "
                             "their common "
                             f"perpendicular lies {d:.3g} m away; use `standard`, which writes Hayati's row there.")
    row = Row(axis.name, theta, d, a, alpha, None, axis.is_rotary, axis.limits)
    return row, here @ _about_z(theta, d) @ _about_x(alpha, a)


def _hayati(axis: Axis, direction: Array, point: Array, here: Transform) -> tuple[Row, Transform]:
    """Rz(theta) Tx(a) Rx(alpha) Ry(beta): x points to where the following axis meets the plane z = 0."""
    meets = point - direction * (point[2] / direction[2])
    theta = float(np.arctan2(meets[1], meets[0])) if np.hypot(meets[0], meets[1]) > 1e-12 else 0.0
    turned = geometry.rotation_z(-theta) @ direction
    # Rx(alpha) Ry(beta) z = (sin beta, -sin alpha cos beta, cos alpha cos beta)
    beta = float(np.arctan2(turned[0], np.hypot(turned[1], turned[2])))
    alpha = float(np.arctan2(-turned[1], turned[2]))
    a = float(np.hypot(meets[0], meets[1]))
    row = Row(axis.name, theta, 0.0, a, alpha, beta, axis.is_rotary, axis.limits)
    return row, (here @ _about_z(theta, 0.0) @ _about_x(alpha, a) @ _motion(geometry.rotation_y(beta), (0, 0, 0)))


def _last(axis: Axis, here: Transform) -> tuple[Row, Transform]:
    """The last row is empty: what follows the last axis stands in the transform of the tip."""
    return Row(axis.name, 0.0, 0.0, 0.0, 0.0, None, axis.is_rotary, axis.limits), here
