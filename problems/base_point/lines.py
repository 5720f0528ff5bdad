"""Readings of tracking interferometers along lines: what was read, from tables of a job and from case folders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import Estimate
from calib.analyse.shapes import points_of
from calib.errors import InputError
from calib.job import Job
from calib.scene import Points, Scene, Sights
from calib.table import Table
from problems.base_point.algebraic import Span
from problems.recorded import recorded

Array = NDArray[np.float64]
AXES = ("x", "y", "z")
_VECTORS = ("points", "along", "velocity")


@dataclass(frozen=True, eq=False)
class Lines:
    """Readings of one or more trackers on target points: n rows, SI.

    points: (n, 3) recorded coordinates; readings: (n,), or None to plan; u: (n,) or number, of the trackers.
    along: (n, 3) unit direction of the line whose interferometer read the point, zero where there was none.
    u_coordinate: (n,) or number, of that interferometer; seating: (n,) keys, rows of one key share its reading.
    velocity: (n, 3) [m/s] of the reflector when it was read, zero at rest.
    tracker, zeroing: (n,) keys; the readings of one tracker since one zeroing share a start length.
    rows: (n,) row numbers of the file; covariates: {name: (n,) or ((n,), unit)} for effects.
    Raises InputError where a column has not one value for each row.
    """

    points: Array
    readings: Any
    u: Any
    along: Any = (0.0, 0.0, 0.0)
    u_coordinate: Any = 0.0
    seating: Any = None
    velocity: Any = (0.0, 0.0, 0.0)
    tracker: Any = "tracker"
    zeroing: Any = ""
    rows: Any = None
    covariates: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.points)
        counted = np.arange(1, n + 1) if self.rows is None else np.asarray(self.rows)
        object.__setattr__(self, "rows", counted)
        object.__setattr__(self, "seating", counted if self.seating is None else self.seating)
        for name in (*_VECTORS, "readings", "u", "u_coordinate", "seating", "tracker", "zeroing", "rows"):
            given, shape = getattr(self, name), (n, 3) if name in _VECTORS else (n,)
            if given is None:
                continue
            try:
                object.__setattr__(self, name, np.broadcast_to(np.asarray(given), shape))
            except ValueError:
                raise InputError(f"lines: '{name}' has shape {np.shape(given)} where {shape} is expected: one value "
                                 "for each target point") from None

    def __len__(self) -> int:
        return len(self.points)

    def covariates_of(self, rows: NDArray) -> dict[str, Any]:
        """The covariates of some rows, with their units."""
        def part(column: Any) -> Any:
            return (part(column[0]), column[1]) if isinstance(column, tuple) else np.asarray(column)[rows]
        return {name: part(column) for name, column in self.covariates.items()}


def directions(direction: ArrayLike, along: Array) -> dict[str, Array]:
    """Covariates direction_x, _y, _z (n,): the direction of approach on lines along that axis, else 0."""
    return {f"direction_{axis}": np.asarray(direction) * along[:, a] for a, axis in enumerate(AXES)}


def lines_of_job(job: Job) -> Lines:
    """The table `lines` of a job: columns x, y, z, d; line, tracker, zeroing, block, direction, time, temperature.

    Raises InputError naming file, line, key or column.
    """
    table = job.table("lines")
    points = coordinates(table)
    readings = table.number("d", "length")
    fixed, rate = job.instrument("lines").uncertainty("u", "length")
    along = _travelled(points, table.text("line")) if table.has("line") else np.zeros_like(points)
    covariates: dict[str, Any] = {name: table.text(name) for name in ("line", "tracker") if table.has(name)}
    covariates |= recorded(job, table)
    if "direction" in covariates:
        covariates |= directions(covariates.pop("direction"), along)
    line_instrument = job.options.text("line_instrument", None)
    u_coordinate, _ = (job.instruments.table(line_instrument).uncertainty("u", "length") if line_instrument
                       else (0.0, 0.0))
    return Lines(points, readings, fixed + rate * np.abs(readings), along, u_coordinate, covariates=covariates,
                 tracker=table.text("tracker") if table.has("tracker") else "tracker",
                 zeroing=table.text("zeroing") if table.has("zeroing") else "", rows=table.row_numbers)


def lines_of_case(job: Job) -> Lines:
    """A case folder of the scenario `basepoint_multilateration`: a line of kind "fine" has a zeroing of its own.

    Raises InputError naming file, line, key or column.
    """
    table, known = job.table("measurements"), job.known
    described = {one.text("id"): one for one in known.tables("lines")}
    line = table.text("line")
    missing = sorted(set(line) - set(described))
    if missing:
        raise InputError(f"{table.path}: line '{missing[0]}' is not described; add it to known.lines of {job.path} "
                         f"(there: {', '.join(described)})")
    axis = {name: np.eye(3)[AXES.index(one.text("axis", among=AXES))] for name, one in described.items()}
    kind = {name: one.text("kind", among=("long", "fine")) for name, one in described.items()}

    def of_line(key: str) -> Array:
        values = {name: one.quantity(key, "length") for name, one in described.items()}
        return np.array([values[name] for name in line])

    along = np.array([axis[name] for name in line])
    covariates = {
        **recorded(job, table), **directions(table.whole("direction"), along), "line": line,
        "split": table.text("split"), "abbe_x": (of_line("abbe_x"), "m"), "abbe_y": (of_line("abbe_y"), "m")}
    return Lines(coordinates(table), table.number("d", "length"), of_line("sigma_d"), along, of_line("sigma_axis"),
                 velocity=along * table.number("speed_mm_s", "length/time")[:, None], rows=table.row_numbers,
                 zeroing=[name if kind[name] == "fine" else "long" for name in line], covariates=covariates)


def coordinates(table: Table) -> Array:
    """The recorded coordinates (n, 3) [m] of a table."""
    return np.column_stack([table.number(axis, "length") for axis in AXES])


def _travelled(points: Array, line: NDArray) -> Array:
    """Unit direction (n, 3) of the line of each row, from the recorded coordinates, towards growing ones."""
    along = np.zeros_like(points)
    for name in np.unique(line):
        direction = Span.of(points[line == name]).axes[0]
        along[line == name] = direction * np.sign(direction[np.abs(direction).argmax()])
    return np.where(np.abs(along) < 1e-9, 0.0, along)


def scene(job: Job, estimate: Estimate) -> Scene:
    """The target points on their lines, the base points with their uncertainty, and who looked where.

    job: of the readings; estimate: of its problem. Returns the scene in the machine's axes.
    """
    lines = lines_of_case(job) if "lines" in job.known else lines_of_job(job)
    base = points_of(estimate.fit, estimate.problem.select("base_point").unknown)
    keys = np.unique(lines.tracker).tolist()
    seen = [Sights(str(key), base.places[i], lines.points[lines.tracker == key]) for i, key in enumerate(keys)]
    return Scene((Points("targets", lines.points), base, *seen))
