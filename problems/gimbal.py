"""Two-axis gimbal with a camera: how it stands, its axes, its circles and its sighting error, from images of known
targets.

A camera turns about a vertical axis C and a horizontal axis A, like the telescope of a theodolite, and reports where a
target stands in its image: two small angles, right and up. Where the targets are is known. Unknown are how the gimbal
stands among them, that the camera does not look squarely off its axis (a sighting error), that A lies off C and is not
square to it, and what the circles do. Each target is seen in both faces, which tells the sighting error from the tilt
of A; `pointing` gives the commands that bring a target into the middle of the image.
Source: ISO 230-1:2012, annex A (location errors); Deumlich and Staiger, Instrumentenkunde, 2002 (collimation).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from casadi import atan2, vertcat
from numpy.typing import ArrayLike

from calib import (
    Effect,
    Estimate,
    Ipopt,
    Observations,
    Parameter,
    Pose,
    Problem,
    Shared,
    Unknown,
    direct,
    geometry,
    hands_slots_to,
    simulate,
    solve,
)
from calib.errors import InputError
from calib.job import Job
from calib.mechanism import Frame, Load, Mechanism, Rotary, encoder_harmonic, location_errors, sag
from calib.mechanism.conditions import approaches, drawn_conditions, driven_by_conditions, written_conditions
from calib.mechanism.heldout import misses, rms
from calib.mechanism.inputs import checked_positions
from calib.mechanism.relation import crossing
from calib.mechanism.scene import axes_of
from calib.mechanism.start import nearest_motion
from calib.scene import Points, Scene, Sights
from calib.table import written, xyz_mm
from calib.units import arcsec, degree, mm
from problems.recorded import recorded

accepts = ("problems.gimbal",)
FIELD = 20 * degree         # what a camera can see to the side; a target beyond it is another one
LARGEST_MISS = 1 * degree   # more than errors of manufacture: another sign, unit or target
FREE = ("sighting_error (sight)", "EY0A (A)", "EB0A (A)", "encoder_1x_C (C)", "encoder_1x_A (A)")
columns = {
    "images": {"C, A": "commanded angles", "target": "name", "right, up": "where it stands in the image, angles",
               "C_approach, A_approach": "+1 or -1, the direction an axis came from (optional)",
               "time, temp, block": "when, in which temperature, after which set-up (optional)"},
    "targets": {"target": "name", "x, y, z": "where it stands; z up"}}
options = {"u": "standard uncertainty of a place in the image, an angle",
           "free": "effects to estimate; sighting error, location of A and both circles if not given"}


@lru_cache(maxsize=1)
def gimbal() -> Mechanism:
    """C vertical, A on it along X; at zero the camera looks along Y. Its weight lies ahead of A."""
    return Mechanism("gimbal", axes=[Rotary("C", (0, 0, 1)),
                                     Rotary("A", (1, 0, 0), carried_by="C", limits=(-1.0, 4.2))],
                     frames=[Frame("camera", carried_by="A")], loads=[Load("camera", (0, 0.1, 0), "A")])


camera = gimbal().pose("camera")


@hands_slots_to(camera)
def image(field_from_base: Any, positions: Any, target: Any, *, sight: Any = direct, **slots: Any) -> Any:
    """Where a target (3,) [m] stands in the image (2,): right and up [rad]. Slot `sight`: the two angles."""
    seen = (field_from_base @ camera(positions, **slots)).inverse() @ target
    return sight(vertcat(atan2(seen[0], seen[1]), atan2(seen[2], seen[1])))


@lru_cache(maxsize=1)
def effects() -> tuple[Effect, ...]:
    """Sighting error, location of A, two harmonics and the backlash of each circle, sag of A under the camera."""
    mechanism = gimbal()
    sighting = Effect("sighting_error", "sight", lambda value, p: vertcat(p.right, p.up),
                      (Parameter("right", "arcsec", (1 * arcsec, 1000 * arcsec)),
                       Parameter("up", "arcsec", (1 * arcsec, 1000 * arcsec))), source="Deumlich and Staiger 2002")
    location = [e for e in location_errors(mechanism, ["A"]) if e.name in ("EY0A", "EB0A")]
    return (sighting, *location, *(encoder_harmonic(axis, order) for axis in mechanism.axes for order in (1, 2)),
            *driven_by_conditions(mechanism), sag(mechanism, mechanism.axis("A")))


def declare(positions: ArrayLike, targets: ArrayLike, images: ArrayLike | None, u: float, field: geometry.Transform,
            free: Sequence[str] = FREE, names: Sequence[object] | np.ndarray | None = None,
            conditions: Mapping[str, Any] | None = None, rows: ArrayLike | None = None) -> Problem:
    """Declare the identification of the gimbal.

    positions: (n, 2) of C and A [rad]; targets: (n, 3) [m] of the target in each image; images: (n, 2) right, up [rad]
    or None to plan; u: standard uncertainty of each [rad]; field: field_from_base, roughly; free: effects to estimate;
    names: (n,) of the targets; conditions: covariates such as `C_approach`; rows: numbers in the data file.
    Returns the problem with the unknown `field_from_base`, and angle and distance of the axes as quantity `C_to_A`.
    """
    mechanism = gimbal()
    positions, targets = checked_positions(mechanism, positions, rows), np.asarray(targets, float)
    place = Pose("field_from_base", field.rotation, field.translation, unit="mm", angle_unit="arcsec")
    covariates = {name: (positions[:, i], "rad") for i, name in enumerate("CA")}
    observations = Observations(
        image, place, positions, targets, readings=images, u=u, group="images", unit="arcsec",
        components=("right", "up"), rows=rows,
        covariates={**covariates, **(conditions or {}),
                    "target": np.asarray(names if names is not None else ["all"] * len(positions))})
    problem = Problem([observations], name="gimbal")
    problem = problem.with_effects(*problem.acting(effects())).free(*free)
    return problem.with_quantities(crossing(problem, mechanism, "C", "A"))


def from_job(job: Job) -> Problem:
    """Declare the gimbal of a job: tables [data.images] and [data.targets], options u and free."""
    table, standing = job.table("images"), job.table("targets")
    positions = np.stack([table.number(name, "angle") for name in "CA"], axis=1)
    seen = np.stack([table.number(name, "angle") for name in ("right", "up")], axis=1)
    places = dict(zip(standing.text("target"), np.stack([standing.number(n, "length") for n in "xyz"], axis=1),
                      strict=True))
    names = table.text("target")
    for row, name in zip(table.row_numbers, names, strict=True):
        if name not in places:
            raise InputError(f"{table.path}, row {row}: the target '{name}' is not in {standing.path}; there are: "
                             f"{', '.join(places)}. Correct the name or add its place.")
    beyond = np.flatnonzero(np.abs(seen).max(axis=1) > FIELD)
    if len(beyond):
        raise InputError(f"{table.path}, row {table.row_numbers[beyond[0]]}: the target stands "
                         f"{np.abs(seen[beyond[0]]).max() / degree:.3g} degrees off the middle of the image; check the "
                         "unit of the columns right and up.")
    checked_positions(gimbal(), positions, table.row_numbers, str(table.path))
    targets = np.array([places[name] for name in names])
    field, miss = rough_field(positions, targets, seen)
    if miss > LARGEST_MISS:
        raise InputError(f"{table.path}: the images miss the gimbal as it is designed by {miss / degree:.3g} degrees "
                         "(rms); check the signs of right and up, of C and A, and the names of the targets.")
    return declare(positions, targets, seen, job.options.quantity("u", "angle"), field,
                   job.options.texts("free", FREE), names, {**approaches(gimbal(), table), **recorded(job, table)},
                   table.row_numbers)


def rough_field(positions: np.ndarray, targets: np.ndarray, images: np.ndarray) -> tuple[geometry.Transform, float]:
    """field_from_base from targets (n, 3) [m] and images (n, 2) [rad] by the nominal geometry; rms miss of lines [rad].

    A target lies on its line of sight at a distance that is not measured: guessed from the middle of the targets, then
    taken from the place found, until it stands still.
    """
    rotations, _ = gimbal().poses("camera", positions)
    ahead = np.stack([np.tan(images[:, 0]), np.ones(len(images)), np.tan(images[:, 1])], axis=1)
    lines = np.einsum("nij,nj->ni", rotations, ahead / np.linalg.norm(ahead, axis=1)[:, None])
    place, distance = geometry.Transform(np.eye(3), targets.mean(axis=0)), np.zeros(len(targets))
    for _ in range(100):
        distance = np.linalg.norm(targets - place.translation, axis=1)
        place = nearest_motion(targets, lines * distance[:, None])
    missed = np.linalg.norm(targets - place @ (lines * distance[:, None]), axis=1) / distance
    return place, float(np.sqrt(np.mean(missed ** 2)))


def heldout(job: Job, estimate: Estimate) -> list[tuple[str, float, float, str]]:
    """Miss of targets that were not used: gimbal as designed before, identified after; each from all the others.

    Returns (quantity, before, after, unit).
    """
    problem = estimate.problem
    _, target = np.unique(job.table("images").text("target"), return_inverse=True)
    errors = [a.unknown for a in problem.attached if not problem.is_held(a.unknown).all()]
    before, after = misses(problem, "images", target, errors, estimate)
    return [("rms miss of a target not used", rms(before) / arcsec, rms(after) / arcsec, "arcsec")]


def pointing(estimate: Estimate, target: ArrayLike, near: ArrayLike) -> np.ndarray:
    """Commands (2,) of C and A [rad] that bring a target (3,) [m] into the middle of the image of a calibrated gimbal.

    near: (2,) commands to start from, which pick the face. The limits of A are respected.
    """
    mechanism, known = gimbal(), {u.name: estimate[u] for u in estimate.problem.unknowns}
    commands = Unknown("commands", np.asarray(near, float), "deg", parts=("C", "A"),
                       lower=[a.limits[0] for a in mechanism.axes], upper=[a.limits[1] for a in mechanism.axes])
    place = estimate.problem.select("field_from_base").unknown
    aim = Problem([Observations(image, place, commands, Shared(np.asarray(target, float)), readings=[[0.0, 0.0]],
                                u=1 * arcsec, group="middle of the image")], held=[place])
    aim = aim.with_effects(*aim.acting(estimate.problem.effects))       # without those of approach and temperature
    return np.asarray(solve(aim, Ipopt(), start={u.name: known[u.name] for u in aim.unknowns if u.name in known})
                      ["commands"])


TRUTH: dict[str, Any] = {
    "sighting_error (sight)": [200 * arcsec, -80 * arcsec], "EY0A (A)": 0.3 * mm, "EB0A (A)": 80 * arcsec,
    "encoder_1x_C (C)": [60 * arcsec, 25 * arcsec], "encoder_1x_A (A)": [-20 * arcsec, 30 * arcsec]}
FIELD_FROM_BASE = geometry.Transform(geometry.rotation_from_rpy(0.004, -0.003, 0.8), np.array([0.3, -0.2, 1.4]))


def plan() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Commands (96, 2) [rad], targets (96, 3) [m] and their names: 16 targets around, three places in the image, two
    faces."""
    angle = np.arange(16) * 22.5 * degree
    away = np.tile([4.0, 9.0, 6.0], 6)[:16]
    around = np.stack([away * np.sin(angle), away * np.cos(angle), np.tile([-1.5, 1.0, 3.0, 5.5], 4)], axis=1)
    seen = FIELD_FROM_BASE.inverse() @ around
    first = np.stack([np.arctan2(-seen[:, 0], seen[:, 1]), np.arctan2(seen[:, 2], np.hypot(*seen.T[:2]))], axis=1)
    second = np.stack([first[:, 0] + np.pi, np.pi - first[:, 1]], axis=1)
    commands = np.concatenate([face + shift for face in (first, second)
                               for shift in np.array([[0, 0], [3, 2], [-3, -2]]) * degree])
    return np.round(commands / degree, 4) * degree, np.tile(around, (6, 1)), np.tile(np.arange(16) + 1, 6).astype(str)


