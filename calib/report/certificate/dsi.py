"""Units as the D-SI writes them: \\milli\\metre, \\arcsecond, \\metre\\per\\second."""

from __future__ import annotations

import re

from calib import units
from calib.errors import InputError

# Source: D-SI, Digital System of Units (SmartCom 17IND02): BIPM names, prefixes, and the units accepted beside the SI.
SYMBOLS = {
    "m": r"\metre", "km": r"\kilo\metre", "cm": r"\centi\metre", "mm": r"\milli\metre", "um": r"\micro\metre",
    "nm": r"\nano\metre", "pm": r"\pico\metre", "rad": r"\radian", "mrad": r"\milli\radian",
    "urad": r"\micro\radian", "nrad": r"\nano\radian", "deg": r"\degree", "arcmin": r"\arcminute",
    "arcsec": r"\arcsecond", "s": r"\second", "ms": r"\milli\second", "us": r"\micro\second", "min": r"\minute",
    "h": r"\hour", "d": r"\day", "K": r"\kelvin", "mK": r"\milli\kelvin", "Pa": r"\pascal", "hPa": r"\hecto\pascal",
    "kPa": r"\kilo\pascal", "V": r"\volt", "mV": r"\milli\volt", "uV": r"\micro\volt", "1": r"\one",
}
BASES = {"length": r"\metre", "angle": r"\radian", "time": r"\second", "temperature": r"\kelvin",
         "pressure": r"\pascal", "voltage": r"\volt"}


def dsi(unit: str) -> tuple[str, float]:
    """A unit as the D-SI writes it, and what a number in the old unit is multiplied by.

    unit: text such as "mm" or "arcsec/h".
    return: the D-SI text and the factor; 1 where the D-SI has this very unit, else the SI unit of the dimension.
    raises InputError for an unknown unit.
    """
    if unit in SYMBOLS:
        return SYMBOLS[unit], 1.0
    dimension = units.dimension(unit)
    above, *below = dimension.split("/")
    text = "".join(_power(part) for part in above.split("*") if part not in ("1", "number"))
    text += "".join(r"\per" + _power(part) for part in below)
    return text or r"\one", units.factor(unit)


def _power(part: str) -> str:
    name, _, power = part.partition("^")
    return BASES[name] + (rf"\tothe{{{power}}}" if power else "")


def factor(text: str) -> float:
    """The SI value of a unit in D-SI writing.

    text: as `dsi` writes it.
    return: the SI value of one of it.
    raises InputError for a unit that is not known here.
    """
    for symbol, written in SYMBOLS.items():
        if written == text:
            return units.factor(symbol)
    rest = re.sub(r"\\per|\\tothe\{\d+\}", "", text)
    for base in BASES.values():
        rest = rest.replace(base, "")
    if rest:
        raise InputError(f"the D-SI unit '{text}' is not known here; known are {', '.join(SYMBOLS.values())}")
    return 1.0
