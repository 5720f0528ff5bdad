"""Five-axis motion simulator as two chains: a three-axis table that turns a seeker, a two-axis table that carries its
target.

The seeker stands on a roll axis R, on a pitch axis P, on a yaw axis Y; the target on a pitch axis Q, on a yaw axis W
around them. As designed all five axes meet in one point; at zero Y and W point up, P and Q to the left, R ahead.
Two instruments of different kind measure: a tracker sees reflectors on both tables, and the seeker itself, a camera on
R, sees the target on Q, where the two chains act against each other. Unknown are the tracker's frame, the reflectors,
the camera's sight, and how the axes lie to each other; results are the angles and distances of the axes.
`problems.five_axis` holds the procedure of a paper with theodolites and level for the same simulator.
Source: ISO 230-1:2012, annex A (location errors).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from casadi import atan2, vertcat
from numpy.typing import ArrayLike

from calib import Effect, Estimate, Observations, Pose, Problem, Unknown, geometry, hands_slots_to, simulate
from calib.analyse.shapes import points_of, stations_of
from calib.errors import InputError
from calib.job import Job
from calib.mechanism import Frame, Mechanism, Rotary, encoder_harmonic, location_errors, observe
from calib.mechanism.heldout import in_order, misses, postures, rms
from calib.mechanism.inputs import checked_positions, unlike_the_mechanism
from calib.mechanism.relation import crossing, parallelism
from calib.mechanism.scene import axes_of
from calib.mechanism.start import place_of_points, places_on
from calib.scene import Scene, Sights
from calib.table import written, xyz_mm
from calib.units import arcsec, degree, um

accepts = ("problems.motion_simulator",)
AXES = ("Y", "P", "R", "W", "Q")
FRAMES = ("seeker", "target")
BLOCKS = 6
MARK = "T1"         # the reflector on Q that the camera looks at
# What readings see wherever tracker, reflectors and camera sit.
LOCATION = ("EX0P (P)", "EA0P (P)", "EB0P (P)", "EY0R (R)", "EZ0R (R)", "EC0R (R)", "EX0W (W)", "EY0W (W)", "EA0W (W)",
            "EB0W (W)", "EC0W (W)", "EX0Q (Q)", "EZ0Q (Q)", "EA0Q (Q)")
columns = {
    "points": {"Y, P, R, W, Q": "commanded angles", "reflector": "name; those on the target's table begin with T",
               "x, y, z": "in the tracker's frame"},
    "sights": {"Y, P, R, W, Q": "commanded angles", "left, up": "where the target stands before the camera, angles"}}
options = {"u_point": "standard uncertainty of a coordinate", "u_sight": "of an angle of the camera",
           "free": "further effects to estimate, such as [\"encoder_1x_Y\"]"}


@lru_cache(maxsize=1)
def simulator() -> Mechanism:
    """Both chains from one base, X ahead, Y to the left, Z up."""
    return Mechanism("motion simulator", axes=[
        Rotary("Y", (0, 0, 1)), Rotary("P", (0, 1, 0), carried_by="Y"), Rotary("R", (1, 0, 0), carried_by="P"),
        Rotary("W", (0, 0, 1)), Rotary("Q", (0, 1, 0), carried_by="W", limits=(-1.0, 1.0))],
        frames=[Frame("seeker", carried_by="R"), Frame("target", carried_by="Q")])


chain_to_chain = simulator().pose("target", seen_from="seeker")


@hands_slots_to(chain_to_chain)
def sight(camera: Any, positions: Any, mark: Any, **slots: Any) -> Any:
    """Where a mark (3,) [m] of the target stands before the camera (seeker_from_camera): left and up [rad]."""
    seen = camera.inverse() @ (chain_to_chain(positions, **slots) @ mark)
    return vertcat(atan2(seen[1], seen[0]), atan2(seen[2], seen[0]))


@lru_cache(maxsize=1)
def effects() -> tuple[Effect, ...]:
    """The location errors of LOCATION, two harmonics of each encoder."""
    mechanism = simulator()
    return (*(e for e in location_errors(mechanism) if e.label in LOCATION),
            *(encoder_harmonic(axis, order) for axis in mechanism.axes for order in (1, 2)))


def declare(positions: ArrayLike, reflector: Sequence[str] | np.ndarray, points: ArrayLike | None, u_point: float,
            looking: ArrayLike, sights: ArrayLike | None, u_sight: float, world: geometry.Transform,
            places: Mapping[str, ArrayLike], free: Sequence[str] = (),
            rows: tuple[ArrayLike | None, ArrayLike | None] = (None, None)) -> Problem:
    """Declare the identification of both chains.

    positions: (n, 5) of AXES [rad], reflector: (n,) names, points: (n, 3) [m] or None to plan; looking: (m, 5) [rad],
    sights: (m, 2) [rad] or None; u_point [m], u_sight [rad]: standard uncertainty of each component; world:
    tracker_from_base, roughly; places: {reflector: (3,) roughly on its table [m]}, those on Q begin with T; free:
    further effects; rows: numbers in the two data files.
    """
    mechanism, reflector = simulator(), np.asarray(reflector).astype(str)
    positions, looking = (checked_positions(mechanism, p, r) for p, r in zip((positions, looking), rows, strict=True))
    tracker = Pose("tracker_from_base", world.rotation, world.translation, unit="mm", angle_unit="arcsec")
    camera = Pose("seeker_from_camera", unit="mm", angle_unit="arcsec")
    where = Unknown("reflector", np.array(list(places.values())), "mm", keys=list(places))
    index, observations = np.array([list(places).index(r) for r in reflector]), []
    for frame, chosen in zip(FRAMES, tables_of(reflector), strict=True):
        observations.append(Observations(
            observe.measured_point(mechanism.pose(frame)), tracker, positions[chosen], where[index[chosen]],
            readings=None if points is None else np.asarray(points)[chosen], u=u_point, group=f"points on {frame}",
            unit="um", components=("x", "y", "z"), rows=None if rows[0] is None else np.asarray(rows[0])[chosen],
            covariates={"reflector": reflector[chosen], **_angles(positions[chosen])}))
    observations.append(Observations(
        sight, camera, looking, where[np.full(len(looking), list(places).index(MARK))], readings=sights, u=u_sight,
        group="sights", unit="arcsec", components=("left", "up"), rows=rows[1], covariates=_angles(looking)))
    problem = Problem(observations, effects=effects(), name="five-axis motion simulator").free(*LOCATION, *free)
    pairs = [crossing(problem, mechanism, *pair) for pair in (("Y", "P"), ("P", "R"), ("W", "Q"))]
    return problem.with_quantities(*pairs, *(parallelism(problem, mechanism, *pair) for pair in ("YW", "PQ")))


def _angles(positions: np.ndarray) -> dict[str, tuple[np.ndarray, str]]:
    return {axis: (positions[:, i], "rad") for i, axis in enumerate(AXES)}


def tables_of(reflector: Sequence[str] | np.ndarray) -> list[np.ndarray]:
    """For each of FRAMES which rows (n,) it carries: the names of reflectors on the target's table begin with T."""
    on_target = np.char.startswith(np.asarray(reflector).astype(str), "T")
    return [~on_target, on_target]


