"""Base point of a tracking interferometer from readings along lines ("multilateration").

A tracking interferometer at an unknown base point B follows a reflector to target points P and reads how much longer,
or shorter, the path has become since it was zeroed: reading = sense (|P - B| - L0). The reflector is moved along lines
and its coordinate there is read by a fixed interferometer. Unknown are B (3) and the length L0 at the zero.
Source: Chen, Li, Zhang, Zhao, J. Astronautic Metrology and Measurement 27(2), 2007, 9-13 ("the paper"), equations 1
and 6 with their signs mended (docs/slips/base_point.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calib import Problem, simulate
from calib.errors import InputError
from calib.job import Job
from calib.table import written, xyz_mm
from calib.units import mm, um
from calib.workflow.compare.formulation import Formulation
from problems.base_point import algebraic, bound
from problems.base_point.declare import (
    COORDINATES,
    COUNTS,
    LENGTHENING,
    SHORTENING,
    AbsoluteRange,
    AdjustedCoordinates,
    ExactCoordinates,
    FreeStart,
    ProjectedCoordinates,
    TiedStart,
    Zero,
    declare,
    declare_one_line,
    effects,
    linear,
    with_recorded_effects,
)
from problems.base_point.lines import AXES, Lines, coordinates, directions, lines_of_case, lines_of_job, scene

__all__ = ["COUNTS", "LENGTHENING", "SHORTENING", "AbsoluteRange", "AdjustedCoordinates", "ExactCoordinates",
           "FreeStart", "ProjectedCoordinates", "TiedStart", "accepts", "declare", "declare_one_line", "effects",
           "example", "example_job", "formulations", "from_job", "published", "remarks", "reproduce", "scene",
           "with_recorded_effects"]
if TYPE_CHECKING:
    from calib.workflow.reproduce import Reproduction

accepts = ("base_point", "base-point", "basepoint_multilateration")
published = "base-point"


def from_job(job: Job) -> Problem:
    """The problem of a job with the table `lines`, or of a case folder of the scenario `basepoint_multilateration`.

    Instrument of the table: kind tracking_interferometer, u, counts ("lengthening" or "shortening"). Options:
    start_reading ("free", "tied", "absolute"), start_point (3,), base_point (3,) where it is about known, coordinates
    ("exact", "projected", "adjusted"), line_instrument (the name of the instrument that read the coordinates).
    Raises InputError naming file, line, key or column.
    """
    if "lines" in job.known:
        lines, known = lines_of_case(job), job.known
        limits = np.array([known.table("axis_range_mm").numbers(axis) for axis in AXES]) * mm
        about = known.quantity("base_point_approx", "length")
        problem = declare(lines, FreeStart(), ProjectedCoordinates(), begin=about)
        # a case has no place for a choice: about a single line only the distance matters, so one coordinate stays
        across = algebraic.turning_coordinate(lines.points, about)
        problem = problem.hold(problem.select("base_point").part(across)) if across else problem
        wavelength = known.quantity("wavelength", "length")
        return with_recorded_effects(problem, lines, limits.mean(axis=1), np.ptp(limits, axis=1) / 2, wavelength)
    lines, tracker, options = lines_of_job(job), job.instrument("lines"), job.options
    tracker.text("kind", "tracking_interferometer", ("tracking_interferometer",))
    sense = COUNTS[tracker.text("counts", among=tuple(COUNTS))]
    zeros = _zeros(job)
    choice = options.text("coordinates", "exact", tuple(COORDINATES))
    if choice != "exact" and not np.all(lines.u_coordinate > 0):
        raise InputError(f"{options.where('coordinates')}: '{choice}' needs the uncertainty of the coordinates; name "
                         "the instrument that read them in options.line_instrument, with its u, and add column line")
    problem = declare(lines, zeros[options.text("start_reading", "free", tuple(zeros))], COORDINATES[choice], sense,
                      options.quantity("base_point", "length", None))
    middle, half = (lines.points.max(axis=0) + lines.points.min(axis=0)) / 2, np.ptp(lines.points, axis=0) / 2
    return with_recorded_effects(problem, lines, middle, np.where(half > 0, half, 1.0))


def _zeros(job: Job) -> dict[str, Zero]:
    """What the option start_reading can say; without start_point a tied start was zeroed at the origin."""
    known = job.options.quantity("start_point", "length", None)
    zero_point = None if known is None else (float(known[0]), float(known[1]), float(known[2]))
    return {"free": FreeStart(zero_point), "tied": TiedStart(zero_point or (0.0, 0.0, 0.0)),
            "absolute": AbsoluteRange()}


def formulations(job: Job) -> dict[str, Formulation]:
    """Other ways to put the same readings: start free or tied, and, for one tracker, the linear difference of squares.

    The linear one leaves out that its bracket is |B|^2 - L0^2, and takes the readings on its left side as exact; a
    coordinate in which the targets do not differ is held at zero there. The global one proves a bound.
    """
    problem = from_job(job)
    found: dict[str, Formulation] = {"start free": problem}
    if "lines" in job.known:
        lines, sense = lines_of_case(job), LENGTHENING
    else:
        lines, sense = lines_of_job(job), COUNTS[job.instrument("lines").text("counts", among=tuple(COUNTS))]
        found = {f"start {name}": declare(lines, zero, sense=sense) for name, zero in _zeros(job).items()
                 if name != "absolute"}
        if np.all(lines.u_coordinate > 0):           # errors in variables beside ordinary least squares
            zero = _zeros(job)[job.options.text("start_reading", "free")]
            found |= {f"coordinates {name}": declare(lines, zero, one, sense) for name, one in COORDINATES.items()}
    if len(np.unique(lines.tracker)) == len(np.unique(lines.zeroing)) == 1:
        found["difference of squares"] = linear(lines, sense, problem)
    return {**found, "global bound": bound.of_readings(lines, sense)}


def remarks(job: Job) -> tuple[str, ...]:
    """What no reading of a job can show of the base points, in words; empty where all is seen."""
    return algebraic.unseen(coordinates(next(iter(job.tables.values()))))


def reproduce() -> Reproduction:
    """Every printed number of the paper beside what its own tables give: see `problems.base_point.paper`."""
    from problems.base_point import paper

    return paper.reproduce()


def example(seed: int) -> Problem:
    """One tracker on three lines of a machine, with simulated readings and all effects held; seed: of the noise."""
    run, zero, far = np.linspace(0.0, 0.8, 9), np.zeros(9), np.full(9, 0.8)
    there = np.vstack([np.column_stack(line) for line in ((run, zero, zero), (far, run, zero), (far, zero, run))])
    points, along = np.vstack([there, there[::-1]]), np.repeat(np.eye(3), 9, axis=0)
    along, minutes, forth = np.vstack([along, along[::-1]]), np.arange(len(points)), np.repeat([1.0, -1.0], len(there))
    lines = Lines(points, None, 0.5 * um, along, 0.2 * um, velocity=along * forth[:, None] * 4 * mm, covariates={
        "time": (60.0 * minutes, "s"), "temperature_difference": (0.3 * np.sin(minutes / 9.0), "K"),
        "block": 1 + minutes // 9, "abbe_x": (0.1 + 0.1 * along[:, 1], "m"), "abbe_y": (0.07 + 0.1 * along[:, 2], "m"),
        **directions(forth, along)})
    plan = declare(lines, FreeStart((0.0, 0.0, 0.0)), ProjectedCoordinates(), begin=(-0.2, 1.4, -0.3))
    return with_recorded_effects(simulate(plan, None, seed), lines, np.full(3, 0.4), np.full(3, 0.4))


def example_job(seed: int) -> dict[str, str]:
    """A runnable job {file name: text}: two perpendicular lines, readings that grow when the path shortens."""
    run, zero, far = np.linspace(0.05, 0.75, 15), np.zeros(15), np.full(15, 0.75)
    points = np.vstack([np.column_stack((run, zero, zero)), np.column_stack((far, run, zero))])
    plan = declare(Lines(points, None, 0.5 * um), TiedStart(), sense=SHORTENING, begin=(-0.2, 1.4, -0.23))
    read = simulate(plan, None, seed).observations[0]
    table = {"row": read.rows, "line": np.repeat(["X", "Y"], 15), **xyz_mm(points), "d_mm": read.recorded[:, 0]}
    return {"lines.csv": written(f"simulated, seed {seed}", table), "job.toml": EXAMPLE_JOB}


EXAMPLE_JOB = """problem = "problems.base_point"
[data.lines]
file = "lines.csv"
instrument = "tracker"
[instruments.tracker]
kind = "tracking_interferometer"
u = "0.5 um"
counts = "shortening"
[options]
start_reading = "free"
start_point_mm = [0.0, 0.0, 0.0]
[report]
quantities = ["base_point", "dead_path", "start_reading"]
"""
