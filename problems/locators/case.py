"""Jobs of the locator problem: a case folder of scenario `locator_pose`, or a TOML job with the same tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib import Problem, Quantity
from calib.errors import InputError
from calib.job import Job
from calib.table import Table
from calib.units import kelvin_from_celsius, mm
from instruments import laser_tracker
from problems.locators.errors import AXES, Frames
from problems.locators.identification import Knowledge, with_error_functions, with_knowledge
from problems.locators.measured import Locator, Readings, Setup, declare
from problems.locators.paper import DRIVEN
from problems.locators.pose_error import COMPONENT_UNITS, position_and_angles

SCENARIO = "locator_pose"
KINDS = ("axis", "target")
POSE_PARTS = ("x", "y", "z", "alpha", "beta", "gamma")

columns = {"measurements": {
    "pose": "number of the pose", "kind": "axis or target", "item": "key of the locator or the target",
    "v1, v2, v3": "axis: readings x, y, z of the locator; target: coordinates in the frame of the tracker",
    "time, temp, block": "when, in which temperature and after which set-up of the tracker (optional)",
    "dir1, dir2, dir3": "axis: +1 or -1, the direction each axis was approached from (optional)",
    "split": "fit or check (optional)"}}
options = {
    "free": "list of named effects to estimate, as `calib effects` lists them",
    "errors": "named (default), or functions: all 21 errors of every locator as functions of the travel",
    "prior_length, prior_angle, prior_squareness": "known beforehand of these functions (20 um, 8, 20 arcsec)",
    "[known]": "locators (id, base, ball_in_part), targets (id, in_part), abbe_height, reach_at_zero, "
               "axis_half_range_mm (x, y, z), reference_temperature_C, axes_read (list by locator; else all three)"}


def from_job(job: Job) -> Problem:
    """The declared problem of a job: poses and tracker frame unknown, every named effect held; result: every `pose`.

    job: tables and options as in `columns` and `options`, [instruments.locator] sigma_axis and, with targets,
    [instruments.tracker] sigma_range, sigma_azimuth, sigma_zenith.
    Raises InputError for an unknown kind of row, locator or target, and for what is missing.
    """
    problem = _declared(job, setup_of(job), with_tracker=True)
    if job.problem != SCENARIO:         # a case is solved a thousand times and asks for no pose
        problem = _with_poses(problem)
    problem = problem.free(*job.options.texts("free", ()))
    if job.options.text("errors", "named", ("named", "functions")) == "named":
        return problem
    usual = Knowledge()
    return with_knowledge(with_error_functions(problem), Knowledge(
        job.options.quantity("prior_length", "length", usual.length),
        job.options.quantity("prior_angle", "angle", usual.angle),
        job.options.quantity("prior_squareness", "angle", usual.squareness)))


def formulations(job: Job) -> dict[str, Problem]:
    """The same poses from all readings, from six axes and the tracker as in the paper, and from the axes alone."""
    setup = setup_of(job)
    found = {"all readings": from_job(job)}
    if {locator.key for locator in setup.locators} == set(DRIVEN):
        six = replace(setup, axes=DRIVEN)
        found["six axes and tracker"] = _with_poses(_declared(job, six, with_tracker=True))
        found["six axes alone"] = _with_poses(_declared(job, six, with_tracker=False))
    found["axes alone"] = _with_poses(_declared(job, setup, with_tracker=False))
    return found


def remarks(job: Job) -> tuple[str, ...]:
    """What the readings cannot tell: sentences."""
    if any(kind == "target" for kind in job.table("measurements").text("kind")):
        return ("Where the hall frame lies: an offset that all locators share along one axis, and every offset along "
                "z, "
                "is taken for a place or a tilt of the tracker.",)
    return ("What all locators do alike: without a tracker the axes see only in what they disagree.",)


def _declared(job: Job, setup: Setup, with_tracker: bool) -> Problem:
    table = job.table("measurements")
    axes, targets = readings_of_kind(table, "axis", job), readings_of_kind(table, "target", job)
    if not len(axes.rows):
        raise InputError(f"{table.path}: no row of kind 'axis'; the readings of the locators are missing. Add them.")
    u_axis = job.instruments.table("locator").quantity("sigma_axis", "length")
    u_tracker: list[float] = []
    if len(targets.rows) or "tracker" in job.instruments:
        tracker = job.instruments.table("tracker")
        u_tracker = [tracker.quantity(f"sigma_{name}", kind) for name, kind in
                     (("range", "length"), ("azimuth", "angle"), ("zenith", "angle"))]
    try:
        if not with_tracker or not len(targets.rows):
            return declare(setup, axes, None, u_axis=u_axis)
        return declare(setup, axes, targets, u_axis=u_axis, u_tracker=u_tracker)
    except InputError as error:
        raise InputError(f"{table.path}: {error}") from None


def _with_poses(problem: Problem) -> Problem:
    part = next(unknown for unknown in problem.unknowns if unknown.name == "part")
    return problem.with_quantities(
        Quantity("pose", position_and_angles, part.each, unit=COMPONENT_UNITS, parts=POSE_PARTS, keys=part.keys))


def setup_of(job: Job) -> Setup:
    """Locators, targets and lever arms from the table [known] of a job; [known.axes_read] names the axes that count."""
    known = job.known
    height, reach = known.quantity("abbe_height", "length"), known.quantity("reach_at_zero", "length")
    locators = tuple(
        Locator(one.text("id"), Frames.with_levers(one.quantity("base", "length"), height, reach),
                np.asarray(one.quantity("ball_in_part", "length"))) for one in known.tables("locators"))
    if not locators:
        raise InputError(f"{known.where('locators')}: no locator is described; add [[known.locators]] with id, "
                         f"base_mm and "
                         "ball_in_part_mm")
    targets = {one.text("id"): np.asarray(one.quantity("in_part", "length")) for one in known.tables("targets")}
    half = known.table("axis_half_range_mm")
    read = known.table("axes_read")
    axes = {locator.key: read.texts(locator.key, ()) for locator in locators} if len(read) else {}
    strange = sorted({axis for chosen in axes.values() for axis in chosen} - set(AXES))
    if strange:
        raise InputError(f"{read.where()}: '{strange[0]}' is no axis; write some of x, y, z for each locator")
    return Setup(locators, targets, tuple(half.number(axis) * mm for axis in AXES), axes)


def readings_of_kind(table: Table, kind: str, job: Job) -> Readings:
    """The axis or target rows of a table; Cartesian coordinates of targets are turned back into polar readings.

    table: `measurements`; kind: "axis" or "target". Raises InputError for a kind that is neither.
    """
    kinds = table.text("kind")
    strange = [(row, k) for row, k in zip(table.row_numbers, kinds, strict=True) if k not in KINDS]
    if strange:
        raise InputError(f"{table.path}, row {strange[0][0]}, column 'kind': '{strange[0][1]}' is neither 'axis' nor "
                         f"'target'; "
                         "correct it")
    n = len(table)
    difference = np.zeros(n)
    if table.has("temp"):
        reference = kelvin_from_celsius(job.known.number("reference_temperature_C", 20.0))
        difference = table.number("temp", "temperature") - reference
    readings = Readings(
        pose=table.whole("pose"), item=np.asarray(table.text("item")),
        values=np.column_stack([table.number(name, "length") for name in ("v1", "v2", "v3")]),
        approach=np.column_stack([table.number(name, "number") if table.has(name) else np.zeros(n)
                                  for name in ("dir1", "dir2", "dir3")]),
        time=table.number("time", "time") if table.has("time") else np.zeros(n), temperature_difference=difference,
        block=table.whole("block") if table.has("block") else np.ones(n, dtype=int), rows=table.row_numbers,
        split=np.asarray(table.text("split")) if table.has("split") else np.full(n, "fit"))
    chosen = readings.where(np.asarray(kinds) == kind)
    if kind == "target" and len(chosen.rows):
        chosen = replace(chosen, values=laser_tracker.polar_readings(chosen.values))
    return chosen