def from_job(job: Job) -> Problem:
    """Declare the simulator of a job: tables [data.points] and [data.sights], options u_point, u_sight and free."""
    table, seen = job.table("points"), job.table("sights")
    positions, looking = (np.stack([t.number(name, "angle") for name in AXES], axis=1) for t in (table, seen))
    points = np.stack([table.number(name, "length") for name in "xyz"], axis=1)
    reflector = np.asarray(table.text("reflector"))
    on_seeker, on_target = tables_of(reflector)
    if MARK not in reflector or not on_seeker.any():
        raise InputError(f"{table.path}: there is no reflector {MARK if on_seeker.any() else 'on the seeker'}; call "
                         f"those on the seeker S1, S2 ..., those on the target T1, T2 ...; the camera sees {MARK}.")
    for one, angles in ((table, positions), (seen, looking)):
        checked_positions(simulator(), angles, one.row_numbers, str(one.path))
    for frame, chosen in zip(FRAMES, (on_seeker, on_target), strict=True):
        unlike_the_mechanism(simulator(), frame, positions[chosen], reflector[chosen], points[chosen], str(table.path))
    world, places = place_of_points(simulator(), "seeker", positions[on_seeker], reflector[on_seeker],
                                    points[on_seeker])
    places |= places_on(simulator(), "target", positions[on_target], reflector[on_target], points[on_target], world)
    return declare(positions, reflector, points, job.options.quantity("u_point", "length"), looking,
                   np.stack([seen.number(name, "angle") for name in ("left", "up")], axis=1),
                   job.options.quantity("u_sight", "angle"), world, places, job.options.texts("free", ()),
                   (table.row_numbers, seen.row_numbers))


