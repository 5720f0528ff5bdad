"""Simulated campaigns: a hall, a part, poses, and what axes and tracker would read by the declared model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib import Effect, Problem, predict, simulate, solve
from calib.files import csv_text
from calib.geometry import Transform
from calib.units import arcsec, degree, minute, mm, um
from instruments import laser_tracker
from problems.locators.errors import AXES, Frames
from problems.locators.kinematics import pose
from problems.locators.measured import Locator, Readings, Setup, declare
from problems.locators.vocabulary import TARGETS, axis_group

U_AXIS = 6 * um
U_TRACKER = (5 * um, 0.8 * arcsec, 1.0 * arcsec)
HALL = Setup(
    tuple(Locator(key, Frames.with_levers((x, y, 1.0), 0.8, 0.35), np.array([x, y, 0.0]))
          for key, x, y in (("A", 1.44, 0.0), ("B", -0.72, 0.59), ("C", -0.72, -0.59))),
    {"t1": (1.55, -0.45, 0.55), "t2": (1.2, 0.5, 0.35), "t3": (-0.3, -0.75, 0.6), "t4": (-1.0, 0.7, 0.3),
     "t5": (0.2, 0.05, 0.7)})
TRACKER = Transform(pose((0, 0, 0), 0.002, -0.001, 1.1).rotation, np.array([-3.1, 2.4, -1.8]))


@dataclass(frozen=True)
class Campaign:
    """What was measured: the setup, axis readings, target readings, and the true poses of part and tracker."""

    setup: Setup
    axes: Readings
    targets: Readings
    part: tuple[Transform, ...]
    tracker: Transform


def drawn_poses(count: int, seed: int, reach: float = 150 * mm, turn: float = 2.0 * degree) -> tuple[Transform, ...]:
    """Poses of the part, uniform within +-reach [m] about the height of 1 m and +-turn [rad] about each axis."""
    generator = np.random.default_rng(seed)
    return tuple(pose(np.array([0, 0, 1.0]) + generator.uniform(-reach, reach, 3) * (1, 1, 0.5),
                      *generator.uniform(-turn, turn, 3)) for _ in range(count))


def measure(part: Sequence[Transform], seed: int, truth: Mapping[str, ArrayLike] | None = None, *, setup: Setup = HALL,
            further: Sequence[Effect] = (), noise: bool = True, checks: int = 0) -> Campaign:
    """Readings of all axes and targets in each of the poses, from the declared model; the part floats on the locators.

    part: true hall_from_part; seed: of conditions and noise; truth: {label of an effect: parameters, SI}; setup;
    further: effects beyond the named ones that `truth` speaks of; noise: whether errors are drawn; checks: how many
    poses at the end are for checking only.
    """
    axes, targets = _nominal(setup, part, seed, checks)
    values: dict[Any, Any] = {"part": list(part), "tracker": TRACKER, **(truth or {})}
    # Errors are taken at the travel that is read, so the travel has to come first.
    for last in (False, True):
        problem = declare(setup, axes, targets, u_axis=U_AXIS, u_tracker=U_TRACKER).with_effects(*further)
        readings = _drawn(problem, values, seed) if last and noise else predict(problem, values)
        axes = replace(axes, values=_by_row(axes, setup, readings))
        targets = replace(targets, values=readings[TARGETS])
    return Campaign(setup, axes, targets, tuple(part), TRACKER)


def drive(commanded: Sequence[Transform], seed: int, truth: Mapping[str, ArrayLike], *, setup: Setup = HALL,
          further: Sequence[Effect] = (), checks: int = 0) -> Campaign:
    """All nine axes driven to the nominal travels of commanded poses, and what the tracker then reads on the part.

    Joints that give way alike let the part take the pose nearest to all nine; the axes read the travels without noise.
    Arguments as for `measure`, commanded poses in the place of true ones. The part of the campaign is where it went.
    """
    axes, targets = _nominal(setup, commanded, seed, checks)
    driven = declare(setup, axes, None, u_axis=U_AXIS).with_effects(*further)
    part = solve(driven, start=truth)["part"]
    problem = declare(setup, axes, targets, u_axis=U_AXIS, u_tracker=U_TRACKER)
    readings = _drawn(problem, {"part": list(part), "tracker": TRACKER}, seed)
    return Campaign(setup, axes, replace(targets, values=readings[TARGETS]), tuple(part), TRACKER)


def _nominal(setup: Setup, part: Sequence[Transform], seed: int, checks: int) -> tuple[Readings, Readings]:
    """Axis and target readings of poses without errors."""
    axes, targets = _conditions(setup, len(part), seed, checks)
    predicted = predict(declare(setup, axes, None, u_axis=U_AXIS), {"part": list(part)})
    points = [TRACKER @ (part[i - 1] @ np.array(setup.targets[key])) for i, key in zip(targets.pose, targets.item,
                                                                                       strict=True)]
    return (replace(axes, values=_by_row(axes, setup, predicted)),
            replace(targets, values=laser_tracker.polar_readings(np.array(points))))


def _conditions(setup: Setup, n: int, seed: int, checks: int) -> tuple[Readings, Readings]:
    """Axis and target readings of n poses, all zero yet, with time, temperature, blocks and directions of approach."""
    generator = np.random.default_rng([seed, 1])
    temperature = np.cumsum(generator.normal(0.0, 0.2, n))
    start = 5 * minute * np.arange(n)
    split = np.where(np.arange(n) < n - checks, "fit", "check")
    block = 1 + (np.arange(n) >= n // 2)
    approach = generator.choice([-1.0, 1.0], (n, 3))
    keys, names = [locator.key for locator in setup.locators], list(setup.targets)
    per_pose = len(keys) + len(names)

    def kind(items: Sequence[str], first_row: int, later: np.ndarray, approached: bool) -> Readings:
        index = np.repeat(np.arange(n), len(items))
        rows = 1 + first_row + per_pose * index + np.tile(np.arange(len(items)), n)
        return Readings(1 + index, np.tile(items, n), np.zeros((len(index), 3)), approach[index] * approached,
                        start[index] + np.tile(later, n), temperature[index], block[index], rows, split[index])
    return (kind(keys, 0, np.zeros(len(keys)), True),
            kind(names, len(keys), 15.0 * np.arange(1, len(names) + 1), False))


def _drawn(problem: Problem, values: Mapping[Any, Any], seed: int) -> dict[str, Any]:
    return {o.group: o.readings for o in simulate(problem, values, seed).observations}


def _by_row(axes: Readings, setup: Setup, readings: Mapping[str, np.ndarray]) -> np.ndarray:
    values = np.zeros((len(axes.rows), len(AXES)))
    for locator in setup.locators:
        values[axes.item == locator.key] = readings[axis_group(locator.key)]
    return values


def job_files(seed: int, count: int = 12, truth: Mapping[str, ArrayLike] | None = None) -> dict[str, str]:
    """A job with simulated readings, as texts of its files.

    seed: of poses and noise; count: of poses, the last quarter of them for checking; truth: effects that are present,
    locator A out of square by 60 arcseconds where nothing is said. Returns {file name: text}.
    """
    campaign = measure(drawn_poses(count, seed), seed, truth or {"squareness (A.xy)": 60 * arcsec}, checks=count // 4)
    return {"job.toml": _job_text(campaign.setup), "measurements.csv": _measurements_text(campaign, seed)}


def _job_text(setup: Setup) -> str:
    def vector(values: Any) -> str:
        return "[" + ", ".join(f"{value / mm:.4f}" for value in values) + "]"
    frames = setup.locators[0].frames
    half = [f"{axis} = {length / mm:.1f}" for axis, length in zip(AXES, setup.half_range, strict=True)]
    lines = ['problem = "problems.locators"', "", "[data.measurements]", 'file = "measurements.csv"', "",
             "[instruments.locator]", f"sigma_axis_um = {U_AXIS / um:g}", "", "[instruments.tracker]",
             f"sigma_range_um = {U_TRACKER[0] / um:g}", f"sigma_azimuth_arcsec = {U_TRACKER[1] / arcsec:g}",
             f"sigma_zenith_arcsec = {U_TRACKER[2] / arcsec:g}", "", "[known]", "reference_temperature_C = 20.0",
             f"abbe_height_mm = {frames.abbe_height / mm:.4f}", f"reach_at_zero_mm = {frames.reach / mm:.4f}", "",
             "[known.axis_half_range_mm]", *half]
    for locator in setup.locators:
        lines += ["", "[[known.locators]]", f'id = "{locator.key}"', f"base_mm = {vector(locator.frames.base)}",
                  f"ball_in_part_mm = {vector(locator.ball_in_part)}"]
    for key, point in setup.targets.items():
        lines += ["", "[[known.targets]]", f'id = "{key}"', f"in_part_mm = {vector(point)}"]
    return "\n".join(lines) + "\n"


def _measurements_text(campaign: Campaign, seed: int) -> str:
    coordinates = laser_tracker.cartesian_readings(campaign.targets.values)
    rows = []
    for kind, readings, values in (("axis", campaign.axes, campaign.axes.values),
                                   ("target", campaign.targets, coordinates)):
        for i, row in enumerate(readings.rows):
            rows.append([int(row), readings.split[i], int(readings.pose[i]), int(readings.block[i]),
                         f"{readings.time[i] / minute:.4f}", f"{20.0 + readings.temperature_difference[i]:.3f}", kind,
                         readings.item[i], *(f"{value / mm:.5f}" for value in values[i]),
                         *(f"{direction:.0f}" for direction in readings.approach[i])])
    header = ["row", "split", "pose", "block", "time_min", "temp_C", "kind", "item", "v1_mm", "v2_mm", "v3_mm",
              "dir1", "dir2", "dir3"]
    return csv_text(header, sorted(rows), f"simulated by problems.locators, seed {seed}")
