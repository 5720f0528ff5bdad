"""Units: texts such as "arcsec/h" to SI factors and dimensions; stated uncertainties such as "0.5 um + 0.2 um/m"."""

from __future__ import annotations

import math
import re
from functools import cache
from typing import Any

from .errors import InputError

metre = 1.0
cm = 1e-2
mm = 1e-3
um = 1e-6
nm = 1e-9
radian = 1.0
mrad = 1e-3
urad = 1e-6
degree = math.pi / 180.0
arcmin = degree / 60.0
arcsec = degree / 3600.0
gon = math.pi / 200.0
mgon = gon / 1000.0
second = 1.0
minute = 60.0
hour = 3600.0
kelvin = 1.0
ppm = 1e-6
percent = 1e-2

# One dimension each. An angle is a dimension of its own: "arcsec/h" is a drift of an angle and no frequency.
SYMBOLS: dict[str, tuple[float, str]] = {
    "m": (metre, "length"), "km": (1e3, "length"), "cm": (cm, "length"), "mm": (mm, "length"),
    "um": (um, "length"), "nm": (nm, "length"), "pm": (1e-12, "length"),
    "rad": (radian, "angle"), "mrad": (mrad, "angle"), "urad": (urad, "angle"), "nrad": (1e-9, "angle"),
    "deg": (degree, "angle"), "°": (degree, "angle"), "arcmin": (arcmin, "angle"), "arcsec": (arcsec, "angle"),
    "mas": (arcsec / 1000.0, "angle"), "gon": (gon, "angle"), "mgon": (mgon, "angle"), "cc": (gon / 1e4, "angle"),
    "rev": (2.0 * math.pi, "angle"),
    "s": (second, "time"), "ms": (1e-3, "time"), "us": (1e-6, "time"), "min": (minute, "time"), "h": (hour, "time"),
    "d": (86400.0, "time"), "Hz": (1.0, "1/time"),
    "K": (kelvin, "temperature"), "mK": (1e-3, "temperature"),
    "Pa": (1.0, "pressure"), "hPa": (100.0, "pressure"), "kPa": (1e3, "pressure"), "mbar": (100.0, "pressure"),
    "bar": (1e5, "pressure"),
    "V": (1.0, "voltage"), "mV": (1e-3, "voltage"), "uV": (1e-6, "voltage"),
    "1": (1.0, "number"), "%": (percent, "number"), "ppm": (ppm, "number"), "ppb": (1e-9, "number"),
}
CUSTOMARY = {"length": "mm", "angle": "arcsec", "time": "s", "temperature": "K", "pressure": "hPa", "voltage": "mV",
             "number": "ppm"}
_SPELLINGS = {"metre": "m", "meter": "m", "micron": "um", "degree": "deg", "degrees": "deg", "radian": "rad",
              "second": "s", "sec": "s", "minute": "min", "hour": "h", "kelvin": "K", "percent": "%",
              '"': "arcsec", "″": "arcsec",
              "'": "arcmin", "′": "arcmin"}
_CELSIUS = ("degC", "°C", "C", "celsius")
_SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_TOKEN = re.compile(r"\s*(?:(?P<operator>[*/()])|"
                    r"(?P<symbol>1(?!\d)|[A-Za-z°%\"'″′]+)(?:(?:\^|\*\*)?(?P<power>-?\d+))?)")
_TERM = re.compile(r"\s*(?P<plus>\+)?\s*(?P<number>-?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?P<unit>[^+]*)")