def heldout(job: Job, estimate: Estimate) -> list[tuple[str, float, float, str]]:
    """Sights that were not used, which join the two chains: simulator as designed before, identified after.

    Sixths of the sights are predicted from the other ones and all points. Returns (quantity, before, after, unit).
    """
    problem = estimate.problem
    looking = np.stack([job.table("sights").number(name, "angle") for name in AXES], axis=1)
    errors = [a.unknown for a in problem.attached if not problem.is_held(a.unknown).all()]
    before, after = misses(problem, "sights", in_order(postures(looking), BLOCKS), errors, estimate)
    return [("rms miss of the target in sights not used", rms(before) / arcsec, rms(after) / arcsec, "arcsec")]


TRUTH = {"EX0P (P)": 30 * um, "EA0P (P)": 8 * arcsec, "EB0P (P)": -12 * arcsec, "EY0R (R)": -20 * um,
         "EZ0R (R)": 15 * um, "EC0R (R)": 5 * arcsec, "EX0W (W)": 40 * um, "EY0W (W)": -25 * um,
         "EA0W (W)": 10 * arcsec, "EB0W (W)": -6 * arcsec, "EC0W (W)": 15 * arcsec, "EX0Q (Q)": 35 * um,
         "EZ0Q (Q)": -45 * um, "EA0Q (Q)": 7 * arcsec}
PLACES = {"S1": (0.25, 0.0, 0.0), "S2": (-0.10, 0.20, 0.05), "S3": (-0.05, -0.12, 0.18),
          "T1": (1.2, 0.0, 0.0), "T2": (1.1, 0.25, -0.05), "T3": (1.0, -0.1, 0.3)}
WORLD = geometry.Transform(geometry.rotation_from_rpy(0.01, -0.02, 1.2), np.array([0.5, -3.0, 0.2]))


def plan() -> tuple[np.ndarray, list[str], np.ndarray]:
    """Postures of the points (n, 5) [rad] with the reflector of each, and of the sights (m, 5) [rad]."""
    turns, few = np.arange(0, 360, 30) * degree, [0.0, 50 * degree]
    seeker = [(y, p, 0.0, 0.0, 0.0) for y in turns for p in few] + [(0.0, p, 0.0, 0.0, 0.0) for p in turns] \
        + [(y, 0.3, r, 0.0, 0.0) for r in turns for y in few]
    target = [(0.0, 0.0, 0.0, w, q) for w in turns for q in (-30 * degree, 0.0, 30 * degree)]
    rows = [(row, name) for rows, names in ((seeker, "S"), (target, "T")) for row in rows for name in PLACES
            if name.startswith(names)]
    generator = np.random.default_rng(4)
    y, p = generator.uniform(-60, 60, 40) * degree, generator.uniform(-25, 25, 40) * degree
    # the target follows the seeker's sight to a few degrees
    aside = generator.uniform(-5, 5, (40, 2)) * degree
    looking = np.stack([y, p, generator.choice(turns, 40), y + aside[:, 0], p + aside[:, 1]], axis=1)
    return np.array([row for row, _ in rows]), [name for _, name in rows], np.round(looking / degree, 4) * degree


def example(seed: int) -> Problem:
    """Three reflectors on each table in 84 postures and 40 sights, simulated with errors. seed: of the readings."""
    positions, reflector, looking = plan()
    problem = declare(positions, reflector, None, 10 * um, looking, None, 2 * arcsec, WORLD, PLACES)
    return simulate(problem, {problem.parameters(n).name: [[v]] for n, v in TRUTH.items()}, seed)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with simulated readings: {file name: text}. seed: of the errors."""
    on_seeker, on_target, seen = example(seed).observations
    left, up = seen.recorded.T
    sights = {**{f"{axis}_deg": seen.covariates[axis] for axis in AXES}, "left_arcsec": left, "up_arcsec": up}
    both = (on_seeker, on_target)
    points = {**{f"{axis}_deg": np.concatenate([table.covariates[axis] for table in both]) for axis in AXES},
              "reflector": np.concatenate([table.covariates["reflector"] for table in both]),
              **xyz_mm(np.vstack([table.recorded for table in both]))}
    job = """problem = "problems.motion_simulator"

[data.points]
file = "points.csv"

[data.sights]
file = "sights.csv"

[options]
u_point = "10 um"
u_sight = "2 arcsec"
"""
    return {"job.toml": job, "sights.csv": written("simulated, camera of the seeker", sights),
            "points.csv": written("simulated, tracker on both tables of a five-axis simulator", points)}


def scene(job: Job, estimate: Estimate) -> Scene:
    """The axes, the reflectors of both tables with their uncertainty, and the tracker that sees them."""
    reflector, tracker = (estimate.problem.select(name).unknown for name in ("reflector", "tracker_from_base"))
    places, eyes = points_of(estimate.fit, reflector), stations_of(estimate.fit, tracker)
    return Scene((axes_of(simulator()), places, eyes, Sights("measured", eyes.places[0], places.places)))
