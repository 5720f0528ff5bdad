"""Plumb fit: the direction of vertical turning axes from a level that turns with them, over a part turn or a full one.

The level reads its zero plus the inclination of its seat,

    reading = zero - theta_y cos(gamma) + theta_x sin(gamma)

theta_x, theta_y are the plumb error of the axis; zero holds the zero of the level and the set of its seat against the
axis. A known tilt may be applied to a table between set-ups. Several tables may be read; their parallelism is a result.

Source: Ren, Gao, Zhao (2015), J. Harbin Inst. Tech. 47(10), eq (1)-(3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from casadi import cos, sin, sqrt
from numpy.typing import ArrayLike

from calib import Effect, Gaussian, Observations, Parameter, Problem, Quantity, Unknown, hands_slots_to, simulate
from calib.errors import InputError
from calib.job import Job
from calib.table import written
from calib.units import arcsec, degree, hour, minute
from instruments import level
from problems.recorded import recorded

accepts = ("problems.plumb", "level_plumb")
SOURCE = "FORMAT of the discrepancy cases; axis tilt error motion: ISO 230-7:2015, 3.2"


@hands_slots_to(level.on_turning_axis)
def level_on_table(axis_tilt: Any, applied_tilt: Any, angle: Any, zero: Any, **slots: Any) -> Any:
    """Reading of a level on a turning table [rad].

    axis_tilt: (2,) plumb error theta_x, theta_y [rad]; applied_tilt: (2,) added to it in this set-up [rad]; angle: of
    the table [rad]; zero: of the level [rad]. Slots: those of the level.
    """
    return level.on_turning_axis(axis_tilt + applied_tilt, angle, zero, **slots)


def difference(first: Any, second: Any) -> Any:
    """Plumb error of the second table less that of the first, and its length: the parallelism, eq (3) [rad]."""
    x, y = second[0] - first[0], second[1] - first[1]
    return [x, y, sqrt(x**2 + y**2)]


def declare(
    angle: ArrayLike,
    reading: ArrayLike | None,
    u: ArrayLike | Gaussian,
    table: ArrayLike | None = None,
    applied_tilt: ArrayLike | None = None,
    covariates: dict[str, Any] | None = None,
    rows: ArrayLike | None = None,
) -> Problem:
    """Declare the plumb fit of one or more tables.

    angle: (n,) [rad]; reading: (n,) [rad] or None to plan; u: standard uncertainty of a reading [rad] or Gaussian;
    table: (n,) key of the table of each row (one table if not given); applied_tilt: (n, 2) [rad]; covariates: as of
    Observations; rows: numbers in the data file.
    Returns the problem with unknowns `plumb` (theta_x, theta_y of each table) and `zero`, and `parallelism` of two
    tables.
    """
    angle = np.asarray(angle, float)
    keys = ["table"] * len(angle) if table is None else [str(t) for t in np.asarray(table)]
    tables = list(dict.fromkeys(keys))
    index = np.array([tables.index(k) for k in keys])
    named = None if table is None else tables
    first = (
        np.zeros(len(tables))
        if reading is None
        else np.array([np.mean(np.asarray(reading)[index == i]) for i in range(len(tables))])
    )
    plumb = Unknown("plumb", np.zeros((len(tables), 2)), "arcsec", parts=("x", "y"), keys=named)
    zero = Unknown("zero", first[:, None], "arcsec", keys=named)
    applied = np.zeros((len(angle), 2)) if applied_tilt is None else np.asarray(applied_tilt, float)
    readings = Observations(
        level_on_table,
        plumb[index],
        applied,
        angle,
        zero[index],
        readings=reading,
        u=u,
        group="level",
        unit="arcsec",
        covariates={"table": np.array(keys), "angle": (angle, "rad"), **(covariates or {})},
        rows=rows,
    )
    quantities = []
    if len(tables) == 2:
        quantities.append(
            Quantity("parallelism", difference, plumb[0], plumb[1], unit="arcsec", parts=("x", "y", "total"))
        )
    return Problem([readings], quantities=quantities, name="plumb fit")


def effects(blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """The effects of the level, and tilt error motions of two and three lobes of each table.

    blocks: seatings of the level at which a step may have happened. Returns the effects.
    """
    amplitudes = tuple(Parameter(name, "arcsec", (0.05 * arcsec, 10 * arcsec)) for name in ("c", "s"))
    motions = [
        Effect(f"tilt_motion_{order}x", "reading", _lobes(order), amplitudes, "table", per="table", source=SOURCE)
        for order in (2, 3)
    ]
    return (*(e for e in level.effects(blocks) if e.name not in ("zero", "settling")), *motions)


def _lobes(order: int) -> Callable[..., Any]:
    return lambda value, p, angle: p.c * cos(order * angle) + p.s * sin(order * angle)


def from_job(job: Job) -> Problem:
    """Declare the plumb fit of a job or of a case of scenario `level_plumb`.

    Columns of [data.level] (or measurements.csv): angle, reading; where there are: table, setup, direction, block,
    time, temp. The instrument gives u (or sigma); [known] applied_tilt and reference_temperature as in the case format.
    Raises InputError where something is missing.
    """
    case = "measurements" in job.tables
    data = job.table("measurements" if case else "level")
    instrument = job.instruments.table("level") if case else job.instrument("level")
    u = instrument.quantity("sigma", "angle") if case else instrument.uncertainty("u", "angle")[0]
    angle = data.number("angle", "angle")
    covariates = recorded(job, data)
    problem = declare(
        angle,
        data.number("reading", "angle"),
        u,
        data.text("table") if data.has("table") else None,
        _applied(job, data, len(angle)),
        covariates,
        data.row_numbers,
    )
    blocks = sorted(set(covariates.get("block", [])))[1:]
    have = {*covariates, "angle", "table", "inclination"}
    return problem.with_effects(*(e for e in effects(blocks) if set(e.inputs) <= have))


def _applied(job: Job, data: Any, n: int) -> np.ndarray:
    applied = np.zeros((n, 2))
    tilts = {
        one.whole("setup"): [one.quantity("dtheta_x", "angle"), one.quantity("dtheta_y", "angle")]
        for one in job.known.tables("applied_tilt")
    }
    if tilts:
        for row, setup in enumerate(data.whole("setup")):
            if int(setup) not in tilts:
                raise InputError(
                    f"{job.path}: set-up {setup} of the readings has no [[known.applied_tilt]]; there are "
                    f"{', '.join(map(str, tilts))}; add it, with zeros where nothing was applied."
                )
            applied[row] = tilts[int(setup)]
    return applied


def example(seed: int) -> Problem:
    """Two tables read over 90 degrees, the first also after a known tilt; simulated readings.

    seed: of the errors. Returns the problem with its effects as held candidates.
    """
    sweep = np.arange(0.0, 91.0, 5.0) * degree
    angle = np.tile(np.concatenate([sweep, sweep[::-1]]), 2)
    n = len(angle)
    half = n // 2
    table = ["three-axis"] * half + ["two-axis"] * half
    applied = np.zeros((n, 2))
    applied[len(sweep) : half] = np.array([40.0, 0.0]) * arcsec
    applied[half + len(sweep) :] = np.array([0.0, 40.0]) * arcsec
    time = np.arange(n) * 2 * minute
    problem = declare(
        angle,
        None,
        0.2 * arcsec,
        table,
        applied,
        {
            "time": (time, "s"),
            "temperature_difference": (0.4 * np.sin(time / (2 * hour)), "K"),
            "direction": np.tile(np.repeat([1, -1], len(sweep)), 2),
            "block": np.repeat([1, 2], half),
        },
    )
    truth = {"plumb": np.array([[-1.7, 2.4], [-1.4, -0.8]]) * arcsec, "zero": np.array([[66.0], [152.0]]) * arcsec}
    return simulate(problem.with_effects(*effects(blocks=(2,))), truth, seed)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with simulated readings: {file name: text}. seed: of the errors."""
    observations = example(seed).observations[0]
    c = observations.covariates
    tilted = observations.arguments[1].data.any(axis=1)
    setup = np.where(~tilted, 1, np.where(c["table"] == "three-axis", 2, 3))
    level = {"table": c["table"], "setup": setup, "block": c["block"], "direction": c["direction"],
             "angle_deg": c["angle"], "time_min": c["time"], "reading_arcsec": observations.recorded[:, 0]}
    job = """problem = "problems.plumb"

[data.level]
file = "level.csv"
instrument = "level"

[instruments.level]
kind = "level"
u = "0.2 arcsec"

[[known.applied_tilt]]
setup = 1
dtheta_x = "0 arcsec"
dtheta_y = "0 arcsec"

[[known.applied_tilt]]
setup = 2
dtheta_x = "40 arcsec"
dtheta_y = "0 arcsec"

[[known.applied_tilt]]
setup = 3
dtheta_x = "0 arcsec"
dtheta_y = "40 arcsec"
"""
    return {"job.toml": job,
            "level.csv": written("simulated, two tables over 90 degrees, a known tilt applied half-way", level)}
