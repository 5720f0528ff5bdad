"""Three-axis turntable: perpendicularity, intersection and positioning of three nested axes from reflectors by a
tracker.

An outer axis C (vertical), a middle axis A and an inner axis B carry each other. A tracker measures reflectors on the
inner table, each axis in steps with the others at a few places. The tracker's place and the reflectors' places are
unknown.
Source: ISO 230-1:2012, annex A (location errors); ISO 230-7:2015 (axes of rotation).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib import Effect, Estimate, Observations, Pose, Problem, Unknown, geometry, simulate
from calib.job import Job
from calib.mechanism import Frame, Mechanism, Rotary, encoder_harmonic, error_motion, location_errors, observe
from calib.mechanism.conditions import approaches, drawn_conditions, driven_by_conditions, written_conditions
from calib.mechanism.heldout import in_order, misses, postures, rms
from calib.mechanism.inputs import checked_positions, unlike_the_mechanism
from calib.mechanism.relation import crossing
from calib.mechanism.scene import measured
from calib.mechanism.start import place_of_points
from calib.scene import Scene
from calib.table import written, xyz_mm
from calib.units import arcsec, degree, um
from problems.recorded import recorded

accepts = ("problems.three_axis_turntable",)
AXES = ("C", "A", "B")
BLOCKS = 6
LOCATION = ("EY0A (A)", "EB0A (A)", "EX0B (B)", "EZ0B (B)", "EC0B (B)")  # what readings see wherever the tracker stands
REFLECTORS = {"1": (0.25, 0.0, 0.0), "2": (-0.10, 0.05, 0.22), "3": (-0.12, -0.05, -0.20)}
columns = {"points": {"C, A, B": "commanded angles", "reflector": "name", "x, y, z": "in the tracker's frame",
                      "C_approach, A_approach, B_approach": "+1 or -1, the direction an axis came from (optional)",
                      "time, temp, block": "when, in which temperature, after which set-up (optional)"}}
options = {"u": "standard uncertainty of a coordinate", "free": "further effects to estimate, such as "
                                                                "[\"encoder_1x_C\"]"}


def turntable() -> Mechanism:
    """Three axes that cross in one point at right angles: C vertical outside, A within it, B inside."""
    return Mechanism("three-axis turntable", axes=[Rotary("C", (0, 0, 1)), Rotary("A", (1, 0, 0), carried_by="C"),
                                                   Rotary("B", (0, 1, 0), carried_by="A")],
                     frames=[Frame("table", carried_by="B")])


def effects() -> tuple[Effect, ...]:
    """Location errors of A and B, two harmonics of each encoder, radial and tilt error motions of each axis, and what
    the conditions drive where they were noted."""
    mechanism = turntable()
    found = [e for e in location_errors(mechanism, ["A", "B"]) if e.label in LOCATION]
    for axis in mechanism.axes:
        found += [encoder_harmonic(axis, 1), encoder_harmonic(axis, 2)]
        found += [error_motion(axis, "XYZABC"[i + kind], (2,)) for i in range(3) if i != axis.along for kind in (0, 3)]
    return (*found, *driven_by_conditions(mechanism))


def declare(positions: ArrayLike, reflector: Sequence[object] | np.ndarray, points: ArrayLike | None, u: float,
            world: geometry.Transform, places: Mapping[str, ArrayLike], free: Sequence[str] = (),
            conditions: Mapping[str, Any] | None = None, rows: ArrayLike | None = None) -> Problem:
    """Declare the identification of the turntable.

    positions: (n, 3) of C, A, B [rad]; reflector: (n,) names; points: (n, 3) [m] or None to plan; u: standard
    uncertainty of a coordinate [m]; world: tracker_from_base, places: {reflector: (3,) on the table [m]}, both roughly;
    free: further effects; conditions: covariates such as `C_approach`; rows: numbers in the data file.
    Returns the problem with the unknowns `tracker_from_base`, `reflector`, the location errors free, and as quantities
    the departures from perpendicular and the distances of C and A, A and B.
    """
    mechanism = turntable()
    positions = checked_positions(mechanism, positions, rows)
    names = list(places)
    index = np.array([names.index(str(r)) for r in reflector])
    tracker = Pose("tracker_from_base", world.rotation, world.translation, unit="mm", angle_unit="arcsec")
    where = Unknown("reflector", np.array(list(places.values())), "mm", keys=names)
    observations = Observations(
        observe.measured_point(mechanism.pose("table")), tracker, positions, where[index], readings=points, u=u,
        group="points", unit="um", components=("x", "y", "z"), rows=rows,
        covariates={**(conditions or {}), "reflector": np.array(names)[index],
                    **{a: (positions[:, i], "rad") for i, a in enumerate(AXES)}})
    problem = Problem([observations], name="three-axis turntable")
    problem = problem.with_effects(*problem.acting(effects()))
    problem = problem.free(*(problem.parameters(name) for name in (*LOCATION, *free)))
    return problem.with_quantities(crossing(problem, mechanism, "C", "A"), crossing(problem, mechanism, "A", "B"))


def from_job(job: Job) -> Problem:
    """Declare the turntable of a job: table [data.points], options u and free. The tracker's place is found from the
    data."""
    table, positions = job.table("points"), _positions(job)
    points = np.stack([table.number(name, "length") for name in "xyz"], axis=1)
    u, free = job.options.quantity("u", "length"), job.options.texts("free", ())
    reflector = table.text("reflector")
    checked_positions(turntable(), positions, table.row_numbers, str(table.path))
    unlike_the_mechanism(turntable(), "table", positions, reflector, points, str(table.path))
    world, places = place_of_points(turntable(), "table", positions, reflector, points)
    return declare(positions, reflector, points, u, world, places, free,
                   {**approaches(turntable(), table), **recorded(job, table)}, table.row_numbers)


def _positions(job: Job) -> np.ndarray:
    return np.stack([job.table("points").number(name, "angle") for name in AXES], axis=1)


def heldout(job: Job, estimate: Estimate) -> list[tuple[str, float, float, str]]:
    """Miss of reflectors in postures that were not used: axes as designed before, identified after.

    Sixths of the recorded postures, in their order, are predicted from the others. Returns (quantity, before, after,
    unit).
    """
    problem = estimate.problem
    errors = [a.unknown for a in problem.attached if not problem.is_held(a.unknown).all()]
    before, after = misses(problem, "points", in_order(postures(_positions(job)), BLOCKS), errors, estimate)
    return [("rms miss of a reflector in postures not used", rms(before) / um, rms(after) / um, "um")]


def _plan() -> tuple[np.ndarray, list[str]]:
    turns = np.arange(0, 360, 30) * degree
    rest = [0.0, 60 * degree]
    rows = [(t, a, b) for t in turns for a in rest for b in rest[:1]] + [(0.0, t, b) for t in turns for b in rest] + \
        [(c, 0.4, t) for t in turns for c in rest]
    positions = np.repeat(np.array(rows), len(REFLECTORS), axis=0)
    return positions, [name for _ in rows for name in REFLECTORS]


TRUTH = {"EY0A (A)": 8 * um, "EB0A (A)": 3 * arcsec, "EX0B (B)": -12 * um, "EZ0B (B)": 5 * um, "EC0B (B)": -4 * arcsec}


def example(seed: int) -> Problem:
    """Three reflectors in 72 postures, simulated with errors of the axes. seed: of the readings."""
    positions, reflector = _plan()
    world = geometry.Transform(geometry.rotation_from_rpy(0.02, -0.01, 1.0), np.array([2.5, 0.4, 0.3]))
    problem = declare(positions, reflector, None, 5 * um, world, REFLECTORS, ("encoder_1x_C",),
                      drawn_conditions(turntable(), len(positions), 9))
    truth: dict[str, Any] = {problem.parameters(name).name: [[value]] for name, value in TRUTH.items()}
    truth[problem.parameters("encoder_1x_C").name] = [[2 * arcsec, -3 * arcsec]]
    return simulate(problem, truth, seed)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with simulated readings: {file name: text}. seed: of the errors."""
    problem = example(seed)
    observations = problem.observations[0]
    c = observations.covariates
    points = {**{f"{axis}_deg": c[axis] for axis in AXES}, "reflector": c["reflector"],
              **xyz_mm(observations.recorded), **written_conditions(turntable(), c)}
    job = 'problem = "problems.three_axis_turntable"\n\n[data.points]\nfile = "points.csv"\n\n[options]\nu = "5 um"\n' \
          'free = ["encoder_1x_C"]\n'
    return {"job.toml": job,
            "points.csv": written("simulated, tracker and three reflectors on a three-axis turntable", points)}


def scene(job: Job, estimate: Estimate) -> Scene:
    """The axes, the reflectors with their uncertainty, where they were measured and the tracker."""
    problem = estimate.problem
    reflector, tracker = (problem.select(name).unknown for name in ("reflector", "tracker_from_base"))
    index = [reflector.keys.index(name) for name in job.table("points").text("reflector")]
    return measured(turntable(), estimate.fit, "table", _positions(job), np.asarray(estimate[reflector])[index],
                    tracker, reflector)
