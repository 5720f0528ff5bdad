"""The readings of the five-axis procedure as arrays: level, filaments, targets on the pitch and roll axes, distances,
index.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from calib.errors import InputError
from calib.table import Table, shipped
from calib.units import arcsec, degree

FOLDER = "five_axis"
FILES = {
    "level": "table1_level.csv",
    "wires": "table2_filaments.csv",
    "pitch": "table3_pitch.csv",
    "roll": "table4_roll.csv",
    "distances": "distances.csv",
    "centres": "axis_centres.csv",
}
TABLES = ("three_axis", "two_axis")
WIRES = ("S3", "S2")
INSTRUMENTS = ("T1", "T2")
FIELD = 10 * degree
# Directions that the printed readings are counted from: T1 and T2 horizontally, and the horizon.
HORIZONTAL, T2_HORIZONTAL = (185 * 3600 + 29 * 60) * arcsec, (27 * 3600 + 20 * 60) * arcsec
VERTICAL = 90 * degree
SIGHTS = tuple(f"{i} {w}" for i in INSTRUMENTS for w in WIRES)
NEAR_AND_FAR = {"pitch": ("A", "B"), "roll": ("C", "D"), "two_axis_pitch": ("E", "F")}


@dataclass(frozen=True)
class Circle:
    """Readings of one table: target (n,), angle (n,) [rad], reading (n,) or (n, 2) H, V [rad], row numbers (n,)."""

    target: np.ndarray
    angle: np.ndarray
    reading: np.ndarray
    rows: np.ndarray
    instrument: np.ndarray

    def index(self, keys: tuple[str, ...]) -> np.ndarray:
        """Number of the target of each row among keys."""
        return np.array([keys.index(t) for t in self.target])


@dataclass(frozen=True)
class Readings:
    """All that is read, in SI.

    level_angle (n,), level (n, 2): yaw position and level reading on the three-axis and the two-axis table; wires,
    pitch, roll; distance: {target, or wire for the yaw axis: (value, u)}; centre: {"E": (H, V, u)} of fitted targets
    without readings; index: (value, u) of the vertical circle at a horizontal line of sight; u_level, u_circle: of
    one reading.
    """

    level_angle: np.ndarray
    level: np.ndarray
    level_rows: np.ndarray
    wires: Circle
    pitch: Circle
    roll: Circle
    distance: Mapping[str, tuple[float, float]]
    centre: Mapping[str, tuple[float, float, float]]
    index: tuple[float, float]
    u_level: float
    u_circle: float
    feet: Mapping[str, tuple[int, float, float]] = field(default_factory=dict)

    def sights(self) -> dict[str, float]:
        """Mean reading of every circle, {"T1 S3": ..., "A H": ..., "A V": ...} [rad], to start from.

        Readings of one circle are taken within half a turn of each other, those of T1 also of its reading of S3.
        Raises InputError where a target stands far off the line of sight along the axis.
        """
        found: dict[str, float] = {}
        for instrument in INSTRUMENTS:
            for wire in WIRES:
                read = self.wires.reading[(self.wires.instrument == instrument) & (self.wires.target == wire)]
                found[f"{instrument} {wire}"] = _near(read, found.get(f"{instrument} {WIRES[0]}", read[0]))
        along = np.array([found["T1 S3"], self.index[0]])
        read = {t: circle.reading[circle.target == t] for circle in (self.pitch, self.roll) for t in circle.target}
        read |= {t: np.array([[h, v]]) for t, (h, v, _) in self.centre.items()}
        for target, both in read.items():
            for name, readings, axis in zip("HV", both.T, along):
                found[f"{target} {name}"] = _near(readings, axis)
                if abs(found[f"{target} {name}"] - axis) > FIELD:
                    raise InputError(
                        f"target {target} is read at {found[f'{target} {name}'] / degree:.2f} deg, {name} along the "
                        f"axes is {axis / degree:.2f} deg: the theodolite looks along the axes, so these must agree to "
                        f"{FIELD / degree:.0f} deg. Was it turned or set anew between the tables? Correct the readings."
                    )
        return found


def _near(readings: np.ndarray, angle: float) -> float:
    """Mean of circle readings, each taken within half a turn of an angle."""
    turn = 2 * np.pi
    return float(np.mean(readings - turn * np.rint((readings - angle) / turn)))


def published(*, as_printed: bool = False) -> Readings:
    """The readings of the paper's tables 1 to 4 and section 5.1.

    as_printed: with the digit of table 4 (target C, 270 degrees) as printed instead of repaired.
    """
    return from_tables(
        {name: shipped(f"{FOLDER}/{file}") for name, file in FILES.items()},
        roll_column="horizontal_printed" if as_printed else "horizontal",
    )


def from_tables(
    tables: Mapping[str, Table], *, index: tuple[float, float] = (90 * degree + 16 * arcsec, 1 * arcsec),
    u_level: float = 0.2 * arcsec, u_circle: float = 1 * arcsec, roll_column: str = "horizontal"
) -> Readings:
    """Readings from tables in the columns of the shipped ones.

    tables: level, wires, pitch, roll, distances and, where targets have fitted centres only, centres; index, u_level,
    u_circle: in rad, as the paper states them; roll_column: the horizontal circle on the roll axis.
    Raises InputError for a missing table, an unknown target or instrument, or a missing distance.
    """
    for name, file in FILES.items():
        if name not in tables and name != "centres":
            raise InputError(
                f"table '{name}' is missing; name it in the job, in the columns of problems/data/{FOLDER}/{file}"
            )
    level = tables["level"]
    pitch, roll = _circle(tables["pitch"], "horizontal"), _circle(tables["roll"], roll_column)
    wires = _circle(tables["wires"], "horizontal", horizontal_only=True)
    _check(tables["wires"], np.array([f"{i} {w}" for i, w in zip(wires.instrument, wires.target)]), SIGHTS, "target")
    _check(tables["pitch"], pitch.target, NEAR_AND_FAR["pitch"])
    _check(tables["roll"], roll.target, NEAR_AND_FAR["roll"])
    lengths = tables["distances"]
    distance = {}
    for instrument, target, value, u in zip(
        lengths.text("instrument"), lengths.text("target"), lengths.number("distance", "length"),
        lengths.number("u", "length")):
        distance[str(instrument) if target in WIRES else str(target)] = (float(value), float(u))
    for row in np.flatnonzero(lengths.number("u", "length") <= 0.0):
        raise InputError(f"{lengths.place(int(row), lengths.column('u'))}: a distance needs a positive u; state it")
    centre = {}
    if "centres" in tables:
        given = tables["centres"]
        for target, h, v, u in zip(
            given.text("target"), given.number("horizontal", "angle"), given.number("vertical", "angle"),
            given.number("u", "angle")):
            centre[str(target)] = (float(h), float(v), float(u))
    feet = {}
    if "feet" in tables:
        given = tables["feet"]
        _check(given, given.text("table"), TABLES, "table")
        places = zip(given.text("table"), given.text("foot"), given.number("x", "length"), given.number("y", "length"))
        for table, foot, x, y in places:
            feet[f"{foot} of the {table.replace('_', '-')} table"] = (TABLES.index(table), float(x), float(y))
    for target in (*INSTRUMENTS, *NEAR_AND_FAR["pitch"], *NEAR_AND_FAR["roll"], *centre):
        if target not in distance:
            raise InputError(
                f"{lengths.path}: the distance of {target} is missing; add a line for it (instruments: to the yaw axis)"
            )
    levels = np.stack([level.number(f"{table}", "angle") for table in TABLES], axis=1)
    return Readings(
        level.number("position", "angle"), levels, level.row_numbers, wires, pitch, roll, distance, centre, index,
        u_level, u_circle, feet)


def _circle(table: Table, horizontal: str, *, horizontal_only: bool = False) -> Circle:
    h = table.number(horizontal, "angle")
    reading = h if horizontal_only else np.stack([h, table.number("vertical", "angle")], axis=1)
    return Circle(
        table.text("target"), table.number("position", "angle"), reading, table.row_numbers, table.text("instrument")
    )


def _check(table: Table, found: np.ndarray, known: tuple[str, ...], column: str = "target") -> None:
    for row, name in enumerate(found):
        if name not in known:
            raise InputError(
                f"{table.place(row, table.column(column))}: '{name}' is not one of {', '.join(known)}; correct it"
            )
    for name in known:
        if name not in found:
            raise InputError(f"{table.path}: no row of {column} '{name}'; the procedure needs {' and '.join(known)}")
