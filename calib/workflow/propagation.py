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
from calib.workflow.montecarlo import MonteCarlo, montecarlo

CHUNK = 10_000      # trials between two steps of a progress bar
NORMAL_95 = 1.959964
QUANTILE_SPREAD = 2.67   # standard error of a 2.5% quantile of normal samples, times the root of their number, over u


def propagated(
    estimate: Estimate, trials: int, seed: int, quantities: Sequence[Quantity], step: Callable[[], None] = lambda: None
) -> MonteCarlo:
    """Monte Carlo that tells how far it is.

    estimate: taken as the truth; trials: how many; seed: of the errors; quantities: to sample; step: called once for
    each chunk of trials.
    return: all samples together.
    """
    told = 0

    def tell(done: int) -> None:
        nonlocal told
        while told * CHUNK < done:
            told += 1
            step()

    return montecarlo(estimate, trials, seed, quantities, tell)


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


def verdict(linear: float, linear_u: float, interval: Sequence[float], trials: int) -> str:
    """Whether the linear result holds, to how many digits of u.

    linear, linear_u: value and u of the linear propagation; interval: 95% interval of the samples; trials: how many.
    return: "valid to two digits of u", "valid to one digit of u" (with what more trials would decide), "not valid" or
    "undecided: more trials".
    source: JCGM 101:2008, clause 8, with the sampling error of the interval taken into account.
    """
    if linear_u == 0.0:
        return "valid to two digits of u"
    ends = (linear - NORMAL_95 * linear_u, linear + NORMAL_95 * linear_u)
    distance = max(abs(end - found) for end, found in zip(ends, interval))
    error = 2.0 * QUANTILE_SPREAD * linear_u / math.sqrt(trials)
    power = math.floor(math.log10(linear_u))
    two_digits, one_digit = (0.5 * 10.0 ** (power - digits + 1) for digits in (2, 1))
    if distance + error <= two_digits:
        return "valid to two digits of u"
    if distance + error <= one_digit:
        more = "; more trials would decide on two" if distance - error <= two_digits else ""
        return f"valid to one digit of u{more}"
    return "undecided: more trials" if distance - error <= one_digit else "not valid"
