"""Reliability floors: every kept reading checked by others, and a bias that stays hidden must not harm a result.

Redundancy (Q_vv P)_ii, minimal detectable bias bias / sqrt((P Q_vv P)_ii) and its influence F C J'P e_i, as in
`calib.reliability`, for readings that may be correlated and candidates that may have unknowns of their own.
Source: Baarda (1968); Wang and Chen (1994) for correlated readings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib import units
from calib.analyse.selection.candidates import Candidates
from calib.analyse.selection.criterion import functions_of
from calib.analyse.selection.readings import Readings, readings_of
from calib.blocks import Array
from calib.errors import InputError

SAME = 1e-9      # two redundancies that differ by less are one


@dataclass(frozen=True)
class Floors:
    """What every kept scalar reading must meet.

    redundancy: at least (0 to 1); mdb: {group: largest minimal detectable bias, SI}; influence: {quantity: largest
    change of it by a bias that just stays hidden, SI}; level, power: of the test that detects.
    """

    redundancy: float = 0.0
    mdb: Mapping[str, float] = field(default_factory=dict)
    influence: Mapping[Any, float] = field(default_factory=dict)
    level: float = 0.001
    power: float = 0.8

    def __post_init__(self) -> None:
        if not 0.0 <= self.redundancy < 1.0:
            raise InputError(f"floors: redundancy {self.redundancy:g}; it lies from 0 (unchecked) to below 1")
        for name, limit in (*self.mdb.items(), *self.influence.items()):
            if not limit > 0.0:
                raise InputError(f"floors: the limit {limit:g} of '{name}' must be positive")


@dataclass(frozen=True)
class Margin:
    """How a choice stands to the floors: excess (positive where one is broken) of the worst reading, sum of the squares
    of all that is broken, and the worst reading in words."""

    excess: float
    broken: float
    words: str


class Checked:
    """The scalar readings of candidates with what the floors ask of them."""

    def __init__(self, candidates: Candidates, floors: Floors):
        self.candidates, self.floors = candidates, floors
        fit = candidates.fit
        self.bias = NormalDist().inv_cdf(1 - floors.level / 2) + NormalDist().inv_cdf(floors.power)
        groups = [g.name for g in fit.groups if not g.is_prior]
        strange = [name for name in floors.mdb if name not in groups]
        if strange:
            raise InputError(f"floors: there is no group '{strange[0]}'; there are {', '.join(groups)}")
        self.readings: Readings = readings_of(candidates)
        self.mdb = np.array([floors.mdb.get(name, np.inf) for name in self.readings.groups])
        names, shown, rows, limits = [], [], [np.zeros((0, candidates.rank))], []
        for what, limit in floors.influence.items():
            functions = functions_of(fit, what)
            scale = np.array([units.factor(unit) for unit in functions.units])
            names += list(functions.labels)
            shown += list(functions.units)
            rows.append(candidates.functions(functions) * scale[:, None])
            limits += [limit] * len(functions.labels)
        self.units = shown
        self.names, self.influence, self.limit = names, np.concatenate(rows), np.array(limits)

    @property
    def monotone(self) -> bool:
        """Whether more readings can only help: no influence is limited, and no redundancy of correlated readings."""
        return not self.names and (self.floors.redundancy == 0.0 or self.readings.independent)

    def possible(self, left: NDArray[np.bool_] | None = None) -> Array:
        """One for the candidates (n,) that some choice among those that are left could keep, else zero.

        Redundancy and detectable biases are best where all else that can be kept is kept, so what fails then is out,
        again and again until nothing fails. Redundancies of correlated readings and influences rule nothing out.
        """
        n = len(self.candidates)
        left = np.ones(n, dtype=bool) if left is None else left.copy()
        while left.any():
            kept, redundancy, mdb = self._state(left.astype(float))
            # An influence is bounded by nothing that more readings could not change: it is asked of choices only.
            fails = mdb > self.mdb[kept] * (1 + SAME)
            if self.readings.independent:
                fails |= redundancy < self.floors.redundancy - SAME
            owners = np.unique(self.readings.owner[kept][fails])
            if (owners < 0).any():
                return np.zeros(n)      # what is always there fails even with all the rest
            if not owners.size:
                break
            left[owners] = False
        return left.astype(float)

    def reachable(self, keep: int) -> float:
        """A least redundancy of independent readings that no choice of `keep` candidates or more exceeds."""
        left, best = np.ones(len(self.candidates), dtype=bool), 0.0
        while left.sum() >= keep:
            kept, redundancy, _ = self._state(left.astype(float))
            worst = int(np.argmin(redundancy))
            best = max(best, float(redundancy[worst]))
            owner = self.readings.owner[kept][worst]
            if owner < 0:
                break
            left[owner] = False
        return best

    def _state(self, weights: Array) -> tuple[NDArray[np.bool_], Array, Array]:
        """Which readings are kept, and their redundancy and minimal detectable bias (zero and infinite where the
        unknowns are not determined)."""
        kept = np.append(weights, 1.0)[self.readings.owner] > 0.5
        root = self._root(weights)
        if root is None:
            return kept, np.zeros(int(kept.sum())), np.full(int(kept.sum()), np.inf)
        return kept, self.readings.redundancy(kept, root), self.bias / self.readings.control(kept, root)

    def _root(self, weights: Array) -> Array | None:
        """R with R R' the inverse information, None where that is singular."""
        try:
            return np.asarray(np.linalg.inv(np.linalg.cholesky(self.candidates.information(weights))).T)
        except np.linalg.LinAlgError:
            return None

    def margin(self, chosen: Sequence[int]) -> Margin:
        """How a choice stands."""
        weights = self.candidates.indicator(chosen)
        kept, redundancy, mdb = self._state(weights)
        root = self._root(weights)
        if root is None:
            return Margin(np.inf, np.inf, "the unknowns are not determined")
        parts: list[tuple[Array, Array, Any, str]] = [
            (self.floors.redundancy - redundancy - SAME, redundancy, self.floors.redundancy, "redundancy")]
        limit = self.mdb[kept]
        parts.append((np.where(np.isfinite(limit), mdb / limit - 1.0 - SAME, -np.inf), mdb, limit,
                      "minimal detectable bias"))
        change = np.abs(self.readings.right[kept] @ root @ (self.influence @ root).T) * mdb[:, None]
        for k, name in enumerate(self.names):
            parts.append((change[:, k] / self.limit[k] - 1.0 - SAME, change[:, k], self.limit[k],
                          f"influence on {name}"))
        worst = max(parts, key=lambda part: float(part[0].max(initial=-np.inf)))
        if not kept.any():
            return Margin(-np.inf, 0.0, "no reading is kept")
        place = int(np.argmax(worst[0]))
        reading = int(np.flatnonzero(kept)[place])
        influences = [f"influence on {name}" for name in self.names]
        unit = self.units[influences.index(worst[3])] if worst[3] in influences else \
            "1" if worst[3] == "redundancy" else self.readings.units[reading]
        shown = [float(np.broadcast_to(each, len(redundancy))[place]) / units.factor(unit) for each in worst[1:3]]
        words = f"{self.readings.labels[reading]}: {worst[3]} {shown[0]:.3g} instead of {shown[1]:.3g}"
        words += "" if unit == "1" else f" {unit}"
        broken = float(sum(np.sum(np.maximum(part[0], 0.0) ** 2) for part in parts))
        return Margin(float(worst[0][place]), broken, words)
