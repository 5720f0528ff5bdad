"""A quadratic objective under quadratic equations: the semidefinite relaxation, and what its multipliers prove.

Counted from a feasible candidate at x = 0, the objective is f + 2 c'x + x'Q x and every condition x'A x + 2 a'x = 0.
For any multipliers, f + min over x of x'(Q + sum l A)x + 2 (c + sum l a)'x is a lower bound everywhere: the highest of
these is Shor's relaxation. Counting from the candidate keeps the last digits: where the relaxation is tight, the
linear part vanishes and only the sign of the eigenvalues of one well-scaled matrix is left to decide.
Source: Boyd & Vandenberghe 2004, Convex Optimization, appendix B; Briales & Gonzalez-Jimenez 2017, CVPR, 5612-5621.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.blocks import Array
from calib.solve.globally.bound import Bound

ZERO = 1e-13  # size of an eigenvalue, in units of the largest, that is rounding of zero


@dataclass(frozen=True)
class QuadraticProgram:
    """f + 2 c'x + x'Q x under x'A_k x + 2 a_k'x = 0, counted from a feasible candidate.

    matrix: Q (p, p); linear: c (p,); constant: f; conditions: A (m, p, p); slopes: a (m, p).
    reach: |x| of every point that could be better than the candidate, in the scale of x.
    """

    matrix: Array
    linear: Array
    constant: float
    conditions: Array
    slopes: Array
    reach: float


@dataclass(frozen=True)
class Multipliers:
    """Multipliers (m,) of the conditions with the matrix (p, p) and linear part (p,) that they leave."""

    value: Array
    matrix: Array
    linear: Array


def lower_bound(program: QuadraticProgram, what: str) -> Bound:
    """The bound of the semidefinite relaxation, made safe against the rounding of its solver.

    program: counted from the candidate; what: names the relaxation in the sentence of the bound.
    Returns the bound on the objective, with the value at the candidate.
    """
    found = _relaxed(program)
    lower: float = max(_safe(program, _of(program, found)), _safe(program, _stationary(program, found)))
    return Bound(min(lower, program.constant), program.constant, f"dual of {what}")


def _of(program: QuadraticProgram, value: Array) -> Multipliers:
    return Multipliers(value, program.matrix + np.tensordot(value, program.conditions, 1),
                       program.linear + value @ program.slopes)


def _stationary(program: QuadraticProgram, value: Array) -> Multipliers:
    """The nearest multipliers for which the candidate is stationary, taken twice for the last digits."""
    for _ in range(2):
        rest = program.linear + value @ program.slopes
        value = value - np.linalg.lstsq(program.slopes.T, rest, rcond=1e-13)[0]
    return _of(program, value)


def _safe(program: QuadraticProgram, multipliers: Multipliers) -> float:
    """The lower bound that multipliers prove within reach: negative eigenvalues are paid for in full."""
    values, vectors = np.linalg.eigh(multipliers.matrix)
    along = vectors.T @ multipliers.linear
    size = max(float(np.abs(values).max()), 1e-300)
    bent = values > 1e-10 * size
    loss = float(np.sum(along[bent] ** 2 / values[bent]))
    flat = ~bent
    # within reach, a flat direction loses at most its slope times the reach, a negative one its curvature too
    loss += 2.0 * float(np.linalg.norm(along[flat])) * program.reach
    lowest = float(values[0])
    if lowest < -ZERO * size:
        loss += -lowest * program.reach**2
    return float(program.constant - loss)


def _relaxed(program: QuadraticProgram) -> Array:
    """Multipliers (m,) of the semidefinite relaxation, by Clarabel."""
    import cvxpy

    p, m = len(program.linear), len(program.slopes)
    scale = max(float(np.abs(program.matrix).max()), 1e-300)
    size = max(float(np.linalg.norm(program.linear)) / scale, 1e-300)  # x moves by about this
    quadratic, linear = program.matrix / scale, program.linear / (scale * size)
    # near a tight candidate the multipliers are as small as the pull of the residuals
    weight, drop = cvxpy.Variable(m), cvxpy.Variable()
    left = quadratic + size * sum(weight[k] * program.conditions[k] for k in range(m))
    right = cvxpy.reshape(linear + program.slopes.T @ weight, (p, 1), order="C")
    whole = cvxpy.bmat([[left, right], [right.T, cvxpy.reshape(drop, (1, 1), order="C")]])
    relaxation = cvxpy.Problem(cvxpy.Minimize(drop), [(whole + whole.T) / 2 >> 0])
    try:
        relaxation.solve(solver=cvxpy.CLARABEL)
    except cvxpy.error.SolverError:
        return np.zeros(m)
    return np.zeros(m) if weight.value is None else scale * size * np.asarray(weight.value, float)
