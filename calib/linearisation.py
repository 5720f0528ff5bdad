"""The waist: whitened residuals and derivatives at given values, held columns too, on which every analysis stands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib import elimination
from calib.blocks import Array, Block, Index, Part
from calib.effect import Effect
from calib.elimination import Factor
from calib.errors import DeclarationError
from calib.factor import Conditions
from calib.layout import Layout
from calib.normal import NormalEquations, sparse_rows
from calib.observations import Observations, Quantity
from calib.pattern import Raw, Source, pattern_of
from calib.problem import Problem
from calib.system import System, Term
from calib.uncertainty import Weighting
from calib.unknown import Selection, Unknown

STORED = 200_000  # derivatives of a group beyond which they are evaluated when they are asked for


class Derivatives(Sequence[Part]):
    """Derivatives of many rows with respect to all unknowns: evaluated when asked for, never kept.

    term: of a system; values: where.
    """

    def __init__(self, term: Term[Observations], values: Mapping[Unknown, Array]):
        self._term, self._values = term, values

    def columns(self, held_too: bool = True) -> tuple[Index, ...]:
        """Columns (n, f) of each argument that is an unknown; held_too: even where nothing of it is free."""
        wanted = self._term.wanted(held_too)
        return tuple(c for c, want in zip(self._term.columns, wanted, strict=True) if want)

    def evaluate(self, rows: Index, held_too: bool = True) -> list[Array]:
        """Derivatives (f, dim, c) of chosen rows (c,) with respect to the same arguments."""
        return self._term.evaluate(self._values, rows, held_too)[1]

    def raw(self, residual: Array) -> Raw | None:
        """What a compiled loop evaluates the rows from, where that pays, with residuals (n, dim)."""
        return self._term.raw(self._values, residual, given=True)

    def __len__(self) -> int:
        return sum(self._term.any_unknown)

    def __getitem__(self, place: Any) -> Any:
        return tuple(self._term.derive(self._values, held_too=True)[1])[place]

    def __iter__(self) -> Iterator[Part]:
        return iter(self._term.derive(self._values, held_too=True)[1])


@dataclass(frozen=True)
class Group:
    """One group of observations at the point of linearisation.

    name; rows (n,) of the data file; components, units: of the dim components; readings (n, dim) or None;
    predicted, residual (n, dim) SI; weighting: its covariance; parts: derivatives with respect to all columns;
    covariates, covariate_units; is_prior; counted (n,): whether a row takes part in the estimate.
    """

    name: str
    rows: NDArray
    components: tuple[str, ...]
    units: tuple[str, ...]
    readings: Array | None
    predicted: Array
    residual: Array
    weighting: Weighting
    parts: Sequence[Part]
    covariates: Mapping[str, NDArray]
    covariate_units: Mapping[str, str]
    is_prior: bool
    counted: NDArray[np.bool_]

    @property
    def whitened(self) -> tuple[Block, ...]:
        """Whitened residuals and derivatives."""
        kept = self.__dict__.get("_whitened")
        if kept is None:
            kept = tuple(m.apply(self.residual, self.parts) for m in self.weighting.whitening)
            if not isinstance(self.parts, Derivatives):
                self.__dict__["_whitened"] = kept
        return kept

    def source(self, free: NDArray[np.bool_]) -> Source:
        """The rows, to be evaluated piece by piece, with derivatives with respect to arguments with a free column."""
        parts = self.parts
        if isinstance(parts, Derivatives):
            return Source(parts.columns(held_too=False), self.weighting.whitening,
                          lambda rows: (self.residual[rows].T, parts.evaluate(rows, False)), parts.raw(self.residual))
        kept = [p for p in parts if free[p.columns].any()]
        return Source(tuple(p.columns for p in kept), self.weighting.whitening,
                      lambda rows: (self.residual[rows].T, [p.jacobian[rows].transpose(2, 1, 0) for p in kept]))

    @cached_property
    def size(self) -> int:
        """Number of scalar readings that take part in the estimate."""
        return int(self.counted.sum()) * self.residual.shape[1]

    @cached_property
    def objective(self) -> float:
        """v'Pv of the rows that take part."""
        blocks = (m.apply(self.residual, ()) for m in self.weighting.whitening)
        return sum(float(np.sum(b.residual[self.counted[b.rows[:, 0]]] ** 2)) for b in blocks)


@dataclass(frozen=True)
class Functions:
    """Linear functions of the columns: labels, display units, values (k,) SI and derivatives (k, size)."""

    labels: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    derivatives: Array


