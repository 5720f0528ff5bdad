"""System: a problem ready for numbers - residuals, derivatives and constraints at given values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from calib.accumulation import predicted_compiled
from calib.blocks import Array, Block, Index, Part
from calib.errors import CalibrationError, ModelBreakdown
from calib.layout import Layout
from calib.observations import BoundModel, Constraint, Observations, Quantity
from calib.pattern import Raw, Source, pieces
from calib.problem import Problem
from calib.trace import Traced, numeric_covariates, trace
from calib.uncertainty import Weighting
from calib.unknown import Unknown

Values = Mapping[Unknown, Array]
Rows = Index | slice
B = TypeVar("B", bound=BoundModel)
EVERY = slice(None)


@dataclass(frozen=True)
class _Feed:
    """One source of a row function, bound: an unknown with the instance of each row, or data (n or 1, width)."""

    unknown: Unknown | None
    index: NDArray[np.int64]
    data: Array

    def inputs(self, values: Values, rows: Rows = EVERY) -> list[Any]:
        if self.unknown is None:
            data = self.data if len(self.data) == 1 else self.data[rows]
            return [c[0] if len(self.data) == 1 else c for c in np.ascontiguousarray(data.T)]
        stored = values[self.unknown]
        if self.unknown.count == 1:
            return list(stored[0])
        return list(np.ascontiguousarray(stored[self.index[rows]].T))

    def raw(self, values: Values) -> tuple[Array, Index | None]:
        """As they are stored, with the instance of each row where there are several."""
        numbers = np.ascontiguousarray(self.data if self.unknown is None else values[self.unknown])
        several = self.unknown is not None and self.unknown.count > 1
        return numbers, np.ascontiguousarray(self.index) if several else None  # which may repeat one number


class Term(Generic[B]):
    """One bound model in a system: its row functions and where its arguments stand among the columns."""

    def __init__(self, bound: B, traced: Traced, feeds: Sequence[_Feed], layout: Layout):
        self.bound, self.traced, self.feeds = bound, traced, tuple(feeds)
        self.n, self.dim = bound.n, traced.dim
        nothing = np.zeros((self.n, 0), dtype=np.int64)
        self.columns = [nothing if f.unknown is None else layout.columns(f.unknown, f.index) for f in feeds]
        self.any_free = tuple(f.unknown is not None and layout.any_free(f.unknown, f.index) for f in feeds)
        self.any_unknown = tuple(f.unknown is not None for f in feeds)

    def _inputs(self, values: Values, rows: Rows = EVERY) -> list[Any]:
        return [column for feed in self.feeds for column in feed.inputs(values, rows)]

    def predict(self, values: Values) -> Array:
        """Predictions (n, dim)."""
        program = self.traced.program((False,) * len(self.feeds))
        if program.pays(self.n):
            return predicted_compiled(program, [f.raw(values) for f in self.feeds], self.n)
        found = np.empty((self.n, self.dim))
        for rows in pieces(self.n, 1 / 8):  # what is gathered for all rows at once would need much memory
            found[rows] = program.run(self._inputs(values, rows), len(rows), compiled=False).T
        return found

    def wanted(self, held_too: bool) -> tuple[bool, ...]:
        """Which arguments have derivatives: those with anything free, or all unknowns."""
        return self.any_unknown if held_too else self.any_free

    def evaluate(self, values: Values, rows: Index, held_too: bool = False) -> tuple[Array, list[Array]]:
        """Predictions (dim, c) of chosen rows (c,), and derivatives (f, dim, c) with respect to each argument that is
        wanted."""
        wanted = self.wanted(held_too)
        program = self.traced.program(wanted)
        # Compiled or not is decided for all rows, so that a piece has the digits of the whole.
        result = program.run(self._inputs(values, rows), len(rows), program.pays(self.n))
        return result[: self.dim], self._split(result, wanted)

    def raw(self, values: Values, readings: Array, given: bool, held_too: bool = False) -> Raw | None:
        """What a compiled loop evaluates the rows from, where that pays; given: whether readings are residuals."""
        program = self.traced.program(self.wanted(held_too))
        if not program.pays(self.n):
            return None
        feeds = tuple(f.raw(values) for f in self.feeds)
        return Raw(program, feeds, np.ascontiguousarray(readings), given, self.periods)

    @cached_property
    def periods(self) -> tuple[float | None, ...]:
        """Period of each component of the readings, None where it has none."""
        period: Any = getattr(self.bound, "period", None)
        return (period,) * self.dim if np.ndim(period) == 0 else tuple(period)

    def _split(self, result: Array, wanted: tuple[bool, ...]) -> list[Array]:
        freedom = [s.freedom for s, want in zip(self.traced.sources, wanted, strict=True) if want]
        ends = self.dim * (1 + np.cumsum([0, *freedom]))
        return [result[a:b].reshape(f, self.dim, -1) for f, a, b in zip(freedom, ends[:-1], ends[1:], strict=True)]

    def derive(self, values: Values, held_too: bool = False) -> tuple[Array, list[Part]]:
        """Predictions (n, dim) and their derivatives; held_too: also with respect to what is held."""
        wanted = self.wanted(held_too)
        result = self.traced.program(wanted)(self._inputs(values), self.n)
        columns = [c for c, want in zip(self.columns, wanted, strict=True) if want]
        parts = [Part(c, np.ascontiguousarray(j.transpose(2, 1, 0)))
                 for c, j in zip(columns, self._split(result, wanted), strict=True)]
        return np.ascontiguousarray(result[: self.dim].T), parts

    def matrix(self, values: Values, size: int) -> tuple[Array, Array]:
        """Predictions (n, dim) and their derivatives (n dim, size) with respect to all columns."""
        value, parts = self.derive(values, held_too=True)
        block = Block(np.zeros((self.n, 1), dtype=np.int64), value, tuple(parts))
        return value, block.dense(np.arange(size), size)

    def curvature(self, values: Values, weights: Array) -> tuple[NDArray[np.int64], Array]:
        """Columns (n, F) of the free arguments and the Hessians (n, F, F) of weights (n, dim) times the prediction."""
        columns = np.concatenate([c for c, want in zip(self.columns, self.any_free, strict=True) if want], axis=1)
        flat = self.traced.curvature(self.any_free)([*self._inputs(values), *np.ascontiguousarray(weights.T)], self.n)
        size = columns.shape[1]
        return columns, flat.reshape(size, size, self.n).transpose(2, 0, 1)

    def bend(self, values: Values, weights: Array) -> Callable[[Array, Array], None]:
        """Adds to a sum (size,) the Hessian of weights (n, dim) times the prediction, times a step (size,)."""
        fixed = [*self._inputs(values), *np.ascontiguousarray(weights.T)]
        wanted = [(feed.unknown.count == 1, c)  # whether all rows see one instance
                  for feed, c, want in zip(self.feeds, self.columns, self.any_free, strict=True)
                  if want and feed.unknown is not None]
        program = self.traced.bend(self.any_free)

        def add(step: Array, total: Array) -> None:
            directions = [d for one, c in wanted for d in (step[c[0]] if one else step[c].T.copy())]
            slopes, begin = program([*fixed, *directions], self.n), 0
            for one, columns in wanted:
                for f, slope in enumerate(slopes[begin : begin + columns.shape[1]]):
                    if one:
                        total[columns[0, f]] += slope.sum()
                    else:
                        total += np.bincount(columns[:, f], slope, len(total))
                begin += columns.shape[1]

        return add


def _excess(term: Term[Constraint], value: Array) -> tuple[Array, Array]:
    """By how much values (n, dim) lie over the upper and under the lower limit, in units of the tolerance (n dim,)."""
    constraint = term.bound
    over, under = value - constraint.upper, constraint.lower - value
    return (over / constraint.tolerance).ravel(), (under / constraint.tolerance).ravel()


class System:
    """A problem with its traced row functions; readings, weights and held values are its data.

    problem: what was declared; layout: its columns; terms, conditions, results: its observations, constraints and
    quantities, ready to evaluate.
    """

    def __init__(self, problem: Problem):
        self.problem = problem
        self.layout = Layout(problem.unknowns, {u: problem.is_held(u) for u in problem.unknowns})
        self.terms = tuple(self._term(o) for o in problem.observations)
        self.conditions = tuple(self.plain(c) for c in problem.constraints)
        for term in self.terms:
            observations = term.bound
            if observations.readings is not None and observations.readings.shape != (term.n, term.dim):
                raise CalibrationError(
                    f"observations '{observations.group}': the model {observations.model_name} predicts "
                    f"{term.dim} components for {term.n} rows, the readings have shape "
                    f"{observations.readings.shape}."
                )

    def _feeds(self, bound: BoundModel) -> list[_Feed]:
        return [_Feed(a.unknown, a.index, a.data) for a in bound.arguments]

    def _term(self, observations: Observations) -> Term[Observations]:
        acting = [a for a in self.problem.attached if observations.group in a.places]
        needed = {name for a in acting for name in a.effect.inputs}
        covariates = tuple(name for name in numeric_covariates(observations) if name in needed)
        traced = trace(observations, tuple(a.effect for a in acting), tuple(a.unknown for a in acting), covariates)
        feeds = self._feeds(observations)
        feeds += [_Feed(a.unknown, a.index(observations), np.zeros((0, 0))) for a in acting]
        none = np.zeros(0, dtype=np.int64)
        feeds += [_Feed(None, none, np.asarray(observations.covariates[c], float)[:, None]) for c in covariates]
        return Term(observations, traced, feeds, self.layout)

    def plain(self, bound: B) -> Term[B]:
        """A bound model without effects, ready to evaluate."""
        return Term(bound, trace(bound), self._feeds(bound), self.layout)

    @cached_property
    def results(self) -> dict[Quantity, Term[Quantity]]:
        """The quantities, ready to evaluate."""
        return {q: self.plain(q) for q in self.problem.quantities}

    @property
    def affine(self) -> bool:
        """Whether every prediction and condition is affine in the unknowns."""
        return all(t.traced.affine for t in self.terms) and all(t.traced.affine for t in self.conditions)

    # --- observations ---------------------------------------------------------------------------------------------

    def weightings(self, values: Values) -> list[Weighting]:
        """Row operations of every group of observations; those that depend on row quantities are taken at the
        values."""
        return [self._weighting(term, values) for term in self.terms] if self.depends else self._stated

    @cached_property
    def _stated(self) -> list[Weighting]:
        return [self._weighting(term, {}) for term in self.terms]

    def _weighting(self, term: Term[Observations], values: Values) -> Weighting:
        observations = term.bound

        def quantity(name: str) -> Array:
            if name == "reading":
                return term.predict(values) if observations.readings is None else observations.readings
            for argument, feed in zip(observations.arguments, term.feeds, strict=False):
                if argument.name == name:
                    source = values[feed.unknown][feed.index] if feed.unknown is not None else feed.data
                    return np.broadcast_to(source, (term.n, source.shape[1]))
            raise CalibrationError(
                f"observations '{observations.group}': the uncertainty depends on '{name}', which is "
                f"neither `reading` nor an argument of {observations.model_name}."
            )

        return observations.uncertainty.weighting(term.n, term.dim, f"observations '{observations.group}'", quantity)

    @cached_property
    def depends(self) -> bool:
        """Whether any uncertainty depends on row quantities."""
        return any(o.uncertainty.needs for o in self.problem.observations)

    def residual(self, term: Term[Observations], predicted: Array, rows: Rows = EVERY) -> Array:
        """Reading minus prediction (c, dim) of chosen rows, brought into half a period where readings are periodic;
        zero if planned."""
        observations = term.bound
        if observations.readings is None:
            return np.zeros_like(predicted)
        residual = observations.readings[rows] - predicted
        for j, period in enumerate(term.periods):
            if period is not None:
                residual[:, j] -= period * np.rint(residual[:, j] / period)
        bad = np.argwhere(~np.isfinite(residual))
        if len(bad):
            raise ModelBreakdown(
                f"observations '{observations.group}', row {observations.rows[rows][bad[0][0]]}: the model "
                f"{observations.model_name} gives {predicted[tuple(bad[0])]} at the present values of "
                f"{', '.join(u.name for u in observations.unknowns)}; start nearer, or mend the model there."
            )
        return residual

    def residuals(self, values: Values) -> list[Array]:
        """Residuals (n, dim) of every group."""
        return [self.residual(t, t.predict(values)) for t in self.terms]

    def whitened(self, values: Values, weightings: Sequence[Weighting]) -> Array:
        """All whitened residuals in one vector."""
        return np.concatenate([
            m.apply(r, ()).residual.ravel()
            for r, w in zip(self.residuals(values), weightings, strict=True)
            for m in w.whitening
        ])

    def rounding(self, values: Values, weightings: Sequence[Weighting]) -> float:
        """Size in units of u of the rounding of all predictions and of the values themselves (a coordinate of 6000 km
        is known to 1 nm), below which no step can be told from noise."""
        total, sizes = 0.0, self._stored(values)
        for term, weighting in zip(self.terms, weightings, strict=True):
            columns = [c for c, free in zip(term.columns, term.any_free, strict=True) if free]
            for rows in pieces(term.n):
                predicted, derivatives = term.evaluate(values, rows)
                weight = 1.0 / weighting.u[rows].T
                total += float(np.sum((predicted * weight) ** 2))
                for c, one in zip(columns, derivatives, strict=True):
                    total += float(np.sum((one * weight * sizes[c[rows]].T[:, None]) ** 2))
        return 8 * float(np.finfo(float).eps) * float(np.sqrt(total))

    def _stored(self, values: Values) -> Array:
        """Size of the stored number behind each column; 1 for those of rotations and directions."""
        sizes = [
            np.abs(values[u]).ravel() if u.kind == "vector" else np.ones(u.count * u.freedom)
            for u in self.layout.unknowns
        ]
        return np.concatenate(sizes)

    def blocks(self, values: Values, weightings: Sequence[Weighting]) -> list[Block]:
        """All whitened residuals with the derivatives of the predictions with respect to what is free."""
        blocks = []
        for term, weighting in zip(self.terms, weightings, strict=True):
            predicted, parts = term.derive(values)
            residual = self.residual(term, predicted)
            blocks += [m.apply(residual, parts) for m in weighting.whitening]
        return blocks

    def sources(self, values: Values, weightings: Sequence[Weighting]) -> list[Source]:
        """The rows of every group, to be evaluated piece by piece, with derivatives with respect to what is free."""
        return [self._source(term, weighting, values) for term, weighting in zip(self.terms, weightings, strict=True)]

    def _source(self, term: Term[Observations], weighting: Weighting, values: Values) -> Source:
        def evaluate(rows: Index) -> tuple[Array, list[Array]]:
            predicted, derivatives = term.evaluate(values, rows)
            return self.residual(term, predicted.T, rows).T, derivatives

        columns = tuple(c for c, free in zip(term.columns, term.any_free, strict=True) if free)
        readings = term.bound.readings
        raw = term.raw(values, np.zeros((term.n, term.dim)) if readings is None else readings, readings is None)
        return Source(columns, weighting.whitening, evaluate, raw)

    # --- conditions and results -----------------------------------------------------------------------------------

    def equalities(self, values: Values) -> tuple[Array, Array, Array]:
        """Equality constraints at the values: excess (m,), derivatives (m, size), and tolerances (m,)."""
        excess, matrices, tolerances = [np.zeros(0)], [np.zeros((0, self.layout.size))], [np.zeros(0)]
        for term in self.conditions:
            constraint = term.bound
            if constraint.is_equality:
                value, matrix = term.matrix(values, self.layout.size)
                excess.append((value - constraint.lower).ravel())
                matrices.append(matrix)
                tolerances.append(np.full(value.size, constraint.tolerance))
        return np.concatenate(excess), np.concatenate(matrices), np.concatenate(tolerances)

    def active_conditions(self, values: Values) -> tuple[Array, Array, float]:
        """Derivatives of the equalities and of the active inequalities (signed upwards), and the largest excess of any
        condition in units of its tolerance."""
        nothing = np.zeros((0, self.layout.size))
        equal, unequal, worst = [nothing], [nothing], 0.0
        for term in self.conditions:
            value, matrix = term.matrix(values, self.layout.size)
            over, under = _excess(term, value)
            worst = max(worst, float(np.max(np.maximum(over, under))))
            if term.bound.is_equality:
                equal.append(matrix)
            else:
                unequal += [matrix[over >= -1.0], -matrix[under >= -1.0]]
        return np.concatenate(equal), np.concatenate(unequal), worst

    def forces(self, values: Values, multipliers: Array) -> list[Array]:
        """Multipliers of the active conditions, equalities first, as one (n, dim) array for each constraint."""
        arrays = [np.zeros(t.n * t.dim) for t in self.conditions]
        taken = 0
        for equality in (True, False):
            for term, array in zip(self.conditions, arrays, strict=True):
                if term.bound.is_equality is not equality:
                    continue
                over, under = _excess(term, term.predict(values))
                for rows, sign in ((slice(None), 1.0),) if equality else ((over >= -1.0, 1.0), (under >= -1.0, -1.0)):
                    array[rows] += sign * multipliers[taken : taken + len(array[rows])]
                    taken += len(array[rows])
        return [a.reshape(t.n, t.dim) for a, t in zip(arrays, self.conditions, strict=True)]

    def second_order(self, values: Values, weighed: Sequence[Array], multipliers: Array) -> Array:
        """What the exact Hessian of half v'Pv and of the conditions adds to the normal matrix, over the free columns;
        weighed: P v (n, dim) of every group."""
        matrix = np.zeros((self.layout.size, self.layout.size))
        for term, weights in self._bent(values, weighed, multipliers):
            columns, hessians = term.curvature(values, weights)
            np.add.at(matrix, (columns[:, :, None], columns[:, None, :]), hessians)
        return matrix[np.ix_(self.layout.free_columns, self.layout.free_columns)]

    def bend(self, values: Values, weighed: Sequence[Array], multipliers: Array) -> Callable[[Array], Array] | None:
        """Multiplies a step (p,) of the free columns by what `second_order` returns, without forming it; None where
        everything is affine."""
        terms = [term.bend(values, weights) for term, weights in self._bent(values, weighed, multipliers)]
        free = self.layout.free_columns

        def product(step: Array) -> Array:
            whole, total = np.zeros(self.layout.size), np.zeros(self.layout.size)
            whole[free] = step
            for add in terms:
                add(whole, total)
            return total[free]

        return product if terms else None

    def _bent(self, values: Values, weighed: Sequence[Array], multipliers: Array) -> list[tuple[Term[Any], Array]]:
        """Terms whose prediction is bent in what is free, each with the weights (n, dim) of its second derivatives."""
        terms: list[Term[Any]] = [*self.terms, *self.conditions]
        weights = [*(-w for w in weighed), *self.forces(values, multipliers)]
        return [(term, w) for term, w in zip(terms, weights, strict=True)
                if term.n and not term.traced.affine and any(term.any_free)]

    def at_bounds(self, values: Values) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which free columns (p,) sit at their lower, and which at their upper bound."""
        lower, upper = (room[self.layout.free_columns] for room in self.layout.bounds(values))
        return lower >= 0, upper <= 0

    def result(self, quantity: Quantity, values: Values) -> tuple[Array, Array]:
        """Values (n, dim) of a quantity and their derivatives (n dim, size) with respect to all columns."""
        return (self.results.get(quantity) or self.plain(quantity)).matrix(values, self.layout.size)
