"""What the pages draw of a discovery: residuals before and after against what shows them, candidates side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib import units
from calib.blocks import Array
from calib.linearisation import linearise
from calib.workflow.discrepancy.conclusion import Explanation
from calib.workflow.discrepancy.readings import Channel, channels
from calib.workflow.discrepancy.shown import Shown
from calib.workflow.discrepancy.structure import TURNED, sense_of

MAPPED = 10  # candidates of the alias map
CLASSES = 12  # of the values of a covariate
COLOURS = 4  # values of what colours the points
PARTED = 1.2  # by how much better an effect must show where points are coloured by a covariate
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


def pictures(shown: Shown, count: int) -> list[Picture]:
    """What betrays each named effect, then the channels and covariates that show most; where nothing shows, the first
    channel against what was recorded with it."""
    found = shown.found
    lines = {c.name: c for c in channels(shown.fit, found.before.problem)}
    before, after = shown.fit.rows[1], _whitened(found, shown.fit.rows[1])
    drawn: dict[tuple[str, str], Picture] = {}
    for channel, label, x, unit, added in _betraying(shown, list(lines.values())):
        drawn.setdefault((channel.name, label), _picture(channel, label, x, unit, before, after, added))
    wanted = [(p.channel, p.covariate) for p in (*found.structure, *found.where)]
    if not wanted and not drawn:
        wanted = [(name, covariate) for name, channel in lines.items() for covariate in _numeric(channel)][:1]
    for place, covariate in wanted:
        part, turned, setting = place.partition(TURNED)
        name = part.split(", ")[0]
        if name in lines and covariate in _numeric(lines[name]):
            channel = lines[name]
            sense = np.ones(len(before))
            if turned:
                sense[channel.places] = sense_of(channel.covariates[setting])
            drawn.setdefault((name + turned + setting, covariate), _picture(
                replace(channel, name=name + turned + setting), covariate, channel.covariates[covariate],
                channel.units.get(covariate, "1"), before * sense, after * sense))
    return list(drawn.values())[:count]


def _betraying(shown: Shown, lines: Sequence[Channel]) -> Iterator[tuple[Channel, str, Array, str, Array]]:
    """(channel, label, x, unit, what it adds there [u]) for each named effect: the channel that it changes most,
    against what drives it, or where that was not recorded against what it adds to the readings beside the unknowns."""
    place = {c.label: i for i, c in enumerate(shown.chosen)}
    for one in shown.found.effects:
        number = place.get(f"{one.name} ({one.channel})")
        if number is None or not lines:
            continue
        values = np.array([value * units.factor(unit) for value, _, unit in one.parameters.values()])
        added = shown.field.signals[number] @ values
        channel = max(lines, key=lambda line: float(np.sum(added[line.places] ** 2)))
        drivers = [name for name in shown.chosen[number].effect.inputs if name in _numeric(channel)]
        if drivers:
            best = max(drivers, key=lambda name: _followed(added[channel.places], channel.covariates[name]))
            x, unit = channel.covariates[best], channel.units.get(best, "1")
        else:
            best, x, unit = f"{one.name} ({one.channel}), net / u", added[channel.places], "1"
        yield channel, best, x, unit, added[channel.places]


def _followed(signal: Array, values: Array) -> float:
    """How much of a signal follows a covariate: the sum of squares of its means over up to twelve classes of values."""
    different = np.unique(values)
    edges = different if len(different) <= CLASSES else np.quantile(values, np.arange(CLASSES) / CLASSES)
    place = np.searchsorted(edges, values, side="right")
    return sum(float(np.sum(place == k) * np.mean(signal[place == k]) ** 2) for k in np.unique(place))


def _numeric(channel: Channel) -> list[str]:
    """Covariates that may stand on an axis: numbers that vary."""
    return [k for k, v in channel.covariates.items() if v.dtype.kind in "fiu" and len(np.unique(v)) > 1]


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


def _picture(
    channel: Channel, label: str, values: Array, unit: str, before: Array, after: Array, added: Array | None = None
) -> Picture:
    shown = SHOWN_IN.get(unit, unit)
    x = np.asarray(values, float) / units.factor(shown)
    key = _key(channel, label, x, added)
    keys = channel.covariates[key] if key else np.zeros(len(x), dtype=int)
    name = label.replace("_", " ")
    against = name.replace(", net / u", " as it shows beside the unknowns")
    caption = f"{channel.name}: residual in units of u against {against}; the band holds 95 % of good readings."
    return Picture(x, before[channel.places], after[channel.places], np.asarray(keys), key,
                   name if shown == "1" else f"{name} / {shown}", caption)


def _key(channel: Channel, label: str, x: Array, added: Array | None) -> str:
    """The covariate of a few values that colours the points: the one that parts what an effect adds, else a name."""
    few = {k: v for k, v in channel.covariates.items() if k != label and 1 < len(np.unique(v)) <= COLOURS}
    if added is not None and few:
        parted = {k: sum(_followed(added[v == one], x[v == one]) for one in np.unique(v)) for k, v in few.items()}
        best = max(parted, key=lambda k: parted[k])
        if parted[best] > PARTED * _followed(added, x):
            return best
    named = [k for k, v in few.items() if v.dtype.kind not in "fiub"]
    return next(iter([*named, *(k for k in ("direction", "block") if k in few)]), "")


def separation(shown: Shown) -> Separation | None:
    """The alias map of the candidates that stand highest, those named first; None where there are not two."""
    found, field = shown.found, shown.field
    place = {c.label: i for i, c in enumerate(shown.chosen)}
    first = [f"{e.name} ({e.channel})" for e in found.effects]
    first += [f"{name} ({channel})" for e in found.effects for name, channel in e.aliases]
    wanted: Sequence[str] = list(dict.fromkeys([*first, *(r.label for r in found.ranking)]))
    mapped = [place[w] for w in wanted if w in place and field.frames[place[w]].shape[1]][:MAPPED]
    if len(mapped) < 2:
        return None
    matrix = np.array([[_imitated(field.frames[i], field.frames[j]) for j in mapped] for i in mapped])
    return Separation(tuple(shown.chosen[i].label for i in mapped), matrix)


def _imitated(one: Array, other: Array) -> float:
    return float(np.sqrt(np.sum((other.T @ one) ** 2) / one.shape[1]))
