"""Which positions of the five-axis tables matter for each of the 12 results."""

from __future__ import annotations

import numpy as np

import calib
from calib import C, units
from calib.errors import RankDefect
from calib.report.selection import listed
from calib.units import degree, mm
from problems.five_axis import results
from problems.five_axis.readings import published

Rows = list[dict[str, object]]
WITHIN = 1.1      # times the u of all readings


def as_built() -> calib.Linearisation:
    """The joint estimate where every free unknown is known beforehand as from a drawing: angles to a degree, lengths to
    10 mm. Without that a choice must keep what sees unknowns that a result hardly depends on (factors of 1e-8)."""
    estimate = results.fits(published()).joint.estimate
    problem = estimate.problem
    loose = {"angle": 1 * degree, "length": 10 * mm}
    known = []
    for unknown in problem.unknowns:
        if not problem.is_held(unknown).all():
            u = [loose.get(units.dimension(unit), 1.0) for unit in unknown.units]
            known.append(calib.prior(unknown, estimate[unknown], np.broadcast_to(u, (unknown.count, len(u)))))
    return calib.linearise(problem.with_observations(*known), {u: estimate[u] for u in problem.unknowns})


def positions() -> Rows:
    """For each of the 12 results of the joint estimate: how few positions of the tables hold its u within 10 %, fewer
    than how many cannot, and which."""
    linear = as_built()
    total = sum(len(np.unique(g.rows)) for g in linear.groups if not g.is_prior)
    return [_fewest(linear, item, next(iter(results.JOINT[item])), total) for item in results.ITEMS]


def _fewest(fit: calib.Linearisation, item: str, name: str, total: int) -> dict[str, object]:
    whole = calib.select(fit, total, C(name), by="row")
    limit = WITHIN**2 * whole.value
    low, high, best = 1, total, whole
    out_of_reach = 0
    while low < high:
        keep = (low + high) // 2
        try:
            found = calib.select(fit, keep, C(name), by="row", method=calib.Exchange())
        except RankDefect:
            low = keep + 1
            continue
        if found.bound > limit:
            out_of_reach = max(out_of_reach, keep)
        if found.value <= limit:
            high, best = keep, found
        else:
            low = keep + 1
    return {"result": item, "quantity": name, "positions": f"{len(best.chosen)} of {total}",
            "proven to need more than": out_of_reach or "", "u against all": np.sqrt(best.value / whole.value),
            "gap to the bound": best.gap, "which": listed(best)}
