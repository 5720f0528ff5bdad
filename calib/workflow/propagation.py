"""Monte Carlo of a solved job, and whether it bears out the linear result (JCGM 101)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from calib.errors import InputError
from calib.observations import Quantity
from calib.problem import Problem
from calib.solve.estimate import Estimate
from calib.unknown import Selection, Unknown
from calib.workflow.montecarlo import Adaptive, MonteCarlo, montecarlo
from calib.workflow.places import Place

STEPS = 100         # of a progress bar
WORDS = ("no digit", "one digit", "two digits", "three digits", "four digits")
NORMAL_95 = 1.959964
QUANTILE_SPREAD = 2.67   # standard error of a 2.5% quantile of normal samples, times the root of their number, over u


def propagated(
    estimate: Estimate, trials: int | Adaptive, seed: int, quantities: Sequence[Quantity],
    step: Callable[[], None] = lambda: None, place: Place | None = None,
) -> MonteCarlo:
    """Monte Carlo that tells how far it is.

    estimate: taken as the truth; trials: how many, or `Adaptive`; seed: of the errors; quantities: to sample; step:
    called once for each of STEPS parts of the largest number of trials; place: who makes the trials.
    return: all samples together.
    """
    told, largest = 0, trials.largest if isinstance(trials, Adaptive) else trials

    def tell(done: int) -> None:
        nonlocal told
        while told < STEPS * done // largest:
            told += 1
            step()

    return montecarlo(estimate, trials, seed, quantities, tell, place)


def sampled(problem: Problem, wanted: Sequence[Any]) -> tuple[Quantity, ...]:
    """Requested results as quantities that can be sampled.

    problem: that they belong to; wanted: quantities, and unknowns or parts of them.
    return: the quantities.
    raises InputError where nothing of it is a plain number.
    """
    found = []
    for one in wanted:
        if isinstance(one, Quantity):
            found.append(one)
            continue
        selection = one if isinstance(one, Selection) else Selection(one)
        if selection.unknown.kind == "vector":
            found.append(_as_quantity(selection))
    if not found:
        raise InputError(f"{problem.name}: none of the requested results is a plain number; name others in [report] "
                         "quantities")
    return tuple(found)


def _as_quantity(selection: Selection) -> Quantity:
    unknown: Unknown = selection.unknown
    parts = tuple(range(unknown.freedom)) if selection.parts is None else selection.parts

    def themselves(value: Any) -> Any:
        return [value[part] if unknown.freedom > 1 else value for part in parts]

    index = np.arange(unknown.count) if selection.index is None else np.atleast_1d(selection.index)
    names = tuple(unknown.parts[part] for part in parts)
    if len(index) == 1 and selection.index is not None and len(parts) == 1:
        label, unit = unknown.label(int(index[0]), parts[0]), unknown.units[parts[0]]
        return Quantity(label, themselves, unknown[index], unit=unit)
    keys = [unknown.keys[i] for i in index] if unknown.count > 1 or unknown.named_keys else None
    return Quantity(unknown.name, themselves, unknown[index], unit=tuple(unknown.units[part] for part in parts),
                    parts=names, keys=keys)


def verdict(linear: float, linear_u: float, interval: Sequence[float], trials: int, digits: int = 2) -> str:
    """Whether the linear result holds, to how many digits of u.

    linear, linear_u: value and u of the linear propagation; interval: 95% interval of the samples; trials: how many;
    digits: of u that are asked for.
    return: "valid to two digits of u", "valid to one digit of u" (with what more trials would decide), "not valid" or
    "undecided: more trials".
    source: JCGM 101:2008, clause 8, with the sampling error of the interval taken into account.
    """
    apart, error = max(departures(linear, linear_u, interval)), sampling_error(linear_u, trials)
    if linear_u == 0.0:  # held, or at a bound, which the samples leave
        return f"valid to {WORDS[digits]} of u" if apart <= 1e-9 * abs(linear) else "not valid"
    for wanted in range(digits, 0, -1):
        if apart + error <= tolerance(linear_u, wanted):
            more = wanted < digits and apart - error <= tolerance(linear_u, wanted + 1)
            hint = f"; more trials would decide on {WORDS[wanted + 1].split()[0]}" if more else ""
            return f"valid to {WORDS[wanted]} of u{hint}"
    return "undecided: more trials" if apart - error <= tolerance(linear_u, 1) else "not valid"


def departures(linear: float, linear_u: float, interval: Sequence[float]) -> tuple[float, float]:
    """How far both ends of the linear 95% interval lie from those of the samples, d_low and d_high of JCGM 101, 8.1."""
    low, high = (linear - NORMAL_95 * linear_u, linear + NORMAL_95 * linear_u)
    return abs(low - interval[0]), abs(high - interval[1])


def sampling_error(linear_u: float, trials: int) -> float:
    """Twice the standard error of an end of a 95% interval from so many trials."""
    return 2.0 * QUANTILE_SPREAD * linear_u / math.sqrt(trials)


def tolerance(u: float, digits: int) -> float:
    """Numerical tolerance of u stated to so many digits; JCGM 101:2008, 7.9.2."""
    return float(Adaptive(digits).tolerance(np.array([u]))[0])
