"""Search under reliability floors: swaps that first mend what is broken; and what is said where none does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np

from calib.analyse.selection.exchange import exchange
from calib.analyse.selection.floors import Checked
from calib.analyse.selection.greedy import greedy, regularised
from calib.analyse.selection.limits import Limits
from calib.analyse.selection.objective import Objective
from calib.analyse.selection.starts import completed
from calib.blocks import Array
from calib.errors import InputError

STARTS = 12      # one from the best choice without floors, the others from anywhere
TRIED = 60      # candidates tried in place of each chosen one, where there are more
PATIENCE = 15.0      # seconds for all starts
SHORT = 3.0      # seconds to look for the nearest number that meets the floors
PASSES = 50


def with_floors(objective: Objective, limits: Limits, checked: Checked, chosen: Sequence[int],
                patience: float = PATIENCE) -> list[int] | None:
    """Swap candidates until the floors are met and no swap that keeps them helps the criterion.

    objective, limits, checked; chosen: to begin with; patience: seconds. Returns None where no swap was found that
    leads to a choice that meets them.
    """
    end = perf_counter() + patience
    possible = checked.possible()
    if possible.sum() < limits.exactly:
        return None
    generator = np.random.default_rng(STARTS)
    for begin in range(STARTS):
        start = _begun(objective, limits, possible, chosen) if begin == 0 else _anywhere(objective, limits, possible,
                                                                                         generator)
        found = _exchanged(objective, limits, checked, start, possible > 0.5, end)
        if found is not None or perf_counter() > end:
            return found
    return None


def _anywhere(objective: Objective, limits: Limits, possible: Array, generator: np.random.Generator) -> list[int]:
    taken = np.zeros(len(possible))
    for i in generator.permutation(np.flatnonzero(possible)):
        taken[i] = float(np.all(limits.matrix @ taken + limits.matrix[:, i] <= limits.most + 1e-9))
    return completed(objective, limits, np.flatnonzero(taken).tolist())


def _exchanged(objective: Objective, limits: Limits, checked: Checked, chosen: Sequence[int], possible: Array,
               end: float) -> list[int] | None:
    """Swaps that first mend what is broken, then help the criterion; None where something stays broken."""
    weights = checked.candidates.indicator(chosen)

    def rank(trial: Array) -> tuple[float, float]:
        taken = np.flatnonzero(trial).tolist()
        return checked.margin(taken).broken, objective.loss(taken)

    now = rank(weights)
    for _ in range(PASSES):
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
            if perf_counter() > end:
                break
        if now == before or perf_counter() > end:
            break
    found_choice = np.flatnonzero(weights).tolist()
    return found_choice if now[0] == 0.0 and np.isfinite(now[1]) and limits.meets(found_choice) else None


def _begun(objective: Objective, limits: Limits, possible: Array, chosen: Sequence[int]) -> Sequence[int]:
    """The choice itself where it can stay; otherwise a greedy one of the candidates that can be kept at all."""
    if possible[list(chosen)].all():
        return chosen
    barred = replace(limits, matrix=np.vstack([limits.matrix, 1.0 - possible]), most=np.append(limits.most, 0.0),
                     words=(*limits.words, "what can never meet the floors"))
    return exchange(objective, barred, completed(objective, barred, greedy(objective, barred)))


def _tried(objective: Objective, limits: Limits, weights: Array, possible: Array) -> Array:
    among = np.flatnonzero(limits.room(limits.matrix @ weights) & (weights == 0) & possible)
    if len(among) <= TRIED:
        return among
    after = objective.after([regularised(t.information(weights)) for t in objective.terms], among)
    return np.asarray(among[np.argsort(after)[:TRIED]])


def refusal(objective: Objective, limits: Limits, checked: Checked, chosen: Sequence[int], proven: bool) -> InputError:
    """Why the floors cannot be met, and the nearest request that can be.

    chosen: the best choice without them; proven: whether every choice was ruled out.
    """
    candidates, floors = checked.candidates, checked.floors
    n, keep = len(candidates), int(limits.exactly) or 1
    stands = f"; the best choice without them leaves {checked.margin(chosen).words}" if len(chosen) else ""
    whole = f"floors: no choice of {keep}" if limits.keep else "floors: no choice"
    sentence = f"{whole} meets them{stands}" if proven else f"{whole} was found that meets them{stands}"
    possible = checked.possible()
    count = int(possible.sum())
    if checked.readings.independent and floors.redundancy > (reached := checked.reachable(keep)) + 1e-9:
        return InputError(f"{sentence}; no choice of {keep} or more of the {n} candidates can reach more than "
                          f"{np.floor(1e4 * reached) / 1e4:.4g}: ask for that at most, or add candidates")
    if not count:
        return InputError(f"{sentence}; none of the {n} candidates can be kept under them, whatever else is kept: "
                          "loosen them")
    if count < keep:
        return InputError(f"{sentence}; only {count} of the {n} candidates can be kept at all under them: ask for "
                          f"{count} at most or loosen them")
    if limits.keep is None:
        return InputError(f"{sentence}; raise the budget or loosen the floors")
    # Redundancy numbers add up to readings less unknowns, so their least is at most the mean.
    per, fixed = float(np.mean(candidates.readings)), int(np.sum(checked.readings.owner < 0))
    unknowns = candidates.rank + int(np.sum(~candidates.shared)) * keep / n
    needed = int(np.ceil((unknowns / max(1.0 - floors.redundancy, 1e-9) - fixed) / per - 1e-9))
    nearest = _nearest(objective, limits, checked, count)
    meets = f"; {nearest} was found to meet them" if nearest else ""
    return InputError(f"{sentence}; keep more (at least {min(max(needed, keep + 1), n)}{meets}) or loosen the floors")


def _nearest(objective: Objective, limits: Limits, checked: Checked, most: int) -> int | None:
    """A number to keep, not much larger, for which a choice was found that meets the floors."""
    assert limits.keep is not None
    end = perf_counter() + SHORT
    for keep in range(limits.keep + 1, most + 1):
        wider = replace(limits, keep=keep, most=np.append(float(keep), limits.most[1:]))
        start = completed(objective, wider, greedy(objective, wider))
        if len(start) < keep:
            return None
        if with_floors(objective, wider, checked, start, 0.5) is not None:
            return keep
        if perf_counter() > end:
            break
    return None
