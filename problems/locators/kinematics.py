"""Models of a part on three 3-axis locators: what an axis reads and what a tracker reads on a target of the part.

One model serves the paper and the measured cases: lever arms are data (`Frames`), errors are slots.
Source: Li Chen, Fang Qiang, Li Jiangxiong 2010, eq 1, 2, 14-16.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib import direct, hands_slots_to
from calib.geometry import Transform, rotation_from_rpy
from instruments import laser_tracker
from problems.locators.errors import AXES, BODY_OF, SHIFTS, TURNS, Frames, ball_centre


def motion_errors(travel: Any, half_range: Any, approach: Any, shifts: Any, turns: Any, reach: Any, **slots: Any
                  ) -> dict[str, Any]:
    """The errors of one locator at one travel, each through the slot of its own name.

    travel, half_range, approach: (3,) [m, m, +1 or -1]; shifts: (12,) [m]; turns: (12,) [rad]; reach: of the ball along
    y [m]. The slot of an error of body b hands on the travel of b (`along` [m]), its share of the half range
    (`fraction`) and the `direction` it was approached from; every slot hands on the reach.
    """
    constants = [*((name, shifts[i]) for i, name in enumerate(SHIFTS)), *((name, turns[i]) for i,
                                                                          name in enumerate(TURNS))]
    through = {}
    for name, value in constants:
        quantities = {"reach": reach}
        if name in BODY_OF:
            i = AXES.index(BODY_OF[name])
            quantities |= {"along": travel[i], "fraction": travel[i] / half_range[i], "direction": approach[i]}
        through[name] = slots.get(name, direct)(value, **quantities)
    return through


# 24 slots of one kind: written out they would say less than table 1.
motion_errors.__signature__ = inspect.signature(motion_errors).replace(parameters=[      # type: ignore[attr-defined]
    *list(inspect.signature(motion_errors).parameters.values())[:-1],
    *(inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=direct) for name in (*SHIFTS, *TURNS))])


@hands_slots_to(motion_errors)
def axis_reading(part_pose: Transform, ball_in_part: Any, frames: Any, travel: Any, half_range: Any, approach: Any,
                 shifts: Any, turns: Any, *, ball_point: Any = direct, **slots: Any) -> Any:
    """The three axis readings (3,) [m] of a locator that holds a ball of the part (eq 16).

    part_pose: hall_from_part; ball_in_part: (3,) [m], r_i; frames: (4, 3) [m]; travel: (3,) [m], where the errors are
    taken (the recorded readings); half_range: (3,) [m]; approach: (3,), +1 or -1; shifts: (12,) [m] and turns: (12,)
    [rad], errors that do not depend on the travel. Slots: the names of SHIFTS and TURNS, and `ball_point` ((3,) [m] in
    the hall, which hands on `nominal`, the same point without errors).
    """
    lever = Frames.of_matrix(frames)
    nominal = lever.base + travel
    error = motion_errors(travel, half_range, approach, shifts, turns, lever.reach + travel[1], **slots)
    actual = ball_point(ball_centre(travel, error, lever), nominal=nominal)
    return part_pose @ ball_in_part - lever.base - (actual - nominal)


@lru_cache
def readings_of(axes: tuple[str, ...]) -> Callable[..., Any]:
    """The model of a locator of which only some axes are driven or read.

    axes: one to three of "x", "y", "z". Returns a model like `axis_reading` with one component for each of them.
    """
    if axes == AXES:
        return axis_reading
    chosen = [AXES.index(axis) for axis in axes]

    @hands_slots_to(axis_reading)
    def axis_readings(part_pose: Transform, ball_in_part: Any, frames: Any, travel: Any, half_range: Any, approach: Any,
                      shifts: Any, turns: Any, **slots: Any) -> Any:
        return axis_reading(part_pose, ball_in_part, frames, travel, half_range, approach, shifts, turns,
                            **slots)[chosen]
    return axis_readings


@hands_slots_to(laser_tracker.polar_from_station)
def target_reading(part_pose: Transform, tracker_from_hall: Transform, target_in_part: Any, **slots: Any) -> Any:
    """Range, azimuth and zenith angle (3,) [m, rad, rad] of a target of the part; slots are those of the tracker.

    part_pose: hall_from_part; tracker_from_hall: frame of the tracker; target_in_part: (3,) [m].
    """
    return laser_tracker.polar_from_station(tracker_from_hall, part_pose @ target_in_part, **slots)


def pose(position: ArrayLike, alpha: float, beta: float, gamma: float) -> Transform:
    """hall_from_part of a position (3,) [m] and angles [rad] about the fixed axes x, then y, then z (eq 1)."""
    return Transform(rotation_from_rpy(alpha, beta, gamma), np.asarray(position, dtype=float))
