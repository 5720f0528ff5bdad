"""Conformity of a result with its tolerance (guard band of ISO 14253-1) and with another result (E_n)."""

from __future__ import annotations

import math
from dataclasses import dataclass

PROBABILITY = 0.95
PASS, FAIL, UNDECIDED = "pass", "fail", "undecided"


@dataclass(frozen=True)
class Conformity:
    """Whether a result keeps its tolerance; all in SI.

    value, u, lower, upper; probability: of the quantity lying within the limits; verdict: "pass" where that is at least
    0.95, "fail" where it is at most 0.05, else "undecided".
    """

    quantity: str
    unit: str
    value: float
    u: float
    lower: float
    upper: float
    probability: float
    verdict: str


def judge(quantity: str, unit: str, value: float, u: float, lower: float, upper: float) -> Conformity:
    """Judge one result.

    quantity, unit: for display; value, u, lower, upper: SI, u > 0.
    return: the verdict with the probability it rests on.
    source: ISO 14253-1:2017, default limit of 95% for proving conformity and for proving nonconformity. Far from the
    other limit this is the guard band of 1.65 u; for u beyond the width of the tolerance it stays right.
    """
    within = _normal((upper - value) / u) - _normal((lower - value) / u)
    verdict = PASS if within >= PROBABILITY else FAIL if within <= 1.0 - PROBABILITY else UNDECIDED
    return Conformity(quantity, unit, value, u, lower, upper, within, verdict)


@dataclass(frozen=True)
class Compatibility:
    """A result beside that of a second method or an earlier calibration; all in SI.

    value, other; expanded, other_expanded: their expanded uncertainties (k = 2); normalised: the normalised error E_n;
    compatible: whether it is at most 1 in size.
    """

    quantity: str
    unit: str
    value: float
    expanded: float
    other: float
    other_expanded: float
    normalised: float
    compatible: bool


def compared(quantity: str, unit: str, value: float, expanded: float, other: float, other_expanded: float
             ) -> Compatibility:
    """Compare two results of one quantity that are independent of each other.

    quantity, unit: for display; value, other: SI; expanded, other_expanded: expanded uncertainties, not both zero.
    return: the comparison, E_n = (x - y)/sqrt(U_x^2 + U_y^2).
    source: ISO/IEC 17043, E_n number.
    """
    normalised = (value - other) / math.hypot(expanded, other_expanded)
    return Compatibility(quantity, unit, value, expanded, other, other_expanded, normalised, abs(normalised) <= 1.0)


def _normal(z: float) -> float:
    return 0.5 * math.erfc(-z / math.sqrt(2.0))
