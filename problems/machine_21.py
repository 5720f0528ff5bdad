"""Three-axis machine with 21 errors: six error motions of each linear axis and three squarenesses, from three
reflectors.

Z is carried by Y, Y by X. A tracking interferometer or tracker measures three reflectors at different offsets on the
spindle, over the volume; the reflectors' offsets and the tracker's place are unknown. The error motions are polynomials
over the travel that cannot imitate a squareness or a zero.
Source: ISO 230-1:2012, 3.4 and annex A; Schwenke et al., CIRP Annals 57(2), 2008 (geometric error measurement).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib import Effect, Estimate, Observations, Pose, Problem, Unknown, geometry, prior, simulate
from calib.errors import InputError
from calib.job import Job
from calib.mechanism import Frame, Linear, Mechanism, error_motions, location_errors, observe
from calib.mechanism.conditions import approaches, drawn_conditions, driven_by_conditions, written_conditions
from calib.mechanism.heldout import misses, postures, rms
from calib.mechanism.inputs import checked_positions
from calib.mechanism.scene import measured
from calib.mechanism.start import nearest_motion
from calib.mechanism.tolerance import tolerances
from calib.scene import Scene
from calib.table import written, xyz_mm
from calib.units import mm, um
from problems.recorded import recorded

accepts = ("problems.machine_21",)
BLOCKS = 5
LARGEST_MISS = 10 * mm      # more than errors of manufacture: another unit, sign or reflector
SQUARENESS = ("EC0Y (Y)", "EA0Z (Z)", "EB0Z (Z)")
OFFSETS = np.array([[0.0, 0.0, -0.10], [0.15, 0.0, -0.12], [0.0, 0.15, -0.20]])
columns = {"points": {"X, Y, Z": "commanded positions", "reflector": "name", "x, y, z": "in the tracker's frame",
                      "X_approach, Y_approach, Z_approach": "+1 or -1, the direction an axis came from (optional)",
                      "time, temp, block": "when, in which temperature, after which set-up (optional)"}}
options = {"u": "standard uncertainty of a coordinate", "u_offset": "of the stated offset of a reflector on the "
                                                                    "spindle",
           "u_motion": "how large an error motion may be, a length", "u_turn": "how large an angular one may be"}


def machine() -> Mechanism:
    """The machine as designed: travels of 1.0, 0.6 and 0.4 m."""
    return Mechanism("three-axis machine", axes=[Linear("X", (1, 0, 0), limits=(0.0, 1.0)),
                                                 Linear("Y", (0, 1, 0), carried_by="X", limits=(0.0, 0.6)),
                                                 Linear("Z", (0, 0, 1), carried_by="Y", limits=(0.0, 0.4))],
                     frames=[Frame("spindle", carried_by="Z")])


def effects() -> tuple[Effect, ...]:
    """The 21 errors, EXX, EYX ... ECZ and the squarenesses EC0Y, EA0Z, EB0Z; what the conditions drive where noted."""
    mechanism = machine()
    return (*(e for e in location_errors(mechanism, ["Y", "Z"]) if e.label in SQUARENESS), *error_motions(mechanism),
            *driven_by_conditions(mechanism))


def declare(positions: ArrayLike, reflector: Sequence[object] | np.ndarray, points: ArrayLike | None, u: float,
            offsets: dict[str, ArrayLike],
            world: geometry.Transform, u_offset: float = 0.2 * mm, u_motion: float = 50 * um, u_turn: float = 100e-6,
            conditions: Mapping[str, Any] | None = None, rows: ArrayLike | None = None) -> Problem:
    """Declare the identification of all 21 errors.

    positions: (n, 3) [m]; reflector: (n,) names; points: (n, 3) [m] in the tracker's frame or None to plan; u: standard
    uncertainty of a coordinate [m]; offsets: {name: (3,)} on the spindle, known to u_offset [m]; world:
    tracker_from_base, roughly; u_motion [m], u_turn [rad]: how large a coefficient of an error motion may be;
    conditions: covariates such as `X_approach`; rows: numbers in the data file.
    """
    mechanism = machine()
    positions = checked_positions(mechanism, positions, rows)
    names = list(dict.fromkeys(str(r) for r in reflector))
    index = np.array([names.index(str(r)) for r in reflector])
    tracker = Pose("tracker_from_base", world.rotation, world.translation, unit="mm", angle_unit="urad")
    places = Unknown("reflector", np.array([offsets[n] for n in names]), "mm", keys=names)
    observations = Observations(
        observe.measured_point(mechanism.pose("spindle")), tracker, positions, places[index], readings=points, u=u,
        group="points",
        unit="um", components=("x", "y", "z"), rows=rows,
        covariates={**(conditions or {}), "reflector": np.array(names)[index],
                    **{a: (positions[:, i], "m") for i, a in enumerate("XYZ")}})
    problem = Problem([observations, prior(places, places.ambient, u_offset, name="offsets of the reflectors")],
                      name="three-axis machine")
    problem = problem.with_effects(*problem.acting(effects()))
    motions = [e for e in problem.effects if e.slot.endswith("_motion")]
    lengths = {e: u_motion for e in motions if e.name[1] in "XYZ"}
    turns = {e: u_turn for e in motions if e.name[1] in "ABC"}
    return problem.free(*SQUARENESS, *motions).with_observations(tolerances(problem, lengths, "size of error motions"),
                                                            tolerances(problem, turns, "size of angular error motions"))


def from_job(job: Job) -> Problem:
    """Declare the machine of a job: tables [data.points] and [data.offsets] (reflector, x, y, z on the spindle)."""
    table, mounted = job.table("points"), job.table("offsets")
    positions = np.stack([table.number(name, "length") for name in "XYZ"], axis=1)
    points = np.stack([table.number(name, "length") for name in "xyz"], axis=1)
    offsets = dict(zip(mounted.text("reflector"), np.stack([mounted.number(n, "length") for n in "xyz"], axis=1),
                       strict=True))
    reflector, where = table.text("reflector"), str(table.path)
    checked_positions(machine(), positions, table.row_numbers, where)
    lacking = [r for r in dict.fromkeys(reflector) if r not in offsets]
    if lacking:
        raise InputError(f"{where}: reflector '{lacking[0]}' has no offset in {mounted.path}; add its row there.")
    nominal = positions + np.array([offsets[r] for r in reflector])
    world = nearest_motion(points, nominal)
    missed = np.linalg.norm(points - world @ nominal, axis=1)
    if np.sqrt(np.mean(missed ** 2)) > LARGEST_MISS:
        raise InputError(f"{where}: the points miss the machine as it is designed by "
                         f"{np.sqrt(np.mean(missed ** 2)) / mm:.3g} mm (rms), most in row "
                         f"{table.row_numbers[np.argmax(missed)]}; check signs, order and units of the columns, and "
                         "the names of the reflectors.")
    return declare(positions, reflector, points, job.options.quantity("u", "length"), offsets,
                   world, job.options.quantity("u_offset", "length", 0.2 * mm),
                   job.options.quantity("u_motion", "length", 50 * um),
                   job.options.quantity("u_turn", "angle", 100e-6),
                   {**approaches(machine(), table), **recorded(job, table)}, table.row_numbers)


def heldout(job: Job, estimate: Estimate) -> list[tuple[str, float, float, str]]:
    """Miss of reflectors at places that were not used: machine as designed before, with its 21 errors after.

    Every fifth place is predicted from the others. Returns (quantity, before, after, unit).
    """
    problem, table = estimate.problem, job.table("points")
    places = postures(np.stack([table.number(name, "length") for name in "XYZ"], axis=1))
    before, after = misses(problem, "points", places % BLOCKS, [a.unknown for a in problem.attached], estimate)
    return [("rms miss of a reflector at places not used", rms(before) / um, rms(after) / um, "um")]


TRUTH = {"EC0Y (Y)": 20e-6, "EA0Z (Z)": -15e-6, "EB0Z (Z)": 8e-6, "EYX (X)": [3 * um, -2 * um],
         "EXX (X)": [10 * um, 1 * um, 0],
         "EAX (X)": [5e-6, -3e-6, 1e-6], "ECZ (Z)": [-4e-6, 2e-6, 0]}


def example(seed: int) -> Problem:
    """Three reflectors at 80 places of the volume, simulated with errors. seed: of the readings."""
    grid = np.stack([g.ravel() for g in np.meshgrid(np.linspace(0, 1.0, 5), np.linspace(0, 0.6, 4),
                                                    np.linspace(0, 0.4, 4),
                                                    indexing="ij")], axis=1)
    positions, names = np.repeat(grid, 3, axis=0), [str(i + 1) for _ in grid for i in range(3)]
    world = geometry.Transform(geometry.rotation_from_rpy(0.01, 0.02, 0.5), np.array([-1.5, -1.0, 0.4]))
    problem = declare(positions, names, None, 1 * um, {str(i + 1): OFFSETS[i] for i in range(3)}, world,
                      conditions=drawn_conditions(machine(), len(names), 9))
    truth = {problem.parameters(n).name: np.atleast_2d(np.asarray(v)) for n, v in TRUTH.items()}
    return simulate(problem, truth, seed)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with simulated readings: {file name: text}. seed: of the errors."""
    observations = example(seed).observations[0]
    c = observations.covariates
    points = {"X_mm": c["X"], "Y_mm": c["Y"], "Z_mm": c["Z"], "reflector": c["reflector"],
              **xyz_mm(observations.recorded), **written_conditions(machine(), c)}
    mounted = {"reflector": np.arange(len(OFFSETS)) + 1, **xyz_mm(OFFSETS)}
    job = """problem = "problems.machine_21"

[data.points]
file = "points.csv"

[data.offsets]
file = "offsets.csv"

[options]
u = "1 um"
"""
    return {"job.toml": job, "offsets.csv": written("simulated", mounted), "points.csv": written(
        "simulated, tracking interferometer and three reflectors on the spindle", points)}


def scene(job: Job, estimate: Estimate) -> Scene:
    """The axes, the reflectors with their uncertainty, the places they were measured at and the tracker."""
    table, problem = job.table("points"), estimate.problem
    reflector, tracker = (problem.select(name).unknown for name in ("reflector", "tracker_from_base"))
    index = [reflector.keys.index(name) for name in table.text("reflector")]
    positions = np.stack([table.number(name, "length") for name in "XYZ"], axis=1)
    return measured(machine(), estimate.fit, "spindle", positions, np.asarray(estimate[reflector])[index], tracker,
                    reflector)
