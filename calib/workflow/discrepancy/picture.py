"""What the pages draw of a discovery: residuals before and after against what shows them, candidates side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib import units
from calib.analyse.score import candidates, field_of
from calib.blocks import Array
from calib.linearisation import linearise
from calib.workflow.discrepancy.conclusion import Explanation
from calib.workflow.discrepancy.readings import Channel, channels

MAPPED = 10  # candidates of the alias map
SHOWN_IN = {"rad": "deg", "m": "mm", "s": "min"}


@dataclass(frozen=True)
class Picture:
    """Residuals in u of one channel, before and after, against one covariate; keys colour the points."""

    x: Array
    before: Array
    after: Array
    keys: NDArray
    key_label: str
    label: str
    caption: str


@dataclass(frozen=True)
class Separation:
    """How much of one candidate's net signal another can imitate, 0 to 1: labels and matrix (k, k)."""

    labels: tuple[str, ...]
    matrix: Array


def pictures(found: Explanation, count: int) -> list[Picture]:
    """The channels and covariates that show most, or the first channel against time where nothing shows."""
    problem = found.before.problem
    fit = linearise(found.before)
    lines = {c.name: c for c in channels(fit, problem)}
    before, after = fit.rows[1], _whitened(found, fit.rows[1])
    shown = [(p.channel.split(", ")[0], p.covariate) for p in found.where]
    # What drives a named effect comes first, in the channel that shows most.
    drivers = [name for e in found.effects for a in problem.attached if a.effect.name == e.name
               for name in a.effect.inputs]
    driven = [(channel, name) for channel, name in shown if name in drivers]
    driven += [(channel, name) for channel, _ in shown[:1] for name in dict.fromkeys(drivers)]
    wanted = [*driven, *shown]
    drawn: list[Picture] = []
    for name, covariate in dict.fromkeys(wanted):
        values = lines[name].covariates.get(covariate) if name in lines else None
        if values is None or values.dtype.kind not in "fiu" or len(drawn) >= count:
            continue
        drawn.append(_picture(lines[name], covariate, before, after))
    if not drawn and lines:
        first = next(iter(lines.values()))
        numeric = [k for k, v in first.covariates.items() if v.dtype.kind in "fiu" and len(np.unique(v)) > 2]
        if numeric:
            drawn.append(_picture(first, numeric[0], before, after))
    return drawn


def _whitened(found: Explanation, before: Array) -> Array:
    """Residuals after, over all rows: those that were left out are judged by what was found without them."""
    if found.after is found.before:
        return before
    freed = found.after.problem
    whole = found.before.problem
    for unknown in freed.unknowns:
        held = freed.is_held(unknown)
        if (~held).any() and unknown in whole.unknowns and whole.is_held(unknown).any() and not held.all():
            whole = whole.free(unknown)
    values = {u: u.show(v) for u, v in found.after.values.items() if u in whole.unknowns}
    return linearise(whole, values).rows[1]


def _picture(channel: Channel, covariate: str, before: Array, after: Array) -> Picture:
    unit = channel.units.get(covariate, "1")
    shown = SHOWN_IN.get(unit, unit)
    x = channel.covariates[covariate].astype(float) / units.factor(shown)
    text = next((k for k, v in channel.covariates.items() if v.dtype.kind not in "fiub" and 1 < len(set(v)) <= 4), "")
    way = next((k for k in ("direction", "block") if 1 < len(np.unique(channel.covariates.get(k, [0]))) <= 4), "")
    key = text or (way if way != covariate else "")
    keys = channel.covariates[key] if key else np.zeros(len(x), dtype=int)
    name = covariate.replace("_", " ")
    return Picture(x, before[channel.places], after[channel.places], np.asarray(keys), key,
                   name if shown == "1" else f"{name} / {shown}",
                   f"{channel.name}: residual in units of u against {name}; the band holds 95 % of good readings.")


def separation(found: Explanation) -> Separation | None:
    """The alias map of the candidates that stand highest, those named first; None where there are not two."""
    fit = linearise(found.before)
    chosen = candidates(fit)
    field = field_of(fit, chosen)
    place = {c.label: i for i, c in enumerate(chosen)}
    first = [f"{e.name} ({e.channel})" for e in found.effects]
    first += [f"{name} ({channel})" for e in found.effects for name, channel in e.aliases]
    wanted: Sequence[str] = list(dict.fromkeys([*first, *(r.label for r in found.ranking)]))
    shown = [place[w] for w in wanted if w in place and field.frames[place[w]].shape[1]][:MAPPED]
    if len(shown) < 2:
        return None
    matrix = np.array([[_imitated(field.frames[i], field.frames[j]) for j in shown] for i in shown])
    return Separation(tuple(chosen[i].label for i in shown), matrix)


def _imitated(one: Array, other: Array) -> float:
    return float(np.sqrt(np.sum((other.T @ one) ** 2) / one.shape[1]))
