"""Any mechanism, from a table or a robot description, measured by any mix of instruments: what these can know is free.

The mechanism is read from axes.csv (lines in space), dh.csv or a URDF. Its measurements are tables of their own, each
with the positions of all axes, its instrument and its uncertainty: points or poses by an instrument at an unknown
place, distances from stations (ball bar), inclinations by a level, seats of a ball in sockets at unknown places,
distances of sockets. All errors that are asked for are free, as far as the readings can tell them from each other and
from the places; what they cannot tell is held and said. The identified geometry is written back as tables and as URDF.
Source: ISO 230-1:2012, annex A (location errors); Hollerbach and Wampler 1996 (identifiable parameters).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib import (
    Direction,
    Effect,
    Estimate,
    Observations,
    Pose,
    Problem,
    Shared,
    Unknown,
    linearise,
)
from calib.errors import InputError, RankDefect
from calib.job import Job
from calib.mechanism import (
    Mechanism,
    encoder_harmonic,
    location_errors,
    observe,
    sag,
    scale,
    tabulated,
    urdf,
)
from calib.mechanism.conditions import approaches, driven_by_conditions
from calib.mechanism.geometry_files import geometry_files
from calib.mechanism.heldout import misses, postures, rms
from calib.mechanism.inputs import checked_positions, other_quaternion_order, unlike_the_mechanism
from calib.mechanism.scene import axes_of
from calib.mechanism.start import misfit, place_of_points, world_and_target
from calib.mechanism.statement import Statement, minimal
from calib.mechanism.tolerance import tolerances
from calib.scene import Scene
from calib.table import Table
from calib.units import um
from problems.recorded import recorded

accepts = ("problems.mechanism",)
BLOCKS = 5
FAMILIES = ("location", "scale", "encoder_1x", "encoder_2x", "sag", "conditions")
POSITIONS = {"AXIS of the mechanism, each": "commanded positions", "AXIS_approach, temp, time, block": "optional"}
columns = {
    "axes | table": {"the mechanism": "lines in space, or rows of Denavit and Hartenberg; calib.mechanism.tabulated "
                                      "says which columns"},
    "points": {**POSITIONS, "point": "name", "x, y, z": "in the instrument's frame"},
    "poses": {**POSITIONS, "x, y, z, qw, qx, qy, qz": "of a target on the frame, in the instrument's frame"},
    "distances": {**POSITIONS, "station, point": "names, described in [data.places]", "distance": "measured"},
    "levels": {**POSITIONS, "level": "name, described in [data.places]", "inclination": "measured"},
    "seats": {**POSITIONS, "socket": "name; the ball is the one called `ball` in [data.places]"},
    "apart": {"first, second": "sockets", "distance": "measured"},
    "places": {"name": "of a station, point, ball or level", "x, y, z": "roughly: a station in base coordinates, a "
               "point or ball on the frame; of a level its sensitive direction on the frame, of any length"}}
options = {
    "urdf, tip, base": "the mechanism as robot description, in place of [data.axes] and [data.table]",
    "convention": "of [data.table]: standard (default; rows with beta are Hayati's) or modified",
    "frame": "that carries what is measured (the tip, or the last one if not given)",
    "errors": f"families to free: {', '.join(FAMILIES)} ([\"location\"] if not given); the others are candidates",
    "u_length, u_angle": "tolerances of the location errors: with both, all of them stay free",
    "down": "plumb direction in base coordinates ([0, 0, -1])"}


@dataclass(frozen=True, eq=False)
class Described:
    """A mechanism, the frame that is measured, and the robot description with its base where it came from one."""

    mechanism: Mechanism
    frame: str
    description: urdf.Description | None = None
    base: str | None = None


def described(job: Job) -> Described:
    """The mechanism of a job. Raises InputError unless exactly one of [data.axes], [data.table] and urdf is named."""
    said = job.options
    given = [name for name in ("axes", "table") if name in job.tables] + ["urdf"] * ("urdf" in said)
    if len(given) != 1:
        raise InputError(f"{job.path}: names {' and '.join(given) or 'no mechanism'}; name one file, as [data.axes], "
                         "[data.table] or the option urdf.")
    frame = said.text("frame") if "frame" in said else None
    if given[0] == "urdf":
        found, base = urdf.read(job.file(said.text("urdf"))), said.text("base") if "base" in said else None
        tip = said.text("tip") if "tip" in said else None
        mechanism = urdf.mechanism(found, base, tip, said.numbers("down", (0.0, 0.0, -1.0)))
        frame = frame or (urdf.frame_name(tip, base or found.root) if tip else None)
        return Described(mechanism, _frame(mechanism, frame), found, base)
    path = job.table(given[0]).path
    mechanism = tabulated.read_axes(path) if given[0] == "axes" else tabulated.read_table(
        path, said.text("convention", "standard", ("standard", "modified")))
    return Described(mechanism, _frame(mechanism, frame))


def _frame(mechanism: Mechanism, frame: str | None) -> str:
    carried = [f.name for f in mechanism.frames if f.carried_by]
    return mechanism.frame(frame or (carried[-1] if carried else mechanism.axes[-1].name)).name


def effects_of(mechanism: Mechanism) -> dict[str, tuple[Effect, ...]]:
    """The effects of each of FAMILIES."""
    axes = mechanism.axes
    turning = [axis for axis in axes if axis.is_rotary]
    loaded = [axis for axis in axes if any(axis in mechanism.path_of(load) for load in mechanism.loads)]
    return {"location": location_errors(mechanism), "scale": tuple(scale(axis) for axis in axes),
            "encoder_1x": tuple(encoder_harmonic(axis, 1) for axis in turning),
            "encoder_2x": tuple(encoder_harmonic(axis, 2) for axis in turning),
            "sag": tuple(sag(mechanism, axis) for axis in loaded), "conditions": driven_by_conditions(mechanism)}


def from_job(job: Job) -> Problem:
    """Declare the identification of a job. Raises InputError for a mechanism or a measurement that cannot be used."""
    problem, statement = _declared(job)
    return problem.hold(*statement.to_hold) if statement else problem


def remarks(job: Job) -> tuple[str, ...]:
    """What these readings cannot tell and is held, and what they know worse than it may be: sentences."""
    _, statement = _declared(job)
    return (*(one.sentence for one in statement.confounded), *statement.weak) if statement else ()


def _declared(job: Job) -> tuple[Problem, Statement | None]:
    """The problem with all that is asked for free, and what of it the readings can know; None with tolerances."""
    what, places = described(job), _places(job)
    observations = [one for kind, declare in DECLARE.items() if kind in job.tables
                    for one in declare(job, job.table(kind), what, places)]
    if not observations:
        raise InputError(f"{job.path}: nothing is measured; give one of [data.{'], [data.'.join(DECLARE)}].")
    families = effects_of(what.mechanism)
    wanted = job.options.texts("errors", ("location",))
    strange = [name for name in wanted if name not in families]
    if strange:
        raise InputError(f"{job.path}: errors = '{strange[0]}' is no family; there are: {', '.join(families)}.")
    problem = Problem(observations, name=what.mechanism.name)
    problem = problem.with_effects(*problem.acting([e for family in families.values() for e in family]))
    free = [e for e in problem.effects if any(e in families[name] for name in wanted)]
    problem = problem.free(*free)
    if "u_length" not in job.options:
        return problem, minimal(linearise(problem))
    sizes = {True: job.options.quantity("u_length", "length"), False: job.options.quantity("u_angle", "angle")}
    located = {e: sizes[e.name[1] in "XYZ"] for e in free if e in families["location"]}
    return problem.with_observations(tolerances(problem, located, "tolerances of location")), None


# --- measurements -----------------------------------------------------------------------------------------------------


def _positions(job: Job, table: Table, what: Described) -> tuple[np.ndarray, dict[str, Any]]:
    """Positions (n, axes) after a look at them, and rows and covariates of a table."""
    axes = what.mechanism.axes
    values = np.stack([table.number(a.name, "angle" if a.is_rotary else "length") for a in axes], axis=1)
    checked_positions(what.mechanism, values, table.row_numbers, str(table.path))
    covariates = {a.name: (values[:, i], a.unit) for i, a in enumerate(axes)}
    return values, {"rows": table.row_numbers, "covariates": {
        **covariates, **approaches(what.mechanism, table), **recorded(job, table)}}


def _places(job: Job) -> dict[str, np.ndarray]:
    """What [data.places] says: {name: (3,)}."""
    if "places" not in job.tables:
        return {}
    table = job.table("places")
    return dict(zip(table.text("name"), np.stack([table.number(n, "length") for n in "xyz"], axis=1), strict=True))


def _named(table: Table, column: str, places: dict[str, np.ndarray], name: str) -> tuple[Any, np.ndarray]:
    """The unknown of the places that a column names, started where [data.places] says, and the place of each row."""
    rows = table.text(column)
    for row, key in zip(table.row_numbers, rows, strict=True):
        if key not in places:
            raise InputError(f"{table.path}, row {row}: {column} '{key}' is not in [data.places]; say there roughly "
                             "where it is.")
    keys = list(dict.fromkeys(rows))
    return (Unknown(name, np.array([places[k] for k in keys]), "mm", keys=keys),
            np.array([keys.index(k) for k in rows]))


def _points(job: Job, table: Table, what: Described, places: dict[str, np.ndarray]) -> list[Observations]:
    positions, common = _positions(job, table, what)
    seen = np.stack([table.number(n, "length") for n in "xyz"], axis=1)
    unlike_the_mechanism(what.mechanism, what.frame, positions, table.text("point"), seen, str(table.path))
    world, found = place_of_points(what.mechanism, what.frame, positions, table.text("point"), seen)
    point, index = _named(table, "point", found, "point")
    station = Pose("instrument_from_base", world.rotation, world.translation, unit="mm", angle_unit="arcsec")
    return [Observations(observe.measured_point(what.mechanism.pose(what.frame)), station, positions, point[index],
                         readings=seen, u=job.instrument("points").quantity("u", "length"), group="points", unit="um",
                         components=("x", "y", "z"), **common)]


def _poses(job: Job, table: Table, what: Described, places: dict[str, np.ndarray]) -> list[Observations]:
    positions, common = _positions(job, table, what)
    at = np.stack([table.number(n, "length") for n in "xyz"], axis=1)
    w, x, y, z = (table.number(n) for n in ("qw", "qx", "qy", "qz"))
    turned = observe.rotations_from_quaternions(w, x, y, z, str(table.path), table.row_numbers)
    frames, other = what.mechanism.poses(what.frame, positions), observe.rotations_from_quaternions(
        z, w, x, y, str(table.path))
    other_quaternion_order(misfit(turned, at, *frames), misfit(other, at, *frames), str(table.path))
    world, target = world_and_target(turned, at, *frames)
    camera, mounted = (Pose(name, t.rotation, t.translation, unit="mm", angle_unit="arcsec")
                       for name, t in (("camera_from_base", world), ("frame_from_target", target)))
    said = job.instrument("poses")
    u = [said.quantity("u", "length")] * 3 + [said.quantity("u_orientation", "angle")] * 3
    return [Observations(observe.measured_pose(what.mechanism.pose(what.frame)), camera, positions, mounted, turned,
                         readings=observe.pose_readings(at, turned), u=u, group="poses", unit=["um"] * 3 + ["urad"] * 3,
                         components=("x", "y", "z", "rx", "ry", "rz"), **common)]


def _distances(job: Job, table: Table, what: Described, places: dict[str, np.ndarray]) -> list[Observations]:
    positions, common = _positions(job, table, what)
    (station, of_station), (end, of_end) = (_named(table, column, places, name) for column, name in (
        ("station", "station"), ("point", "bar_end")))
    return [Observations(observe.measured_distance(what.mechanism.pose(what.frame)), station[of_station], positions,
                         end[of_end], readings=table.number("distance", "length"),
                         u=job.instrument("distances").quantity("u", "length"), group="distances", unit="um", **common)]


def _levels(job: Job, table: Table, what: Described, places: dict[str, np.ndarray]) -> list[Observations]:
    positions, common = _positions(job, table, what)
    rough, index = _named(table, "level", places, "level")
    directions = rough.ambient / np.linalg.norm(rough.ambient, axis=1, keepdims=True)
    sensitive = Direction("sensitive_direction", directions, keys=rough.keys)
    zero = Unknown("level_zero", np.zeros((rough.count, 1)), "arcsec", keys=rough.keys)
    return [Observations(observe.level_on(what.mechanism.pose(what.frame)), positions, sensitive[index],
                         Shared(np.asarray(what.mechanism.down)), zero[index],
                         readings=table.number("inclination", "angle"),
                         u=job.instrument("levels").quantity("u", "angle"), group="levels", unit="arcsec", **common)]


def _seats(job: Job, table: Table, what: Described, places: dict[str, np.ndarray]) -> list[Observations]:
    positions, common = _positions(job, table, what)
    at, keys = places.get("ball", np.zeros(3)), list(dict.fromkeys(table.text("socket")))
    index = np.array([keys.index(k) for k in table.text("socket")])
    rotations, origins = what.mechanism.poses(what.frame, positions)
    balls = rotations @ at + origins
    socket = Unknown("socket", np.array([balls[index == i].mean(axis=0) for i in range(len(keys))]), "mm", keys=keys)
    found = [Observations(observe.contact(what.mechanism.pose(what.frame)), socket[index], positions,
                          Unknown("ball", at, "mm"), readings=np.zeros((len(positions), 3)),
                          u=job.instrument("seats").quantity("u", "length"), group="seats", unit="um",
                          components=("x", "y", "z"), **common)]
    if "apart" in job.tables:
        apart = job.table("apart")
        strange = [one for column in ("first", "second") for one in apart.text(column) if one not in keys]
        if strange:
            raise InputError(f"{apart.path}: no ball was seated in a socket '{strange[0]}'; there are: "
                             f"{', '.join(keys)}.")
        first, second = (np.array([keys.index(k) for k in apart.text(c)]) for c in ("first", "second"))
        found.append(Observations(observe.distance_between, socket[first], socket[second], group="apart", unit="um",
                                  readings=apart.number("distance", "length"), rows=apart.row_numbers,
                                  u=job.instrument("apart").quantity("u", "length")))
    return found


DECLARE = {"points": _points, "poses": _poses, "distances": _distances, "levels": _levels, "seats": _seats}


def in_columns(observations: Observations) -> tuple[str, dict[str, np.ndarray]] | None:
    """Poses as their table has them: {column: values}."""
    return ("poses", observe.pose_columns(observations)) if observations.group == "poses" else None


def identified_files(job: Job, estimate: Estimate) -> dict[str, str]:
    """The identified geometry: identified_axes.csv, identified_dh.csv, and identified.urdf of a URDF."""
    what = described(job)
    return geometry_files(what.mechanism, estimate, what.frame, what.description, what.base)


def heldout(job: Job, estimate: Estimate) -> list[tuple[str, float, float, str]]:
    """Readings of postures that were not used: mechanism as designed before, identified after; every fifth posture.

    Of points, else poses, else distances. Returns (quantity, before, after, unit); nothing where the other postures
    cannot do without these.
    """
    problem, what = estimate.problem, described(job)
    errors = [a.unknown for a in problem.attached if not problem.is_held(a.unknown).all()]
    group = next((g for g in ("points", "poses", "distances") if g in job.tables), None)
    if group is None or not errors:
        return []
    blocks = postures(_positions(job, job.table(group), what)[0]) % BLOCKS
    try:
        before, after = misses(problem, group, blocks, errors, estimate)
    except RankDefect:
        return []
    return [(f"rms miss of {group} in postures not used", rms(before[:, :3]) / um, rms(after[:, :3]) / um, "um")]


def scene(job: Job, estimate: Estimate) -> Scene:
    """The axes as designed."""
    return Scene((axes_of(described(job).mechanism),))


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with simulated readings of a tracker, a ball bar and two levels: {file name: text}. seed: of the
    errors."""
    from problems.mechanism.stand import job_files
    return job_files(seed)
