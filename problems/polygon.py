"""Optical polygon on a rotary table, read by an autocollimator: which error is the polygon's and which the table's.

Stops of the table are numbered 0, 1, 2 ... in steps of one pitch. Series j starts on face j, and each step brings the
next face: stop k shows face j + k, and stop n of n faces closes the circle on the first face again. One series reads
only the sum of table and face; a second starting face separates them, because both circles close.
Source: Sim 1984, in Hewitt (ed.), Modern Techniques in Metrology, World Scientific: angle calibration by closure.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import gcd
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from calib import Gaussian, Observations, Problem, Unknown, simulate
from calib.errors import InputError
from calib.table import written
from calib.units import arcsec, minute
from instruments.autocollimator import closure, effects, polygon_face
from problems.recorded import recorded

if TYPE_CHECKING:
    from calib.job import Job

__all__ = ["accepts", "declare", "effects", "example", "example_job", "from_job", "separating_starts", "start"]


def start(faces: int) -> dict[str, Any]:
    """Start values: every deviation zero [rad], for a polygon with a number of faces."""
    return {"face": np.zeros((faces, 1)), "table": np.zeros((faces, 1))}


def declare(stop: ArrayLike, series: ArrayLike, start_face: ArrayLike, readings: ArrayLike | None, faces: int,
            u: ArrayLike | Gaussian, covariates: Mapping[str, Any] | None = None,
            rows: ArrayLike | None = None) -> Problem:
    """Deviations of the faces of a polygon and of the stops of a table, each circle closed.

    stop: (n,) number of the stop, 0 to faces (the last closes the circle); series: (n,) name of the mounting of the
    polygon; start_face: (n,) face at stop 0 of that series, from 1; readings: (n,) of the autocollimator [rad], or None
    for planning; faces: how many; u: standard uncertainty [rad]; covariates: time [s], block,
    temperature_difference [K]; rows: (n,) row numbers of the file.
    The sums of the deviations of faces and of stops are zero; `zero` of each series takes what is common.
    Raises InputError for a stop, a face or a mounting that cannot be.
    """
    stop, first = np.asarray(stop, int), np.asarray(start_face, int)
    names = np.asarray(series).astype(str)
    keys = list(dict.fromkeys(names.tolist()))
    _check(stop, first, names, keys, faces)
    item = np.array([keys.index(name) for name in names])
    face = Unknown("face", np.zeros((faces, 1)), "arcsec", keys=range(1, faces + 1))
    table = Unknown("table", np.zeros((faces, 1)), "arcsec", keys=[f"{360.0 * k / faces:g}" for k in range(faces)])
    zero = Unknown("zero", np.zeros((len(keys), 1)), "arcsec", keys=keys)
    given = covariates or {}
    seen = Observations(polygon_face, face[(first - 1 + stop) % faces], table[stop % faces], zero[item],
                        readings=readings, u=u, group="autocollimator", unit="arcsec", components=("angle",), rows=rows,
                        covariates={"stop": stop, "series": names, **given})
    blocks = np.unique(seen.covariates["block"])[1:].tolist() if "block" in given else []
    drivers = {"time", "block", "temperature_difference", "tilt", "table_angle"}
    candidates = [e for e in effects(blocks) if e.slot in ("mirror", "autocollimator")
                  and set(e.inputs) & drivers <= set(given)]
    return Problem([seen], [closure("faces close", face), closure("table closes", table)], effects=candidates,
                   name="polygon on a rotary table")


def _check(stop: np.ndarray, first: np.ndarray, names: np.ndarray, keys: list[str], faces: int) -> None:
    if faces < 3:
        raise InputError(f"a polygon with {faces} faces closes no circle; it has three or more")
    for what, values, low, high in (("stop", stop, 0, faces), ("starting face", first, 1, faces)):
        for row in np.flatnonzero((values < low) | (values > high)):
            raise InputError(f"row {row + 1}: {what} {values[row]} does not exist on a polygon of {faces} faces "
                             f"({low} to {high}); correct the number or the count of faces")
    for key in keys:
        starts = np.unique(first[names == key])
        if len(starts) > 1:
            there = ", ".join(map(str, starts))
            raise InputError(f"series '{key}' starts on faces {there}; a series is one mounting of the polygon: give "
                             "every mounting a name of its own")


def separating_starts(starts: ArrayLike, faces: int) -> str:
    """What a choice of starting faces can tell, in words.

    starts: starting faces, from 1; faces: of the polygon. Two series that start s faces apart compare faces s apart, so
    the circle is chained together where the greatest common divisor of all these distances and the number of faces is
    one; else it falls into that many chains.
    """
    apart = np.unique(np.asarray(starts, int))
    chains = gcd(faces, *(int(s - apart[0]) for s in apart))
    if chains == 1:
        return "polygon and table are separated"
    if chains == faces:
        return (f"one starting face reads only sums of table and face: {faces - 1} directions are unknown; "
                "mount the polygon again, one face further round")
    return (f"the faces fall into {chains} chains that no series compares: {chains - 1} directions are unknown; "
            "add a series that starts one face further round")


# --- jobs and examples -------------------------------------------------------------------------------------------

accepts = ("polygon",)


def from_job(job: Job) -> Problem:
    """Polygon and table from a job.

    Table `readings`: stop, series, start_face, reading (angle), optionally time, block. Its instrument,
    kind = "autocollimator", with u. Option faces: how many faces the polygon has.
    """
    table, instrument = job.table("readings"), job.instrument("readings")
    instrument.text("kind", among=("autocollimator",))
    return declare(table.whole("stop"), table.text("series"), table.whole("start_face"),
                   table.number("reading", "angle"), job.options.whole("faces"), instrument.quantity("u", "angle"),
                   recorded(job, table), table.row_numbers)


def example(seed: int, faces: int = 12, starts: tuple[int, ...] = (1, 2, 5)) -> Problem:
    """Three series over a polygon of twelve faces, every circle closed on its first face; simulated readings.

    seed: of deviations and noise; faces, starts: of the polygon and of the series.
    """
    stop = np.tile(np.arange(faces + 1), len(starts))
    begin = np.repeat(starts, faces + 1)
    covariates = {"time": (np.arange(len(stop)) * 2.0 * minute, "min"),
                  "block": np.repeat(range(1, len(starts) + 1), faces + 1)}
    problem = declare(stop, begin, begin, None, faces, 0.2 * arcsec, covariates)
    drawn = np.random.default_rng(seed).normal(size=(2, faces, 1)) * np.array([0.8, 3.0])[:, None, None] * arcsec
    truth = dict(zip(("face", "table"), drawn - drawn.mean(axis=1, keepdims=True)))
    return simulate(problem, truth, seed)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with the readings of `example`: {file name: text}."""
    seen = example(seed).observations[0]
    c = seen.covariates
    readings = {"stop": c["stop"], "series": c["series"], "start_face": c["series"], "time_min": c["time"],
                "block": c["block"], "reading_arcsec": seen.recorded[:, 0]}
    return {
        "job.toml": 'problem = "problems.polygon"\n\n[data.readings]\nfile = "readings.csv"\n'
                    'instrument = "collimator"\n\n[instruments.collimator]\nkind = "autocollimator"\n'
                    'u = "0.2 arcsec"\n\n[options]\nfaces = 12\n\n'
                    '[report]\nquantities = ["face", "table"]\n',
        "readings.csv": written(f"simulated, seed {seed}", readings)}