@cache
def _parsed(unit: str) -> tuple[float, tuple[tuple[str, int], ...]]:
    """SI factor and sorted powers of the base dimensions of a unit text."""
    if not isinstance(unit, str):
        raise InputError(f"a unit is a text such as 'mm' or 'arcsec/h', not {unit!r}")
    text = unit.strip().replace("µ", "u").replace("μ", "u").replace("·", "*").replace("−", "-").translate(_SUPERSCRIPTS)
    # `outer` is the sign of the bracket we are in, `sign` that of the last operator inside it
    powers: dict[str, int] = {}
    factor, sign, outer, signs, position, expects_symbol = 1.0, 1, 1, [], 0, True
    while position < len(text.rstrip()):
        found = _TOKEN.match(text, position)
        if found is None:
            raise InputError(f"the unit '{unit}' cannot be read at '{text[position:]}': write products, quotients and "
                             "powers of known units, as in 'um/m' or 'ppm/K'")
        position = found.end()
        operator = found["operator"]
        if operator is None:
            power = sign * outer * int(found["power"] or 1)
            scale, dimension = _symbol(found["symbol"], unit)
            factor *= scale**power if power > 0 else 1.0 / scale**-power
            base, turn = ("time", -1) if dimension == "1/time" else (dimension, 1)
            if base != "number":
                powers[base] = powers.get(base, 0) + turn * power
            sign, expects_symbol = 1, False
        elif operator == "(":
            signs.append(outer)
            outer, sign, expects_symbol = outer * sign, 1, True
        elif expects_symbol or (operator == ")" and not signs):
            raise InputError(f"the unit '{unit}' has a '{operator}' with nothing before it that it belongs to")
        elif operator == ")":
            outer = signs.pop()
        else:
            sign, expects_symbol = (-1 if operator == "/" else 1), True
    if expects_symbol or signs:
        raise InputError(f"the unit '{unit}' is not complete: a unit or a closing bracket is missing "
                         "(the unit of a plain number is '1')")
    return factor, tuple(sorted((name, power) for name, power in powers.items() if power))


def _symbol(symbol: str, unit: str) -> tuple[float, str]:
    known = SYMBOLS.get(_SPELLINGS.get(symbol, symbol))
    if known is not None:
        return known
    inside = "" if symbol == unit else f" in '{unit}'"
    if symbol in _CELSIUS:
        raise InputError(f"'{symbol}'{inside} has an offset and is no factor: write differences and uncertainties in "
                         "'K'; absolute temperatures in degrees Celsius go through units.kelvin_from_celsius")
    near = near_matches(symbol, [*SYMBOLS, *(spelling for spelling in _SPELLINGS if spelling.isalpha())])
    hint = f"did you mean {' or '.join(repr(name) for name in near)}?" if near else f"known are {', '.join(SYMBOLS)}"
    raise InputError(f"unknown unit '{symbol}'{inside}: {hint}")


def near_matches(word: str, names: list[str], most: int = 3) -> list[str]:
    """Names that a person may have meant by a word.

    word: what was written; names: what exists; most: how many to return. Returns the nearest names, nearest first.
    """
    def distance(name: str) -> float:
        a, b = word.lower(), name.lower()
        row = list(range(len(b) + 1))
        for i, letter in enumerate(a, 1):
            before, row[0] = row[0], i
            for j, other in enumerate(b, 1):
                before, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, before + (letter != other))
        return row[-1] + 0.5 * (a != b and not b.startswith(a) and not a.startswith(b))

    ranked = sorted((distance(name), index) for index, name in enumerate(names))
    return [names[index] for value, index in ranked[:most] if value < max(1.6, 0.5 * len(word))]


def factor(unit: str) -> float:
    """The SI value of one unit.

    unit: text such as "mm", "arcsec/h", "um/(m*K)". Raises InputError on an unknown symbol, naming near ones.
    """
    return _parsed(unit)[0]


def dimension(unit: str) -> str:
    """The dimension of a unit as a text: "length", "angle/time", "1/temperature", "length^2", or "number" for "um/m".

    unit: text. Raises InputError on an unknown symbol.
    """
    powers = _parsed(unit)[1]
    above = [name + (f"^{power}" if power > 1 else "") for name, power in powers if power > 0]
    below = [name + (f"^{-power}" if power < -1 else "") for name, power in powers if power < 0]
    if not powers:
        return "number"
    return "/".join(["*".join(above) or "1", *below])


