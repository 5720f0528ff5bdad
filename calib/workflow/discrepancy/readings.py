"""The scalar readings of a linearisation with all that is recorded about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array
from calib.linearisation import Group, Linearisation
from calib.observations import Observations
from calib.problem import Problem

ANGLES = ("angle", "command", "azimuth", "elevation")  # arguments of models that are angles, so that harmonics apply
PLACES = ("position", "travel")  # arguments and covariates that are places along a guide


@dataclass(frozen=True)
class Channel:
    """The scalar readings of one component of one group: where they stand among all, their rows and covariates.

    name: group and component; component; places (m,): among all whitened scalar rows; rows (m,): of the data file;
    covariates, units: recorded with each reading; order (m,): sorts them in time (or as they stand in the file).
    """

    name: str
    component: str
    places: NDArray[np.int64]
    rows: NDArray
    covariates: dict[str, NDArray]
    units: dict[str, str]
    order: NDArray[np.int64]


def channels(fit: Linearisation, problem: Problem | None = None) -> list[Channel]:
    """One channel for each component of each group of observations that is no prior.

    fit: a linearisation; problem: that it is of; what its models know of each row (an angle, a position) is then taken
    beside what was recorded.
    """
    known = {} if problem is None else {o.group: _known(o) for o in problem.observations}
    found, begin = [], 0
    for group in fit.groups:
        more = known.get(group.name, {})
        for block in group.whitened:
            m, d = block.residual.shape
            if not group.is_prior and block.rows.shape[1] == 1:
                found += [
                    _channel(group, block.rows[:, 0], begin + np.arange(m) * d + k, k, more) for k in range(d)
                ]
            begin += m * d
    return found


def parts(fit: Linearisation) -> dict[str, NDArray[np.int64]]:
    """Places of the scalar readings among all whitened rows, {group and component: (m,)}; readings that a covariance
    joins count by group alone, priors not at all."""
    found: dict[str, list[NDArray[np.int64]]] = {}
    begin = 0
    for group in fit.groups:
        for block in group.whitened:
            m, d = block.residual.shape
            for k in range(0 if group.is_prior else d):
                name = _name(group, k) if block.rows.shape[1] == 1 else group.name
                found.setdefault(name, []).append(begin + np.arange(m) * d + k)
            begin += m * d
    return {name: np.concatenate(places) for name, places in found.items()}


def _name(group: Group, component: int) -> str:
    return " ".join(part for part in (group.name, group.components[component]) if part)


def _known(observations: Observations) -> dict[str, Array]:
    """Known arguments of a model that vary from row to row, one column each."""
    found = {}
    for argument in observations.arguments:
        if argument.unknown is not None or argument.data.ndim != 2 or argument.data.shape[1] > 3:
            continue
        for k, column in enumerate(np.asarray(argument.data, float).T):
            name = argument.name if argument.data.shape[1] == 1 else f"{argument.name} {'xyz'[k]}"
            if len(column) == observations.n and np.ptp(column) > 1e-9 * max(float(np.max(np.abs(column))), 1e-12):
                found[name] = column
    return found


def _channel(
    group: Group, inside: NDArray[np.int64], places: NDArray[np.int64], component: int, known: Mapping[str, Array]
) -> Channel:
    covariates = {name: np.asarray(values)[inside] for name, values in group.covariates.items() if name != "split"}
    units = dict(group.covariate_units)
    for word, values in known.items():
        if not any(v.dtype.kind in "fiu" and np.array_equal(v, values[inside]) for v in covariates.values()):
            covariates[word] = values[inside]
            units[word] = "rad" if word in ANGLES else "m" if word.startswith(PLACES) else "1"
    name = _name(group, component)
    time = covariates.get("time")
    order = np.arange(len(inside)) if time is None or time.dtype.kind not in "fiu" else np.argsort(time, kind="stable")
    return Channel(name, group.components[component], places, group.rows[inside], covariates, units, order)


def sequences(channels: Sequence[Channel]) -> dict[str, list[NDArray[np.int64]]]:
    """Ways in which one reading may have followed another, each a list of places in their order: each channel in time;
    where several groups have the same components, those of one component as they stand in the file; and where a channel
    takes several keys in turn (targets, lines), those of one key in time."""
    ways = {"channels": [channel.places[channel.order] for channel in channels]}
    together = []
    for component in dict.fromkeys(channel.component for channel in channels):
        alike = [channel for channel in channels if channel.component == component]
        places = np.concatenate([channel.places for channel in alike])
        together.append(places[np.argsort(np.concatenate([channel.rows for channel in alike]), kind="stable")])
    if len(together) < len(channels):
        ways["groups"] = together
    for name in dict.fromkeys(name for channel in channels for name in channel.covariates):
        apart = [places for channel in channels for places in _by_key(channel, channel.covariates.get(name))]
        if len(apart) > len(channels):
            ways[f"readings of each {name}"] = apart
    return ways


def _by_key(channel: Channel, keys: NDArray | None) -> list[NDArray[np.int64]]:
    """Places of a channel in time, apart for every key of a text covariate that comes back after another one."""
    if keys is None or keys.dtype.kind in "fiub":
        return [channel.places[channel.order]]
    inside = keys[channel.order]
    if np.sum(inside[1:] != inside[:-1]) < len(np.unique(inside)):
        return [channel.places[channel.order]]
    return [channel.places[channel.order][inside == key] for key in np.unique(inside)]


@dataclass(frozen=True, order=True)
class Reading:
    """One reading by the row of its data file and its group: several tables number their rows alike."""

    row: int
    group: str


def readings_at(fit: Linearisation, places: Sequence[int]) -> tuple[Reading, ...]:
    """The readings that whitened scalar rows belong to, each once."""
    numbers, ends = row_numbers(fit), np.cumsum([g.size for g in fit.groups])
    return tuple(sorted({Reading(int(numbers[p]), fit.groups[int(np.searchsorted(ends, p, side="right"))].name)
                         for p in places}))


def without(problem: Problem, chosen: Sequence[Reading]) -> dict[str, NDArray[np.bool_]]:
    """{group: (n,) true where a reading is none of the chosen}."""
    return {o.group: ~np.isin(o.rows, [one.row for one in chosen if one.group == o.group])
            for o in problem.observations if not o.is_prior}


def row_numbers(fit: Linearisation) -> NDArray:
    """Row of the data file of every whitened scalar row; 0 for priors and for rows that mix several readings."""
    numbers = []
    for group in fit.groups:
        for block in group.whitened:
            alone = not group.is_prior and block.rows.shape[1] == 1
            numbers.append(
                np.repeat(
                    group.rows[block.rows[:, 0]] if alone else np.zeros(len(block.rows), dtype=int),
                    block.residual.shape[1],
                )
            )
    return np.concatenate(numbers)
