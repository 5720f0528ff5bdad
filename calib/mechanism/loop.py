"""Closed loops: chains that meet, as constraints on joint positions, and legs of a parallel mechanism."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from casadi import vertcat
from numpy.typing import ArrayLike

from calib import geometry
from calib.effect import direct, hands_slots_to, slots_of
from calib.errors import InputError
from calib.mechanism.chain import Mechanism
from calib.observations import Constraint, Shared


def meeting(first: Callable[..., Any], second: Callable[..., Any]) -> Callable[..., Any]:
    """Model `(positions, point_on_first, point_on_second) -> (3,)` [m]: how far apart two points of two branches are.

    first, second: pose models of one mechanism (`mechanism.pose(frame)`). Zero where a ball joint joins them.
    """
    own = {id(pose): set(slots_of(pose)) for pose in (first, second)}

    @hands_slots_to(first, second)
    def model(positions: Any, point_on_first: Any, point_on_second: Any, **slots: Any) -> Any:
        ends = [pose(positions, **{k: v for k, v in slots.items() if k in own[id(pose)]}) for pose in (first, second)]
        return ends[0] @ point_on_first - ends[1] @ point_on_second
    return model


@lru_cache(maxsize=256)
def held_by(pose: Callable[..., Any]) -> Callable[..., Any]:
    """Model `(body, point_on_body, positions, point_on_frame) -> (3,)` [m]: how far a point of a free body is from one
    of a branch, in base coordinates.

    pose: of a frame of the branch (`mechanism.pose(frame)`); body: Transform base_from_body. Zero where a ball joint
    joins them: as a Constraint it closes the loop exactly, as Observations with the uncertainty of the seat.
    """
    @hands_slots_to(pose)
    def model(body: Any, point_on_body: Any, positions: Any, point_on_frame: Any, **slots: Any) -> Any:
        return body @ point_on_body - pose(positions, **slots) @ point_on_frame
    return model


def hinge(first: Callable[..., Any], second: Callable[..., Any]) -> Callable[..., Any]:
    """Model `(positions, point_on_first, point_on_second, axis_on_first, axis_on_second) -> (5,)`: miss of a hinge,
    three distances along the base axes [m] and two cosines of the second axis with directions across the first."""
    together = meeting(first, second)

    def model(positions: Any, point_on_first: Any, point_on_second: Any, axis_on_first: Any,
              axis_on_second: Any) -> Any:
        one, other = first(positions).turn(axis_on_first), second(positions).turn(axis_on_second)
        side = geometry.cross(one, other)
        return vertcat(together(positions, point_on_first, point_on_second), side[0], side[1])
    return model


def closed(name: str, mechanism: Mechanism, first: str, second: str, positions: Any, point_on_first: ArrayLike,
           point_on_second: ArrayLike, tolerance: float = 1e-9) -> Constraint:
    """The constraint that a point of one frame is a point of another, for every row of positions.

    first, second: frames of the mechanism; positions: an unknown (`u.each` for a row each), whose passive axes the
    constraint finds; points: (3,) in their frames; tolerance: by which it may be missed [m].
    """
    return Constraint(name, meeting(mechanism.pose(first), mechanism.pose(second)), positions, Shared(point_on_first),
                      Shared(point_on_second), tolerance=tolerance, unit="mm")


def check_closed(mechanism: Mechanism, first: str, second: str, positions: ArrayLike, point_on_first: ArrayLike,
                 point_on_second: ArrayLike, tolerance: float, where: str = "") -> None:
    """Look whether recorded positions close a loop nominally.

    positions: (n, axes); tolerance: largest gap [m] that errors of manufacture may explain.
    Raises InputError naming row and gap where it is not closed.
    """
    rows = np.asarray(positions, float)
    (r1, t1), (r2, t2) = mechanism.poses(first, rows), mechanism.poses(second, rows)
    gap = np.linalg.norm(r1 @ np.asarray(point_on_first, float) + t1 - r2 @ np.asarray(point_on_second, float) - t2,
                         axis=1)
    refuse_open(gap[:, None], [f"of '{first}' and '{second}'"], tolerance, where)


def refuse_open(gaps: ArrayLike, loops: Sequence[str], tolerance: float, where: str = "",
                rows: ArrayLike | None = None) -> None:
    """Raise InputError, with row and gap, where loops do not close within what errors of manufacture may explain.

    gaps: (n, k) by which k loops miss in n rows, by the nominal geometry [m]; loops: what each of them is, for the
    message; tolerance: [m]; where: the file, rows: (n,) numbers in it.
    """
    size = np.abs(np.asarray(gaps, float))
    row, loop = divmod(int(np.argmax(size)), size.shape[1])
    if size[row, loop] > tolerance:
        number = row + 1 if rows is None else np.asarray(rows)[row]
        beyond = int(np.sum(size.max(axis=1) > tolerance))
        raise InputError(f"{where + ': ' if where else ''}the loop {loops[loop]} is not closed: in row {number} the "
                         f"two ends are {size[row, loop] * 1e3:.3g} mm apart, {beyond} of {len(size)} rows are beyond "
                         f"{tolerance * 1e3:.3g} mm; check signs, units and zeros of the positions, or the points.")


def leg_length(platform: Any, base_point: Any, platform_point: Any, offset: Any, *, leg: Any = direct) -> Any:
    """Reading of a leg of a parallel mechanism: the distance of its two joints less an offset [m].

    platform: Transform base_from_platform; base_point, platform_point: (3,) centres of the joints; offset: of the leg
    [m]. Slot `leg`: the length; effects there may ask for `length`.
    """
    length = geometry.norm(platform @ platform_point - base_point)
    return leg(length, length=length) - offset