def to_si(value: Any, unit: str) -> Any:
    """A value in SI.

    value: number or array in `unit`; unit: text. Returns value times the factor. Raises InputError on an unknown unit.
    """
    return value * factor(unit)


def from_si(value: Any, unit: str) -> Any:
    """An SI value in a unit.

    value: number or array [SI]; unit: text. Returns the number in `unit`. Raises InputError on an unknown unit.
    """
    return value / factor(unit)


def customary(expected: str) -> str:
    """A unit that people would write for a dimension, for the examples in messages; expected: such as "angle/time"."""
    return re.sub("[a-z]+", lambda name: CUSTOMARY[name[0]], expected)


def kelvin_from_celsius(value: Any) -> Any:
    """Absolute temperature [K] of a temperature in degrees Celsius (number or array)."""
    return value + 273.15


def quantity(text: str, expected: str | None = None) -> float:
    """The SI value of a text such as "0.1 mm".

    text: number and unit; expected: dimension that it must have ("length"), None for any. Returns the value [SI].
    Raises InputError when the text is no number with a unit or has another dimension.
    """
    terms = _terms(text)
    if len(terms) != 1:
        raise InputError(f"'{text}' is a sum; one number with its unit is wanted, as in "
                         f"'0.1 {customary(expected or 'length')}'")
    value, unit = terms[0]
    _require(text, unit, expected)
    return to_si(value, unit)


def uncertainty(text: str, expected: str | None = None) -> tuple[float, float]:
    """A stated standard uncertainty "a + b L" as its two SI numbers.

    text: "0.5 um + 0.2 um/m", "10 urad", "2 mm + 1 ppm"; expected: dimension of the reading ("length"), None for any;
    with it a lone "5 ppm" of a length is proportional. Returns (constant [SI], proportional [SI per metre]).
    Raises InputError when a term is not a number with a unit, is negative, or has the wrong dimension.
    """
    terms = _terms(text)
    of = expected if expected is not None else dimension(terms[0][1])
    constant, proportional, seen = 0.0, 0.0, set()
    for value, unit in terms:
        per_length = {"length": "number", "number": "1/length"}.get(of, f"{of}/length")
        kind = dimension(unit)
        if kind in seen:
            raise InputError(f"'{text}' names two terms of the same dimension; write one constant and one per length")
        seen.add(kind)
        if value < 0.0:
            raise InputError(f"'{text}' has a negative term; an uncertainty is not negative")
        if kind == of:
            constant = to_si(value, unit)
        elif kind == per_length:
            proportional = to_si(value, unit)
        else:
            raise InputError(f"'{value:g} {unit}' in '{text}' is a {kind}; for a reading of dimension {of} write a "
                             f"constant of dimension {of} and, where wanted, a second term of dimension {per_length}")
    return constant, proportional


def _terms(text: str) -> list[tuple[float, str]]:
    if not isinstance(text, str):
        raise InputError(f"a value with its unit is a text such as '0.5 um', not {text!r}")
    terms, position = [], 0
    while position < len(text.rstrip()):
        found = _TERM.match(text, position)
        if found is None or (position > 0) != (found["plus"] is not None):
            raise InputError(f"'{text}' is not understood at '{text[position:].strip()}': write a number and a "
                             "unit, as in '10 urad' or '0.5 um + 0.2 um/m'")
        unit = found["unit"].strip()
        if not unit:
            raise InputError(f"'{text}' has a number without a unit; write '1' as the unit of a plain number")
        factor(unit)
        terms.append((float(found["number"]), unit))
        position = found.end()
    if not terms:
        raise InputError("an empty text where a value with its unit is wanted, as in '0.5 um + 0.2 um/m'")
    return terms


def _require(text: str, unit: str, expected: str | None) -> None:
    if expected is not None and dimension(unit) != expected:
        raise InputError(f"'{text}' is a {dimension(unit)}, but a {expected} is wanted")
