"""A part on three locators in measured poses: axis readings, and targets of the part seen by a tracker.

Unknown: the pose of the part every time and once the frame of the tracker. What the axes do wrong enters as effects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import Observations, Pose, Problem, Quantity, Shared
from calib.errors import InputError
from calib.geometry import Transform
from calib.units import arcsec, mm, um
from instruments import laser_tracker
from problems.locators.errors import AXES, SHIFTS, TURNS, Frames
from problems.locators.kinematics import readings_of, target_reading
from problems.locators.vocabulary import TARGETS, axis_group, effects

TRACKER_UNITS = ("um", "arcsec", "arcsec")
TRACKER_COMPONENTS = ("range", "azimuth", "zenith")
FAR = 10.0           # half ranges: a reading beyond is of another unit
STRANGE = 0.05       # share of the size of the part: targets that miss by more are other targets, axes or units


@dataclass(frozen=True)
class Locator:
    """One locator: its key, its lever arms and the ball of the part (3,) [m] that it holds."""

    key: str
    frames: Frames
    ball_in_part: Any


@dataclass(frozen=True)
class Setup:
    """What is known of hall and part.

    locators; targets: {key: (3,) [m] in the part}; half_range: (3,) [m] half range of the axes; axes: {locator: axes
    that are driven or read}, all three where nothing is said.
    """

    locators: tuple[Locator, ...]
    targets: Mapping[str, Any] = field(default_factory=dict)
    half_range: Any = (0.3, 0.3, 0.2)
    axes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def axes_of(self, key: str) -> tuple[str, ...]:
        """The axes of a locator that are driven or read."""
        return tuple(self.axes.get(key, AXES if not self.axes else ()))


@dataclass(frozen=True)
class Readings:
    """Readings of one kind, n rows: pose and item of each, values (n, 3), and what may have influenced them.

    pose: (n,) keys; item: (n,) locator or target; values: (n, 3) axis readings [m] or range, azimuth, zenith [m, rad,
    rad]; approach: (n, 3), +1 or -1; time: (n,) [s]; temperature_difference: (n,) [K]; block: (n,); rows: (n,) of the
    data file; split: (n,), "fit" or "check".
    """

    pose: Any
    item: Any
    values: Any
    approach: Any
    time: Any
    temperature_difference: Any
    block: Any
    rows: Any
    split: Any

    @staticmethod
    def plain(pose: ArrayLike, item: ArrayLike, values: ArrayLike) -> Readings:
        """Readings under constant conditions: no time, temperature, block or direction of approach."""
        values = np.asarray(values, dtype=float)
        none, n = np.zeros(len(values)), len(values)
        return Readings(np.asarray(pose), np.asarray(item), values, np.zeros((n, 3)), none, none, np.ones(n, dtype=int),
                        np.arange(1, n + 1), np.full(n, "fit"))

    def where(self, chosen: NDArray[np.bool_]) -> Readings:
        """The chosen rows."""
        return Readings(*(np.asarray(getattr(self, name))[chosen] for name in self.__dataclass_fields__))

    @property
    def covariates(self) -> dict[str, Any]:
        """Influences, by the names that effects ask for."""
        return {"time": (self.time, "s"), "temperature_difference": (self.temperature_difference, "K"),
                "block": self.block, "pose": self.pose, "split": self.split}


def rigid_fit(points_in_b: ArrayLike, points_in_a: ArrayLike) -> Transform:
    """The transform a_from_b that takes points (n, 3) nearest to points (n, 3): a start value. Source: Kabsch 1976."""
    b, a = np.asarray(points_in_b, dtype=float), np.asarray(points_in_a, dtype=float)
    left, _, right = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return Transform(turn, a.mean(0) - turn @ b.mean(0))


def start_poses(setup: Setup, axes: Readings, poses: Sequence[Any]) -> list[Transform]:
    """Approximate hall_from_part of every pose, from the axis readings; an axis that is not read counts as zero."""
    result = []
    for pose in poses:
        hall, part = [], []
        for locator in setup.locators:
            row = np.flatnonzero((axes.pose == pose) & (axes.item == locator.key))
            travel = axes.values[row[0]] if len(row) else np.zeros(3)
            read = np.array([axis in setup.axes_of(locator.key) for axis in AXES])
            hall.append(locator.frames.base + np.where(read, travel, 0.0))
            part.append(locator.ball_in_part)
        result.append(rigid_fit(np.array(part), np.array(hall)))
    return result


def declare(setup: Setup, axes: Readings, targets: Readings | None = None, *, u_axis: ArrayLike = 6 * um,
            u_tracker: ArrayLike = (5 * um, 1 * arcsec, 1 * arcsec), quantities: Sequence[Quantity] = ()) -> Problem:
    """The poses of the part and the frame of the tracker from what axes and tracker read, with every named effect held.

    setup; axes: axis readings; targets: polar readings of the targets, or None for encoders alone; u_axis: [m] of one
    axis reading; u_tracker: (3,) [m, rad, rad]; quantities: derived results.
    Raises InputError for a locator, target or pose without readings or a name that the setup does not know.
    """
    _check(setup, axes, targets)
    poses = np.unique(axes.pose)
    start = start_poses(setup, axes, list(poses))
    part_pose = Pose("part", np.stack([one.rotation for one in start]), np.stack([one.translation for one in start]),
                     "mm", "arcsec", keys=list(poses))
    observations = []
    for locator in setup.locators:
        read = setup.axes_of(locator.key)
        mine = axes.where(axes.item == locator.key)
        if read:
            observations.append(Observations(
                readings_of(read), part_pose[np.searchsorted(poses, mine.pose)], Shared(locator.ball_in_part),
                Shared(locator.frames.matrix), mine.values, Shared(setup.half_range), mine.approach,
                Shared(np.zeros(len(SHIFTS))), Shared(np.zeros(len(TURNS))),
                readings=mine.values[:, [AXES.index(a) for a in read]], u=u_axis,
                group=axis_group(locator.key), unit="um", components=read, covariates=mine.covariates, rows=mine.rows))
    if targets is not None:
        observations.append(_target_observations(setup, targets, part_pose, poses, start, u_tracker))
    blocks = sorted({int(b) for b in targets.block})[1:] if targets is not None else ()
    named = effects([locator.key for locator in setup.locators if setup.axes_of(locator.key)], blocks)
    if targets is None:
        named = tuple(e for e in named if e.groups != (TARGETS,))
    return Problem(observations, quantities=quantities, effects=named, name="part on three-axis locators")


def _target_observations(setup: Setup, targets: Readings, part_pose: Pose, poses: np.ndarray,
                         start: Sequence[Transform], u: ArrayLike) -> Observations:
    index = np.searchsorted(poses, targets.pose)
    in_part = np.array([setup.targets[key] for key in targets.item], dtype=float)
    in_hall = np.array([start[i] @ point for i, point in zip(index, in_part, strict=True)])
    seen = laser_tracker.cartesian_readings(targets.values)
    near = rigid_fit(in_hall, seen)
    misfit = np.linalg.norm(near @ in_hall - seen, axis=1)
    size = np.sqrt(np.mean(np.sum((in_hall - in_hall.mean(0)) ** 2, axis=1)))
    unread = float(np.linalg.norm(setup.half_range)) if setup.axes else 0.0     # start poses know nothing of these axes
    if len(seen) > 3 and np.median(misfit) > STRANGE * size + unread:
        raise InputError(f"the coordinates of the targets do not fit the part at all: half of them are more than "
                         f"{np.median(misfit) / mm:.0f} mm off in a part of {size / mm:.0f} mm; look at their unit, "
                         f"at the "
                         "order of the columns and at the names of the targets.")
    tracker = Pose("tracker", near.rotation, near.translation, "mm", "arcsec")
    return Observations(target_reading, part_pose[index], tracker, in_part, readings=targets.values, u=u, group=TARGETS,
                        unit=TRACKER_UNITS, components=TRACKER_COMPONENTS, period=laser_tracker.PERIOD,
                        covariates={**targets.covariates, "target": targets.item}, rows=targets.rows)


def _check(setup: Setup, axes: Readings, targets: Readings | None) -> None:
    for kind, readings, known in (("locator", axes, [locator.key for locator in setup.locators]),
                                  ("target", targets, list(setup.targets))):
        if readings is None:
            continue
        strange = [i for i, item in enumerate(readings.item) if str(item) not in known]
        if strange:
            raise InputError(f"row {readings.rows[strange[0]]} is of {kind} '{readings.item[strange[0]]}', which the "
                             f"setup does not know; it knows "
                             f"{', '.join(known)}: add the {kind} or mend its name.")
    silent = [locator.key for locator in setup.locators
              if setup.axes_of(locator.key) and not np.any(axes.item == locator.key)]
    if silent:
        raise InputError(f"locator '{silent[0]}' has no axis readings; give them, or leave the locator out of the "
                         "setup.")
    far = np.argwhere(np.abs(axes.values) > FAR * np.asarray(setup.half_range))
    if len(far):
        row, axis = far[0]
        raise InputError(f"row {axes.rows[row]}: axis {AXES[axis]} of locator '{axes.item[row]}' reads "
                         f"{axes.values[row, axis] / mm:.1f} mm, far outside its half range of "
                         f"{setup.half_range[axis] / mm:.1f} mm; look at the unit of the readings or mend the range.")
    if targets is not None:
        lost = np.flatnonzero(~np.isin(targets.pose, axes.pose))
        if len(lost):
            raise InputError(f"row {targets.rows[lost[0]]}: pose {targets.pose[lost[0]]} has target readings but no "
                             f"axis "
                             "readings; give both or leave the pose out.")
