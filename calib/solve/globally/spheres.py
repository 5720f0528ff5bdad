"""Circle in the plane and sphere: the smallest eigenvalue of Pratt's pencil bounds the orthogonal distances from below.

The algebraic distance (|P - c|^2 - R^2) / (2 R) is e (1 + e / (2 R)) for a distance e from the circle, and the least
sum of its squares over all circles is an eigenvalue: a global minimum. Whatever is no worse than the candidate keeps
|e| within u sqrt(F), and the factor is then nearly one.
Source: Pratt 1987, Computer Graphics 21, 145-152; the bound: own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from calib.blocks import Array
from calib.solve.globally.bound import Bound


def sphere_bound(points: ArrayLike, u: ArrayLike, centre: ArrayLike, radius: float) -> Bound:
    """How far the sum of ((|P - c| - R) / u)^2 at a candidate can lie above the least over all circles or spheres.

    points: (n, 2) or (n, 3) [m]; u: (n,) [m]; centre: (2,) or (3,) [m], radius [m]: the candidate.
    """
    p = np.asarray(points, float)
    u = np.broadcast_to(np.asarray(u, float), len(p))
    error = np.linalg.norm(p - np.asarray(centre, float), axis=1) - radius
    objective = float(np.sum((error / u) ** 2))
    proof = "the smallest eigenvalue of Pratt's pencil, global over all radii and centres"
    away = float(u.max()) * np.sqrt(objective)
    smallest = 0.5 * float(np.linalg.norm(p[:, None] - p[None, :], axis=2).max()) - away
    if smallest <= 0.0:
        return Bound(0.0, objective, "a sum of squares is not negative; the errors are as large as the figure")
    return Bound(min(eigenvalue(p, u) / (1.0 + away / (2.0 * smallest)) ** 2, objective), objective, proof)


def eigenvalue(points: Array, u: Array) -> float:
    """The least weighted sum of squared algebraic distances over all circles or spheres, planes among them."""
    from scipy.linalg import qr, solve_triangular

    middle = points.mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum((points - middle) ** 2, axis=1))))
    q = (points - middle) / size
    rows = np.column_stack([np.sum(q**2, axis=1), q, np.ones(len(q))]) * (size / u)[:, None]
    width = rows.shape[1]
    condition = np.eye(width)                          # b'b - 4 a c = 1
    condition[0, 0] = condition[-1, -1] = 0.0
    condition[0, -1] = condition[-1, 0] = -2.0
    root = qr(rows, mode="economic")[1]
    if np.min(np.abs(np.diag(root))) < 1e-14 * np.max(np.abs(np.diag(root))):
        return 0.0
    # |root z|^2 / z' condition z is least at the largest eigenvalue of root'^-1 condition root^-1
    half = solve_triangular(root, condition, trans="T")
    return float(1.0 / np.linalg.eigvalsh(solve_triangular(root, half.T, trans="T"))[-1])
