"""The mechanism of the paper as its tables give it: frames, poses, strokes.

Source: Li Chen, Fang Qiang, Li Jiangxiong 2010, tables 2, 3 and 5. The balls in the part (r_i) are not tabulated; in
the initial pose the part is level and all strokes are zero, so r_i is the ball centre of table 5 less the initial
position.
"""

from __future__ import annotations

import tomllib

import numpy as np

from calib import Observations, Problem, Shared, predict
from calib.geometry import Transform
from calib.table import DATA, shipped
from problems.locators.errors import AXES, SHIFTS, TURNS, Frames
from problems.locators.kinematics import axis_reading, pose
from problems.locators.measured import Locator, Setup

LOCATORS = ("A", "B", "C")
DRIVEN = {"A": ("x", "y", "z"), "B": ("y", "z"), "C": ("z",)}      # the paper's choice of six, eq 48-51


def part_poses() -> dict[str, Transform]:
    """hall_from_part of the initial and the target pose, table 2."""
    table = shipped("locators/table2_poses.csv")
    position = np.column_stack([table.number(f"{axis}_p", "length") for axis in AXES])
    angles = np.column_stack([table.number(name, "angle") for name in ("alpha", "beta", "gamma")])
    return {str(name): pose(p, *a) for name, p, a in zip(table.text("pose"), position, angles, strict=True)}


def setup() -> Setup:
    """The three locators of table 5 and the balls of the part."""
    table = shipped("locators/table5_frames.csv")
    start = part_poses()["initial"]
    locators = []
    for key in LOCATORS:
        frames = Frames(*table.number(key, "length").reshape(4, 3))
        locators.append(Locator(key, frames, start.inverse() @ frames.base))
    return Setup(tuple(locators))


def strokes(mechanism: Setup, part_pose: Transform) -> np.ndarray:
    """Travel (3, 3) [m] of every locator (rows) and axis that brings the part into a pose, without errors (eq 1-2).

    mechanism: locators and balls; part_pose: hall_from_part.
    """
    from calib import Pose
    where = Pose("part", part_pose.rotation, part_pose.translation, "mm", "arcsec")
    rows = [Observations(axis_reading, where, Shared(locator.ball_in_part), Shared(locator.frames.matrix),
                         Shared(np.zeros(3)), Shared(np.ones(3)), Shared(np.zeros(3)), Shared(np.zeros(len(SHIFTS))),
                         Shared(np.zeros(len(TURNS))), u=1.0, group=locator.key) for locator in mechanism.locators]
    predicted = predict(Problem(rows, name="inverse kinematics"))
    return np.array([predicted[locator.key][0] for locator in mechanism.locators])


def tolerances() -> dict[str, float]:
    """The accuracy indices of table 4 [m], by their short names; the lengths they refer to are printed nowhere."""
    with (DATA / "locators" / "table4_accuracy.toml").open("rb") as stream:
        return {entry["id"]: entry["value_mm"] * 1e-3 for entry in tomllib.load(stream)["index"]}
