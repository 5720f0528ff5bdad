"""The certificate: conditions of optimality at an estimate, computed apart from the solver that found it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array
from calib.linearisation import Linearisation
from calib.solve.curvature import smallest_curvature
from calib.system import System, Values

STATIONARITY = 1e-6  # remaining step, in units of u, that passes
CURVATURE_SIZE = 400  # unknowns up to which the curvature of the exact Hessian is searched


@dataclass(frozen=True)
class Certificate:
    """What was verified at an estimate.

    stationarity: remaining step in units of u within the active conditions (None where the loss is not least squares);
    feasibility: largest excess of a condition in units of its tolerance; signs: whether every active bound or
    inequality pushes the right way; curvature: smallest eigenvalue of the exact Hessian relative to the Gauss-Newton
    matrix (None where there are too many unknowns); gap: duality gap where the method proves one; passed; why: a
    sentence.
    """

    stationarity: float | None
    feasibility: float
    signs: bool
    curvature: float | None
    gap: float | None
    passed: bool
    why: str


def certify(
    system: System,
    values: Values,
    fit: Linearisation,
    gap: float | None = None,
    least_squares: bool = True,
) -> Certificate:
    """Certify stored values of a system.

    fit: the linearisation there; gap: duality gap proved by the method; least_squares: whether the objective is v'Pv
    (else only feasibility and the gap are judged).
    """
    layout, factor, conditions = system.layout, fit.factor, fit.conditions
    weightings = [g.weighting for g in fit.groups]
    equal, unequal, feasibility = system.active_conditions(values)
    if not least_squares:
        passed = feasibility <= 1.0 and gap is not None and gap <= 1e-6
        return Certificate(
            None,
            feasibility,
            True,
            None,
            gap,
            passed,
            "duality gap closed" if passed else "the duality gap is open or a condition is broken",
        )
    pull = fit.pull
    low, high = system.at_bounds(values)
    pins = low | high
    stationarity = float(np.sqrt(factor.covariance(pull[None])[0, 0]))
    multipliers = np.linalg.lstsq(conditions.matrix.T, pull, rcond=None)[0] if len(conditions.target) else np.zeros(0)
    signs = _signs_hold(multipliers, len(equal), len(unequal), low[pins], high[pins])
    curvature = None
    if len(layout.free_columns) <= CURVATURE_SIZE and not factor.defect:
        weighed = [g.weighting.weigh(g.residual) for g in fit.groups]
        bend = system.bend(values, weighed, multipliers[: len(equal) + len(unequal)])
        curvature = 1.0 if bend is None else smallest_curvature(bend, fit)
    reasons = []
    # No step below the rounding of the values themselves can be taken.
    if not (stationarity <= STATIONARITY or stationarity <= system.rounding(values, weightings)):
        reasons.append(f"a step of {stationarity:.1e} u remains")
    if not feasibility <= 1.0:
        reasons.append(f"a condition is missed by {feasibility:.1e} of its tolerance")
    if not signs:
        reasons.append("an active bound pushes the wrong way")
    if curvature is not None and not curvature > 0:
        reasons.append(f"the objective curves downwards ({curvature:.1e}): a saddle or a maximum")
    if factor.defect:
        reasons.append(f"{factor.defect} direction(s) change no reading")
    return Certificate(
        stationarity,
        feasibility,
        signs,
        curvature,
        gap,
        not reasons,
        "; ".join(reasons) if reasons else "stationary, feasible and curved upwards",
    )


def _signs_hold(
    multipliers: Array, equalities: int, inequalities: int, low: NDArray[np.bool_], high: NDArray[np.bool_]
) -> bool:
    """Whether active inequalities push downwards and bounds outwards; what is pinned from both sides may push
    anywhere."""
    slack = 1e-6 * max(1.0, float(np.abs(multipliers).max(initial=0.0)))
    at_bound = multipliers[equalities + inequalities :]
    return not (
        np.any(multipliers[equalities : equalities + inequalities] < -slack)
        or np.any(low & ~high & (at_bound > slack))
        or np.any(high & ~low & (at_bound < -slack))
    )
