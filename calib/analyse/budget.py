"""Uncertainty budget: what each group of observations, prior and held quantity contributes to u of a result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.analyse.covariance import considered, refuse_what_cannot_be_known
from calib.blocks import Array
from calib.errors import DeclarationError
from calib.linearisation import Functions, Linearisation


@dataclass(frozen=True)
class Contribution:
    """One line of a budget: label, contribution to u in SI, and share of the variance."""

    label: str
    u: float
    share: float


@dataclass(frozen=True)
class Budget:
    """Contributions to the standard uncertainty u (SI) of one result, largest first; unit is for display."""

    name: str
    unit: str
    value: float
    u: float
    contributions: tuple[Contribution, ...]


def budget(fit: Linearisation, what: Any) -> Budget:
    """Split the variance of one scalar result into its contributions, which add up to it exactly.

    fit: a linearisation; what: a scalar quantity, selection or name.
    Raises DeclarationError where `what` is not one scalar, RankDefect where it cannot be known.
    Source: JCGM 100:2008, 5.1 (each contribution is |sensitivity coefficient| times u of its input).
    """
    functions = fit.functions(what)
    if len(functions.labels) != 1:
        raise DeclarationError(
            f"a budget is of one scalar; this is {len(functions.labels)}: {', '.join(functions.labels)}. "
            "Ask for one of them by name."
        )
    return budgets(fit, functions)[0]


def budgets(fit: Linearisation, functions: Functions) -> tuple[Budget, ...]:
    """The budget of each of some functions, in one pass over the rows; arguments and errors as of `budget`."""
    refuse_what_cannot_be_known(fit, functions)
    free = fit.free_part(functions.derivatives)
    directions = np.zeros(functions.derivatives.shape)
    directions[:, fit.layout.free_columns] = fit.factor.solve(free.T).T
    variances: dict[str, Array] = {}
    for group in fit.groups:
        blocks = group.whitened
        variances[group.name] = np.array([sum(float(np.sum(b.times(one) ** 2)) for b in blocks) for one in directions])
    held = considered(fit)
    sensitivity = functions.derivatives[:, list(held.columns)] + free @ held.response
    for label, of_each in zip(held.labels, (sensitivity * (sensitivity @ held.covariance)).T, strict=True):
        variances[f"held {label}"] = of_each
    return tuple(
        _budget(functions.labels[k], functions.units[k], float(functions.values[k]),
                {label: float(of_each[k]) for label, of_each in variances.items()})
        for k in range(len(directions)))


def _budget(name: str, unit: str, value: float, variances: Mapping[str, float]) -> Budget:
    """A budget from {label: variance}; a group that the result does not depend on has no line."""
    total = sum(variances.values())
    lines = tuple(Contribution(label, float(np.sqrt(max(v, 0.0))), v / total)
                  for label, v in sorted(variances.items(), key=lambda item: -item[1]) if v != 0.0)
    return Budget(name, unit, value, float(np.sqrt(total)), lines)
