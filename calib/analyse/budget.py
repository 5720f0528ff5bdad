"""Uncertainty budget: what each group of observations, prior and held quantity contributes to u of a result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.analyse.covariance import considered, refuse_what_cannot_be_known
from calib.errors import DeclarationError
from calib.linearisation import Linearisation


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
    refuse_what_cannot_be_known(fit, functions)
    free = fit.free_part(functions.derivatives)
    direction = np.zeros(fit.layout.size)
    direction[fit.layout.free_columns] = fit.factor.solve(free.T)[:, 0]
    variances: list[tuple[str, float]] = []
    for group in fit.groups:
        total = 0.0
        for block in group.whitened:
            total += float(np.sum(block.times(direction) ** 2))
        if total > 0.0:
            variances.append((group.name, total))
    held = considered(fit)
    if held.columns:
        sensitivity = (functions.derivatives[:, list(held.columns)] + free @ held.response)[0]
        for label, variance in zip(held.labels, sensitivity * (held.covariance @ sensitivity), strict=True):
            variances.append((f"held {label}", float(variance)))
    total = sum(v for _, v in variances)
    lines = tuple(
        Contribution(label, float(np.sqrt(max(v, 0.0))), v / total if total else 0.0)
        for label, v in sorted(variances, key=lambda item: -item[1])
    )
    return Budget(functions.labels[0], functions.units[0], float(functions.values[0]), float(np.sqrt(total)), lines)
