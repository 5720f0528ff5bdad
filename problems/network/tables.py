"""Survey networks in CSV tables of a job: points, frames, and one table or more for each kind of reading."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from calib import units
from calib.errors import InputError
from calib.job import Job
from calib.table import Table
from problems.network import noise
from problems.network.frames import PARTS, RigidFrame
from problems.network.models import KINDS
from problems.network.stated import uncertainty
from problems.network.stations import Ranging, Sightings
from problems.network.survey import ADJUSTED, CONSTRAINED, FIXED, LEFT_HANDED, RIGHT_HANDED, Batch, Point, Survey
from problems.network.tilts import Tilts
from problems.network.unreadable import readable
from problems.recorded import recorded

TABLES = {
    "distances": "distance",
    "slope_distances": "slope distance",
    "scale_bars": "scale bar",
    "directions": "direction",
    "angles": "angle",
    "azimuths": "azimuth",
    "zenith_angles": "zenith angle",
    "inclinations": "inclination",
    "height_differences": "height difference",
    "vectors": "vector",
    "coordinates": "coordinates",
    "plane_coordinates": "plane coordinates",
    "heights": "height",
}
INSTRUMENTS = ("tracker", "ranges", "tilts")
ENDS = ("station_height", "target_height")
ROLES = (FIXED, ADJUSTED, CONSTRAINED)


def kinds(job: Job) -> dict[str, str]:
    """{table of the job: table of `columns` that it is like}: by its name, or by its key `kind`.

    Raises InputError for a table that is neither.
    """
    found = {}
    for name in job.tables:
        like = job.settings.table("data").table(name).text("kind", name, (*TABLES, *INSTRUMENTS))
        if like not in (*TABLES, *INSTRUMENTS, "points", "frames"):
            near = units.near_matches(name, [*TABLES, *INSTRUMENTS, "points", "frames"])
            hint = f"did you mean [data.{near[0]}]? " if near else ""
            raise InputError(f"{job.settings.table('data').where(name)}: a network has no table of this name; {hint}"
                             f"Name it so, or say what it is like, as in kind = \"slope_distances\" (there are: "
                             f"{', '.join((*TABLES, *INSTRUMENTS))})")
        found[name] = like
    return found


def read_tables(job: Job, allowed: Collection[str] = ()) -> Survey:
    """The survey of a job.

    job: with [data.points] and any of [data.distances], [data.directions] ... (see `columns`); the instrument of each
    table gives u = "1 mm + 2 ppm" (constant and part of the length) and, where it stands over marks or is pointed,
    station_centring, target_centring and pointing. Points that are not listed are adjusted. allowed: what may be left
    out (`reduction.LEAVE_OUT`), which the remarks then say.
    Raises InputError where a table, a column or an uncertainty is missing.
    """
    like = kinds(job)
    remarks: list[str] = []
    if "unreadable" in allowed:
        job, remarks = readable(job, [name for name, kind in like.items() if kind not in ("points", "frames")])
    batches = [_batch(job, name, TABLES[kind]) for name, kind in like.items() if kind in TABLES]
    sightings = [_sightings(job, name) for name, kind in like.items() if kind == "tracker"]
    ranging = [_ranging(job, name) for name, kind in like.items() if kind == "ranges"]
    tilts = [_tilts(job, name) for name, kind in like.items() if kind == "tilts"]
    if not batches and not sightings and not ranging:
        names = ", ".join(f"[data.{name}]" for name in (*TABLES, "tracker", "ranges"))
        raise InputError(f"{job.path}: has no table of readings; add one of {names}")
    axes = job.options.text("axes", "ne", (*LEFT_HANDED, *RIGHT_HANDED))
    clockwise = job.options.text("circles", "clockwise", ("clockwise", "counterclockwise")) == "clockwise"
    survey = Survey({}, batches, sightings=sightings, ranging=ranging, tilts=tilts, axes=axes, clockwise=clockwise)
    parts = survey.parts
    table = job.tables.get("points")
    points, twice = _points(table, parts, "duplicated" in allowed) if table is not None else ({}, [])
    plane, height = ADJUSTED if "x" in parts else "", ADJUSTED if "z" in parts else ""
    for key in sorted(survey.read):
        points.setdefault(key, Point(plane=plane, height=height))
    return Survey(points, batches, sightings=sightings, ranging=ranging, tilts=tilts, axes=axes, clockwise=clockwise,
                  frames=_frames(job.table("frames")) if "frames" in job.tables else (), remarks=(*remarks, *twice))


def _epochs(table: Table) -> Any:
    return table.text("epoch") if table.has("epoch") else None


def _covariates(job: Job, name: str, table: Table) -> dict[str, Any]:
    """What was written down beside the readings: as everywhere, and face and instrument."""
    found = recorded(job, table)
    if table.has("face"):
        face = table.whole("face")
        for row in np.flatnonzero(~np.isin(face, (1, 2, -1))):
            raise InputError(f"{table.place(int(row), table.column('face'))}: {face[row]} is no face; write 1 or 2 (or "
                             "-1), and readings of face 2 as reduced to face 1")
        found["face"] = np.where(face == 1, 1.0, -1.0)
    described = job.settings.table("data").table(name)
    if "instrument" in described:
        found["instrument"] = np.full(len(table), described.text("instrument"))
    return found


def _sightings(job: Job, name: str) -> Sightings:
    """Polar readings of laser trackers: u of range and across it (as a length, constant and part of the range), or of
    the circles."""
    table, instrument = job.table(name), job.instrument(name)
    ranges = table.number("range", "length")
    constant, per_metre = instrument.uncertainty("u_range", "length")
    angles = np.full(len(table), instrument.quantity("u_angle", "angle", None if "u_across" in instrument else np.nan)
                     or 0.0)
    if np.isnan(angles).any():
        raise InputError(f"{instrument.where('u_angle')}: is missing; add u_angle = \"2 arcsec\" (of the circles) or "
                         "u_across = \"15 um + 6 um/m\" (across the beam), or both")
    if "u_across" in instrument:
        fixed, rate = instrument.uncertainty("u_across", "length")
        angles = np.hypot(angles, (fixed + rate * ranges) / ranges)
    for row in np.flatnonzero(~(ranges > 0.0)):
        raise InputError(f"{table.place(int(row), table.column('range'))}: a range must be positive; correct it")
    readings = np.column_stack([ranges, table.number("azimuth", "angle"), table.number("zenith", "angle")])
    u = np.column_stack([constant + per_metre * ranges, angles / np.sin(readings[:, 2]), angles])
    levelled = instrument.flag("levelled", False)
    return Sightings(table.text("station"), table.text("target"), readings, u, levelled, name, table.row_numbers,
                     _covariates(job, name, table), _epochs(table))


def _ranging(job: Job, name: str) -> Ranging:
    table, instrument = job.table(name), job.instrument(name)
    constant, per_metre = instrument.uncertainty("u", "length")
    counts = instrument.text("counts", "lengthening", ("lengthening", "shortening"))
    return Ranging(table.text("instrument"), table.text("target"), table.number("reading", "length"),
                   noise.of_lengths(constant, per_metre), 1.0 if counts == "lengthening" else -1.0, name,
                   table.row_numbers, _covariates(job, name, table), _epochs(table))


def _tilts(job: Job, name: str) -> Tilts:
    table, instrument = job.table(name), job.instrument(name)
    of = "frame" if table.has("frame") else "station"
    readings = np.stack([table.number(part, "angle") for part in ("along_x", "along_y")], axis=1)
    unit = table.column("along_x").unit or "rad"
    return Tilts(of, table.text(of), readings, instrument.quantity("u", "angle"), name, unit, table.row_numbers,
                 _covariates(job, name, table), _epochs(table))


def _frames(table: Table) -> list[RigidFrame]:
    names = table.text("frame")
    free = table.text("free", may_be_empty=True) if table.has("free") else [""] * len(table)
    epochs = table.text("epoch", may_be_empty=True) if table.has("epoch") else [""] * len(table)
    parents = table.text("parent", may_be_empty=True) if table.has("parent") else [""] * len(table)
    place = np.zeros((len(table), 6))
    for i, part in enumerate(PARTS):
        if table.has(part):
            place[:, i] = table.number(part, "length" if i < 3 else "angle")
    return [RigidFrame(str(name), tuple(str(moves).replace(",", " ").split()), tuple(where.tolist()), str(epoch),
                       str(parent))
            for name, moves, where, epoch, parent in zip(names, free, place, epochs, parents, strict=True)]


def _points(table: Table, parts: str, ignoring_duplicated: bool) -> tuple[dict[str, Point], list[str]]:
    """The points, and remarks about those that are listed twice, whose coordinates then follow from readings alone."""
    keys = table.text("point").tolist()
    rows: dict[str, list[str]] = {}
    for key, row in zip(keys, table.row_numbers, strict=True):
        rows.setdefault(key, []).append(str(row))
    twice = sorted(key for key, those in rows.items() if len(those) > 1)
    for key in twice[: not ignoring_duplicated]:
        raise InputError(f"{table.path}: point '{key}' stands in rows {', '.join(rows[key])}; give each point its own "
                         "name, or delete one")
    given = {part: _coordinates(table, part) for part in parts if table.has(part)}
    roles = table.text("role").tolist() if table.has("role") else [ADJUSTED] * len(keys)
    inside = table.text("frame", may_be_empty=True).tolist() if table.has("frame") else [""] * len(keys)
    points = {}
    for i, (key, role, frame) in enumerate(zip(keys, roles, inside, strict=True)):
        if role not in ROLES:
            raise InputError(f"{table.path}: role '{role}' of point '{key}' is none of fixed, adjusted, constrained")
        position = tuple(float(given[part][i]) if part in given else np.nan for part in "xyz")
        missing = [part for part, value in zip("xyz", position) if part in parts and np.isnan(value)]
        if role == FIXED and missing:
            raise InputError(f"{table.path}, line {table.lines[i]}: point '{key}' is fixed and has no {missing[0]}; "
                             f"give it, in a column such as {missing[0]}_m, or let the point be adjusted")
        if key in twice:
            position, role = (np.nan,) * 3, ADJUSTED
        points[key] = Point(position, role if "x" in parts else "", role if "z" in parts else "", frame)  # type: ignore[arg-type]
    return points, [f"Left out: the coordinates of point '{key}', which stands in rows {', '.join(rows[key])} of "
                    f"{table.path.name}; it is adjusted from its readings. Give each point its own name."
                    for key in twice]


def _coordinates(table: Table, part: str) -> np.ndarray:
    """Coordinates of a column, not a number where a cell is empty: what is adjusted may start from its readings."""
    column = table.column(part)
    there = np.array([bool(cells[table.columns.index(column)].strip()) for cells in table.cells])
    found = np.full(len(table), np.nan)
    if there.any():
        found[there] = table.where(there).number(part, "length")
    return found


def _settings(table: Table, station: np.ndarray) -> np.ndarray:
    """Names of the settings of the circle: where stations number theirs alike, each with its station."""
    if not table.has("set"):
        return station
    pairs = list(zip(station.tolist(), table.text("set").tolist(), strict=True))
    alike = len({setting for _, setting in pairs}) < len(set(pairs))
    return np.array([f"{of} {setting}" if alike else setting for of, setting in pairs])


def _batch(job: Job, name: str, kind: str) -> Batch:
    table = job.table(name)
    model = KINDS[kind]
    dimension = "angle" if model.angular else "length"
    station = table.text("station")
    if len(model.components) > 1:
        readings = np.stack([table.number(c, "length") for c in model.components], axis=1)
    else:
        readings = table.number("reading", dimension)
    unit = "m" if dimension == "length" else table.column("reading").unit or "rad"
    return Batch(
        kind=kind,
        station=station,
        target=table.text("target") if model.points > 1 else station,
        readings=readings,
        u=uncertainty(job, name, table, kind, model),
        back=table.text("back") if model.points == 3 else None,
        orientation=_settings(table, station) if kind == "direction" else None,
        **{end: table.number(end, "length") if table.has(end) else 0.0 for end in ENDS},
        group=name,
        unit=unit,
        rows=table.row_numbers,
        covariates=_covariates(job, name, table),
        epoch=_epochs(table),
    )
