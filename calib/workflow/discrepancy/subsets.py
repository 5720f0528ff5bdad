"""Sets of effects and blunders in one field: what each set leaves over, from one matrix of inner products."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Field, orthonormal
from calib.blocks import Array

PARAMETER = 4.0  # what a parameter costs: of two effects that explain the readings alike, the simpler one is named
BLUNDER = 6.0  # what a blunder costs beside its choice: it may be anywhere within 25 u to either side
SAME = 1e-4  # squared share of a direction outside the others, below which it is theirs (it would be a hundredfold)
TRACE = 1e-9  # that keeps a matrix regular


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
            self._known[key] = self._beside(key) if key else self.products_of(self._framed)
        return self._known[key]

    @cached_property
    def _framed(self) -> Field:
        return replace(self.field, signals=self.field.frames)

    def products_of(self, field: Field) -> Products:
        """Inner products of the candidates' signals, as they are, in a field."""
        ends = np.cumsum([s.shape[1] for s in field.signals], dtype=np.int64)
        starts = ends - np.array([s.shape[1] for s in field.signals], dtype=np.int64)
        together = np.concatenate([*field.signals, np.zeros((len(field.residual), 0))], axis=1)
        signs = np.zeros(together.shape[1])
        for one in self.positive:
            if ends[one] > starts[one]:
                signs[starts[one]] = np.sign(self.field.frames[one][:, 0] @ self.field.signals[one][:, 0])
        return Products(together.T @ together, together.T @ field.residual, field.squares, starts, ends, signs)

    def _beside(self, blunders: tuple[int, ...]) -> Products:
        alone, places = self.products(()), list(blunders)
        rows, residual = self._rows(places), self.field.residual[places]
        solved = np.linalg.solve(self._corner(places), np.column_stack([rows, residual]))
        return replace(alone, matrix=alone.matrix - rows.T @ solved[:, :-1], pull=alone.pull - rows.T @ solved[:, -1],
                       squares=alone.squares - float(residual @ solved[:, -1]))

    def _rows(self, places: list[int]) -> Array:
        """Rows of all frames at some places."""
        return np.concatenate([*(f[places] for f in self.field.frames), np.zeros((len(places), 0))], axis=1)

    def _corner(self, places: list[int]) -> Array:
        """Inner products of what shows of errors of single readings; a trace keeps it regular where nothing does."""
        basis = self.field.basis[places]
        return (1 + TRACE) * np.eye(len(places)) - basis @ basis.T

    def rises(self, effects: Sequence[int], blunders: Sequence[int]) -> Array:
        """By how much the sum of squares would rise without each blunder alone, all from one inverse (Schur)."""
        if not blunders:
            return np.zeros(0)
        alone, places = self.products(()), list(blunders)
        inside = [q for e in effects for q in range(alone.starts[e], alone.ends[e])]
        across = self._rows(places)[:, inside]
        matrix = alone.matrix[np.ix_(inside, inside)] + TRACE * np.eye(len(inside))
        inverse = np.linalg.inv(np.block([[matrix, across.T], [across, self._corner(places)]]))
        steps = inverse @ np.concatenate([alone.pull[inside], self.field.residual[places]])
        return np.asarray(steps**2 / np.diag(inverse))[len(inside):]

    def columns(self, effects: Sequence[int], blunders: Sequence[int]) -> Array:
        """Orthonormal directions of what is chosen."""
        pieces = [self.field.frames[e] for e in effects]
        if blunders:
            pieces.append(self.field.alone(blunders))
        together = np.concatenate([*pieces, np.zeros((len(self.field.residual), 0))], axis=1)
        return orthonormal(together, np.ones(together.shape[1])) if together.shape[1] else together

    @cached_property
    def sides(self) -> Array:
        """Share of the tail probability that counts for each candidate: half where only one sign can be."""
        return np.array([0.5 if one in self.positive else 1.0 for one in range(len(self.field.signals))])

    def squares(self, effects: Sequence[int], blunders: Sequence[int]) -> tuple[float, int]:
        """Sum of squares left and the degrees of freedom taken."""
        left, taken, _ = self.products(blunders).judge([effects])
        return float(left[0]), int(taken[0]) + len(blunders)

    def costs(self, sets: Sequence[Sequence[int]], blunders: Sequence[int], scale: float) -> Array:
        """Sum of squares in units of the noise, plus what parameters and every choice among so many cost."""
        left, taken, allowed = self.products(blunders).judge(sets)
        choices = np.array([len(one) for one in sets]) * np.log(self.looks + 1)
        choices += len(blunders) * np.log(max(len(self.readings), 1))
        return np.where(allowed, left / scale + PARAMETER * taken + BLUNDER * len(blunders) + 2 * choices, np.inf)
