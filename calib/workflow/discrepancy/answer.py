"""The answer file of a discovery: an explanation in the words, units and keys of the case format."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from calib import units
from calib.workflow.discrepancy.conclusion import Explanation, NamedEffect
from calib.workflow.discrepancy.shown import Shown
from calib.workflow.discrepancy.structure import Place

# A cosine error is declared by kappa = 1/cos(beta) - 1, whose derivative at zero is not zero; answers give beta.
COSINE, KAPPA, BETA = "cosine", "kappa", "beta"
LISTED = 12


def answer(case: str, found: Explanation, shown: Shown | None = None) -> dict[str, Any]:
    """The content of answer.json.

    case: name of the case or job; found: its explanation; shown: the same with what its page shows, if it is there.
    Returns a dictionary of plain values; what could not be judged (held-out rows where there are none) is null.
    """
    shown = shown or Shown(found)
    return {
        "format": 1,
        "case": case,
        "verdict": found.verdict,
        "sentence": found.sentence,
        "p_value": found.p_value,
        "effects": [_effect(one) for one in found.effects],
        "outlier_rows": list(found.outlier_rows),
        "outliers": [{"group": one.group, "row": one.row} for one in found.outliers],
        "noise_factor": found.noise_factor,
        "rms": {"before": found.rms[0], "after": found.rms[1]},
        "heldout_rms": _pair(found.heldout_rms),
        "variance_factor": _pair(shown.variance_factor),
        "groups": [{"group": g.group, "readings": g.readings, "rms": _pair(g.rms),
                    "variance_factor": _pair(g.variance_factor), "heldout_rms": _pair(g.heldout)} for g in shown.gaps],
        "results": [{"name": r.name, "unit": r.unit, "before": {"value": r.before[0], "u": r.before[1]},
                     "after": {"value": r.after[0], "u": r.after[1]}, "moved_in_u": r.in_u} for r in shown.results],
        "where": [_place(p) for p in found.where[:LISTED]],
        "structure": [_place(p) for p in found.structure[:LISTED]],
        "noise": [{"what": t.what, "where": t.where, "figure": t.figure, "p_value": t.p_value} for t in found.noise],
        "hidden": [{"effect": h.effect, "quantity": h.quantity, "u_added": float(units.from_si(h.u_added, h.unit)),
                    "unit": h.unit} for h in found.hidden],
        "next_measurement": found.next_measurement,
        "detectable": [{"effect": d.effect, "parameter": d.parameter, "unit": d.unit, "usual": list(d.usual),
                        "size": d.size if math.isfinite(d.size) else None} for d in shown.detectable],
        "remarks": list(found.remarks),
    }


def _pair(both: tuple[float, float] | None) -> dict[str, float] | None:
    return None if both is None else {"before": both[0], "after": both[1]}


def _effect(one: NamedEffect) -> dict[str, Any]:
    return {
        "name": one.name,
        "channel": one.channel,
        "parameters": {name: {"value": value, "u": u, "unit": unit}
                       for name, (value, u, unit) in in_case_units(one).items()},
        "p_value": one.p_value,
        "alias": [{"name": name, "channel": channel} for name, channel in one.aliases],
        "plausibility": one.plausibility,
    }


def in_case_units(one: NamedEffect) -> dict[str, tuple[float, float, str]]:
    """Parameters {name: (value, u, unit)} as the case format gives them."""
    if one.name != COSINE or KAPPA not in one.parameters:
        return dict(one.parameters)
    kappa, u, _ = one.parameters[KAPPA]
    beta = math.acos(1 / (1 + max(kappa, 0.0)))
    # d kappa / d beta = sin(beta)/cos(beta)^2; at beta = 0 the parabola itself bounds what u can mean.
    slope = math.sin(beta) / math.cos(beta) ** 2
    spread = u / slope if slope > math.sqrt(2 * u) else math.sqrt(2 * u)
    return {BETA: (1e3 * beta, 1e3 * spread, "mrad")}


def _place(place: Place) -> dict[str, Any]:
    figures = {name: np.asarray(value).tolist() for name, value in place.figures.items()}
    return {"channel": place.channel, "covariate": place.covariate, "shape": place.shape, "p_value": place.p_value,
            **figures}
