"""The relaxation as a conic program, the independent judge of the framework's own interior point."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.analyse.selection.interior import inverse_of
from calib.analyse.selection.limits import Limits
from calib.analyse.selection.objective import Objective
from calib.analyse.selection.relaxation import Relaxed
from calib.analyse.selection.terms import Determinant, DeterminantOfSet, OfFunctions, Support, Term, Trace
from calib.analyse.selection.worst import Largest, LargestOf, mean_of
from calib.blocks import Array
from calib.errors import InputError

MOST = 2000      # candidates times unknowns squared / 1000, beyond which a cone program takes minutes


def conic(objective: Objective, limits: Limits) -> Relaxed:
    """Solve the relaxation by CVXPY and Clarabel; the bound is recomputed from the weights alone.

    objective; limits. Returns weights and bound as `relax` does.
    Raises InputError where the program is too large for a cone solver.
    """
    import cvxpy as cp

    n, p = objective.count, objective.terms[0].rows.shape[2]
    if n * p * p > 1000 * MOST:
        raise InputError(f"a conic program of {n} candidates and {p} unknowns would take long; use Relaxation(), which "
                         "computes the same bound")
    weights = cp.Variable(n)
    worst = cp.Variable()
    conditions = [weights >= 0, weights <= 1, limits.matrix @ weights <= limits.most]
    duals: list[tuple[Any, Any]] = []      # of each term: its share, and what proves its part of the bound
    for term in objective.terms:
        products = np.einsum("nmi,nmj->nij", term.rows, term.rows).reshape(n, -1)
        information = cp.reshape(products.T @ weights, (p, p), order="C") + term.fixed
        # The size of F only moves the loss, and the solver likes numbers near one.
        functions = np.zeros((0, p))
        inner: Any = None
        if isinstance(term, OfFunctions):
            functions = term.functions / np.linalg.norm(term.functions)
        # Each is exp(-loss) or a power of it, up to the scale of D: larger is better, concave in the information.
        if isinstance(term, Determinant):
            good = (cp.log_det(information) + term.log_scale) / p
        elif isinstance(term, Trace):
            good = -cp.sum([cp.matrix_frac(f, information) for f in _independent(functions)])
        elif isinstance(term, Largest):
            scale = cp.Variable()
            # F M^-1 F' <= 1/t for t F'F <= M.
            inner = information - scale * (functions.T @ functions) >> 0
            conditions.append(inner)
            good = scale
        elif isinstance(term, LargestOf):
            largest = cp.Variable()
            inner = cp.hstack([cp.matrix_frac(f, information) for f in functions]) <= largest
            conditions.append(inner)
            good = -largest
        else:
            assert isinstance(term, DeterminantOfSet)
            s = len(functions)
            below = cp.Variable((s, s), symmetric=True)
            # N <= (F M^-1 F')^-1 for F'N F <= M.
            conditions.append(information - functions.T @ below @ functions >> 0)
            good = cp.log_det(below) / s
        conditions.append(worst <= good)
        duals.append((conditions[-1], inner))
    cp.Problem(cp.Maximize(worst), conditions).solve(solver=cp.CLARABEL)
    found = np.clip(np.asarray(weights.value, dtype=float), 0.0, 1.0)
    support = mean_of([_support(term, found, float(share.dual_value), inner)
                       for term, (share, inner) in zip(objective.terms, duals, strict=True)])
    return Relaxed(found, support.bound(limits, np.zeros(n), np.ones(n)), support)


def _support(term: Term, weights: Array, share: float, inner: Any) -> tuple[float, float, Support]:
    """Share, loss and linear function of one term, from the duals of the solver or from the weights alone."""
    information = term.information(weights)
    loss = float(term.loss(information[None])[0])
    if isinstance(term, Largest):
        return share, loss, term.support(np.asarray(inner.dual_value, dtype=float))
    pieces = term.pieces(inverse_of(information))
    each = np.ones(1) if inner is None else np.maximum(np.asarray(inner.dual_value, dtype=float), 0.0)
    return share, loss, term.support(pieces.spread(each), each)


def _independent(matrix: np.ndarray) -> np.ndarray:
    """Rows that are not zero: a triangle may have some."""
    return np.asarray(matrix[np.any(np.abs(matrix) > 1e-14 * np.abs(matrix).max(), axis=1)])
