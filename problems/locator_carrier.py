"""Three-locator carrier as closed loops: a part held at three balls by three locators of three linear axes each.

Every locator (A, B, C) is a branch X, Y, Z that ends in a ball of the part; the part closes three loops through the
floor. Encoders read the axes that have one (in the paper six of nine: the others follow), a tracker sees targets on the
part. Unknown are the pose of the part and all nine travels in every setting, where the balls sit on the part, how the
tracker stands, and the zero and the direction of each axis, of which tolerances are stated. `set_points` turns a wanted
pose of the part into travels. `problems.locators` has the error analysis of the paper for the same carrier.
Source: Li Chen, Fang Qiang, Li Jiangxiong 2010, article no. 1001-4551(2010)03-0006-08; ISO 230-1:2012, annex A.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib import Effect, Estimate, Observations, Pose, Problem, Shared, Unknown, geometry, prior, simulate, solve
from calib.analyse.shapes import points_of, stations_of
from calib.errors import InputError
from calib.job import Job
from calib.mechanism import Frame, Linear, Mechanism, location_errors, observe, scale
from calib.mechanism.heldout import misses, rms
from calib.mechanism.loop import held_by, refuse_open
from calib.mechanism.scene import axes_of, placed
from calib.mechanism.start import nearest_motion
from calib.mechanism.tolerance import tolerances
from calib.scene import Points, Scene, Sights
from calib.table import written, xyz_mm
from calib.units import mm, mrad, um

accepts = ("problems.locator_carrier",)
LOCATORS = {"A": (1.44, 0.0, 1.0), "B": (-0.72, 0.59, 1.0), "C": (-0.72, -0.59, 1.0)}      # ball, all travels zero [m]
BALLS = {key: np.array(place) - (0.0, 0.0, 1.0) for key, place in LOCATORS.items()}        # in the part, as designed
AXES = tuple(f"{key}{axis}" for key in LOCATORS for axis in "XYZ")
DRIVEN = ("AX", "AY", "AZ", "BY", "BZ", "CZ")       # the paper's choice of six
BLOCKS = 5
LARGEST_GAP = 10 * mm       # more than errors of manufacture: another unit, sign or zero
columns = {"axes": {"setting": "number", "AX, AY ... CZ": "travel of each axis that is read"},
           "targets": {"setting": "number", "target": "name", "x, y, z": "in the tracker's frame"},
           "part": {"target": "name", "x, y, z": "in the part's frame"}}
options = {"u_axis": "standard uncertainty of a travel", "u_target": "of a coordinate by the tracker",
           "u_seat": "of a ball in its seat, each component", "u_ball": "tolerance of a ball's place on the part",
           "u_zero, u_tilt": "tolerances of the zero and the direction of an axis"}


@lru_cache(maxsize=1)
def carrier() -> Mechanism:
    """Nine linear axes in three branches, travels of 0.3 m either way in X and Y, 0.2 m in Z."""
    axes = [Linear(f"{key}{axis}", direction, place, f"{key}{before}" if before else None, (-travel, travel))
            for key, place in LOCATORS.items() for axis, before, direction, travel in
            (("X", "", (1, 0, 0), 0.3), ("Y", "X", (0, 1, 0), 0.3), ("Z", "Y", (0, 0, 1), 0.2))]
    return Mechanism("three-locator carrier", axes,
                     [Frame(f"ball_{key}", place, carried_by=f"{key}Z") for key, place in LOCATORS.items()])


@lru_cache(maxsize=1)
def effects() -> tuple[Effect, ...]:
    """Zero and direction of every axis (location errors), and its scale."""
    return (*location_errors(carrier()), *(scale(axis) for axis in carrier().axes))


def declare(read: Sequence[str], travels: ArrayLike, parts: Sequence[geometry.Transform], setting: ArrayLike,
            targets: ArrayLike, points: ArrayLike | None, world: geometry.Transform, u_axis: float, u_target: float,
            u_seat: float, u_ball: float, u_zero: float, u_tilt: float,
            rows: tuple[ArrayLike | None, ArrayLike | None] = (None, None)) -> Problem:
    """Declare the identification of the carrier.

    read: the axes with an encoder; travels: (n, 9) [m], measured where read, roughly elsewhere; parts: n times
    hall_from_part, roughly; setting: (m,) the setting 0..n-1 of each target reading, targets: (m, 3) on the part [m],
    points: (m, 3) as measured [m] or None to plan; world: tracker_from_hall, roughly; u_...: standard uncertainties as
    in `options` [m, rad]; rows: numbers in the data files.
    """
    mechanism, n = carrier(), len(parts)
    keys = [str(i + 1) for i in range(n)]
    part = Pose("part", np.array([p.rotation for p in parts]), np.array([p.translation for p in parts]), unit="mm",
                angle_unit="mrad", keys=keys)
    tracker = Pose("tracker_from_hall", world.rotation, world.translation, unit="mm", angle_unit="mrad")
    travel = Unknown("travel", np.asarray(travels, float), "mm", parts=AXES, keys=keys)
    ball = Unknown("ball", np.array(list(BALLS.values())), "mm", keys=list(BALLS))
    chosen = tuple(mechanism.index(axis) for axis in read)
    recorded = None if points is None else np.asarray(travels, float)[:, chosen]
    observations = [Observations(
        observe.encoders(chosen), travel.each, readings=recorded, u=u_axis,
        group="axes", unit="um", components=tuple(read), rows=rows[0])]
    observations += [Observations(
        held_by(mechanism.pose(f"ball_{key}")), part.each, ball[np.full(n, i)], travel.each, Shared(np.zeros(3)),
        readings=np.zeros((n, 3)), u=u_seat, group=f"seat {key}", unit="um", components=("x", "y", "z"), rows=rows[0])
        for i, key in enumerate(LOCATORS)]
    observations.append(Observations(
        seen_target, tracker, part[np.asarray(setting)], np.asarray(targets, float), readings=points, u=u_target,
        group="targets", unit="um", components=("x", "y", "z"), rows=rows[1]))
    observations.append(prior(ball, ball.ambient, u_ball, name="tolerance of balls"))
    problem = Problem(observations, effects=effects(), name="three-locator carrier")
    zeros, tilts = ([e for e in location_errors(mechanism) if e.name[1] in letters] for letters in ("XYZ", "ABC"))
    labels = [[e.label for e in group] for group in (zeros, tilts)]
    return problem.free(*labels[0], *labels[1]).with_observations(
        tolerances(problem, dict.fromkeys(labels[0], u_zero), "tolerance of zeros"),
        tolerances(problem, dict.fromkeys(labels[1], u_tilt), "tolerance of directions"))


def seen_target(tracker_from_hall: Any, part: Any, target: Any) -> Any:
    """Where the tracker sees a target (3,) of the part [m]."""
    return tracker_from_hall @ (part @ target)


def from_job(job: Job) -> Problem:
    """Declare the carrier of a job: tables [data.axes], [data.targets] and [data.part], options as in `options`."""
    table, seen, known = job.table("axes"), job.table("targets"), job.table("part")
    read = [axis for axis in AXES if table.has(axis)]
    if len(read) < 6:
        raise InputError(f"{table.path}: {len(read)} axes are read ({', '.join(read) or 'none'}), and the pose of the "
                         f"part needs six; add columns, such as those of {', '.join(DRIVEN)}.")
    travels = np.zeros((len(table), len(AXES)))
    travels[:, [AXES.index(axis) for axis in read]] = np.stack([table.number(axis, "length") for axis in read], axis=1)
    places = dict(zip(known.text("target"), np.stack([known.number(n, "length") for n in "xyz"], axis=1), strict=True))
    settings, points = list(table.whole("setting")), np.stack([seen.number(n, "length") for n in "xyz"], axis=1)
    for row, setting, name in zip(seen.row_numbers, seen.whole("setting"), seen.text("target"), strict=True):
        if name not in places or setting not in settings:
            raise InputError(f"{seen.path}, row {row}: " + (f"setting {setting} is not in {table.path}"
                             if name in places else f"target '{name}' is not in {known.path}") + "; add it there.")
    index = np.array([settings.index(s) for s in seen.whole("setting")])
    targets = np.array([places[name] for name in seen.text("target")])
    for setting in range(len(settings)):
        if np.sum(index == setting) < 3:
            raise InputError(f"{seen.path}: {np.sum(index == setting)} targets are seen in setting "
                             f"{settings[setting]}, and a pose needs three; measure more, or leave that setting out.")
    recorded, (world, parts, travels) = travels, rough_poses(travels, read, index, targets, points)
    chosen = [AXES.index(axis) for axis in read]
    following = np.array([[(p @ BALLS[key] - LOCATORS[key])[i] for key in LOCATORS for i in range(3)] for p in parts])
    refuse_open((following - recorded)[:, chosen], [f"through {axis}" for axis in read], LARGEST_GAP, str(table.path),
                table.row_numbers)
    u = {name: job.options.quantity(name, "angle" if name == "u_tilt" else "length")
         for name in ("u_axis", "u_target", "u_seat", "u_ball", "u_zero", "u_tilt")}
    return declare(read, travels, parts, index, targets, points, world, **u, rows=(table.row_numbers, seen.row_numbers))


def rough_poses(travels: np.ndarray, read: Sequence[str], index: np.ndarray, targets: np.ndarray, points: np.ndarray
                ) -> tuple[geometry.Transform, list[geometry.Transform], np.ndarray]:
    """tracker_from_hall, hall_from_part in every setting and all travels [m] by the nominal geometry.

    Targets give the balls in the tracker's frame; axes that are not read follow until they stand still.
    """
    mechanism, balls = carrier(), np.array(list(BALLS.values()))
    seen = [nearest_motion(points[index == i], targets[index == i]) for i in range(len(travels))]
    in_tracker = np.array([tracker_from_part @ balls for tracker_from_part in seen])
    passive, found = [AXES.index(axis) for axis in AXES if axis not in read], travels.copy()
    for _ in range(200):
        held = np.stack([mechanism.poses(f"ball_{key}", found)[1] for key in LOCATORS], axis=1)
        world = nearest_motion(in_tracker.reshape(-1, 3), held.reshape(-1, 3))
        following = (world.inverse() @ in_tracker.reshape(-1, 3)).reshape(held.shape) - held
        found[:, passive] += following.reshape(len(found), -1)[:, passive]
        if np.abs(following.reshape(len(found), -1)[:, passive]).max(initial=0.0) < 1 * um:
            break
    return world, [world.inverse() @ tracker_from_part for tracker_from_part in seen], found


def heldout(job: Job, estimate: Estimate) -> list[tuple[str, float, float, str]]:
    """Targets in settings of which the tracker's readings were not used, by the axes alone: as designed, identified.

    Every fifth setting is predicted. Returns (quantity, before, after, unit).
    """
    problem = estimate.problem
    errors = [problem.select("ball").unknown, *(a.unknown for a in problem.attached)]
    before, after = misses(problem, "targets", job.table("targets").whole("setting") % BLOCKS, errors, estimate)
    return [("rms miss of a target by the axes alone, settings not used", rms(before) / um, rms(after) / um, "um")]


def closing_travels(parts: Sequence[geometry.Transform], ball: ArrayLike, errors: Mapping[str, Any],
                    gaps: ArrayLike = 0.0) -> np.ndarray:
    """Travels (n, 9) [m] of AXES that close the loops for given hall_from_part, n of them.

    ball: (3, 3) places on the part [m]; errors: {label of an effect: its parameters}; gaps: (n, 3, 3), by which each
    ball is to miss its locator [m].
    """
    part = Pose("part", np.array([p.rotation for p in parts]), np.array([p.translation for p in parts]))
    travel, n = Unknown("travel", np.zeros((len(parts), len(AXES))), "mm"), len(parts)
    missed = np.broadcast_to(gaps, (n, 3, 3))
    loops = [Observations(held_by(carrier().pose(f"ball_{key}")), part.each, Shared(place), travel.each,
                          Shared(np.zeros(3)), readings=missed[:, i], u=1 * um, group=key)
             for i, (key, place) in enumerate(zip(LOCATORS, np.asarray(ball, float), strict=True))]
    closed = Problem(loops, effects=effects(), held=[part])
    start = {closed.parameters(label).name: np.atleast_2d(value) for label, value in errors.items()}
    return np.asarray(solve(closed, start=start)[travel])


def set_points(estimate: Estimate, wanted: geometry.Transform) -> np.ndarray:
    """Travels (9,) [m] of AXES that bring the part to hall_from_part `wanted`, by the calibrated carrier."""
    errors = {e.label: estimate[e] for e in estimate.problem.effects}
    return np.asarray(closing_travels([wanted], estimate["ball"], errors)[0])


TARGETS = {"1": (1.6, 0.1, 0.3), "2": (-0.9, 0.7, 0.25), "3": (-0.85, -0.65, 0.4), "4": (0.2, 0.0, 0.9)}
WORLD = geometry.Transform(geometry.rotation_from_rpy(0.002, -0.003, 2.1), np.array([4.0, 1.5, -0.2]))
_DRAW = np.random.default_rng(21)
TRUTH: dict[str, Any] = {"ball": np.array(list(BALLS.values())) + _DRAW.normal(0, 0.1 * mm, (3, 3)),
         **{e.label: float(_DRAW.normal(0, 0.1 * mm if e.name[1] in "XYZ" else 0.2 * mrad))
            for e in location_errors(carrier())}}


def plan(count: int = 15) -> list[geometry.Transform]:
    """hall_from_part of some settings over the travels."""
    generator = np.random.default_rng(8)
    return [geometry.Transform(geometry.rotation_from_rpy(*generator.uniform(-0.08, 0.08, 3)),
                               np.array([0.0, 0.0, 1.0]) + generator.uniform(-0.12, 0.12, 3)) for _ in range(count)]


def example(seed: int) -> Problem:
    """Fifteen settings with four targets, six axes read, simulated with errors within tolerances. seed: of the
    readings."""
    parts, generator = plan(), np.random.default_rng([seed, 1])
    setting, targets = np.repeat(np.arange(len(parts)), len(TARGETS)), np.tile(list(TARGETS.values()), (len(parts), 1))
    errors = {label: value for label, value in TRUTH.items() if label != "ball"}
    travels = closing_travels(parts, TRUTH["ball"], errors, generator.normal(0, 2 * um, (len(parts), 3, 3)))
    problem = declare(DRIVEN, travels, parts, setting, targets, None, WORLD, 3 * um, 10 * um, 2 * um, 0.1 * mm,
                      0.1 * mm, 0.2 * mrad)
    drawn = simulate(problem, {**{problem.parameters(n).name: [[v]] for n, v in errors.items()}, "ball": TRUTH["ball"],
                               "travel": travels}, seed)
    # tolerances are statements on the design, and a seat is read as a gap of zero: both stay where they are
    said = {o.group: o.recorded for o in problem.observations if o.is_prior}
    return drawn.with_readings({**said, **{f"seat {key}": np.zeros((len(parts), 3)) for key in LOCATORS}})


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with simulated readings: {file name: text}. seed: of the errors."""
    problem = example(seed)
    axes, points = (next(o.recorded for o in problem.observations if o.group == g) for g in ("axes", "targets"))
    setting, target = (part.ravel() for part in np.mgrid[:len(axes), :len(TARGETS)])
    names = np.array(list(TARGETS))
    tables = {"axes.csv": {"setting": np.arange(len(axes)) + 1,
                           **{f"{axis}_mm": travel for axis, travel in zip(DRIVEN, axes.T, strict=True)}},
              "targets.csv": {"setting": setting + 1, "target": names[target], **xyz_mm(points)},
              "part.csv": {"target": names, **xyz_mm(list(TARGETS.values()))}}
    job = """problem = "problems.locator_carrier"

[data.axes]
file = "axes.csv"

[data.targets]
file = "targets.csv"

[data.part]
file = "part.csv"

[options]
u_axis = "3 um"
u_target = "10 um"
u_seat = "2 um"
u_ball = "0.1 mm"
u_zero = "0.1 mm"
u_tilt = "0.2 mrad"
"""
    source = "simulated, tracker on a three-locator carrier"
    return {"job.toml": job, **{name: written(source, table) for name, table in tables.items()}}


def scene(job: Job, estimate: Estimate) -> Scene:
    """The axes of the locators, the balls with their uncertainty, where the part was, and the tracker."""
    ball, tracker = (estimate.problem.select(name).unknown for name in ("ball", "tracker_from_hall"))
    parts, eyes = estimate["part"], stations_of(estimate.fit, tracker)
    balls = placed(points_of(estimate.fit, ball), parts[0])
    visited = np.array([np.ravel(pose.translation) for pose in parts])
    return Scene((axes_of(carrier()), balls, Points("part in every setting", visited), eyes,
                  Sights("measured", eyes.places[0], visited)))
