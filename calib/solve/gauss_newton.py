"""Gauss-Newton with Levenberg-Marquardt damping, equality constraints by their null space, and simple bounds."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib import elimination
from calib.blocks import Array, Block
from calib.elimination import EliminatedFactor, Factor, factorise
from calib.errors import ModelBreakdown
from calib.factor import Conditions, DenseFactor
from calib.layout import Layout
from calib.normal import NormalEquations
from calib.pattern import pattern_of
from calib.solve.method import Method, Outcome, missing_readings
from calib.solve.projection import affine_columns, projected
from calib.system import System, Values
from calib.uncertainty import Weighting
from calib.unknown import Unknown

LARGEST_DAMPING = 1e25  # in units of the diagonal of J'J; no step is short enough to lower the objective then


@dataclass(frozen=True)
class GaussNewton(Method):
    """The method for least squares: quadratic near the answer, damped far from it.

    Where it becomes slow, because residuals or multipliers are large and the model is curved, it takes Newton steps
    with the exact Hessian.

    tolerance: the remaining step, in units of u, at which it stops; iterations: how many steps at most.
    """

    tolerance: float = 1e-11
    iterations: int = 1000
    name = "gauss-newton"

    def refusal(self, system: System) -> str | None:
        for term in system.conditions:
            if not term.bound.is_equality:
                return f"constraint '{term.bound.name}' is an inequality; use Ipopt()"
        return missing_readings(system.problem)

    def minimise(self, system: System, start: Values) -> Outcome:
        values = _into_bounds(system, dict(start))
        weightings = system.weightings(values)
        here = _Point.at(system, values, weightings)
        if not np.isfinite(here.objective):
            system.blocks(values, weightings)  # raises the sentence that names row and model
        outcome, faded = self._descend(system, here, weightings, np.zeros(0, dtype=np.int64), 0.0)
        large = len(system.layout.free_columns) > elimination.DENSE_SIZE
        if (outcome.converged and not faded) or system.conditions or large:
            return outcome
        # A far start: once more from there with short steps, what is affine always at its best.
        affine = affine_columns(system)
        near = _Point.at(system, projected(system, values, weightings, affine), weightings)
        begin, iterations = near if near.objective < here.objective else here, outcome.iterations
        for damping in (1.0, 1e3, 1e6):
            again, faded = self._descend(system, begin, weightings, np.flatnonzero(affine), damping)
            iterations += again.iterations
            if again.converged:  # a direction that no reading sees stays unseen
                return outcome if faded else replace(again, iterations=iterations)
        return outcome

    def _descend(self, system: System, here: _Point, weightings: Sequence[Weighting], affine: NDArray[np.int64],
                 damping: float) -> tuple[Outcome, bool]:
        """Go down from a point; and whether a direction is seen by no reading where it ended.

        affine: free columns that are set to their best after each step and not damped; damping: to begin with.
        """
        layout, growth, penalty, last = system.layout, 2.0, 0.0, float("inf")
        lengths, slow, left = here.squares, 0, None
        message = "stopped at the limit of iterations"
        for iteration in range(1, self.iterations + 1):
            lengths = np.maximum(lengths, here.squares)  # as MINPACK: a column that fades does not lose its damping
            lengths[affine] = 0.0
            pins, room = _active(system, here.values, here.pull)
            conditions = here.conditions.pinned(pins, np.zeros(len(pins)))
            undamped = here.factor(layout, conditions)
            remaining = undamped.decrement
            # at a standstill, or where the next step would be too small by the rate of the last
            still = remaining >= 0.5 * last or (remaining <= 1e-6 and remaining**2 <= self.tolerance * last)
            if here.infeasible <= 1e-3 and (
                remaining <= self.tolerance
                or (still and damping == 0.0
                    and (remaining <= 1e-6 or remaining <= system.rounding(here.values, weightings)))
            ):
                arrived = _moved(layout, here.values, undamped.step, room)
                if system.active_conditions(arrived)[2] <= 1.0:  # a bent condition may be left by the last step
                    return Outcome(arrived, True, iteration, "converged"), undamped.defect > 0
            slow, last = slow + 1 if remaining > 0.3 * last else 0, remaining
            multipliers = (
                np.linalg.lstsq(conditions.matrix.T, here.pull, rcond=None)[0]
                if len(conditions.target)
                else np.zeros(0)
            )
            forces = multipliers[: len(here.tolerance)] * here.tolerance
            penalty = max(penalty, 3.0 * float(np.abs(forces).max(initial=0.0)))
            second = None
            if slow and isinstance(undamped, DenseFactor) and undamped.rank:
                weighed = [w.weigh(r) for w, r in zip(weightings, system.residuals(here.values), strict=True)]
                second = system.second_order(here.values, weighed, multipliers)
            while damping < LARGEST_DAMPING:
                step = None
                if second is not None and isinstance(undamped, DenseFactor):
                    step = _newton_step(second, undamped, damping * lengths)
                bent = 0.0 if second is None or step is None else float(step @ second @ step)
                if step is None:
                    step = (
                        undamped.step
                        if damping == 0.0
                        else here.factor(layout, conditions, damping * lengths).step
                    )
                there = _Point.moved(system, here.values, step, room, weightings, affine, left)
                promised = here.promised(layout, step) + penalty * here.infeasible - bent
                gained = here.objective - there.objective + penalty * (here.infeasible - there.infeasible)
                ratio = gained / promised if promised > 0 else -1.0
                # A full step of a hundredth of u is right; what v'Pv says about it is lost in the rounding of the
                # readings.
                small = remaining <= 1e-2 and gained >= -1e-6 * max(1.0, here.objective)
                nearer = here.infeasible > 1.0 and there.infeasible <= 0.5 * here.infeasible
                if small or nearer or ratio > (1e-4 if damping else 0.1):
                    break
                damping, growth, left = max(growth * damping, 1e-3), 2 * growth, there
            else:
                message = "no step lowers the objective; the start may be far away or the model not smooth there"
                break
            here, growth, left = there, 2.0, here
            damping *= max(1 / 5, 1 - (2 * min(max(ratio, 0.0), 1.0) - 1) ** 3)
            damping = damping if damping > 1e-9 and remaining > 1e-2 else 0.0
        return Outcome(here.values, False, iteration, _contradiction(system, here.values) or message), False


@dataclass(frozen=True)
class _Point:
    """A system evaluated at values: whitened rows, or the normal equations of a large problem, J'r and the diagonal of
    J'J over the free columns, and conditions.

    objective: v'Pv; infeasible: sum of the excesses in units of their tolerances; both infinite where the model breaks
    down.
    """

    values: dict[Unknown, Array]
    rows: list[Block] | NormalEquations
    pull: Array
    squares: Array
    conditions: Conditions
    tolerance: Array
    objective: float
    infeasible: float

    @staticmethod
    def at(system: System, values: dict[Unknown, Array], weightings: Sequence[Weighting], left: _Point | None = None
           ) -> _Point:
        """The point at values; left: one that is of no more use, whose memory it takes over."""
        free, nothing = system.layout.free_columns, np.zeros(0)
        excess, matrix, tolerance = system.equalities(values)
        conditions = Conditions(matrix[:, free], -excess)
        rows: list[Block] | NormalEquations
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                if len(free) > elimination.DENSE_SIZE:
                    low, high = system.at_bounds(values)
                    taken = np.any(conditions.matrix != 0.0, axis=0) | low | high
                    sources = system.sources(values, weightings)
                    rows = NormalEquations.of(sources, pattern_of(sources, system.layout, taken), left and left.rows)
                    pull, squares, objective = rows.pull, rows.squares, rows.objective
                else:
                    rows = system.blocks(values, weightings)
                    pull, squares = _gradient(rows, system.layout.position, len(free))
                    objective = sum(float(np.vdot(b.residual, b.residual)) for b in rows)
        except ModelBreakdown:
            return _Point(values, [], nothing, nothing, Conditions.none(len(free)), nothing, np.inf, np.inf)
        sound = np.isfinite(objective) and np.isfinite(squares).all()
        return _Point(
            values,
            rows,
            pull,
            squares,
            conditions,
            tolerance,
            objective if sound else np.inf,
            float(np.abs(excess / tolerance).sum()),
        )

    @staticmethod
    def moved(system: System, values: Values, step: Array, room: tuple[Array, Array],
              weightings: Sequence[Weighting], affine: NDArray[np.int64], left: _Point | None) -> _Point:
        """The point a step (p,) away, with affine free columns at their best; left: as `at`."""
        there = _moved(system.layout, values, step, room)
        if len(affine):
            columns = np.zeros(len(step), dtype=bool)
            columns[affine] = True
            with suppress(ModelBreakdown):
                there = projected(system, there, weightings, columns)
        return _Point.at(system, there, weightings, left)

    def factor(self, layout: Layout, conditions: Conditions, damping: Array | None = None) -> Factor:
        """Factor of the normal equations within conditions; damping (p,) is added to their diagonal."""
        if isinstance(self.rows, NormalEquations):
            return EliminatedFactor(self.rows, conditions, damping)
        return factorise(self.rows, layout, conditions, damping)

    def promised(self, layout: Layout, step: Array) -> float:
        """By how much v'Pv would fall over a step (p,) if the model were straight."""
        if isinstance(self.rows, NormalEquations):
            return 2.0 * float(step @ self.pull) - self.rows.along(step)
        full = np.zeros(layout.size)
        full[layout.free_columns] = step
        changes = [(b.residual, b.times(full)) for b in self.rows]
        return float(sum(np.vdot(c, 2 * r - c) for r, c in changes))


