"""Trials: simulated readings of a problem and what is estimated from them, in blocks with a random stream each."""

from __future__ import annotations

from collections.abc import Sequence
from threading import Lock
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib.analyse.covariance import Considered, considered
from calib.blocks import Array
from calib.compiled import pays
from calib.errors import CalibrationError
from calib.linearisation import Linearisation, linearise_system, pulled
from calib.observations import Quantity
from calib.solve.estimate import solve
from calib.solve.unrolled import is_small, unrolled
from calib.system import System
from calib.unknown import Unknown
from calib.workflow.lanes import STEPS, Lanes, is_bounded, mix, unwrap

BLOCK = 5_000  # trials of one stream of random numbers
LANE_NUMBERS = 4_000_000  # numbers in the derivatives of one block where these are stored
SOLVED_AT_A_TIME = 20  # trials of one stream where each takes a solver of its own
FACTORED_NUMBERS = 100_000  # numbers in the derivatives of one trial from which on none are stored


class Trials(Protocol):
    """Re-estimates of one problem; block: trials of each stream, which follows from the size of the problem alone."""

    block: int

    def sample(self, seed: int, number: int, count: int) -> tuple[Array, NDArray[np.bool_]]:
        """Results (count, k) of the first trials of a block, and which of them converged; from any thread."""


def streams(seed: int, number: int) -> tuple[np.random.Generator, np.random.Generator]:
    """Random streams of a block, for the readings and for what is held; they follow from seed and number alone."""
    children = (np.random.SeedSequence(seed, spawn_key=(number, k)) for k in range(2))
    readings, held = (np.random.Generator(np.random.SFC64(child)) for child in children)
    return readings, held


def trials_of(
    system: System, fit: Linearisation, truth: dict[Unknown, Array], quantities: Sequence[Quantity], expected: int
) -> Trials:
    """Trials of a problem around values taken as the truth.

    system, fit: of the problem, linearised at the truth; quantities: results wanted; expected: number of trials.
    """
    if any(not condition.bound.is_equality for condition in system.conditions):
        return ConstrainedTrials(system, fit, truth, quantities, expected)
    bounded = any(is_bounded(u) and system.layout.free[system.layout.span(u)].any() for u in system.layout.unknowns)
    if is_small(system) and not fit.factor.defect and not bounded:
        return SmallTrials(system, fit, truth, quantities, expected)
    numbers = sum(group.size for group in fit.groups) * len(system.layout.free_columns)
    if numbers > FACTORED_NUMBERS and not (bounded or system.conditions or fit.factor.defect):
        return FactoredTrials(system, fit, truth, quantities, expected)
    return LargeTrials(system, fit, truth, quantities, expected)


def prepared(
    system: System, truth: dict[Unknown, Array], quantities: Sequence[Quantity], expected: int
) -> tuple[Trials, Linearisation]:
    """Trials of a problem around values taken as the truth, and its linearisation there; arguments as `trials_of`."""
    fit = linearise_system(system, truth)
    return trials_of(system, fit, truth, quantities, expected), fit


