"""Conformity of a result with its tolerance, decided by the guard band of ISO 14253-1."""

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


def _normal(z: float) -> float:
    return 0.5 * math.erfc(-z / math.sqrt(2.0))
