"""Columns of a table: the name and unit in a header, and the number or angle in a cell."""

from __future__ import annotations

import re
from dataclasses import dataclass

from calib import units
from calib.errors import InputError

SEXAGESIMAL = "dms"
LARGEST = 1e100     # squares of larger numbers, over a u, overflow
CELSIUS = ("C", "degC", "°C")
_NUMERATORS = frozenset(("m", "mm", "um", "nm", "rad", "mrad", "urad", "deg", "arcsec", "gon", "ppm", "K", "mK"))
_DENOMINATORS = frozenset(("s", "min", "h", "K", "m"))
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
_NOTHING = frozenset(("", "nan", "na", "n/a", "null", "none", "-", "--", "inf", "+inf", "-inf", "infinity"))
_ANGLE = re.compile(
    r"""(?P<sign>[+-]?)\s*(?P<degrees>\d+)\s*(?:°|d|deg|-|:)\s*
        (?P<minutes>\d+(?:\.\d+)?)\s*(?:['′’m]|min)?\s*
        (?:[-:]?\s*(?P<seconds>\d+(?:\.\d+)?)\s*(?:["″”s]|''|sec)?)?""",
    re.VERBOSE,
)


@dataclass(frozen=True)
class Column:
    """One column of a table: its header as written, the name in it, and the unit in it (None where there is none)."""

    header: str
    name: str
    unit: str | None

    @property
    def dimension(self) -> str | None:
        """Dimension of the unit; "angle" for sexagesimal angles, None where the header has no unit."""
        if self.unit is None:
            return None
        if self.unit == SEXAGESIMAL:
            return "angle"
        return "temperature" if self.unit in CELSIUS else units.dimension(self.unit)


def column(header: str) -> Column:
    """The name and unit in a header such as `x_mm`, `x [mm]`, `speed_mm_s`, `hz_dms` or `temp_C`.

    header: one cell of the header line.
    return: the column.
    raises InputError for a unit in brackets that is not known.
    """
    header = header.strip()
    bracketed = re.fullmatch(r"(.*?)\s*\[(.*)\]", header)
    if bracketed:
        unit = bracketed[2].strip()
        if not _is_unit(unit):
            units.dimension(unit)
        return Column(header, bracketed[1], unit)
    words = header.split("_")
    if len(words) > 2 and words[-2] in _NUMERATORS and words[-1] in _DENOMINATORS:
        return Column(header, "_".join(words[:-2]), f"{words[-2]}/{words[-1]}")
    if len(words) > 1 and words[-1] != "1" and _is_unit(words[-1]):
        return Column(header, "_".join(words[:-1]), words[-1])
    return Column(header, header, None)


def _is_unit(text: str) -> bool:
    return text == SEXAGESIMAL or text in CELSIUS or text in units.SYMBOLS


def number(cell: str, unit: str, decimal: str = ".") -> float:
    """The SI value of one cell.

    cell: text of the cell.
    unit: unit of the column; "dms" for angles written as 185-29-31.5.
    decimal: decimal sign, "." or ",".
    return: value in SI.
    raises InputError saying what is wrong with the cell (not where it is).
    """
    text = cell.strip().replace("−", "-")
    if text.lower() in _NOTHING:
        said = f"'{text}'" if text else "empty"
        raise InputError(f"the cell is {said}, where a number is wanted; write it or take the row out")
    if decimal == ",":
        if "." in text:
            raise InputError(f"'{text}' has a decimal point although the decimal sign is the comma; use one sign")
        text = text.replace(",", ".")
    elif _DECIMAL_COMMA.fullmatch(text):
        raise InputError(f"'{text}' has a decimal comma; write a point, or set decimal = \",\" for this table")
    if _NUMBER.fullmatch(text):
        if unit == SEXAGESIMAL:
            raise InputError(f"'{text}' is a plain number in a column of degrees, minutes and seconds; "
                             "write 185-29-31.5, or name the column _deg")
        value = float(text)
        if not abs(value) < LARGEST:
            raise InputError(f"'{text}' is too large for a number; check it")
        return float(units.kelvin_from_celsius(value)) if unit in CELSIUS else float(units.to_si(value, unit))
    if unit in (SEXAGESIMAL, "deg", "°"):
        return angle(text)
    raise InputError(f"'{text}' is not a number; write digits with a decimal point and leave the unit to the header")


def angle(text: str) -> float:
    """The radians of an angle in degrees, minutes and seconds: 185°29'31.5", 185-29-31.5, 185d29m31s.

    text: the angle; minutes and seconds below 60.
    return: radians.
    raises InputError for any other form.
    """
    found = _ANGLE.fullmatch(text.strip().replace("−", "-"))
    if not found:
        raise InputError(f"'{text}' is not an angle; write 185.4921, 185-29-31.5 or 185°29'31.5\"")
    minutes, seconds = float(found["minutes"]), float(found["seconds"] or 0.0)
    if minutes >= 60 or seconds >= 60:
        raise InputError(f"'{text}' has 60 or more minutes or seconds; check the digits")
    # Whole arcseconds are exact in binary, degrees are not: scale once, at the end.
    total = int(found["degrees"]) * 3600 + minutes * 60 + seconds
    return (-total if found["sign"] == "-" else total) * units.arcsec


def text_of(value: float, unit: str | None) -> str:
    """The cell of an SI value in the unit of its column, in full precision.

    value: SI value.
    unit: unit of the column; None for a plain number.
    return: text that `number` reads back.
    """
    if unit == SEXAGESIMAL:
        thousandths = round(abs(value) / units.arcsec * 1e6)
        minutes, rest = divmod(thousandths, 60_000_000)
        degrees, minutes = divmod(minutes, 60)
        return f"{'-' if value < 0 else ''}{degrees}-{minutes:02d}-{rest / 1e6:09.6f}"
    return repr(in_unit(value, unit))


def in_unit(value: float, unit: str | None) -> float:
    """An SI value in the unit of its column, degrees Celsius included; as it is where there is no unit."""
    if unit in CELSIUS:
        return float(value - 273.15)
    return float(units.from_si(value, unit)) if unit else float(value)