def example(seed: int) -> Problem:
    """Sixteen targets in two faces, simulated with errors of the gimbal. seed: of the readings."""
    commands, targets, names = plan()
    problem = declare(commands, targets, None, 5 * arcsec, FIELD_FROM_BASE, names=names,
                      conditions=drawn_conditions(gimbal(), len(names), 9))
    return simulate(problem, {problem.parameters(n).name: np.atleast_2d(v) for n, v in TRUTH.items()}, seed)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with simulated readings: {file name: text}. seed: of the errors."""
    observations, (_, around, names) = example(seed).observations[0], plan()
    c = observations.covariates
    right, up = observations.recorded.T
    images = {"C_deg": c["C"], "A_deg": c["A"], "target": names, "right_arcsec": right, "up_arcsec": up}
    standing = {"target": names[:16], **xyz_mm(around[:16])}
    job = """problem = "problems.gimbal"

[data.images]
file = "images.csv"

[data.targets]
file = "targets.csv"

[options]
u = "5 arcsec"
"""
    return {"job.toml": job, "targets.csv": written("simulated, surveyed targets", standing), "images.csv": written(
        "simulated, camera on a two-axis gimbal", images | written_conditions(gimbal(), c))}


def scene(job: Job, estimate: Estimate) -> Scene:
    """The axes, and the targets where they stand, seen from the camera."""
    table, place = job.table("targets"), estimate["field_from_base"].inverse()
    targets = place @ np.stack([table.number(name, "length") for name in "xyz"], axis=1)
    return Scene((axes_of(gimbal()), Points("targets", targets, table.text("target")),
                  Sights("lines of sight", np.zeros(3), targets)))
