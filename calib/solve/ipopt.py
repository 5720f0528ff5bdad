"""IPOPT through CasADi: exact or Gauss-Newton Hessian, bounds, equality and inequality constraints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from calib.blocks import Array, Block
from calib.layout import Layout
from calib.observations import Constraint
from calib.solve.limits import Side, only_pinned, pinned, revised, set_to_bounds, touched
from calib.solve.method import Method, Outcome, missing_readings
from calib.solve.transcription import Transcription
from calib.system import System, Values
from calib.uncertainty import Weighting
from calib.unknown import Unknown

SEARCHES = 6          # runs with line search, each with local coordinates around the last answer
POLISHES = 40         # runs of full steps near the answer
FINISHED = ("Solve_Succeeded", "Solved_To_Acceptable_Level", "Search_Direction_Becomes_Too_Small",
            "Feasible_Point_Found")
SETTLED = 1e-9        # size of a run's step, in units of u, after which the next would not move


class Hessian:
    """Which second derivatives IPOPT is given."""

    sees_curvature_of_predictions = True


class ExactHessian(Hessian):
    """All second derivatives: quadratic convergence whatever the residuals are."""


class GaussNewtonHessian(Hessian):
    """Without the curvature of the predictions: never indefinite by them, slower where residuals are large."""

    sees_curvature_of_predictions = False


@dataclass(frozen=True)
class Ipopt(Method):
    """The interior-point method, for bounds and inequalities, and as a second opinion on GaussNewton.

    hessian: ExactHessian() or GaussNewtonHessian(); tolerance: of the optimality conditions, with unknowns scaled by
    their conditional standard uncertainty; iterations: how many steps at most in each pass.
    """

    hessian: Hessian = field(default_factory=ExactHessian)
    tolerance: float = 1e-10
    iterations: int = 500
    name = "ipopt"

    def refusal(self, system: System) -> str | None:
        return missing_readings(system.problem)

    def minimise(self, system: System, start: Values) -> Outcome:
        values = {u: np.clip(v, u.lower, u.upper) if u.kind == "vector" else v for u, v in start.items()}
        program = _Program(system, system.weightings(values), self.hessian)
        search, polish = program.solver(self._options(program.rounding(values))), program.solver(_POLISHING)
        active = _Active.none(len(system.layout.free_columns), program.transcription.condition_count)
        total, size = 0, np.inf
        for _ in range(SEARCHES):
            run = program.run(search, values, active, pinned, _at_rest)
            total += run.iterations
            if not run.finite:
                return Outcome(dict(values), False, total, f"IPOPT stopped: {run.status}")
            values, active, size = run.values, run.active, run.size
            if run.status in FINISHED and run.turn < 0.5:
                break
        status = run.status
        limit, last = max(SETTLED, program.rounding(values)), np.inf
        for _ in range(POLISHES if run.status in FINISHED else 0):
            run = program.run(polish, values, active, only_pinned, revised)
            total += run.iterations
            if not run.finite:
                break
            same = run.active.same(active)
            values, active, size = run.values, run.active, run.size
            if same and (size <= limit or (size <= 1e-6 and size >= 0.5 * last)):
                return Outcome(dict(values), True, total, "converged")
            last = size
        return Outcome(dict(values), False, total, f"IPOPT stopped: {status}; its last step is {size:.1e} u")

    def _options(self, rounding: float) -> dict[str, Any]:
        tolerance = max(self.tolerance, rounding)
        return {**_QUIET, "tol": tolerance, "dual_inf_tol": 1e3 * tolerance, "constr_viol_tol": 1e2 * tolerance,
                "compl_inf_tol": 1e2 * tolerance, "acceptable_tol": 1e2 * tolerance, "acceptable_iter": 5,
                "max_iter": self.iterations}


_QUIET = {"nlp_scaling_method": "none", "bound_relax_factor": 0.0, "honor_original_bounds": "yes",
          "print_level": 0, "sb": "yes"}
# Near the answer rounding hides any decrease of the objective: steps are taken as they come and judged by their size.
# Limits are then equations or absent, so that no barrier is left.
_POLISHING = {**_QUIET, "tol": 1e-300, "acceptable_iter": 0, "max_iter": 2, "accept_every_trial_step": "yes"}


def _at_rest(side: Side, value: Array, low: Array, high: Array, push: Array) -> Side:
    return touched(value, low, high, push)


@dataclass(frozen=True)
class _Active:
    """Bounds (p,) and conditions (m,) that hold with equality."""

    bounds: Side
    conditions: Side

    @staticmethod
    def none(unknowns: int, conditions: int) -> _Active:
        return _Active(np.zeros(unknowns, np.int8), np.zeros(conditions, np.int8))

    def same(self, other: _Active) -> bool:
        return np.array_equal(self.bounds, other.bounds) and np.array_equal(self.conditions, other.conditions)


@dataclass(frozen=True)
class _Run:
    """One run of IPOPT: where it ended, the size of its whole step in units of u, and its largest turn [rad]."""

    values: dict[Unknown, Array]
    active: _Active
    size: float
    turn: float
    iterations: int
    status: str
    finite: bool


class _Program:
    """A transcribed problem with its solvers."""

    def __init__(self, system: System, weightings: Sequence[Weighting], hessian: Hessian):
        self.system, self._weightings = system, weightings
        self.transcription = Transcription(system, weightings, hessian.sees_curvature_of_predictions)

    def rounding(self, values: Values) -> float:
        """Rounding of the predictions, in units of u."""
        sizes = [float(np.linalg.norm(t.predict(values) / w.u)) for t, w in
                 zip(self.system.terms, self._weightings, strict=True)]
        return 4 * np.finfo(float).eps * float(np.linalg.norm(sizes))

    def solver(self, options: dict[str, Any]) -> ca.Function:
        """IPOPT with some options."""
        return ca.nlpsol("ipopt", "ipopt", self.transcription.problem, {
            **self.transcription.functions, "ipopt": options, "print_time": False, "show_eval_warnings": False,
            "calc_lam_x": True})

    def run(self, solver: ca.Function, values: Values, active: _Active, room: Callable[..., tuple[Array, Array]],
            after: Callable[..., Side]) -> _Run:
        """One run from stored values.

        active: limits that hold; room: what the solver is given as limits; after: the limits that hold then.
        """
        layout = self.system.layout
        blocks = self.system.blocks(values, self._weightings)
        scale = _conditional_uncertainty(blocks, layout)
        lower, upper = (limit[layout.free_columns] / scale for limit in layout.bounds(values))
        low, high, unit = self._limits(values, scale)
        readings = []
        for term in self.system.terms:
            predicted = term.predict(values)
            readings.append((predicted + self.system.residual(term, predicted)).ravel())
        stored = [r.stored(values).ravel(order="F") for r in (*self.transcription.rows, *self.transcription.conditions)]
        (lbx, ubx), (lbg, ubg) = room(lower, upper, active.bounds), room(low, high, active.conditions)
        found = solver(x0=np.clip(np.zeros(len(scale)), lbx, ubx), p=np.concatenate([scale, unit, *readings, *stored]),
                       lbx=lbx, ubx=ubx, lbg=lbg, ubg=ubg)
        x, pull, push, value = (np.array(found[k]).ravel() for k in ("x", "lam_x", "lam_g", "g"))
        statistics = solver.stats()
        step = np.zeros(layout.size)
        step[layout.free_columns] = np.clip(x, lower, upper) * scale
        finite = bool(np.all(np.isfinite(x)))
        turns = [float(np.abs(step[layout.span(u)]).max()) for u in layout.unknowns if u.kind != "vector"]
        then = _Active(after(active.bounds, x, lower, upper, pull), after(active.conditions, value, low, high, push))
        moved = set_to_bounds(layout, layout.move(values, step), then.bounds) if finite else dict(values)
        return _Run(moved, then, _size(blocks, step), max(turns, default=0.0), int(statistics["iter_count"]),
                    str(statistics["return_status"]), finite)

    def _limits(self, values: Values, scale: Array) -> tuple[Array, Array, Array]:
        """Limits of the conditions and the units they are counted in: what a step of conditional u changes."""
        lows, highs, units = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
        for condition in self.transcription.conditions:
            constraint = condition.term.bound
            assert isinstance(constraint, Constraint)
            value, parts = condition.term.derive(values)
            square = np.zeros(value.shape)
            for part in parts:
                spread = np.append(scale, 0.0)[self.system.layout.position[part.columns]][:, None, :]
                square += np.square(part.jacobian * spread).sum(axis=2)
            units.append(np.where(square > 0, np.sqrt(square), constraint.tolerance).ravel())
            lows.append(np.broadcast_to(constraint.lower, value.shape).ravel() / units[-1])
            highs.append(np.broadcast_to(constraint.upper, value.shape).ravel() / units[-1])
        return np.concatenate(lows), np.concatenate(highs), np.concatenate(units)


def _conditional_uncertainty(blocks: Sequence[Block], layout: Layout) -> Array:
    """Standard uncertainty (p,) of each free column were all others known; one where no reading sees it."""
    square = np.zeros(layout.size)
    for block in blocks:
        for part in block.parts:
            np.add.at(square, part.columns.ravel(), np.square(part.jacobian).sum(axis=1).ravel())
    square = square[layout.free_columns]
    return 1.0 / np.sqrt(np.where(square > 0, square, 1.0))


def _size(blocks: Sequence[Block], step: Array) -> float:
    """Size of a step (size,) in units of u: the change of all whitened predictions."""
    total = 0.0
    for block in blocks:
        change = np.zeros_like(block.residual)
        for part in block.parts:
            change += np.einsum("mdf,mf->md", part.jacobian, step[part.columns])
        total += float(np.vdot(change, change))
    return float(np.sqrt(total))
