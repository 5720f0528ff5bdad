"""Numbers as people read them: a value rounded by its uncertainty, two digits of u."""

from __future__ import annotations

import math

MINUS = "−"
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def decimals(u: float, digits: int = 2) -> int:
    """Decimals of the last digit that an uncertainty leaves meaningful.

    u: standard uncertainty, positive; digits: digits of u to keep.
    return: decimals after the point; negative for tens and hundreds.
    """
    power = math.floor(math.log10(u))
    # 0.0996 to two digits is 0.10: the rounding itself may gain a digit.
    if round(u / 10.0 ** (power - digits + 1)) >= 10**digits:
        power += 1
    return digits - 1 - power


def with_uncertainty(value: float | None, u: float | None) -> tuple[str, str]:
    """A value and its uncertainty, both to two digits of the uncertainty.

    value, u: in one unit; value None where there is none; u None or zero where it is fixed or held.
    return: two texts with a true minus sign; u is empty where there is none; dash and nothing where an uncertainty
    ought to be and is no number, because a value without it says nothing.
    """
    if value is None:
        return "–", "" if u is None else with_uncertainty(0.0, u)[1]
    if u is not None and not math.isfinite(u):
        return "–", ""
    if u is None or u <= 0:
        return plain(value), ""
    places = decimals(u)
    size = max(abs(value), u)
    power = math.floor(math.log10(size))
    if power >= 7 or power <= -5:
        mantissa = max(places + power, 0)
        tail = f"×{ten_to(power)}"
        return (_signed(f"{value / 10.0**power:.{mantissa}f}") + tail, f"{u / 10.0**power:.{mantissa}f}" + tail)
    if places < 0:
        return _signed(f"{round(value, places):.0f}"), f"{round(u, places):.0f}"
    return _signed(f"{value:.{places}f}"), f"{u:.{places}f}"


def plain(value: float | None, digits: int = 4) -> str:
    """A number without uncertainty (a count, a factor, a probability) to a few significant digits.

    value: the number; None or not finite where there is none; digits: significant digits.
    return: text with a true minus sign; a dash where there is no number.
    """
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    power = math.floor(math.log10(abs(value)))
    if power >= 7 or power <= -5:
        return _signed(f"{value / 10.0**power:.{digits - 1}f}") + f"×{ten_to(power)}"
    text = f"{value:.{max(digits - 1 - power, 0)}f}"
    return _signed(text.rstrip("0").rstrip(".") if "." in text else text)


def ten_to(power: int) -> str:
    """A power of ten, "10⁻³"."""
    return f"10{str(power).translate(_SUPERSCRIPTS)}"


def probability(value: float | None) -> str:
    """A probability: "0.58", "0.0003", "below 10⁻⁶"; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    if value < 1e-6:
        return "below 10⁻⁶"
    return f"{value:.2f}" if 0.01 <= value <= 0.995 else plain(value, 2)


def _signed(text: str) -> str:
    negative = text.startswith("-") and any(digit in "123456789" for digit in text)
    return (MINUS if negative else "") + text.lstrip("-")
