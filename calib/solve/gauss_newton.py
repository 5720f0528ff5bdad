"""Gauss-Newton with Levenberg-Marquardt damping, equality constraints by their null space, and simple bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array
from calib.elimination import Conditions, DenseFactor, Factor, factorise
from calib.observations import Constraint
from calib.solve.method import Method, Outcome, missing_readings
from calib.system import System, Values
from calib.uncertainty import Weighting
from calib.unknown import Unknown


@dataclass(frozen=True)
class GaussNewton(Method):
    """The method for least squares: quadratic near the answer, damped far from it.

    Where it becomes slow, because residuals or multipliers are large and the model is curved, it takes Newton steps with
    the exact Hessian.

    tolerance: the remaining step, in units of u, at which it stops; iterations: how many steps at most.
    """

    tolerance: float = 1e-11
    iterations: int = 200
    name = "gauss-newton"

    def refusal(self, system: System) -> str | None:
        for term in system.conditions:
            assert isinstance(term.bound, Constraint)
            if not term.bound.is_equality:
                return f"constraint '{term.bound.name}' is an inequality; use Ipopt()"
        return missing_readings(system.problem)

    def minimise(self, system: System, start: Values) -> Outcome:
        layout, values = system.layout, dict(start)
        values = _into_bounds(system, values)
        weightings = system.weightings(values)
        damping, penalty, last, message = 0.0, 0.0, np.inf, "stopped at the limit of iterations"
        size = np.linalg.norm(np.concatenate([(t.predict(values) / w.u).ravel()
                                              for t, w in zip(system.terms, weightings, strict=True)]))
        floor = 8 * np.finfo(float).eps * float(size)      # rounding of the predictions, in units of u
        for iteration in range(1, self.iterations + 1):
            blocks = system.blocks(values, weightings)
            excess, matrix, tolerance = system.equalities(values)
            conditions = Conditions(matrix[:, layout.free_columns], -excess)
            gradient = _gradient(blocks, layout.position, len(layout.free_columns))
            pins, room = _active(system, values, gradient)
            conditions = conditions.pinned(pins, np.zeros(len(pins)))
            objective = sum(float(np.vdot(b.residual, b.residual)) for b in blocks)
            infeasible = float(np.abs(excess / tolerance).sum()) if len(excess) else 0.0
            undamped = factorise(blocks, layout, conditions)
            remaining = undamped.decrement
            if infeasible <= 1e-3 and (remaining <= max(self.tolerance, floor)
                                       or (remaining <= 1e-6 and remaining >= 0.5 * last and damping == 0.0)):
                values = self._moved(system, values, undamped.step, room)
                return Outcome(values, True, iteration, "converged")
            slow, last, accepted = remaining > 0.3 * last, remaining, False
            for attempt in range(40):
                newton = _newton_step(system, values, weightings, undamped, gradient, conditions) if slow and not attempt else None
                factor = undamped if damping == 0.0 or newton is not None else factorise(blocks, layout, conditions, damping)
                trial = self._moved(system, values, factor.step if newton is None else newton, room)
                gain, new_infeasible = self._merit(system, trial, weightings)
                penalty = max(penalty, 2 * abs(gain - objective) / infeasible if infeasible > 1e-3 and np.isfinite(gain) else 0.0)
                # A full step of a hundredth of u is right; what v'Pv says about it is lost in the rounding of the readings.
                slack = (1e-6 if remaining <= 1e-2 else 1e-10) * max(1.0, objective)
                if gain + penalty * new_infeasible <= objective + penalty * infeasible + slack:
                    accepted = True
                    break
                damping = max(10 * damping, 1e-4) if newton is None else damping
            if not accepted:
                message = "no step lowers the objective; the start may be far away or the model not smooth there"
                break
            values = trial
            damping = damping / 10 if damping > 1e-6 else 0.0
        return Outcome(values, False, iteration, _contradiction(system, values) or message)

    @staticmethod
    def _moved(system: System, values: Values, step: Array, room: tuple[Array, Array]) -> dict[Unknown, Array]:
        layout = system.layout
        full = np.zeros(layout.size)
        full[layout.free_columns] = np.clip(step, room[0], room[1])
        return layout.move(values, full)

    @staticmethod
    def _merit(system: System, values: Values, weightings) -> tuple[float, float]:  # type: ignore[no-untyped-def]
        from calib.errors import CalibrationError
        try:
            whitened = system.whitened(values, weightings)
        except CalibrationError:
            return np.inf, np.inf
        excess, _, tolerance = system.equalities(values)
        return float(whitened @ whitened), float(np.abs(excess / tolerance).sum()) if len(excess) else 0.0


def _gradient(blocks, position: NDArray[np.int64], size: int) -> Array:  # type: ignore[no-untyped-def]
    """Derivative of half the objective with respect to the free columns (p,), negated: where it pulls."""
    pull = np.zeros(size + 1)
    for block in blocks:
        for part in block.parts:
            np.add.at(pull, position[part.columns].ravel(), np.einsum("mdf,md->mf", part.jacobian, block.residual).ravel())
    return pull[:size]


def _newton_step(system: System, values: Values, weightings: Sequence[Weighting], factor: Factor, pull: Array,
                 conditions: Conditions) -> Array | None:
    """Step (p,) with the exact Hessian, or None where there are too many unknowns or it does not curve upwards."""
    if not isinstance(factor, DenseFactor):
        return None
    multipliers = np.linalg.lstsq(conditions.matrix.T, pull, rcond=None)[0] if len(conditions.target) else np.zeros(0)
    second = system.second_order(values, weightings, multipliers)
    hessian = np.eye(factor.rank) + factor.root.T @ second @ factor.root
    lengths, axes = np.linalg.eigh(hessian)
    if not len(lengths) or lengths[0] <= 1e-3:
        return None
    inner = axes @ ((axes.T @ (factor.pull - factor.root.T @ (second @ factor.particular))) / lengths)
    return factor.particular + factor.root @ inner


def _contradiction(system: System, values: Values) -> str | None:
    """A sentence naming the constraint that is missed most, where the constraints cannot all be met."""
    worst = [(float(np.abs(t.predict(values) - t.bound.lower).max() / t.bound.tolerance), t.bound.name) for t in system.conditions]
    missed = max(worst, default=(0.0, ""))
    return (f"the constraints contradict each other or cannot be reached: '{missed[1]}' is missed by {missed[0]:.3g} times its "
            "tolerance; check the constraints, or start nearer" if missed[0] > 1.0 else None)


def _into_bounds(system: System, values: dict[Unknown, Array]) -> dict[Unknown, Array]:
    return {u: np.clip(v, u.lower, u.upper) if u.kind == "vector" else v for u, v in values.items()}


def _active(system: System, values: Values, pull: Array) -> tuple[NDArray[np.int64], tuple[Array, Array]]:
    """Free columns that sit at a bound and are pulled against it, and the room of every free column."""
    lower, upper = (b[system.layout.free_columns] for b in system.layout.bounds(values))
    pins = np.flatnonzero(((lower >= 0) & (pull < 0)) | ((upper <= 0) & (pull > 0)))
    return pins, (lower, upper)