@dataclass(frozen=True)
class Linearisation:
    """Groups, columns, conditions and quantities of a problem at one point; analyses are functions of it.

    name: of the problem; layout; groups; conditions on the free columns; values: stored values of all unknowns;
    results: the quantities as functions; effects: the unknown of each attached effect.
    """

    name: str
    layout: Layout
    groups: tuple[Group, ...]
    conditions: Conditions
    values: Mapping[Unknown, Array]
    results: Mapping[Quantity, Functions]
    effects: Mapping[Effect, Unknown]

    @property
    def blocks(self) -> list[Block]:
        """Whitened rows of all groups."""
        return [b for g in self.groups for b in g.whitened]

    @cached_property
    def _equations(self) -> NormalEquations | None:
        """The normal equations of a large problem; a small one is factored from its rows."""
        if len(self.layout.free_columns) <= elimination.DENSE_SIZE:
            return None
        sources = [g.source(self.layout.free) for g in self.groups]
        taken = np.any(self.conditions.matrix != 0.0, axis=0)
        return NormalEquations.of(sources, pattern_of(sources, self.layout, taken))

    @cached_property
    def factor(self) -> Factor:
        """Factor of the normal equations of the free columns."""
        if self._equations is None:
            return elimination.factorise(self.blocks, self.layout, self.conditions)
        return elimination.EliminatedFactor(self._equations, self.conditions)

    def leverages(self, number: int) -> Array | None:
        """Diagonal (n, dim) of J C J' of the whitened readings of a group; None where no compiled loop goes through
        them, because they are few or correlated."""
        if not isinstance(self.factor, elimination.EliminatedFactor):
            return None
        return self.factor.leverages(self.groups[number].source(self.layout.free), number)

    @cached_property
    def pull(self) -> Array:
        """Where the residuals pull the free columns, J'r (p,)."""
        if self._equations is None:
            return pulled(self.blocks, [b.residual for b in self.blocks], self.layout)
        return self._equations.pull

    @cached_property
    def objective(self) -> float:
        """v'Pv."""
        return sum(g.objective for g in self.groups)

    @cached_property
    def dof(self) -> int:
        """Degrees of freedom: readings less the rank."""
        return sum(g.size for g in self.groups) - self.factor.rank

    def free_part(self, derivatives: Array) -> Array:
        """Derivatives (k, p) with respect to the free columns, of derivatives (k, size)."""
        return derivatives[:, self.layout.free_columns]

    def group(self, name: str) -> Group:
        """A group by name."""
        for group in self.groups:
            if group.name == name:
                return group
        raise DeclarationError(
            f"{self.name} has no group '{name}'; there are {', '.join(g.name for g in self.groups)}."
        )

    def functions(self, *what: Any) -> Functions:
        """Unknowns, selections, effects or quantities as linear functions; nothing: all quantities, else all that is
        free."""
        if not what:
            what = tuple(self.results) or tuple(
                u for u in self.layout.unknowns if self.layout.free[self.layout.span(u)].any()
            )
        pieces = [self._function(w) for w in what]
        return Functions(
            tuple(label for p in pieces for label in p.labels),
            tuple(u for p in pieces for u in p.units),
            np.concatenate([p.values for p in pieces]),
            np.concatenate([p.derivatives for p in pieces]),
        )

    def _function(self, what: Any) -> Functions:
        if isinstance(what, Functions):
            return what
        if isinstance(what, Quantity):
            return self.results[what]
        if isinstance(what, str):
            return self._named(what)
        selection = (
            what if isinstance(what, Selection) else Selection(self.effects[what] if isinstance(what, Effect) else what)
        )
        unknown, mask = selection.unknown, selection.mask().ravel()
        columns = np.flatnonzero(mask)
        derivatives = np.zeros((len(columns), self.layout.size))
        derivatives[np.arange(len(columns)), self.layout.offset[unknown] + columns] = 1.0
        labels = unknown.labels
        if unknown.kind == "vector":
            values = self.values[unknown].ravel()[columns]
        elif unknown.kind == "pose":
            values = np.concatenate([self.values[unknown][:, :3], np.zeros((unknown.count, 3))], axis=1).ravel()[
                columns
            ]
        else:
            values = np.zeros(len(columns))
        return Functions(
            tuple(labels[c] for c in columns),
            tuple(unknown.units[c % unknown.freedom] for c in columns),
            values,
            derivatives,
        )

    def _named(self, name: str) -> Functions:
        for quantity in self.results:
            if quantity.name == name:
                return self.results[quantity]
        for unknown in self.layout.unknowns:
            if unknown.name == name:
                return self._function(unknown)
            if name in unknown.labels:
                instance, part = divmod(unknown.labels.index(name), unknown.freedom)
                return self._function(Selection(unknown, np.array(instance), (part,)))
        names = [q.name for q in self.results] + [u.name for u in self.layout.unknowns]
        raise DeclarationError(f"{self.name} has no quantity or unknown '{name}'; there are {', '.join(names)}.")

    def scaled(self, factors: Mapping[str, float]) -> Linearisation:
        """The same with the standard uncertainties of named groups multiplied by factors."""
        return replace(
            self,
            groups=tuple(
                replace(g, weighting=g.weighting.scaled(factors[g.name])) if g.name in factors else g
                for g in self.groups
            ),
        )

    @cached_property
    def rows(self):  # type: ignore[no-untyped-def]
        """Whitened derivatives of all groups as a sparse matrix (N, p) over the free columns, and the residuals
        (N,)."""
        return sparse_rows(self.blocks, self.layout)

    @cached_property
    def sizes(self) -> Array:
        """Size (p,) of each free column in whitened readings, so that directions in different units compare."""
        if self._equations is None:
            derivatives, _ = self.rows
            norm = np.sqrt(np.asarray(derivatives.multiply(derivatives).sum(axis=0)).ravel())
        else:
            norm = np.sqrt(self._equations.squares)
        return np.where(norm > 0, norm, 1.0)

    def held_columns(self, columns: Sequence[int]) -> Array:
        """Whitened derivatives (N, k) with respect to held columns, rows as in `rows`."""
        position = np.full(self.layout.size, -1)
        position[np.asarray(columns, dtype=int)] = np.arange(len(columns))
        return np.concatenate([b.dense(position, len(columns)) for b in self.blocks])