def _moved(layout: Layout, values: Values, step: Array, room: tuple[Array, Array]) -> dict[Unknown, Array]:
    full = np.zeros(layout.size)
    full[layout.free_columns] = np.clip(step, room[0], room[1])
    return layout.move(values, full)


def _gradient(blocks: Sequence[Block], position: NDArray[np.int64], size: int) -> tuple[Array, Array]:
    """Where the residuals pull the free columns, J'r (p,), and the diagonal of J'J (p,)."""
    pull, squares = np.zeros(size + 1), np.zeros(size + 1)  # the last place takes what is held
    for block in blocks:
        for part in block.parts:
            place = position[part.columns].ravel()
            pull += np.bincount(
                np.where(place < 0, size, place),
                np.einsum("mdf,md->mf", part.jacobian, block.residual).ravel(),
                size + 1,
            )
            squares += np.bincount(np.where(place < 0, size, place), (part.jacobian**2).sum(axis=1).ravel(), size + 1)
    return pull[:size], squares[:size]


def _newton_step(second: Array, factor: DenseFactor, damping: Array) -> Array | None:
    """Damped step (p,) with the exact Hessian, or None where that does not curve upwards."""
    added = second + np.diag(damping)
    with np.errstate(over="ignore", invalid="ignore"):
        hessian = np.eye(factor.rank) + factor.root.T @ added @ factor.root
    if not np.isfinite(hessian).all():
        return None
    lengths, axes = np.linalg.eigh(hessian)
    if lengths[0] <= 1e-6:
        return None
    inner = axes @ ((axes.T @ (factor.pull - factor.root.T @ (added @ factor.particular))) / lengths)
    return factor.particular + factor.root @ inner


def _contradiction(system: System, values: Values) -> str | None:
    """A sentence naming the constraint that is missed most, where the constraints cannot all be met."""
    worst = [
        (float(np.abs(t.predict(values) - t.bound.lower).max() / t.bound.tolerance), t.bound.name)
        for t in system.conditions
    ]
    missed = max(worst, default=(0.0, ""))
    return (
        f"the constraints contradict each other or cannot be reached: '{missed[1]}' is missed by {missed[0]:.3g} times "
        "its tolerance; check the constraints, or start nearer"
        if missed[0] > 1.0
        else None
    )


def _into_bounds(system: System, values: dict[Unknown, Array]) -> dict[Unknown, Array]:
    return {u: np.clip(v, u.lower, u.upper) if u.kind == "vector" else v for u, v in values.items()}


def _active(system: System, values: Values, pull: Array) -> tuple[NDArray[np.int64], tuple[Array, Array]]:
    """Free columns that sit at a bound and are pulled against it, and the room of every free column."""
    lower, upper = (b[system.layout.free_columns] for b in system.layout.bounds(values))
    pins = np.flatnonzero(((lower >= 0) & (pull < 0)) | ((upper <= 0) & (pull > 0)))
    return pins, (lower, upper)
