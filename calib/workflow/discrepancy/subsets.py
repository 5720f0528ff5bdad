"""Sets of effects and blunders in one field: what each set leaves over, from one matrix of inner products."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Field, orthonormal
from calib.blocks import Array

PARAMETER = 4.0  # what a parameter costs: of two effects that explain the readings alike, the simpler one is named
SAME = 1e-9  # share of a direction outside the others, below which it is theirs


@dataclass(frozen=True)
class Products:
    """Inner products of all candidates' frames, with blunders taken out.

    matrix (q, q); pull (q,): with the residual; squares: of the residual; starts, ends: of each candidate's directions
    among the q; signs (q,): +1 or -1 where the parameter cannot be negative, by the sense of the frame, else 0.
    """

    matrix: Array
    pull: Array
    squares: float
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    signs: Array

    def judge(self, sets: Sequence[Sequence[int]]) -> tuple[Array, NDArray[np.int64], NDArray[np.bool_]]:
        """Sum of squares left by each set, the directions it takes, and whether its parameters have a sign that can
        be."""
        left = np.full(len(sets), self.squares)
        taken = np.zeros(len(sets), dtype=np.int64)
        allowed = np.ones(len(sets), dtype=bool)
        columns = [[q for e in one for q in range(self.starts[e], self.ends[e])] for one in sets]
        sizes = np.array([len(c) for c in columns])
        for size in np.unique(sizes[sizes > 0]):
            which = np.flatnonzero(sizes == size)
            inside = np.array([columns[i] for i in which])
            values, vectors = np.linalg.eigh(self.matrix[inside[:, :, None], inside[:, None, :]])
            along = np.einsum("mij,mi->mj", vectors, self.pull[inside])
            seen = values > SAME
            scaled = np.where(seen, along / np.where(seen, values, 1.0), 0.0)
            left[which] -= np.sum(scaled * along, axis=1)
            taken[which] = seen.sum(axis=1)
            steps = np.einsum("mij,mj->mi", vectors, scaled)
            allowed[which] = np.all(steps * self.signs[inside] >= 0, axis=1)
        return left, taken, allowed


@dataclass(frozen=True)
class Subsets:
    """Sets of effects and blunders in a field, judged by the sum of squares with a price for every choice.

    looks: independent looks at the candidates; readings: places of the rows that may be blunders; positive: places of
    the candidates whose one parameter cannot be negative.
    """

    field: Field
    looks: float
    readings: NDArray[np.int64]
    positive: frozenset[int] = frozenset()
    _known: dict[tuple[int, ...], Products] = dataclasses.field(default_factory=dict)

    def products(self, blunders: Iterable[int]) -> Products:
        """Inner products beside the given blunders."""
        key = tuple(sorted(blunders))
        if key not in self._known:
            self._known[key] = self._products(key)
        return self._known[key]

    def _products(self, blunders: tuple[int, ...]) -> Products:
        frames = self.field.frames
        ends = np.cumsum([f.shape[1] for f in frames], dtype=np.int64)
        starts = ends - np.array([f.shape[1] for f in frames], dtype=np.int64)
        together = np.concatenate([*frames, np.zeros((len(self.field.residual), 0))], axis=1)
        residual = self.field.residual
        signs = np.zeros(together.shape[1])
        for one in self.positive:
            if frames[one].shape[1]:
                signs[starts[one]] = np.sign(frames[one][:, 0] @ self.field.signals[one][:, 0])
        if blunders:
            out = self.columns((), blunders)
            together = together - out @ (out.T @ together)
            residual = residual - out @ (out.T @ residual)
        return Products(together.T @ together, together.T @ residual, float(residual @ residual), starts, ends, signs)

    def columns(self, effects: Sequence[int], blunders: Sequence[int]) -> Array:
        """Orthonormal directions of what is chosen."""
        pieces = [self.field.frames[e] for e in effects]
        if blunders:
            unit = np.zeros((len(self.field.residual), len(blunders)))
            unit[list(blunders), np.arange(len(blunders))] = 1.0
            pieces.append(self.field.outside(unit))
        together = np.concatenate([*pieces, np.zeros((len(self.field.residual), 0))], axis=1)
        return orthonormal(together, np.ones(together.shape[1])) if together.shape[1] else together

    def sides(self, one: int) -> float:
        """Share of the tail probability that counts: half where only one sign can be."""
        return 0.5 if one in self.positive else 1.0

    def squares(self, effects: Sequence[int], blunders: Sequence[int]) -> tuple[float, int]:
        """Sum of squares left and the degrees of freedom taken."""
        left, taken, _ = self.products(blunders).judge([effects])
        return float(left[0]), int(taken[0]) + len(blunders)

    def costs(self, sets: Sequence[Sequence[int]], blunders: Sequence[int], scale: float) -> Array:
        """Sum of squares in units of the noise, plus what parameters and every choice among so many cost."""
        left, taken, allowed = self.products(blunders).judge(sets)
        choices = np.array([len(one) for one in sets]) * np.log(self.looks + 1)
        choices += len(blunders) * np.log(max(len(self.readings), 1))
        return np.where(allowed, left / scale + PARAMETER * taken + 2 * choices, np.inf)