def pulled(blocks: Sequence[Block], forces: Sequence[Array], layout: Layout) -> Array:
    """J' times whitened numbers (m, d) of each block, over the free columns (p,)."""
    total = np.zeros(layout.size)
    for block, force in zip(blocks, forces, strict=True):
        for part in block.parts:
            pull = (part.jacobian * force[:, :, None]).sum(axis=1)
            total += np.bincount(part.columns.ravel(), pull.ravel(), layout.size)
    return total[layout.free_columns]


def linearise(at: Any, values: Any = None) -> Linearisation:
    """Linearise a problem at an estimate, or at values for planning (readings may then be absent).

    at: an Estimate, or a Problem; values: with a Problem, {unknown: value in its declared shape} (start values else).
    Returns the Linearisation that every analysis takes.
    """
    if not isinstance(at, Problem):
        return at.fit
    system = System(at)
    stored = dict(system.layout.start())
    for what, value in (values or {}).items():
        unknown = at.select(what).unknown
        stored[unknown] = unknown.store(value)
    return linearise_system(system, stored)


def linearise_system(system: System, values: Mapping[Unknown, Array]) -> Linearisation:
    """Linearise a system at stored values."""
    layout, groups = system.layout, []
    for term, weighting in zip(system.terms, system.weightings(values), strict=True):
        observations = term.bound
        parts: Sequence[Part]
        if term.n * term.dim * sum(c.shape[1] for c in term.columns) > STORED:
            parts = lazy = Derivatives(term, values)
            predicted, columns = term.predict(values), lazy.columns()
        else:
            predicted, parts = term.derive(values, held_too=True)
            columns = tuple(p.columns for p in parts)
        counted = np.ones(term.n, dtype=bool)
        if observations.is_prior:
            counted = np.any([layout.free[c].any(axis=1) for c in columns], axis=0)
        groups.append(
            Group(
                observations.group,
                observations.rows,
                observations.components(term.dim),
                observations.units(term.dim),
                observations.readings,
                predicted,
                system.residual(term, predicted),
                weighting,
                parts if isinstance(parts, Derivatives) else tuple(parts),
                observations.covariates,
                observations.covariate_units,
                observations.is_prior,
                counted,
            )
        )
    equal, unequal, _ = system.active_conditions(values)
    matrix = np.concatenate([equal, unequal])[:, layout.free_columns]
    low, high = system.at_bounds(values)
    pins = np.flatnonzero(low | high)
    conditions = Conditions(matrix, np.zeros(len(matrix))).pinned(pins, np.zeros(len(pins)))
    results = {}
    for quantity in system.problem.quantities:
        value, derivatives = system.result(quantity, values)
        dim = value.shape[1]
        results[quantity] = Functions(
            tuple(quantity.labels(dim)), quantity.units(dim) * quantity.n, value.ravel(), derivatives
        )
    return Linearisation(
        system.problem.name,
        layout,
        tuple(groups),
        conditions,
        dict(values),
        results,
        {a.effect: a.unknown for a in system.problem.attached},
    )
