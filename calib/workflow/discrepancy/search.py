"""The search: which effects and which blunders together explain the residuals, and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Field, orthonormal
from calib.blocks import Array
from calib.workflow.discrepancy.looks import corrected, corrected_each, smallest_tails, tail, tails
from calib.workflow.discrepancy.sparse import sparse_sets
from calib.workflow.discrepancy.subsets import PARAMETER, SAME, Subsets

EXPLORE = 0.25  # corrected p-value up to which the search goes on adding, before it drops what is not needed
MOST_EFFECTS = 6
STEPS = 12  # of exchange at most
LIKELY = 24  # candidates of which pairs are tried
CROWDED = 4  # effects up to which pairs are tried at all
DRAWS = 6000  # simulated residuals from which the number of independent looks is judged
RARE = 0.03  # probability at which it is judged: near the level, with enough draws beyond it
SCALE_LEVEL = 0.002  # at which the stated noise is given up for the one that is left over


@dataclass(frozen=True)
class Shares:
    """How the probability of a false alarm is shared among the kinds of finding.

    The sum is 1.05: looks at one set of residuals overlap, and with a sum of 1 eleven of 1,400 clean cases gave an
    alarm at a level of 1 %.
    """

    effects: float = 0.70
    blunders: float = 0.03
    structure: float = 0.10
    noise: float = 0.22


@dataclass(frozen=True)
class Finding:
    """Chosen candidates and blunders with their corrected p-values, and the field that is left.

    effects, blunders: places among the candidates and among the rows; p_effects, p_blunders; scale: variance of the
    noise that was used, 1 where the stated one holds; left: the field after everything chosen is taken.
    """

    effects: tuple[int, ...]
    blunders: tuple[int, ...]
    p_effects: tuple[float, ...]
    p_blunders: tuple[float, ...]
    scale: float
    left: Field


def noise_scale(squares: float, dof: int) -> float:
    """Variance of what is left, or 1 where it does not contradict the stated one."""
    from scipy.special import gammainc, gammaincc

    if dof < 3:
        return 1.0
    upper, lower = gammaincc(dof / 2, squares / 2), gammainc(dof / 2, squares / 2)
    return squares / dof if min(upper, lower) < SCALE_LEVEL / 2 else 1.0


def independent_looks(field: Field, seed: int) -> float:
    """Number of independent candidates that would be as often the best by chance as these dependent ones."""
    frames = [f for f in field.frames if f.shape[1]]
    if not frames:
        return 1.0
    together = np.concatenate(frames, axis=1)
    values, vectors = np.linalg.eigh(together.T @ together)
    # What noise does to the candidates depends on their inner products alone: as many numbers a draw as they differ.
    seen = values > SAME
    draws = np.random.default_rng(seed).standard_normal((int(seen.sum()), DRAWS))
    dofs = np.array([f.shape[1] for f in frames])
    squared = ((vectors[:, seen] * np.sqrt(values[seen])) @ draws) ** 2
    drops = np.add.reduceat(squared, np.cumsum(dofs) - dofs, axis=0)
    rare = float(np.quantile(smallest_tails(drops, dofs), RARE))
    return float(np.clip(np.log1p(-RARE) / np.log1p(-rare), 1.0, len(frames)))


def search(
    field: Field,
    readings: NDArray[np.int64],
    level: float,
    seed: int,
    shares: Shares | None = None,
    most_blunders: int | None = None,
    positive: frozenset[int] = frozenset(),
    start: Finding | None = None,
) -> Finding:
    """Find effects and blunders by forward steps, exchanges and backward elimination.

    field: residuals with the signals of all candidates; readings: places of the rows that may be blunders; level:
    overall probability of a false alarm; seed: of the simulated looks; shares: of the level; most_blunders: at most;
    positive: places of the candidates whose one parameter cannot be negative; start: a finding where the model stood
    before, to go on from.
    """
    shares = shares or Shares()
    looks = independent_looks(field, seed)
    model = Subsets(field, looks, readings, positive)
    most_blunders = max(6, len(readings) // 12) if most_blunders is None else most_blunders
    effects, blunders = _forward(model, most_blunders, start)
    squares, taken = model.squares(effects, blunders)
    scale = noise_scale(squares, field.dof - taken)
    # A blunder may have been a reading at which an effect not yet found is large: both with them and without.
    trials = [(_exchange(model, effects, some, scale, start is None), some)
              for some in ([blunders, []] if blunders else [blunders])]
    effects, blunders = min(trials, key=lambda trial: model.costs([trial[0]], trial[1], scale)[0])
    return _backward(model, effects, blunders, level, shares)


def _forward(model: Subsets, most_blunders: int, start: Finding | None) -> tuple[list[int], list[int]]:
    readings, frames = model.readings, model.field.frames
    field = replace(model.field, signals=frames, sizes=tuple(np.ones(f.shape[1]) for f in frames))
    effects: list[int] = list(start.effects) if start else []
    blunders: list[int] = list(start.blunders) if start else []
    if start:
        field = field.taking(model.columns(effects, blunders))
    while True:
        steps: list[tuple[float, float, str, int]] = []  # corrected p-value, minus the gain, what, place
        if len(effects) < MOST_EFFECTS and frames:
            left, dofs, allowed = model.products_of(field).judge([[one] for one in range(len(frames))])
            drops = field.squares - left
            p_values = tails(drops, dofs, _scale_after(field, drops, dofs), field.dof - dofs) * model.sides
            for one, p in enumerate(corrected_each(p_values, model.looks)):
                if one not in effects and dofs[one] and allowed[one]:
                    steps.append((float(p), PARAMETER * float(dofs[one]) - float(drops[one]), "effect", one))
        if len(blunders) < most_blunders and len(readings):
            seen = np.where(field.redundancy[readings] > 1e-6, field.redundancy[readings], np.inf)
            squared = field.residual[readings] ** 2 / seen
            place = int(np.argmax(squared))
            drop = float(squared[place])
            scale = float(_scale_after(field, np.array([drop]), np.array([1]))[0])
            p = corrected(tail(drop, 1, scale, field.dof - 1), len(readings))
            steps.append((p, PARAMETER - drop, "blunder", int(readings[place])))
        p, _, what, place = min(steps, default=(1.0, 0.0, "", -1))
        if p >= EXPLORE:
            return effects, blunders
        if what == "effect":
            effects.append(place)
            frame = field.signals[place]
            field = field.taking(orthonormal(frame, np.ones(frame.shape[1])))
        else:
            blunders.append(place)
            field = field.without([place])


def _scale_after(field: Field, drops: Array, dofs: NDArray[np.int64]) -> Array:
    """Variance that would be left after each step, never less than stated: what is not yet found must not look like
    noise that is smaller."""
    left = field.dof - dofs
    return np.where(left > 0, np.maximum(1.0, (field.squares - drops) / np.maximum(left, 1)), 1.0)


def _exchange(model: Subsets, effects: list[int], blunders: list[int], scale: float, far: bool) -> list[int]:
    """Replace one effect or two by one (far: or by two), drop or add one, as long as that costs less."""
    visible = [i for i, f in enumerate(model.field.frames) if f.shape[1]]
    cost = float(model.costs([effects], blunders, scale)[0])
    for _ in range(STEPS):
        for wide in (False, True) if far else (False,):
            trials = _far(model, effects, visible, blunders, scale) if wide else _near(effects, visible)
            costs = model.costs(trials, blunders, scale) if trials else np.array([np.inf])
            best = int(np.argmin(costs))
            if costs[best] < cost - 1e-9:
                effects, cost = trials[best], float(costs[best])
                break
        else:
            return effects
    return effects


def _near(effects: list[int], visible: Sequence[int]) -> list[list[int]]:
    """Sets that differ by one effect dropped, added or replaced, or by two replaced by one."""
    fresh = [new for new in visible if new not in effects]
    rests = [[e for e in effects if e != out] for out in effects]
    rests += [[e for e in effects if e not in pair] for pair in combinations(effects, 2)]
    if len(effects) < MOST_EFFECTS:
        rests.append(effects)
    fewer = [rest for rest in rests[: len(effects)] if rest]  # whether there is any at all is a matter of significance
    return [*fewer, *([*rest, new] for rest in rests for new in fresh)]


def _far(
    model: Subsets, effects: list[int], visible: Sequence[int], blunders: list[int], scale: float
) -> list[list[int]]:
    """Sets in which one to three effects are replaced by two, and those of a sparse convex program: forward steps do
    not come by them."""
    trials = sparse_sets(model.products(blunders), MOST_EFFECTS) if len(effects) > 1 else []
    for count in (1, 2, 3) if len(effects) <= CROWDED else ():
        for out in combinations(effects, count):
            rest = [e for e in effects if e not in out]
            fresh = [new for new in visible if new not in effects or new in out]
            if not fresh:
                continue
            alone = model.costs([[*rest, new] for new in fresh], blunders, scale)
            likely = [fresh[i] for i in np.argsort(alone)[:LIKELY]]
            trials += [[*rest, *pair] for pair in combinations(likely, 2) if set(pair) != set(out)]
    return trials


def _backward(model: Subsets, effects: list[int], blunders: list[int], level: float, shares: Shares) -> Finding:
    """Drop what is not significant beside everything else that is chosen."""
    while True:
        everything, taken = model.squares(effects, blunders)
        dof = model.field.dof - taken
        scale = noise_scale(everything, dof)
        p_effects = []
        for e in effects:
            squares, fewer = model.squares([x for x in effects if x != e], blunders)
            p_effects.append(corrected(tail(squares - everything, taken - fewer, scale, dof) * model.sides[e],
                                       model.looks))
        rises = model.rises(effects, blunders)
        alone = tails(rises, *(np.full(len(rises), value) for value in (1, scale, dof)))
        p_blunders = [float(p) for p in corrected_each(alone, len(model.readings))]
        excess = [p / (level * shares.effects) for p in p_effects] + [p / (level * shares.blunders) for p in p_blunders]
        if not excess or max(excess) <= 1.0:
            left = replace(model.field, signals=(), sizes=()).taking(model.columns(effects, blunders))
            return Finding(tuple(effects), tuple(blunders), tuple(p_effects), tuple(p_blunders), scale, left)
        worst = int(np.argmax(excess))
        if worst < len(effects):
            effects = effects[:worst] + effects[worst + 1 :]
        else:
            worst -= len(effects)
            blunders = blunders[:worst] + blunders[worst + 1 :]
