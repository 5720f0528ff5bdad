"""Reliability floors: every kept reading checked by others, and a bias that stays hidden must not harm a result.

Source: Baarda (1968); redundancy 1 - h and the minimal detectable bias as in `calib.reliability`, for readings with
independent errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any

import numpy as np

from calib import units
from calib.analyse.selection.candidates import Candidates
from calib.analyse.selection.limits import Limits
from calib.analyse.selection.objective import Objective
from calib.blocks import Array
from calib.errors import InputError

STARTS = 12      # one from the best choice without floors, the others from anywhere
TRIED = 60      # candidates tried in place of each chosen one, where there are more


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
        if not candidates.shared.all():
            raise InputError("floors: unknowns that one candidate alone sees leave its readings without a check of "
                             "their own; hold them or give them a prior")
        rows, u, owner, labels, limits = [], [], [], [], []
        for group in fit.groups:
            if group.is_prior:
                continue
            for block, mixing in zip(group.whitened, group.weighting.whitening, strict=True):
                if mixing.rows.shape[1] != 1 or mixing.matrix.ndim != 2:
                    raise InputError(f"floors: the errors of '{group.name}' are correlated; floors are checked for "
                                     "independent readings only")
                rows.append(block.dense(fit.layout.position, len(fit.layout.free_columns)) @ candidates.root)
                u.append(group.weighting.u[block.rows[:, 0]].ravel())
                owner.append(np.repeat(candidates.members[group.name][block.rows[:, 0]], block.residual.shape[1]))
                labels += [f"{group.name} row {r}{' ' + c if c else ''}" for r in group.rows[block.rows[:, 0]]
                           for c in group.components]
                limits.append(np.full(block.residual.size, floors.mdb.get(group.name, np.inf)))
        self.rows, self.u, self.owner = np.concatenate(rows), np.concatenate(u), np.concatenate(owner)
        self.labels, self.mdb = labels, np.concatenate(limits)
        strange = [name for name in floors.mdb if name not in [g.name for g in fit.groups]]
        if strange:
            raise InputError(f"floors: there is no group '{strange[0]}'; there are "
                             f"{', '.join(g.name for g in fit.groups)}")
        self.names, self.influence, self.limit = [], np.zeros((0, candidates.rank)), np.zeros(0)
        for what, limit in floors.influence.items():
            functions = fit.functions(what)
            scale = np.array([units.factor(unit) for unit in functions.units])
            self.names += list(functions.labels)
            self.influence = np.concatenate([self.influence, candidates.functions(functions) * scale[:, None]])
            self.limit = np.append(self.limit, np.full(len(functions.labels), limit))

    def possible(self) -> list[int]:
        """Candidates that some choice could keep: their redundancy and detectable biases are best where all else that
        can be kept is kept, so what fails then is out, again and again until nothing fails."""
        left = np.ones(len(self.candidates), dtype=bool)
        while left.any():
            kept, redundancy = self._redundancy(np.flatnonzero(left).tolist())
            mdb = self.bias / np.sqrt(np.maximum(redundancy, 1e-12)) * self.u[kept]
            fails = (redundancy < self.floors.redundancy) | (mdb > self.mdb[kept])
            gone = np.unique(self.owner[kept][fails])
            gone = gone[gone >= 0]
            if not gone.size:
                break
            left[gone] = False
        return np.flatnonzero(left).tolist()

    def reachable(self, keep: int) -> float:
        """A least redundancy that no choice of `keep` candidates or more exceeds."""
        left, best = np.ones(len(self.candidates), dtype=bool), 0.0
        while left.sum() >= keep:
            kept, redundancy = self._redundancy(np.flatnonzero(left).tolist())
            worst = int(np.argmin(redundancy))
            best = max(best, float(redundancy[worst]))
            owner = self.owner[kept][worst]
            if owner < 0:
                break
            left[owner] = False
        return best

    def _redundancy(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Which readings are kept, and their redundancy numbers (zero where the unknowns are not determined)."""
        kept = np.isin(self.owner, [*chosen, -1])
        information = self.candidates.information(self.candidates.indicator(chosen))
        try:
            root = np.linalg.inv(np.linalg.cholesky(information)).T
        except np.linalg.LinAlgError:
            return kept, np.zeros(int(kept.sum()))
        return kept, np.maximum(1.0 - np.sum((self.rows[kept] @ root) ** 2, axis=1), 0.0)

    def margin(self, chosen: Sequence[int]) -> Margin:
        """How a choice stands."""
        kept = self.candidates.indicator([*chosen])[self.owner] + (self.owner < 0) > 0.5
        information = self.candidates.information(self.candidates.indicator(chosen))
        try:
            root = np.linalg.inv(np.linalg.cholesky(information)).T
        except np.linalg.LinAlgError:
            return Margin(np.inf, np.inf, "the unknowns are not determined")
        seen = self.rows[kept] @ root
        redundancy = np.maximum(1.0 - np.sum(seen**2, axis=1), 0.0)
        factor = self.bias / np.sqrt(np.maximum(redundancy, 1e-12))
        parts = [(self.floors.redundancy - redundancy, "redundancy {:.3g} instead of " + f"{self.floors.redundancy:g}",
                  redundancy)]
        mdb = factor * self.u[kept]
        limit = self.mdb[kept]
        parts.append((np.where(np.isfinite(limit), mdb / limit - 1.0, -np.inf),
                      "minimal detectable bias {:.3g} (SI) above its limit", mdb))
        change = np.abs(seen @ (self.influence @ root).T) * factor[:, None]
        for k, name in enumerate(self.names):
            parts.append((change[:, k] / self.limit[k] - 1.0,
                          f"influence on {name} {{:.3g}} (SI) instead of {self.limit[k]:.3g}", change[:, k]))
        worst = max(parts, key=lambda part: float(part[0].max()))
        place = int(np.argmax(worst[0]))
        label = self.labels[int(np.flatnonzero(kept)[place])]
        broken = float(sum(np.sum(np.maximum(part[0], 0.0) ** 2) for part in parts))
        return Margin(float(worst[0][place]), broken, f"{label}: {worst[1].format(worst[2][place])}")


