"""Affine problems as convex programs: least squares, Huber, L1 and minimum zone, each with a proven gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calib.blocks import Array
from calib.errors import CalibrationError, MethodRefusal
from calib.layout import Layout
from calib.normal import sparse_rows
from calib.solve.affine import Limits, not_affine, within
from calib.solve.limits import WRONG, set_to_bounds
from calib.solve.loss import L1, Huber, LeastSquares, Loss, MinimumZone
from calib.solve.method import Method, Outcome, missing_readings
from calib.system import System, Term, Values
from calib.uncertainty import Weighting

__all__ = ["L1", "Convex", "Huber", "LeastSquares", "Loss", "MinimumZone"]

LARGEST = 50_000_000      # readings times unknowns that are still worked on as one dense matrix
TIGHT = 1e-11             # of Clarabel: gap and feasibility
CROSSED = 1e-12           # how far, in conditional standard uncertainties, rounding may carry beyond a limit
WORST = 1e-9              # relative loss that refining may add by rounding


@dataclass(frozen=True)
class Convex(Method):
    """The method for problems that are affine in what is free: no start value matters and the gap proves the answer.

    loss: LeastSquares(), Huber(threshold), L1() or MinimumZone(), of residuals in units of u. Affine constraints and
    bounds are kept. It is found from the declaration whether a problem is affine.
    """

    loss: Loss = field(default_factory=LeastSquares)
    name = "convex"

    @property
    def least_squares(self) -> bool:     # type: ignore[override]
        return isinstance(self.loss, LeastSquares)

    def refusal(self, system: System) -> str | None:
        terms: list[Term[Any]] = [*system.terms, *system.conditions]
        for term in terms:
            why = not_affine(term, system.layout)
            if why is not None:
                return f"{why}; use GaussNewton() or Ipopt()"
        if self.loss.separates_correlated:
            start = system.layout.start()
            for term, weighting in zip(system.terms, system.weightings(start), strict=True):
                mixed = [m.matrix for m in weighting.whitening if m.matrix.ndim == 3]
                if any(np.count_nonzero(matrix, axis=2).max() > 1 for matrix in mixed):
                    return (f"{term.bound.what} '{term.bound.name}' have correlated errors, for which "
                            f"{type(self.loss).__name__} has no single meaning; use LeastSquares()")
        return missing_readings(system.problem)

    def minimise(self, system: System, start: Values) -> Outcome:
        layout, weightings = system.layout, system.weightings(start)
        matrix, residual = sparse_rows(system.blocks(start, weightings), layout)
        if matrix.shape[0] * matrix.shape[1] > LARGEST:
            raise MethodRefusal(f"convex does not accept {system.problem.name}: {matrix.shape[0]} readings of "
                                f"{matrix.shape[1]} unknowns are too many for one matrix; use GaussNewton()")
        norm = np.sqrt(np.asarray(matrix.multiply(matrix).sum(axis=0)).ravel())
        scale = 1.0 / np.where(norm > 0, norm, 1.0)
        derivatives = matrix.toarray() * scale
        limits = Limits.of(system, start, scale)
        centre = np.linalg.lstsq(derivatives, residual, rcond=None)[0]
        away = residual - derivatives @ centre
        step, active, status, iterations = self._solved(derivatives, away, limits.moved(centre))
        x = centre + step
        values = _moved(layout, start, x * scale)
        there = _whitened_as_predicted(system, values, weightings, residual - derivatives @ x, residual)
        refined = self._refined(derivatives, there, limits.moved(x), active)
        if refined is not None:
            values = set_to_bounds(layout, _moved(layout, values, refined[0] * scale), limits.side(refined[1]))
            there = system.whitened(values, weightings)
        gap, unique = self._gap(derivatives, there, Limits.of(system, values, scale))
        message = f"converged: {status}" if status == "optimal" or gap <= WORST else f"Clarabel stopped: {status}"
        if not unique:
            message += "; other answers have the same loss, and this is one of them"
        return Outcome(values, status == "optimal" or gap <= WORST, iterations, message, gap,
                       {"loss": self.loss.value(there), "unique": float(unique)})

    def _solved(self, derivatives: Array, residual: Array, limits: Limits) -> tuple[Array, Array, str, int]:
        """Step (p,), which inequalities hold with equality, Clarabel's word and its steps."""
        import cvxpy
        x = cvxpy.Variable(derivatives.shape[1])
        unequal = [limits.above @ x <= limits.room] if len(limits.room) else []
        equal = [limits.fixed @ x == limits.target] if len(limits.target) else []
        program = cvxpy.Problem(cvxpy.Minimize(self.loss.expression(residual - derivatives @ x)), [*unequal, *equal])
        try:
            program.solve(solver=cvxpy.CLARABEL, tol_gap_abs=TIGHT, tol_gap_rel=TIGHT, tol_feas=TIGHT, max_iter=200)
        except cvxpy.SolverError as error:
            raise MethodRefusal(f"convex: Clarabel gives up ({error}); use GaussNewton() or Ipopt()") from error
        if x.value is None:
            raise CalibrationError(f"convex: the constraints and bounds contradict each other ({program.status}); "
                                   f"{limits.names}")
        step = np.asarray(x.value, float)
        slack = limits.room - limits.above @ step
        active = slack < np.asarray(unequal[0].dual_value, float).ravel() if unequal else np.zeros(0, bool)
        return step, active, str(program.status), int(program.solver_stats.num_iters or 0)

    def _refined(self, derivatives: Array, residual: Array, limits: Limits, active: Array
                 ) -> tuple[Array, Array] | None:
        """The last step (p,) to rounding that the interior point left open, and what holds then; None if no better."""
        active = active.copy()
        for _ in range(4 * len(residual)):
            conditions = np.concatenate([limits.fixed, limits.above[active]])
            onto, basis = within(conditions, np.concatenate([limits.target, limits.room[active]]))
            step = onto + basis @ self.loss.refined(derivatives @ basis, residual - derivatives @ onto)
            after = residual - derivatives @ step
            crossed = ~active & (limits.above @ step > limits.room + CROSSED)
            dual = self.loss.dual(after)
            pushes = np.zeros(0)
            if len(conditions) and not np.any(dual.low < dual.high):
                pushes = np.linalg.lstsq(conditions.T, derivatives.T @ dual.value, rcond=None)[0][len(limits.target):]
            if np.any(crossed):
                active |= crossed
            elif np.min(pushes, initial=0.0) < -WRONG:
                active[np.flatnonzero(active)[np.argmin(pushes)]] = False
            else:
                break
        before = self.loss.value(residual)
        kept = self.loss.value(after) <= before + WORST * max(before, 1.0) and not np.any(crossed)
        return (step, active) if kept else None

    def _gap(self, derivatives: Array, residual: Array, limits: Limits) -> tuple[float, bool]:
        """Relative gap to a lower bound from multipliers fitted afresh (Fenchel), and whether the answer is unique."""
        from scipy.optimize import lsq_linear
        active = limits.above[limits.room <= 1e-6]
        dual = self.loss.dual(residual)
        open_rows = np.flatnonzero(dual.low < dual.high)
        pushes = np.concatenate([derivatives[open_rows], -limits.fixed, -active]).T
        low = np.concatenate([dual.low[open_rows], np.full(len(limits.target), -np.inf), np.zeros(len(active))])
        high = np.concatenate([dual.high[open_rows], np.full(len(limits.target) + len(active), np.inf)])
        pull = derivatives.T @ dual.value
        multiplier, pressed = dual.value.copy(), np.zeros(len(active))
        if pushes.shape[1]:
            system, right = pushes, -pull
            if dual.total is not None:      # where there is a loss, magnitudes reach the total
                total = np.zeros(pushes.shape[1])
                total[:len(open_rows)] = np.sign(residual[open_rows])
                system, right = np.vstack([pushes, total]), np.append(right, dual.total)
            found = lsq_linear(system, right, (low, high), method="bvls", tol=1e-15).x
            multiplier[open_rows] = found[:len(open_rows)]
            pressed = found[len(open_rows) + len(limits.target):]
            pull = pull + pushes @ found
        if dual.total is not None:
            size = max(float(np.abs(multiplier).sum()) / dual.total, 1.0)
            multiplier, pressed, pull = multiplier / size, pressed / size, pull / size
        value = self.loss.value(residual)
        _, basis = within(limits.fixed, limits.target)
        remaining = np.linalg.lstsq((derivatives @ basis).T, basis.T @ pull, rcond=None)[0]
        slack = limits.room[limits.room <= 1e-6]
        gap = value + self.loss.conjugate(multiplier) - float(multiplier @ residual)       # of Fenchel and Young
        gap += float(pressed @ np.maximum(slack, 0.0))
        gap += float(np.linalg.norm(remaining)) * self.loss.reach(value, len(residual))
        return float(max(gap, 0.0) / max(value, 1.0)), self._is_unique(derivatives, residual, limits)

    def _is_unique(self, derivatives: Array, residual: Array, limits: Limits) -> bool:
        """Whether the residuals that hold the answer leave no direction free."""
        held = self.loss.holding(residual)
        rows = derivatives[held]
        if self.loss.dual(residual).total is not None:
            rows = np.column_stack([np.sign(residual[held])[:, None] * rows, np.ones(len(rows))])
        holds = np.concatenate([limits.fixed, limits.above[limits.room <= 1e-6]])
        holds = np.column_stack([holds, np.zeros((len(holds), rows.shape[1] - holds.shape[1]))])
        return int(np.linalg.matrix_rank(np.concatenate([rows, holds]), tol=1e-9)) == rows.shape[1]


def _moved(layout: Layout, values: Values, step: Array) -> dict[Any, Array]:
    full = np.zeros(layout.size)
    full[layout.free_columns] = step
    return set_to_bounds(layout, layout.move(values, full), np.zeros(len(step), dtype=np.int8))


def _whitened_as_predicted(system: System, values: Values, weightings: Sequence[Weighting], expected: Array,
                           before: Array) -> Array:
    """Whitened residuals at values; they must be what affine predictions give."""
    found = system.whitened(values, weightings)
    size = np.linalg.norm(np.concatenate([(t.predict(values) / w.u).ravel() for t, w in
                                          zip(system.terms, weightings, strict=True)]))
    if float(np.abs(found - expected).max()) > 1e-6 + 1e-12 * (size + float(np.abs(before).max())):
        raise MethodRefusal(f"convex does not accept {system.problem.name}: between the start values and the answer a "
                            "prediction is not affine or a periodic reading changes its period; use GaussNewton()")
    return found
