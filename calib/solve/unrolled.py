"""A small problem written out as one row program: a whole Gauss-Newton step of one trial in each row.

All rows of all observations become one list of scalar instructions with a sparse factorisation in its midst, which the
row back ends run over thousands of trials side by side. Trials move in the local coordinates about one set of values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from calib.blocks import Array, Mixing
from calib.observations import Quantity
from calib.rows import Program
from calib.system import System, Term, Values
from calib.uncertainty import Weighting

LARGEST_ROWS = 20_000  # instructions of all rows, and
LARGEST_SIZE = 120  # free columns, beyond which a problem is not small


@dataclass(frozen=True)
class Unrolled:
    """Row programs of a small problem with p free columns and N readings; every row is one trial.

    step: from local coordinates (p) and readings (N) to better local coordinates (p) and the square of the remaining
    step in units of u; results: from local coordinates (p) to the quantities; predicted: from the local coordinates of
    `drawn` held columns to readings (N). All read the scalars besides, last.
    """

    step: Program
    results: Program
    predicted: Program
    scalars: Array


def is_small(system: System) -> bool:
    """Whether a problem can be unrolled: few rows and columns, and no constraints."""
    rows = sum(t.n * len(t.traced.program(t.any_free)) for t in system.terms)
    return not system.conditions and rows <= LARGEST_ROWS and len(system.layout.free_columns) <= LARGEST_SIZE


class _Scalars:
    """Numbers that are the same for all trials, as symbols: other data need no other program."""

    def __init__(self) -> None:
        self.symbols: list[ca.SX] = []
        self.values: list[float] = []

    def column(self, numbers: Array, zeros_stay: bool = True) -> ca.SX:
        """Symbols for numbers; zeros are written as such where they stay, and what they multiply vanishes."""
        entries = []
        for number in np.ravel(numbers):
            if number == 0.0 and zeros_stay:
                entries.append(ca.SX(0.0))
                continue
            self.symbols.append(ca.SX.sym(f"c{len(self.symbols)}"))
            self.values.append(float(number))
            entries.append(self.symbols[-1])
        return ca.vertcat(*entries)


class _Written:
    """The expressions of a problem, about given values."""

    def __init__(self, system: System, values: Values):
        self.system, self.scalars = system, _Scalars()
        layout = system.layout
        self.local = ca.SX.zeros(layout.size)  # of all columns
        self.free = ca.SX.sym("x", len(layout.free_columns))
        self.local[layout.free_columns.tolist()] = self.free
        self._values = values
        self._stored: dict[tuple[int, int], ca.SX] = {}

    def _instance(self, number: int, instance: int) -> ca.SX:
        if (number, instance) not in self._stored:
            unknown = self.system.layout.unknowns[number]
            held = not self.system.layout.free[self.system.layout.span(unknown)].any()
            self._stored[number, instance] = self.scalars.column(self._values[unknown][instance], zeros_stay=held)
        return self._stored[number, instance]

    def rows(self, term: Term, local: ca.SX, derivatives: bool) -> list[tuple[ca.SX, ca.SX]]:
        """Prediction (dim,) and derivatives (dim, p) of every row of a term at local coordinates of all columns."""
        layout, traced = self.system.layout, term.traced
        ambient, steps = ca.vertcat(*traced.symbols.ambient), ca.vertcat(*traced.symbols.local)
        jacobians = [ca.jacobian(traced.prediction, s) for s in traced.symbols.local] if derivatives else []
        function = ca.Function("row", [ambient, steps], [traced.prediction, *jacobians])
        numbers = {u: k for k, u in enumerate(layout.unknowns)}
        shared = [
            self.scalars.column(f.data[0], False) if f.unknown is None and len(f.data) == 1 else None
            for f in term.feeds
        ]
        found = []
        for i in range(term.n):
            given, moved = [], []
            for feed, columns, whole in zip(term.feeds, term.columns, shared, strict=True):
                if feed.unknown is not None:
                    given.append(self._instance(numbers[feed.unknown], int(feed.index[i])))
                    moved.append(local[columns[i].tolist()])
                else:
                    given.append(self.scalars.column(feed.data[i], False) if whole is None else whole)
            prediction, *parts = function.call([ca.vertcat(*given), ca.vertcat(*moved)])
            matrix = ca.SX(term.dim, len(layout.free_columns))
            for part, columns in zip(parts, term.columns, strict=False):  # none where none are wanted
                places = layout.position[columns[i]]
                kept = np.flatnonzero(places >= 0)
                if len(kept):
                    matrix += ca.mtimes(part[:, kept.tolist()], _selection(places[kept], matrix.shape[1]))
            found.append((prediction, matrix))
        return found

    def step(self, weightings: Sequence[Weighting], readings: ca.SX) -> ca.SX:
        """Better local coordinates of the free columns, and the square of the remaining step."""
        residuals, matrices, begin = [], [], 0
        for term, weighting in zip(self.system.terms, weightings, strict=True):
            rows = self.rows(term, self.local, derivatives=True)
            seen = []
            for prediction, _ in rows:
                seen.append(_unwrapped(term, readings[begin : begin + term.dim] - prediction))
                begin += term.dim
            for mixing in weighting.whitening:
                for i, sources in enumerate(mixing.rows):
                    matrix = self._mixing(mixing, i)
                    residuals.append(ca.mtimes(matrix, ca.vertcat(*[seen[s] for s in sources])))
                    matrices.append(ca.mtimes(matrix, ca.vertcat(*[rows[s][1] for s in sources])))
        residual, matrix = ca.vertcat(*residuals), ca.sparsify(ca.vertcat(*matrices))
        pull = ca.mtimes(matrix.T, residual)
        diagonal, upper, order = ca.ldl(ca.mtimes(matrix.T, matrix), True)
        change = ca.ldl_solve(pull, diagonal, upper, order)
        return ca.vertcat(self.free + ca.densify(change), ca.densify(ca.dot(ca.densify(pull), ca.densify(change))))

    def _mixing(self, mixing: Mixing, i: int) -> ca.SX:
        entries = mixing.matrix[i]
        if entries.ndim == 1:
            return ca.diag(self.scalars.column(entries))
        return ca.sparsify(ca.reshape(self.scalars.column(entries.T), *entries.shape))


def _selection(places: Array, size: int) -> ca.DM:
    return ca.DM(ca.Sparsity.triplet(len(places), size, list(range(len(places))), places.tolist()), 1.0)


def _unwrapped(term: Term, residual: ca.SX) -> ca.SX:
    period = term.bound.period
    if period is None:
        return residual
    periods = [period] * term.dim if np.ndim(period) == 0 else list(period)
    parts = [residual[j] if each is None else residual[j] - each * ca.floor(residual[j] / each + 0.5)
             for j, each in enumerate(periods)]
    return ca.vertcat(*parts)


def unrolled(
    system: System, values: Values, weightings: Sequence[Weighting], quantities: Sequence[Quantity],
    drawn: Sequence[int],
) -> Unrolled:
    """Write out a small problem about values.

    system: without constraints; values: about which trials move; weightings: of each group of observations;
    quantities: wanted of every trial; drawn: held columns that change from trial to trial in `predicted`.
    """
    written = _Written(system, values)
    readings = ca.SX.sym("reading", sum(t.n * t.dim for t in system.terms))
    step = written.step(weightings, readings)
    terms = [system.results.get(q) or system.plain(q) for q in quantities]
    results = [value for term in terms for value, _ in written.rows(term, written.local, derivatives=False)]
    held, moved = ca.SX.sym("held", len(drawn)), ca.SX.zeros(system.layout.size)
    if drawn:
        moved[list(drawn)] = held
    predicted = [value for term in system.terms for value, _ in written.rows(term, moved, derivatives=False)]
    scalars = ca.vertcat(*written.scalars.symbols) if written.scalars.symbols else ca.SX(0, 1)
    return Unrolled(
        Program([written.free, readings, scalars], ca.densify(step)),
        Program([written.free, scalars], ca.densify(ca.vertcat(*results))),
        Program([held, scalars], ca.densify(ca.vertcat(*predicted))),
        np.array(written.scalars.values),
    )
