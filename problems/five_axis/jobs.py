"""The five-axis procedure as a job: its tables, options and effects, and an example with simulated readings."""

from __future__ import annotations

from calib import Effect, Problem, simulate, solve
from calib.errors import RankDefect
from calib.job import Job
from calib.table import Table, shipped
from calib.units import arcsec, degree
from instruments import level, theodolite
from problems import axis_points, plumb

from . import joint, results, step_by_step
from .joint import Sharing
from .readings import FILES, FOLDER, Readings, from_tables, published

accepts = ("problems.five_axis",)
columns = {
    "level": {"position": "yaw position", "three_axis": "level on that table", "two_axis": "level on that table"},
    "wires": {"instrument": "T1, T2", "target": "S3, S2", "position": "yaw position", "horizontal": "circle"},
    "pitch": {"instrument": "T1", "target": "A, B", "position": "", "horizontal": "circle", "vertical": "circle"},
    "roll": {"instrument": "T1", "target": "C, D", "position": "", "horizontal": "circle", "vertical": "circle"},
    "distances": {"instrument": "T1, T2", "target": "(filament: yaw axis)", "distance": "", "u": "of the distance"},
    "centres": {
        "target": "E, F (optional)",
        "horizontal": "fitted centre",
        "vertical": "fitted centre",
        "u": "of both",
    },
    "feet": {"table": "three_axis, two_axis (optional)", "foot": "name", "x": "in the level's frame", "y": "likewise"},
}
options = {
    "procedure": "jointly (default) or step by step, as in the paper",
    "shared": "tested (default): circles of a target share r and phase where the readings accept it at 1 %; all; none",
    "circles": "usual (default): clockwise circle and zenith angles; as printed: they grow to the left and upward",
    "index": "vertical circle at a horizontal line of sight (90 deg)",
    "u_index": "its standard uncertainty (1 arcsec)",
}


def from_job(job: Job) -> Problem:
    """The joint problem of a job, or the paper's own procedure.

    Tables and options as in `columns` and `options`; [data.level] and [data.pitch] name the instruments whose u is that
    of one level reading and of one circle reading.
    Raises InputError where a table, a column or a target is missing.
    """
    readings, up = _readings(job), _up(job)
    shared = job.options.text("shared", "tested", ("tested", "all", "none"))
    if job.options.text("procedure", "jointly", ("jointly", "step by step")) == "step by step":
        return step_by_step.declare(readings)
    return declare(readings, shared=shared, up=up)


def formulations(job: Job) -> dict[str, Problem]:
    """The same readings step by step, and jointly with all, some or no circles shared.

    The step-by-step problem takes the yaw axes as plumb, as the paper does.
    """
    from_job(job)
    readings, up = _readings(job), _up(job)
    found = {"step by step": step_by_step.declare(readings)}
    jointly = {shared: declare(readings, shared=shared, up=up) for shared in ("tested", "all", "none")}
    return found | {f"jointly, sharing {shared}": problem for shared, problem in jointly.items()}


def remarks(job: Job) -> tuple[str, ...]:
    """What the readings cannot tell: sentences."""
    assumed = "clockwise with zenith angles" if _up(job) < 0 else "counter-clockwise with angles that grow upward"
    return (
        f"Which way the circles count: they are taken as {assumed} (options.circles); it decides right and left, up "
        "and down, and on which side the lean of the yaw axes is counted.",
        "How the level lies to the line of sight: its X is taken along that line at yaw position 0, to 1 degree.",
    )


def _readings(job: Job) -> Readings:
    index = (job.options.quantity("index", "angle", 90 * degree), job.options.quantity("u_index", "angle", 1 * arcsec))
    u_level, u_circle = (job.instrument(table).uncertainty("u", "angle")[0] for table in ("level", "pitch"))
    optional = [name for name in ("centres", "feet") if name in job.tables]
    tables = {name: job.table(name) for name in (*(set(FILES) - {"centres"}), *optional)}
    return from_tables(tables, index=index, u_level=u_level, u_circle=u_circle)


