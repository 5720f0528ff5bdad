"""Mechanisms as tables in files: axes as lines in space (product of exponentials) and Denavit-Hartenberg, both ways.

axes.csv   kind (rotary, linear, frame), name, carried_by (empty: the base), direction dx, dy, dz, a point x, y, z,
           lower, upper; a frame has its place x, y, z and roll, pitch, yaw. All in base coordinates, every axis at
           zero.
dh.csv     kind (rotary, linear), name, theta, d, a, alpha, beta (Hayati's; empty in a plain row), lower, upper; a first
           row `base` and a last row `tip` have x, y, z, roll, pitch, yaw of what is before and behind the rows.

Units stand in the headers: x_mm or x_m, roll_deg or roll_rad; limits are in the units of x or of theta (roll).
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from calib import geometry, units
from calib.errors import CalibrationError, DeclarationError, InputError
from calib.geometry import Transform
from calib.mechanism import table
from calib.mechanism.axis import Axis, Frame, Linear, Rotary
from calib.mechanism.chain import Mechanism

LENGTHS, ANGLES = ("x", "y", "z", "d", "a"), ("roll", "pitch", "yaw", "theta", "alpha", "beta")
KINDS: Mapping[str, type[Axis]] = {"rotary": Rotary, "linear": Linear}
AXES_HEADER = ("kind", "name", "carried_by", "dx", "dy", "dz", "x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg",
               "yaw_deg", "lower", "upper")
TABLE_HEADER = ("kind", "name", "theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg", "x_mm", "y_mm", "z_mm",
                "roll_deg", "pitch_deg", "yaw_deg", "lower", "upper")


class _Row:
    """One row: its cells by name without unit, in SI, with file and line for messages."""

    def __init__(self, where: str, cells: Mapping[str, str], unit_of: Mapping[str, str]):
        self.where, self.cells, self.unit_of = where, cells, unit_of

    def text(self, name: str) -> str:
        return self.cells.get(name, "").strip()

    def number(self, name: str, default: float | None = None, unit: str | None = None) -> float:
        text = self.text(name)
        if not text and default is not None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if np.isnan(value):
            raise InputError(f"{self.where}, column '{name}': '{text}' is no number; " +
                             ("write one." if name in self.cells else "add the column."))
        return float(units.to_si(value, unit or self.unit_of.get(name, "1")))

    def place(self) -> Any:
        return np.array([self.number(n, 0.0) for n in "xyz"])

    def transform(self) -> Transform:
        turn = geometry.rotation_from_rpy(*(self.number(n, 0.0) for n in ("roll", "pitch", "yaw")))
        return Transform(turn, self.place())

    def limits(self, is_rotary: bool) -> tuple[float, float]:
        unit = self.unit_of.get("theta", self.unit_of.get("roll", "deg")) if is_rotary else self.unit_of.get("x", "mm")
        return self.number("lower", -np.inf, unit), self.number("upper", np.inf, unit)

    def refused(self, build: Callable[[], Any]) -> Any:
        """What a builder makes, with file and line before its objection."""
        try:
            return build()
        except DeclarationError as error:
            raise InputError(f"{self.where}: {error}") from None


def _rows(path: Path) -> list[_Row]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); check the file.") from None
    lines = [(n, cells) for n, cells in enumerate(csv.reader(StringIO(text)), 1)
             if cells and not cells[0].startswith("#") and any(c.strip() for c in cells)]
    if len(lines) < 2:
        raise InputError(f"{path}: has no rows; write a header and one row for each axis.")
    names, unit_of = [], {}
    for header in (h.strip() for h in lines[0][1]):
        name, _, unit = header.partition("_")
        wanted = "length" if name in LENGTHS else "angle" if name in ANGLES else None
        if wanted:
            if not _is(unit, wanted):
                raise InputError(f"{path}, line {lines[0][0]}: the column '{header}' needs a unit of {wanted}, as in "
                                 f"{name}_{'mm' if wanted == 'length' else 'deg'}.")
            unit_of[name] = unit
        names.append(name if wanted else header)
    for number, cells in lines[1:]:
        if len(cells) != len(names):
            raise InputError(f"{path}, line {number}: {len(cells)} cells where the header has {len(names)}; mend it.")
    return [_Row(f"{path}, line {n}", dict(zip(names, cells, strict=True)), unit_of) for n, cells in lines[1:]]


def _is(unit: str, wanted: str) -> bool:
    try:
        return bool(unit) and units.dimension(unit) == wanted
    except CalibrationError:
        return False


def _kind(row: _Row, further: tuple[str, ...]) -> str:
    kind = row.text("kind")
    if kind not in (*KINDS, *further):
        raise InputError(f"{row.where}: the kind is '{kind}'; write one of {', '.join((*KINDS, *further))}.")
    return kind


def read_axes(path: str | Path) -> Mechanism:
    """The mechanism of an axes.csv, called as the file.

    Raises InputError naming file, line and column for what is no number, has no unit, or is no mechanism.
    """
    axes, frames, rows = [], [], _rows(Path(path))
    for row in rows:
        kind, name, carrier = _kind(row, ("frame",)), row.text("name"), row.text("carried_by") or None
        if kind == "frame":
            there = row.transform()
            frames.append(row.refused(partial(Frame, name, there.translation, there.rotation, carrier)))
        else:
            direction, limits = [row.number(n) for n in ("dx", "dy", "dz")], row.limits(KINDS[kind].is_rotary)
            axes.append(row.refused(partial(KINDS[kind], name, direction, row.place(), carrier, limits)))
    return rows[0].refused(lambda: Mechanism(Path(path).stem, axes, frames))


def write_axes(mechanism: Mechanism, remark: str = "") -> str:
    """The text of an axes.csv of a mechanism; remark: a first line. An axis is written as a line, without its
    reference."""
    rows = []
    for axis in mechanism.axes:
        unit = "deg" if axis.is_rotary else "mm"
        rows.append([_name_of(axis), axis.name, axis.carried_by or "", *map(float, np.asarray(axis.direction)),
                     *_mm(axis.through), "", "", "", *_limits(axis.limits, unit)])
    for frame in mechanism.frames:
        if frame.name != "base":
            rows.append(["frame", frame.name, frame.carried_by or "", "", "", "", *_mm(frame.at),
                         *_degrees(geometry.rpy_from_rotation(np.asarray(frame.rotation))), "", ""])
    return _text(AXES_HEADER, rows, remark)


def read_table(path: str | Path, convention: str = "standard") -> Mechanism:
    """The mechanism of a dh.csv; its last frame is `tip`.

    convention: "standard" (rows with beta are Hayati's) or "modified". Raises InputError as `read_axes`.
    """
    if convention not in ("standard", "modified"):
        raise InputError(f"the convention of {path} is '{convention}'; write standard or modified.")
    rows, base, tip = [], Transform.identity(), Transform.identity()
    found = _rows(Path(path))
    for row in found:
        kind = _kind(row, ("base", "tip"))
        if kind in ("base", "tip"):
            base, tip = (row.transform(), tip) if kind == "base" else (base, row.transform())
            continue
        beta = row.number("beta") if row.text("beta") else None
        if beta is not None and convention == "modified":
            raise InputError(f"{row.where}: a modified table has no beta; use the standard one for parallel axes.")
        theta, d, a, alpha = (row.number(n) for n in ("theta", "d", "a", "alpha"))
        is_rotary = KINDS[kind].is_rotary
        rows.append(table.Row(row.text("name"), theta, d, a, alpha, beta, is_rotary, row.limits(is_rotary)))
    build = table.from_standard if convention == "standard" else table.from_modified
    return found[0].refused(lambda: build(Path(path).stem, rows, base, tip))


def write_table(given: table.Table, remark: str = "") -> str:
    """The text of a dh.csv of a table (`table.standard` or `table.modified` of a mechanism); remark: a first line."""
    def ends(kind: str, place: Transform) -> list[Any]:
        turn = geometry.rpy_from_rotation(np.asarray(place.rotation))
        return [kind, "", "", "", "", "", "", *_mm(place.translation), *_degrees(turn), "", ""]
    rows = [ends("base", given.base)]
    for row in given.rows:
        unit, angles = "deg" if row.is_rotary else "mm", _degrees([row.theta, row.alpha, row.beta or 0.0])
        rows.append(["rotary" if row.is_rotary else "linear", row.name, angles[0], *_mm([row.d, row.a]), angles[1],
                     "" if row.beta is None else angles[2], "", "", "", "", "", "", *_limits(row.limits, unit)])
    return _text(TABLE_HEADER, [*rows, ends("tip", given.tip)], remark)


def _name_of(axis: Axis) -> str:
    return "rotary" if axis.is_rotary else "linear"


def _mm(values: Any) -> list[float]:
    return [float(units.from_si(v, "mm")) for v in np.ravel(np.asarray(values, float))]


def _degrees(values: Any) -> list[float]:
    return [float(units.from_si(v, "deg")) for v in np.ravel(np.asarray(values, float))]


def _limits(limits: tuple[float, float], unit: str) -> list[Any]:
    return [float(units.from_si(v, unit)) if np.isfinite(v) else "" for v in limits]


def _text(header: tuple[str, ...], rows: list[list[Any]], remark: str) -> str:
    out = StringIO()
    if remark:
        out.write(f"# {remark}\n")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([[repr(c) if isinstance(c, float) else c for c in row] for row in rows])
    return out.getvalue()