def with_floors(objective: Objective, limits: Limits, checked: Checked, chosen: Sequence[int], passes: int = 50
                ) -> list[int]:
    """Swap candidates until the floors are met and no swap that keeps them helps the criterion.

    Raises InputError where no swap leads to a choice that meets them, naming what is out of reach.
    """
    possible = np.isin(np.arange(objective.count), checked.possible())
    generator = np.random.default_rng(STARTS)
    best, least = list(chosen), np.inf
    for begin in range(STARTS):
        start = _begun(objective, limits, checked, chosen) if begin == 0 else _anywhere(limits, possible, generator)
        found, now = _exchanged(objective, limits, checked, start, possible, passes)
        if now < least:
            best, least = found, now
        if now == 0.0:
            return found
    raise InputError(refusal(limits, checked, best))


def _anywhere(limits: Limits, possible: Array, generator: np.random.Generator) -> list[int]:
    taken = np.zeros(len(possible))
    for i in generator.permutation(np.flatnonzero(possible)):
        taken[i] = float(np.all(limits.matrix @ taken + limits.matrix[:, i] <= limits.most + 1e-9))
    return np.flatnonzero(taken).tolist()


def _exchanged(objective: Objective, limits: Limits, checked: Checked, chosen: Sequence[int], possible: Array,
               passes: int) -> tuple[list[int], float]:
    """Swaps that first mend what is broken, then help the criterion; the choice, and what is still broken."""
    weights = checked.candidates.indicator(chosen)

    def rank(trial: Array) -> tuple[float, float]:
        taken = np.flatnonzero(trial).tolist()
        return checked.margin(taken).broken, objective.loss(taken)

    now = rank(weights)
    for _ in range(passes):
        before = now
        for i in np.flatnonzero(weights):
            weights[i] = 0.0
            best, best_j = now, i
            for j in _tried(objective, limits, weights, possible):
                weights[j] = 1.0
                found = rank(weights)
                if found[0] < best[0] - 1e-15 or (found[0] <= best[0] and found[1] < best[1] - 1e-9):
                    best, best_j = found, j
                weights[j] = 0.0
            weights[best_j], now = 1.0, best
        if now == before:
            break
    return np.flatnonzero(weights).tolist(), now[0]


def _begun(objective: Objective, limits: Limits, checked: Checked, chosen: Sequence[int]) -> Sequence[int]:
    """The choice itself where it can stay; otherwise a greedy one of the candidates that can be kept at all."""
    from calib.analyse.selection.exchange import exchange
    from calib.analyse.selection.greedy import greedy

    possible = np.isin(np.arange(objective.count), checked.possible())
    if limits.keep is not None and possible.sum() < limits.keep:
        raise InputError(refusal(limits, checked, chosen))
    if possible[list(chosen)].all():
        return chosen
    barred = Limits(np.vstack([limits.matrix, ~possible]), np.append(limits.most, 0.0),
                    (*limits.words, "what can never meet the floors"), limits.keep)
    return exchange(objective, barred, greedy(objective, barred))


def _tried(objective: Objective, limits: Limits, weights: Array, possible: Array) -> Array:
    from calib.analyse.selection.greedy import regularised

    among = np.flatnonzero(limits.room(limits.matrix @ weights) & (weights == 0) & possible)
    if len(among) <= TRIED:
        return among
    after = objective.after([regularised(t.information(weights)) for t in objective.terms], among)
    return np.asarray(among[np.argsort(after)[:TRIED]])


def refusal(limits: Limits, checked: Checked, chosen: Sequence[int]) -> str:
    """Why the floors cannot be met, and the nearest request that might be."""
    candidates, floors = checked.candidates, checked.floors
    n, keep = len(candidates), limits.keep or 1
    reached, possible = checked.reachable(keep), checked.possible()
    sentence = f"floors: no choice was found that meets them; the best one leaves {checked.margin(chosen).words}"
    if floors.redundancy > reached:
        return f"{sentence}; no choice of {keep} or more of the {n} candidates can reach more than {reached:.3g}: " \
               "ask for that at most, or add candidates"
    if len(possible) < keep:
        return f"{sentence}; only {len(possible)} of the {n} candidates can be kept at all under them: ask for " \
               f"{len(possible)} or loosen them" if possible else f"{sentence}; none of the {n} candidates can be " \
               "kept under them: loosen them"
    if limits.keep is not None:
        # Redundancy numbers add up to readings less unknowns, so their least is at most the mean.
        per = float(np.mean(candidates.readings))
        fixed = int(np.sum(checked.owner < 0))
        needed = int(np.ceil((candidates.rank / max(1.0 - floors.redundancy, 1e-9) - fixed) / per))
        more = max(needed, limits.keep + 1)
        return f"{sentence}; keep more (at least {min(more, len(possible))}; {len(possible)} can be kept together) " \
               "or loosen the floors"
    return f"{sentence}; raise the budget or loosen the floors"