def _up(job: Job) -> int:
    return -1 if job.options.text("circles", "usual", ("usual", "as printed")) == "usual" else 1


def declare(readings: Readings, *, shared: str = "tested", up: int = -1) -> Problem:
    """The joint problem, with the circles of a target shared where the readings accept it.

    readings: of all tables; shared: "tested" at 1 %, "all" or "none"; up: as in `Sharing`, here by default for
    circles of the usual make.
    Returns the problem with its effects as held candidates.
    """
    targets = [*dict.fromkeys((*readings.pitch.target, *readings.roll.target))]
    if shared == "tested":
        try:
            circles = results.accepted(readings)
        except RankDefect as error:
            raise RankDefect(
                "whether the circles of a target may be shared cannot be tested, because each circle by itself cannot "
                f'be fitted: take it for granted with shared = "all" in [options], or read more positions. {error}',
                error.directions,
            ) from error
    else:
        circles = targets if shared == "all" else []
    problem = joint.declare(readings, Sharing(circles, up=up))
    return problem.with_effects(*effects())


def effects() -> tuple[Effect, ...]:
    """What may be missing: error motions of all axes, sensitivity of the level, axis errors of the theodolites.

    Returns the effects that need no time and no temperature, which the procedure does not record.
    """
    motions = [e for e in plumb.effects() if e.name.startswith("tilt_motion")]
    gain = [e for e in level.effects() if e.name == "gain"]
    runout = [e for e in axis_points.effects() if e.name == "radial_runout_2x"]
    axes = [e for e in theodolite.effects() if e.name in ("collimation", "trunnion_tilt")]
    return (*motions, *gain, *runout, *axes)


def example(seed: int) -> Problem:
    """The paper's procedure with readings simulated at its own result.

    seed: of the errors. Returns the joint problem with its effects as held candidates.
    """
    problem = declare(published(), shared="all")
    return simulate(problem, solve(problem), seed)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with simulated readings in the columns of the paper's tables: {file name: text}.

    seed: of the errors.
    """
    drawn = {o.group: o.readings for o in example(seed).observations if o.readings is not None}
    tables = {name: shipped(f"{FOLDER}/{file}") for name, file in FILES.items()}
    three, two = drawn["table 1"][:, 0].reshape(2, -1)
    tables["level"] = tables["level"].with_number("three_axis", three).with_number("two_axis", two)
    tables["wires"] = tables["wires"].with_number("horizontal", drawn["table 2"][:, 0])
    for name, group in (("pitch", "table 3"), ("roll", "table 4")):
        for i, circle in enumerate(("horizontal", "vertical")):
            tables[name] = tables[name].with_number(circle, drawn[group][:, i])
    files = {FILES[name]: _text(table, seed) for name, table in tables.items()}
    data = "\n".join(
        f'[data.{name}]\nfile = "{file}"\n'
        + ('instrument = "level"\n' if name == "level" else "")
        + ('instrument = "theodolite"\n' if name in ("wires", "pitch", "roll") else "")
        for name, file in FILES.items()
    )
    return {"job.toml": _JOB.format(data=data), **files}


_JOB = """problem = "problems.five_axis"

{data}
[instruments.level]
kind = "level"
u = "0.2 arcsec"

[instruments.theodolite]
kind = "theodolite"
u = "1 arcsec"

[options]
index = "90.00444444444445 deg"
u_index = "1 arcsec"
shared = "tested"
"""


def _text(table: Table, seed: int) -> str:
    left_out = ("horizontal_printed_dms", "repaired", "where", "key")
    keep = [i for i, column in enumerate(table.columns) if column.header not in left_out]
    lines = [f"# source: simulated at the paper's result (seed {seed}), columns of {FOLDER}/{table.path.name}"]
    lines.append(",".join(table.columns[i].header for i in keep))
    lines += [",".join(row[i] for i in keep) for row in table.cells]
    return "\n".join(lines) + "\n"
