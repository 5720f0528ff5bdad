"""What a job states of the uncertainty of its readings: columns, texts of instruments, files with a full covariance.

The text u of an instrument may hold a constant and a part of the length; centring and pointing are keys of their own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from calib import Gaussian, units
from calib.errors import InputError
from calib.job import Job
from calib.settings import Settings, unit_in
from calib.table import Table
from problems.network import noise
from problems.network.models import Kind

STEEP = ("zenith angle", "inclination")


def uncertainty(job: Job, name: str, table: Table, kind: str, model: Kind) -> Gaussian:
    """The uncertainty of the readings of a table.

    name: of the table; kind, model: of its readings. Raises InputError where it is missing, of another dimension, or
    where a covariance does not fit the table.
    """
    described = job.settings.table("data").table(name)
    instrument = job.instrument(name) if "instrument" in described else None
    dimension = "angle" if model.angular else "length"
    if "covariance" in described:
        return _whole(job, described, table, model)
    if any(table.has(f"u_{part}") for part in model.components if part):
        return Gaussian.matrix(_of_components(table, model))
    constant: Any = None
    per_metre = 0.0
    if table.has("u"):
        constant = table.number("u", dimension)
        positive(table, "u", constant)
    elif instrument is not None:
        constant, per_metre = instrument.uncertainty("u", dimension)
    else:
        raise InputError(f"{table.path}: the {kind}s have no uncertainty; add a column u_..., or an instrument with u "
                         f"in [data.{name}]")
    if len(model.components) > 1:
        return Gaussian.standard(np.broadcast_to(np.reshape(constant, (-1, 1)), (len(table), len(model.components))))
    sight = _sight(instrument, per_metre, dimension) if instrument is not None else {}
    if kind == "angle":
        return noise.of_angles(constant, **sight)
    if dimension == "angle":
        return noise.of_sights(constant, **sight, inclined=kind in STEEP)
    ends = [sight.get(f"{end}_centring", 0.0) for end in ("station", "target")]
    return noise.of_lengths(constant, per_metre, float(np.hypot(ends[0], ends[1])))


def positive(table: Table, name: str, values: np.ndarray) -> None:
    """Raise InputError naming the first cell of a column of uncertainties that is not above zero."""
    for row in np.flatnonzero(~(values > 0.0))[:1]:
        raise InputError(f"{table.place(int(row), table.column(name))}: an uncertainty must be positive; correct it "
                         "(what is exact is a fixed point, not a reading)")


def _sight(instrument: Settings, per_metre: float, dimension: str) -> dict[str, float]:
    """Arguments of `noise.of_sights`: centring of an instrument, and its pointing as a length at the target, an angle,
    or an angle per length."""
    found = {f"{end}_centring": instrument.quantity(f"{end}_centring", "length", 0.0) for end in ("station", "target")}
    negative = [key for key, value in found.items() if value < 0.0]
    if negative:
        raise InputError(f"{instrument.where(negative[0])}: is negative; an uncertainty is not")
    found["per_metre"] = per_metre
    if "pointing" not in instrument:
        return found
    text, where = instrument.text("pointing"), instrument.where("pointing")
    if dimension != "angle":
        raise InputError(f"{where}: only angles are pointed; take it out, or add what it does to a length to u")
    try:
        value = units.quantity(text)
        of = units.dimension(unit_in(text))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    if of not in ("length", "angle", "angle/length") or value < 0.0:
        raise InputError(f"{where}: '{text}' is a {of}; write a length at the target (\"0.3 mm\"), an angle "
                         "(\"1 arcsec\") or an angle per length (\"0.02 arcsec/m\"), not negative")
    given = {"length": "pointing", "angle": "aiming", "angle/length": "aiming_per_metre"}
    return found | {given[of]: value}


def _of_components(table: Table, model: Kind) -> np.ndarray:
    """Covariance (n, dim, dim) from columns u_x, u_y, u_z and, where there are any, correlations r_xy, r_xz, r_yz."""
    u = np.stack([table.number(f"u_{part}", "length") for part in model.components], axis=1)
    for j, part in enumerate(model.components):
        positive(table, f"u_{part}", u[:, j])
    correlation = np.broadcast_to(np.eye(len(model.components)), (len(table), *(2 * u.shape[1:]))).copy()
    for i, one in enumerate(model.components):
        for j in range(i):
            name = next((n for n in (f"r_{model.components[j]}{one}", f"r_{one}{model.components[j]}") if table.has(n)),
                        None)
            if name is not None:
                correlation[:, i, j] = correlation[:, j, i] = table.number(name)
    lowest = np.linalg.eigvalsh(correlation)[:, 0]
    for row in np.flatnonzero(~(lowest > 1e-12))[:1]:
        raise InputError(f"{table.path}, line {table.lines[row]} (row {table.row_numbers[row]}): these correlations "
                         "make no covariance (it is not positive definite); correct them, they lie between -1 and 1")
    return np.asarray(u[:, :, None] * correlation * u[:, None, :])


def _whole(job: Job, described: Settings, table: Table, model: Kind) -> Gaussian:
    """One matrix over all readings of a table, from the file that `covariance` names: a square table with a header."""
    source = Table.read(job.file(described.text("covariance")))
    dim = len(model.components)
    names = [f"{row}.{part}" if part else str(row) for row in table.row_numbers for part in model.components]
    keys = table.text("station").tolist()
    keys = [f"{a}-{b}" for a, b in zip(keys, table.text("target").tolist())] if model.points > 1 else keys
    by_point = [f"{key}.{part}" if part else key for key in keys for part in model.components]
    headers = list(source.names)
    order = next((n for n in (names, by_point) if len(set(n)) == len(n) and sorted(n) == sorted(headers)), None)
    if order is None:
        raise InputError(f"{source.path}, line {source.header_line}: the columns of the covariance of "
                         f"{table.path.name} must be the {len(names)} readings, {', '.join(by_point[:dim + 1])} ... or "
                         f"by row {', '.join(names[:dim + 1])} ..., with their unit, as in \"{names[0]} [mm^2]\"; "
                         f"there are {len(headers)}: {', '.join(headers[:4])} ...")
    if len(source) != len(names):
        raise InputError(f"{source.path}: has {len(source)} rows for {len(names)} columns; a covariance is square")
    square = "angle^2" if model.angular else "length^2"
    matrix = np.stack([source.number(name, square) for name in headers], axis=1)
    place = [headers.index(name) for name in order]
    matrix = matrix[np.ix_(place, place)]
    if np.abs(matrix - matrix.T).max() > 1e-9 * np.abs(matrix).max():
        i, j = np.unravel_index(np.argmax(np.abs(matrix - matrix.T)), matrix.shape)
        raise InputError(f"{source.path}: the covariance is not symmetric at {order[i]}, {order[j]}; correct it")
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        raise InputError(f"{source.path}: the covariance is not positive definite: a variance is zero, or a "
                         "correlation too large; correct it") from None
    return Gaussian.groups(np.zeros(len(table), int), {0: matrix})
