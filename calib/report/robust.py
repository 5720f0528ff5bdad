"""What a robust loss did, for people: which readings it took for wild, and what the uncertainties then mean."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib import units
from calib.report import numbers
from calib.report.template import Grid
from calib.solve.downweight import RobustLoss, Truncated, wild_below
from calib.solve.loss import Huber
from calib.solve.robust import RobustEstimate
from calib.workflow.solution import Solution

NAMED = 3       # wild readings in the sentence
LISTED = 20     # wild readings on a page; result.json has all


def named(loss: RobustLoss) -> str:
    """A loss in words."""
    if isinstance(loss, Huber):
        return f"Huber's loss, straight from {loss.threshold:g} u on"
    return f"squares up to {loss.limit:g} u (graduated non-convexity)" if isinstance(loss, Truncated) else \
        "the sum of magnitudes (L1)"


def sentence(solution: Solution, found: RobustEstimate) -> str:
    """How the readings were weighed, and which do not belong."""
    wild, count = len(_wild(found)), sum(weights.size for weights in found.weights.values())
    what = "left out" if isinstance(found.loss, Truncated) else "hardly pull" + ("s" if wild == 1 else "")
    most = f"{wild or 'none'} of {count} scalar readings {'is' if wild < 2 else 'are'} wild"
    worst = [f"row {one['row']} of {' '.join(filter(None, (one['group'], one['component'])))} (off by "
             f"{numbers.with_uncertainty(one['residual'], one['u'])[0]} {one['unit']})"
             for one in list(_entries(solution, found))[:NAMED]]
    misses = f" Check {', '.join(worst)}." if worst else ""
    return (f"Robust estimate with {named(found.loss)}: {most}{f' and {what}' if wild else ''}.{misses} The "
            "uncertainties hold where all others are as stated.")


def content(solution: Solution) -> dict[str, Any]:
    """The entry `robust` of result.json; nothing where least squares were asked for."""
    found = solution.robust
    if found is None:
        return {}
    loss = found.loss
    return {"robust": {
        "loss": "truncated" if isinstance(loss, Truncated) else "huber" if isinstance(loss, Huber) else "l1",
        "limit": loss.limit if isinstance(loss, Truncated) else loss.threshold if isinstance(loss, Huber) else None,
        "converged": found.converged, "iterations": found.iterations, "loss_value": found.value,
        "readings": sum(weights.size for weights in found.weights.values()), "wild": list(_entries(solution, found))}}


def weight_of(solution: Solution) -> dict[tuple[str, int, str], float]:
    """{(group, row, component): weight} of every scalar reading; empty where least squares were asked for."""
    if solution.robust is None:
        return {}
    return {(group.name, int(row), component): float(weight)
            for group in solution.fit.groups if group.name in solution.robust.weights
            for row, line in zip(group.rows, solution.robust.weights[group.name])
            for component, weight in zip(group.components, line)}


def wild(solution: Solution) -> Grid | None:
    """The wild readings, the least weighed first."""
    if solution.robust is None:
        return None
    rows = []
    for one in list(_entries(solution, solution.robust))[:LISTED]:
        residual, u = numbers.with_uncertainty(one["residual"], one["u"])
        rows.append([one["group"], str(one["row"]), one["component"], residual, u, one["unit"],
                     numbers.plain(one["weight"], 2)])
    header = ["group", "row", "component", "residual", "u", "unit", "weight"]
    return Grid(header, rows).without_empty() if rows else None


def _wild(found: RobustEstimate) -> list[tuple[str, int, int]]:
    """(group, row in it, component) of the wild readings, least weighed first."""
    below = wild_below(found.loss)
    places = [(float(weights[i, j]), name, int(i), int(j)) for name, weights in found.weights.items()
              for i, j in np.argwhere(weights < below)]
    return [place[1:] for place in sorted(places)]


def _entries(solution: Solution, found: RobustEstimate) -> Any:
    for name, i, j in _wild(found):
        group = solution.fit.group(name)
        scale = units.factor(group.units[j])
        yield {"group": name, "row": int(group.rows[i]), "component": group.components[j],
               "residual": group.residual[i, j] / scale, "u": group.weighting.u[i, j] / scale, "unit": group.units[j],
               "weight": float(found.weights[name][i, j])}
