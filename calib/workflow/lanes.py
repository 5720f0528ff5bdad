"""Trials in lanes: all trials of a batch re-solved side by side, for any problem whose constraints are equalities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array, Mixing
from calib.compiled import pays
from calib.observations import Observations, Quantity
from calib.system import System, Term
from calib.uncertainty import Weighting
from calib.unknown import Unknown

STEPS = 25  # Gauss-Newton steps at most; trials start at the truth, so that three are usual


class Lanes:
    """A system whose trials run side by side: every unknown has one set of instances for each trial."""

    def __init__(self, system: System, weightings: Sequence[Weighting], expected: int):
        self.system, self.weightings, self._expected = system, weightings, expected
        self.size = len(system.layout.free_columns)
        self._bounded = [u for u in system.layout.unknowns if is_bounded(u)]

    def run(self, term: Term, wanted: tuple[bool, ...], values: dict[Unknown, Array], trials: int) -> Array:
        """Outputs (outputs, trials n) of a row function, compiled where all the trials together repay it."""
        program = term.traced.program(wanted)
        compiled = pays(len(program), 3.0 * self._expected * term.n)
        return program.run(self.inputs(term, values, trials), trials * term.n, compiled)

    def inputs(self, term: Term, values: dict[Unknown, Array], trials: int) -> list[Any]:
        """Input columns of a term for all trials, trial by trial."""
        columns: list[Any] = []
        for feed in term.feeds:
            if feed.unknown is None:
                data = np.broadcast_to(feed.data, (term.n, feed.data.shape[1])) if len(feed.data) > 1 else feed.data
                columns += [c[0] if len(c) == 1 else np.tile(c, trials) for c in data.T]
            else:
                gathered = values[feed.unknown].reshape(trials, feed.unknown.count, -1)[:, feed.index]
                columns += list(np.ascontiguousarray(gathered.reshape(trials * term.n, -1).T))
        return columns

    def derived(self, term: Term[Any], values: dict[Unknown, Array], trials: int) -> tuple[Array, Array]:
        """Predictions (trials, n, dim) of a term and their derivatives (trials, n, dim, p)."""
        result = self.run(term, term.any_free, values, trials)
        matrix, begin = np.zeros((trials, term.n, term.dim, self.size)), term.dim
        for columns, source, want in zip(term.columns, term.traced.sources, term.any_free, strict=True):
            if want:
                end = begin + term.dim * source.freedom
                piece = result[begin:end].reshape(source.freedom, term.dim, trials, term.n)
                _scatter(matrix, piece, self.system.layout.position[columns])
                begin = end
        return result[: term.dim].reshape(term.dim, trials, term.n).transpose(1, 2, 0), matrix

    def rows(self, values: dict[Unknown, Array], readings: Sequence[Array], trials: int) -> tuple[Array, Array]:
        """Whitened residuals (trials, N) and derivatives (trials, N, p)."""
        residuals, matrices = [], []
        for term, weighting, reading in zip(self.system.terms, self.weightings, readings, strict=True):
            predicted, matrix = self.derived(term, values, trials)
            residual = reading - predicted
            unwrap(term, residual)
            for mixing in weighting.whitening:
                residuals.append(mix(mixing, residual[..., None]).reshape(trials, -1))
                matrices.append(mix(mixing, matrix).reshape(trials, -1, self.size))
        return np.concatenate(residuals, axis=1), np.concatenate(matrices, axis=1)

    def conditions(self, values: dict[Unknown, Array], trials: int) -> tuple[Array, Array]:
        """Excess (trials, m) and derivatives (trials, m, p) of the equality constraints."""
        excess, matrices = [np.zeros((trials, 0))], [np.zeros((trials, 0, self.size))]
        for term in self.system.conditions:
            value, matrix = self.derived(term, values, trials)
            excess.append((value - term.bound.lower).reshape(trials, -1))
            matrices.append(matrix.reshape(trials, -1, self.size))
        return np.concatenate(excess, axis=1), np.concatenate(matrices, axis=1)

    def solve(
        self, start: dict[Unknown, Array], readings: Sequence[Array], trials: int
    ) -> tuple[dict[Unknown, Array], NDArray[np.bool_]]:
        """Stored values (trials count, width) of all unknowns after Gauss-Newton, and which trials converged.

        A trial that comes to a bound goes on along it, and leaves it where its readings pull away (projected steps;
        Bertsekas, 1982, SIAM J. Control and Optimization 20).
        """
        layout = self.system.layout
        values = {u: np.tile(v, (trials, 1)) for u, v in start.items()}
        remaining = np.full(trials, np.inf)
        for _ in range(STEPS):
            residual, matrix = self.rows(values, readings, trials)
            scale = np.sqrt(np.einsum("tni,tni->ti", matrix, matrix))
            matrix /= np.where(scale > 0, scale, 1.0)[:, None, :]
            excess, conditions = self.conditions(values, trials)
            conditions = conditions / scale[:, None, :]
            m = excess.shape[1]
            saddle = np.zeros((trials, self.size + m, self.size + m))
            saddle[:, : self.size, : self.size] = matrix.transpose(0, 2, 1) @ matrix
            saddle[:, self.size :, : self.size] = conditions
            saddle[:, : self.size, self.size :] = conditions.transpose(0, 2, 1)
            pull = (matrix.transpose(0, 2, 1) @ residual[..., None])[..., 0]
            right = np.concatenate([pull, -excess], axis=1)
            low, high = self._room(values, trials)
            if self._bounded:
                trial, column = np.nonzero(((low >= 0) & (pull < 0)) | ((high <= 0) & (pull > 0)))
                saddle[trial, column], saddle[trial, :, column] = 0.0, 0.0
                saddle[trial, column, column], right[trial, column] = 1.0, 0.0
            step = np.linalg.solve(saddle, right[..., None])[:, : self.size, 0]
            previous, remaining = remaining, np.linalg.norm((matrix @ step[..., None])[..., 0], axis=1)
            step = np.clip(step / scale, low, high) if self._bounded else step / scale
            full = np.zeros((trials, layout.size))
            full[:, layout.free_columns] = step
            for unknown in layout.unknowns:
                moved = full[:, layout.span(unknown)].reshape(trials * unknown.count, unknown.freedom)
                values[unknown] = unknown.move(values[unknown], moved)
            for unknown in self._bounded:  # exactly there, so that the next step sees it
                least, most = (np.tile(limit, (trials, 1)) for limit in (unknown.lower, unknown.upper))
                held = np.tile(~layout.free[layout.span(unknown)].reshape(unknown.count, -1), (trials, 1))
                values[unknown] = np.where(held, values[unknown], np.clip(values[unknown], least, most))
            if np.all((remaining < 1e-8) | ((remaining < 1e-5) & (remaining > 0.3 * previous))):
                break
        return values, remaining < 1e-5

    def _room(self, values: dict[Unknown, Array], trials: int) -> tuple[Array, Array]:
        """Room (trials, p) of the free columns down to the lower and up to the upper bound."""
        layout = self.system.layout
        low, high = np.full((trials, layout.size), -np.inf), np.full((trials, layout.size), np.inf)
        for unknown in self._bounded:
            here = values[unknown].reshape(trials, unknown.count, unknown.freedom)
            low[:, layout.span(unknown)] = (unknown.lower - here).reshape(trials, -1)
            high[:, layout.span(unknown)] = (unknown.upper - here).reshape(trials, -1)
        return low[:, layout.free_columns], high[:, layout.free_columns]

    def functions(self, quantities: Sequence[Quantity], values: dict[Unknown, Array], trials: int) -> Array:
        """Values (trials, k) of quantities."""
        pieces = []
        for quantity in quantities:
            term = self.system.results.get(quantity) or self.system.plain(quantity)
            result = self.run(term, (False,) * len(term.feeds), values, trials)
            pieces.append(result.reshape(term.dim, trials, term.n).transpose(1, 2, 0).reshape(trials, -1))
        return np.concatenate(pieces, axis=1)


def is_bounded(unknown: Unknown) -> bool:
    """Whether an unknown has a finite bound."""
    return unknown.kind == "vector" and bool(np.isfinite(unknown.lower).any() or np.isfinite(unknown.upper).any())


def unwrap(term: Term[Observations], residual: Array) -> None:
    """Take whole periods out of residuals (..., dim) of periodic readings, in place."""
    period = term.bound.period
    if period is not None:
        for j, each in enumerate([period] * term.dim if np.ndim(period) == 0 else period):
            if each is not None:
                residual[..., j] -= each * np.rint(residual[..., j] / each)


def _scatter(matrix: Array, piece: Array, places: NDArray[np.int64]) -> None:
    """Add derivatives (f, dim, trials, n) into (trials, n, dim, p) at the places (n, f)."""
    for f in range(len(piece)):
        rows = np.flatnonzero(places[:, f] >= 0)
        matrix[:, rows, :, places[rows, f]] += piece[f][:, :, rows].transpose(2, 1, 0)


def mix(mixing: Mixing, array: Array) -> Array:
    """Apply row operations to (trials, n, dim, k): (trials, m, d, k)."""
    if mixing.matrix.ndim == 2:
        return mixing.matrix[None, :, :, None] * array[:, mixing.rows[:, 0]]
    trials, _, dim, k = array.shape
    source = array[:, mixing.rows].reshape(trials, len(mixing.rows), mixing.rows.shape[1] * dim, k)
    return mixing.matrix[None] @ source
