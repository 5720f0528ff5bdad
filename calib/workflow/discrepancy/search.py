"""The search: which effects and which blunders together explain the residuals, and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Field, orthonormal
from calib.blocks import Array

EXPLORE = 0.25  # corrected p-value up to which the search goes on adding, before it drops what is not needed
MOST_EFFECTS = 6
DRAWS = 400  # simulated residuals from which the number of independent looks is judged
SCALE_LEVEL = 0.002  # at which the stated noise is given up for the one that is left over


@dataclass(frozen=True)
class Shares:
    """How the probability of a false alarm is shared among the kinds of finding."""

    effects: float = 0.40
    blunders: float = 0.15
    structure: float = 0.20
    noise: float = 0.25


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


def tail(drop: float, dof: int, scale: float, left_dof: int) -> float:
    """Probability of a larger drop: chi-squared where the noise is as stated (scale 1), else F."""
    from scipy.special import fdtrc, gammaincc

    if dof == 0:
        return 1.0
    return float(gammaincc(dof / 2, drop / 2) if scale == 1.0 else fdtrc(dof, max(left_dof, 1), drop / dof / scale))


def corrected(p: float, looks: float) -> float:
    """Probability of so small a p-value among a number of looks (Sidak)."""
    return float(-np.expm1(looks * np.log1p(-min(p, 1 - 1e-16))))


def noise_scale(field: Field) -> float:
    """Variance of what is left, or 1 where it does not contradict the stated one."""
    from scipy.special import gammainc, gammaincc

    if field.dof < 3:
        return 1.0
    upper, lower = gammaincc(field.dof / 2, field.squares / 2), gammainc(field.dof / 2, field.squares / 2)
    return field.squares / field.dof if min(upper, lower) < SCALE_LEVEL / 2 else 1.0


def independent_looks(field: Field, seed: int) -> float:
    """Number of independent candidates that would be as often the best by chance as these dependent ones."""
    from scipy.special import gammaincc

    frames = [f for f in field.frames if f.shape[1]]
    if not frames:
        return 1.0
    draws = np.random.default_rng(seed).standard_normal((len(field.residual), DRAWS))
    smallest = np.min([gammaincc(f.shape[1] / 2, np.sum((f.T @ draws) ** 2, axis=0) / 2) for f in frames], axis=0)
    middle = 1 / float(np.mean(-np.log1p(-np.minimum(smallest, 1 - 1e-12))))
    rare = np.log(0.95) / np.log1p(-max(float(np.quantile(smallest, 0.05)), 1e-12))
    return float(min(max(middle, rare, 1.0), len(frames)))


class _Model:
    """A set of effects and blunders in a field, judged by the sum of squares with a price for every choice."""

    def __init__(self, field: Field, looks: float, readings: NDArray[np.int64]):
        self.field, self.looks, self.readings = field, looks, readings

    def columns(self, effects: Sequence[int], blunders: Sequence[int]) -> Array:
        """Orthonormal directions of what is chosen."""
        pieces = [self.field.signals[e] / np.where(self.field.sizes[e] > 0, self.field.sizes[e], 1.0) for e in effects]
        if blunders:
            unit = np.zeros((len(self.field.residual), len(blunders)))
            unit[list(blunders), np.arange(len(blunders))] = 1.0
            pieces.append(self.field.outside(unit))
        if not pieces:
            return np.zeros((len(self.field.residual), 0))
        together = np.concatenate(pieces, axis=1)
        return orthonormal(together, np.ones(together.shape[1]))

    def squares(self, effects: Sequence[int], blunders: Sequence[int]) -> tuple[float, int]:
        """Sum of squares left and the degrees of freedom taken."""
        frame = self.columns(effects, blunders)
        return self.field.squares - float(np.sum((frame.T @ self.field.residual) ** 2)), frame.shape[1]

    def cost(self, effects: Sequence[int], blunders: Sequence[int], scale: float) -> float:
        """Sum of squares in units of the noise, plus what every choice among so many costs."""
        squares, taken = self.squares(effects, blunders)
        return (
            squares / scale
            + taken
            + 2 * len(effects) * np.log(self.looks + 1)
            + 2 * len(blunders) * np.log(len(self.readings))
        )


def search(
    field: Field,
    readings: NDArray[np.int64],
    level: float,
    seed: int,
    shares: Shares | None = None,
    most_blunders: int | None = None,
) -> Finding:
    """Find effects and blunders by forward steps, exchanges and backward elimination.

    field: residuals with the signals of all candidates; readings: places of the rows that may be blunders; level:
    overall probability of a false alarm; seed: of the simulated looks; shares: of the level; most_blunders: at most.
    """
    shares = shares or Shares()
    looks = independent_looks(field, seed)
    model = _Model(field, looks, readings)
    most_blunders = max(3, len(readings) // 25) if most_blunders is None else most_blunders
    effects, blunders = _forward(field, readings, looks, most_blunders)
    left = field.taking(model.columns(effects, blunders))
    scale = noise_scale(left)
    effects = _exchange(model, effects, blunders, scale)
    return _backward(model, effects, blunders, level, shares)


def _forward(field: Field, readings: NDArray, looks: float, most_blunders: int) -> tuple[list[int], list[int]]:
    effects: list[int] = []
    blunders: list[int] = []
    while True:
        drops, dofs = field.statistics
        best, step = EXPLORE, None
        for one, (drop, dof) in enumerate(zip(drops, dofs, strict=True)):
            if one in effects or dof == 0 or len(effects) >= MOST_EFFECTS:
                continue
            p = corrected(tail(drop, int(dof), _scale_after(field, drop, int(dof)), field.dof - int(dof)), looks)
            if p < best or (p == best == 0.0 and step is not None and drop > step[2]):
                best, step = p, ("effect", one, drop)
        if len(blunders) < most_blunders and len(readings):
            seen = np.where(field.redundancy[readings] > 1e-6, field.redundancy[readings], np.inf)
            squared = field.residual[readings] ** 2 / seen
            place = int(np.argmax(squared))
            drop = float(squared[place])
            p = corrected(tail(drop, 1, _scale_after(field, drop, 1), field.dof - 1), len(readings))
            if p < best or (p == best == 0.0 and step is not None and drop > step[2]):
                best, step = p, ("blunder", int(readings[place]), drop)
        if step is None:
            return effects, blunders
        if step[0] == "effect":
            effects.append(step[1])
            field = field.taking(field.frames[step[1]])
        else:
            blunders.append(step[1])
            unit = np.zeros((len(field.residual), 1))
            unit[step[1], 0] = 1.0
            field = field.taking(orthonormal(field.outside(unit), np.ones(1)))


def _scale_after(field: Field, drop: float, dof: int) -> float:
    """Variance that would be left after a step, never less than stated: what is not yet found must not look like noise
    that is smaller."""
    left = field.dof - dof
    return max(1.0, (field.squares - drop) / left) if left > 0 else 1.0


def _exchange(model: _Model, effects: list[int], blunders: list[int], scale: float) -> list[int]:
    """Replace one effect, or two by one, or drop or add one, as long as that costs less."""
    visible = [i for i, f in enumerate(model.field.frames) if f.shape[1]]
    cost = model.cost(effects, blunders, scale)
    for _ in range(12):
        trials: list[list[int]] = []
        for out in range(len(effects)):
            rest = effects[:out] + effects[out + 1 :]
            trials.append(rest)
            trials += [[*rest, new] for new in visible if new not in effects]
        for first in range(len(effects)):
            for second in range(first + 1, len(effects)):
                rest = [e for k, e in enumerate(effects) if k not in (first, second)]
                trials += [[*rest, new] for new in visible if new not in effects]
        if len(effects) < MOST_EFFECTS:
            trials += [[*effects, new] for new in visible if new not in effects]
        if not trials:
            return effects
        costs = [model.cost(t, blunders, scale) for t in trials]
        best = int(np.argmin(costs))
        if costs[best] >= cost - 1e-9:
            return effects
        effects, cost = trials[best], costs[best]
    return effects


def _backward(model: _Model, effects: list[int], blunders: list[int], level: float, shares: Shares) -> Finding:
    """Drop what is not significant beside everything else that is chosen."""
    while True:
        left = model.field.taking(model.columns(effects, blunders))
        scale = noise_scale(left)
        everything, taken = model.squares(effects, blunders)
        p_effects, p_blunders = [], []
        for e in effects:
            squares, fewer = model.squares([x for x in effects if x != e], blunders)
            p_effects.append(corrected(tail(squares - everything, taken - fewer, scale, left.dof), model.looks))
        for b in blunders:
            squares, fewer = model.squares(effects, [x for x in blunders if x != b])
            p_blunders.append(
                corrected(tail(squares - everything, taken - fewer, scale, left.dof), len(model.readings))
            )
        excess = [p / (level * shares.effects) for p in p_effects] + [p / (level * shares.blunders) for p in p_blunders]
        if not excess or max(excess) <= 1.0:
            return Finding(tuple(effects), tuple(blunders), tuple(p_effects), tuple(p_blunders), scale, left)
        worst = int(np.argmax(excess))
        if worst < len(effects):
            effects = effects[:worst] + effects[worst + 1 :]
        else:
            worst -= len(effects)
            blunders = blunders[:worst] + blunders[worst + 1 :]