class SmallTrials:
    """Trials of a small problem: a whole Gauss-Newton step of a trial is one row of a row program.

    The first step is that of the linear problem, the same matrix for all trials.
    """

    block = BLOCK

    def __init__(
        self, system: System, fit: Linearisation, truth: dict[Unknown, Array], quantities: Sequence[Quantity],
        expected: int,
    ):
        self._held = considered(fit)
        self._programs = unrolled(system, truth, [g.weighting for g in fit.groups], quantities, self._held.columns)
        self._compiled = pays(len(self._programs.step), 2.0 * expected)
        if self._compiled:  # before threads ask for it
            for program in (self._programs.step, self._programs.results, self._programs.predicted):
                program.compiled  # noqa: B018
        self._size = len(system.layout.free_columns)
        errors, whitening = _drawn_and_whitened(fit)
        derivatives = fit.rows[0].toarray()
        lengths = np.linalg.norm(derivatives, axis=0)
        self._linear = np.linalg.pinv(derivatives / lengths) @ whitening / lengths[:, None]
        self._both = np.concatenate([errors, self._linear @ errors])
        held = [0.0] * len(self._held.columns)
        self._nominal = self._programs.predicted.run([*held, *self._programs.scalars], 1, compiled=False)
        self._uncounted = np.concatenate([
            np.repeat(~g.counted if g.is_prior else np.zeros(len(g.counted), bool), g.residual.shape[1])
            for g in fit.groups
        ])

    def sample(self, seed: int, number: int, count: int) -> tuple[Array, NDArray[np.bool_]]:
        """Results (count, k) of the first trials of a block, and which of them converged."""
        stream, held_stream = streams(seed, number)
        size = self._both.shape[1]
        drawn = self._both @ stream.standard_normal((count, size)).T
        readings, local = drawn[:size], drawn[size:]
        if self._held.columns:
            shift = self._predicted(held_stream, count) - self._nominal
            local += self._linear @ shift
            readings += shift
        readings += self._nominal
        local, good = self._solve(local, readings)
        programs = self._programs
        results = programs.results.run([*local, *programs.scalars], count, self._compiled)
        return results.T, good

    def _predicted(self, stream: np.random.Generator, count: int) -> Array:
        """Predictions (N, count) with the held quantities drawn; priors of what is held keep their nominal reading."""
        steps = np.linalg.cholesky(self._held.covariance) @ stream.standard_normal((count, len(self._held.columns))).T
        programs = self._programs
        seen = programs.predicted.run([*steps, *programs.scalars], count, self._compiled)
        return np.where(self._uncounted[:, None], self._nominal, seen)

    def _solve(self, local: Array, readings: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Local coordinates (p, trials) after Gauss-Newton, and which trials converged; each stops by itself."""
        good, open_ = np.zeros(local.shape[1], dtype=bool), np.arange(local.shape[1])
        found, previous = local, np.full(len(open_), np.sqrt(self._size))
        for _ in range(STEPS):
            whole = self._programs.step.run(
                [*local, *readings, *self._programs.scalars], local.shape[1], self._compiled
            )
            local, square = whole[: self._size], whole[self._size]
            remaining = np.sqrt(np.abs(square))  # of a trial that runs away it is large or not a number
            # steps shrink at least as fast as the last two did: what would come next is beyond all digits
            done = (remaining < 1e-8) | (remaining < 1e-5 * np.sqrt(previous))
            done |= (remaining < 1e-5) & (remaining > 0.3 * previous)
            if len(open_) == len(good):
                found = local
            else:
                found[:, open_] = local
            good[open_] = done | (remaining < 1e-5)
            if done.all():
                break
            if done.any():
                rest = np.flatnonzero(~done)
                local, readings, open_, remaining = local[:, rest], readings[:, rest], open_[rest], remaining[rest]
            previous = remaining
        return found, good


def _drawn_and_whitened(fit: Linearisation) -> tuple[Array, Array]:
    """Errors of all readings (N, N) by independent standard normal numbers, and whitened rows (M, N) by readings."""
    sizes = [g.residual.size for g in fit.groups]
    errors, whitened, begin = np.zeros((sum(sizes), sum(sizes))), [], 0
    for group, size in zip(fit.groups, sizes, strict=True):
        inside = slice(begin, begin + size)
        one_by_one = np.eye(size).reshape(size, *group.residual.shape, 1)
        drawn = np.empty((size, *group.residual.shape))
        for mixing in group.weighting.factors:
            drawn[:, mixing.rows] = mix(mixing, one_by_one).reshape(size, *mixing.rows.shape, group.residual.shape[1])
        errors[inside, inside] = drawn.reshape(size, size).T
        for mixing in group.weighting.whitening:
            rows = np.zeros((mixing.rows.shape[0] * mixing.matrix.shape[1], sum(sizes)))
            rows[:, inside] = mix(mixing, one_by_one).reshape(size, -1).T
            whitened.append(rows)
        begin += size
    return errors, np.concatenate(whitened)


class LargeTrials:
    """Trials of a problem of any size, with equality constraints or without; derivatives are stored block by block."""

    def __init__(
        self, system: System, fit: Linearisation, truth: dict[Unknown, Array], quantities: Sequence[Quantity],
        expected: int,
    ):
        self._system, self._fit, self._truth, self._quantities = system, fit, truth, quantities
        self._lanes = Lanes(system, [g.weighting for g in fit.groups], expected)
        numbers = sum(g.residual.size for g in fit.groups) * max(self._lanes.size, 1)
        self.block = max(1, min(BLOCK, LANE_NUMBERS // max(1, numbers)))
        self._held: Considered = considered(fit)

    def sample(self, seed: int, number: int, count: int) -> tuple[Array, NDArray[np.bool_]]:
        """Results (count, k) of the first trials of a block, and which of them converged."""
        readings = self._draw(*streams(seed, number), count)
        values, good = self._lanes.solve(self._truth, readings, count)
        return self._lanes.functions(self._quantities, values, count), good

    def _draw(self, stream: np.random.Generator, held_stream: np.random.Generator, count: int) -> list[Array]:
        """Readings (count, n, dim) of every group; they see held quantities drawn from their priors, the estimation
        does not."""
        layout = self._system.layout
        seen = {u: np.tile(v, (count, 1)) for u, v in self._truth.items()}
        if self._held.columns:
            root = np.linalg.cholesky(self._held.covariance)
            step = np.zeros((count, layout.size))
            step[:, list(self._held.columns)] = held_stream.standard_normal((count, len(root))) @ root.T
            for unknown in layout.unknowns:
                moved = step[:, layout.span(unknown)].reshape(count * unknown.count, unknown.freedom)
                seen[unknown] = unknown.move(seen[unknown], moved)
        readings = []
        for term, group in zip(self._system.terms, self._fit.groups, strict=True):
            predicted = self._lanes.run(term, (False,) * len(term.feeds), seen, count)
            predicted = predicted.reshape(term.dim, count, term.n).transpose(1, 2, 0)
            normal = stream.standard_normal((count, term.n, term.dim, 1))
            errors = np.empty((count, term.n, term.dim))
            for mixing in group.weighting.factors:
                errors[:, mixing.rows] = mix(mixing, normal).reshape(count, *mixing.rows.shape, term.dim)
            if group.is_prior and not group.counted.all():
                predicted = np.where(group.counted[:, None], predicted, group.predicted)
            readings.append(predicted + errors)
        return readings


class FactoredTrials(LargeTrials):
    """Trials of a problem whose derivatives fill the memory: one after the other, each with the factor of the truth.

    Trials lie so near the truth that its normal matrix leads to their solution in few more steps than their own would;
    where a trial stops, its own residuals pull nowhere.
    """

    def __init__(
        self, system: System, fit: Linearisation, truth: dict[Unknown, Array], quantities: Sequence[Quantity],
        expected: int,
    ):
        super().__init__(system, fit, truth, quantities, expected)
        self.block = max(1, min(100, LANE_NUMBERS // max(1, sum(g.residual.size for g in fit.groups))))

    def sample(self, seed: int, number: int, count: int) -> tuple[Array, NDArray[np.bool_]]:
        """Results (count, k) of the first trials of a block, and which of them converged."""
        readings, results, good = self._draw(*streams(seed, number), count), [], np.zeros(count, dtype=bool)
        for trial in range(count):
            values, good[trial] = self._solved([reading[trial] for reading in readings])
            results.append(self._lanes.functions(self._quantities, values, 1)[0])
        return np.array(results), good

    def _solved(self, readings: Sequence[Array]) -> tuple[dict[Unknown, Array], bool]:
        layout, values = self._system.layout, self._truth
        full, remaining = np.zeros(layout.size), np.inf
        for _ in range(STEPS):
            blocks = []
            for term, group, reading in zip(self._system.terms, self._fit.groups, readings, strict=True):
                predicted, parts = term.derive(values)
                residual = reading - predicted
                unwrap(term, residual)
                blocks += [mixing.apply(residual, parts) for mixing in group.weighting.whitening]
            pull = pulled(blocks, [block.residual for block in blocks], layout)
            step = self._fit.factor.solve(pull[:, None])[:, 0]
            previous, remaining = remaining, float(np.sqrt(max(0.0, float(pull @ step))))
            full[layout.free_columns] = step
            values = layout.move(values, full)
            if remaining < 1e-8 or 0.3 * previous < remaining < 1e-5 or not np.isfinite(remaining):
                break
        return values, remaining < 1e-5


class ConstrainedTrials(LargeTrials):
    """Trials of a problem with inequalities: each is solved for itself by the interior-point method, slowly."""

    def __init__(
        self, system: System, fit: Linearisation, truth: dict[Unknown, Array], quantities: Sequence[Quantity],
        expected: int,
    ):
        super().__init__(system, fit, truth, quantities, expected)
        self.block = SOLVED_AT_A_TIME
        self._alone = Lock()      # the solver's expressions belong to one thread at a time

    def sample(self, seed: int, number: int, count: int) -> tuple[Array, NDArray[np.bool_]]:
        """Results (count, k) of the first trials of a block, and which of them converged."""
        from calib.solve.ipopt import Ipopt

        readings, results, good = self._draw(*streams(seed, number), count), [], np.zeros(count, dtype=bool)
        method, start = Ipopt(), {u: u.show(value) for u, value in self._truth.items()}
        for trial in range(count):
            drawn = {term.bound.group: reading[trial] for term, reading in
                     zip(self._system.terms, readings, strict=True)}
            values = self._truth
            try:
                with self._alone:
                    estimate = solve(self._system.problem.with_readings(drawn), method, start)
                values, good[trial] = dict(estimate.values), estimate.converged
            except CalibrationError:      # it has no solution; it is counted
                pass
            results.append(self._lanes.functions(self._quantities, values, 1)[0])
        return np.array(results), good
