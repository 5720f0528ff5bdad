"""Survey networks in CSV tables of a job: one of points, and one for each kind of reading."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib import Gaussian
from calib.errors import InputError
from calib.job import Job
from calib.table import Table
from problems.network import noise
from problems.network.models import KINDS
from problems.network.stations import Ranging, Sightings
from problems.network.survey import ADJUSTED, CONSTRAINED, FIXED, LEFT_HANDED, RIGHT_HANDED, Batch, Point, Survey
from problems.recorded import recorded

TABLES = {
    "distances": "distance",
    "slope_distances": "slope distance",
    "directions": "direction",
    "angles": "angle",
    "azimuths": "azimuth",
    "zenith_angles": "zenith angle",
    "height_differences": "height difference",
    "vectors": "vector",
    "coordinates": "coordinates",
}
columns = {
    "points": {"point": "its name", "x, y, z": "coordinates; start values where it is adjusted",
               "role": "fixed, adjusted, or constrained (its start defines a free datum); adjusted if not given"},
    **{name: {"station, target": "names of points", "reading": "in a unit of its kind",
              "back": "backsight (angles)", "set": "setting of the circle (directions; one each station if not given)",
              "station_height, target_height": "above the points (0 if not given)",
              "u": "standard uncertainty (else that of the instrument)"}
       for name in TABLES if name not in ("vectors", "coordinates")},
    "tracker": {"station, target": "of a laser tracker with six degrees of freedom",
                "range, azimuth, zenith": "readings; the instrument gives u_range, u_angle, and levelled = true where "
                "its axis is vertical"},
    "ranges": {"instrument, target": "of an interferometer whose base point and dead path are unknown",
               "reading": "its length; the instrument gives u and counts (lengthening or shortening)"},
    "any of them": {"time, temp": "when it was read and how warm it was; drifts and thermal effects can then be found",
                    "block": "a number that grows where something was set up anew"},
    "vectors": {"station, target": "names of points", "dx, dy, dz": "differences of coordinates", "u": "of each"},
    "coordinates": {"station": "name of the point", "x, y, z": "observed", "u": "of each"},
}
options = {"axes": "directions of x and y: ne (default), en, sw, ...",
           "circles": "clockwise (default) or counterclockwise",
           "reference_temperature": "from which temperatures count (20 °C if not given)",
           "network": "a .gkf file beside the job, in place of tables",
           "leave_out_weak": "true to adjust the rest where points lack readings, and say what was left out"}


def read_tables(job: Job) -> Survey:
    """The survey of a job.

    job: with [data.points] and any of [data.distances], [data.directions] ... (see `columns`); the instrument of each
    table gives u = "1 mm + 2 ppm" (constant and part of the length) and, where it stands over marks, station_centring
    and target_centring. Points that are not listed are adjusted.
    Raises InputError where a table, a column or an uncertainty is missing.
    """
    there = [name for name in TABLES if name in job.tables]
    sightings = (_sightings(job),) if "tracker" in job.tables else ()
    ranging = (_ranging(job),) if "ranges" in job.tables else ()
    if not there and not sightings:
        names = ", ".join(f"[data.{name}]" for name in (*TABLES, "tracker"))
        raise InputError(f"{job.path}: has no table of readings; add one of {names}")
    axes = job.options.text("axes", "ne", (*LEFT_HANDED, *RIGHT_HANDED))
    clockwise = job.options.text("circles", "clockwise", ("clockwise", "counterclockwise")) == "clockwise"
    batches = [_batch(job, name) for name in there]
    needs = {part for batch in batches for part in batch.model.needs}
    parts = "".join(part for part in "xyz" if part in needs or sightings)
    points = _points(job.table("points"), parts) if "points" in job.tables else {}
    plane, height = ADJUSTED if "x" in parts else "", ADJUSTED if "z" in parts else ""
    survey = Survey(points, batches, sightings=sightings, ranging=ranging, axes=axes, clockwise=clockwise)
    for key in sorted(survey.read):
        points.setdefault(key, Point(plane=plane, height=height))
    return survey


def _sightings(job: Job) -> Sightings:
    """Polar readings of laser trackers: u of range and across it (as a length, constant and part of the range), or of
    the circles."""
    table, instrument = job.table("tracker"), job.instrument("tracker")
    ranges = table.number("range", "length")
    constant, per_metre = instrument.uncertainty("u_range", "length")
    angles = np.full(len(table), instrument.quantity("u_angle", "angle"))
    if "u_across" in instrument:
        fixed, rate = instrument.uncertainty("u_across", "length")
        angles = np.hypot(angles, (fixed + rate * ranges) / ranges)
    readings = np.column_stack([ranges, table.number("azimuth", "angle"), table.number("zenith", "angle")])
    u = np.column_stack([constant + per_metre * ranges, angles / np.sin(readings[:, 2]), angles])
    levelled = instrument.flag("levelled", False)
    return Sightings(table.text("station"), table.text("target"), readings, u, levelled, rows=table.row_numbers,
                     covariates=recorded(job, table))


def _ranging(job: Job) -> Ranging:
    table, instrument = job.table("ranges"), job.instrument("ranges")
    constant, per_metre = instrument.uncertainty("u", "length")
    counts = instrument.text("counts", "lengthening", ("lengthening", "shortening"))
    return Ranging(table.text("instrument"), table.text("target"), table.number("reading", "length"),
                   noise.of_lengths(constant, per_metre), 1.0 if counts == "lengthening" else -1.0,
                   rows=table.row_numbers, covariates=recorded(job, table))


def _points(table: Table, parts: str) -> dict[str, Point]:
    keys = table.text("point").tolist()
    twice = sorted({key for key in keys if keys.count(key) > 1})
    if twice:
        rows = [int(r) for r, key in zip(table.row_numbers, keys, strict=True) if key == twice[0]]
        raise InputError(f"{table.path}: point '{twice[0]}' stands in rows {', '.join(map(str, rows))}; give each "
                         "point its own name, or delete one")
    given = {part: table.number(part, "length") for part in parts if table.has(part)}
    roles = table.text("role").tolist() if table.has("role") else [ADJUSTED] * len(keys)
    points = {}
    for i, (key, role) in enumerate(zip(keys, roles, strict=True)):
        if role not in (FIXED, ADJUSTED, CONSTRAINED):
            raise InputError(f"{table.path}: role '{role}' of point '{key}' is none of fixed, adjusted, constrained")
        position = tuple(float(given[part][i]) if part in given else np.nan for part in "xyz")
        points[key] = Point(position, role if "x" in parts else "", role if "z" in parts else "")  # type: ignore[arg-type]
    return points


def _batch(job: Job, name: str) -> Batch:
    table, kind = job.table(name), TABLES[name]
    model = KINDS[kind]
    dimension = "angle" if model.angular else "length"
    station = table.text("station")
    if kind in ("vector", "coordinates"):
        readings = np.stack([table.number(c, "length") for c in model.components], axis=1)
    else:
        readings = table.number("reading", dimension)
    ends = ("station_height", "target_height")
    heights = {end: table.number(end, "length") if table.has(end) else 0.0 for end in ends}
    unit = "m" if dimension == "length" else table.column("reading").unit or "rad"
    return Batch(
        kind=kind,
        station=station,
        target=table.text("target") if model.points > 1 else station,
        readings=readings,
        u=_uncertainty(job, name, table, kind, dimension, len(model.components)),
        back=table.text("back") if model.points == 3 else None,
        orientation=(table.text("set") if table.has("set") else station) if kind == "direction" else None,
        station_height=heights["station_height"],
        target_height=heights["target_height"],
        group=name,
        unit=unit,
        rows=table.row_numbers,
        covariates=recorded(job, table),
    )


def _uncertainty(job: Job, name: str, table: Table, kind: str, dimension: str, dim: int) -> Gaussian:
    settings: Any = job.instrument(name) if "instrument" in job.settings.table("data").table(name) else None
    station = target = per_metre = 0.0
    if settings is not None:
        station = settings.quantity("station_centring", "length", 0.0)
        target = settings.quantity("target_centring", "length", 0.0)
    constant: Any
    if table.has("u"):
        constant = table.number("u", dimension)
    elif settings is not None:
        constant, per_metre = settings.uncertainty("u", dimension)
    else:
        raise InputError(f"{table.path}: the {kind}s have no uncertainty; add a column u_..., or an instrument with u "
                         f"in [data.{name}]")
    if dim > 1:
        return Gaussian.standard(np.broadcast_to(np.reshape(constant, (-1, 1)), (len(table), dim)))
    if kind == "angle":
        return noise.of_angles(constant, station, target)
    if dimension == "angle":
        return noise.of_sights(constant, station, target)
    return noise.of_lengths(constant, per_metre, float(np.hypot(station, target)))
