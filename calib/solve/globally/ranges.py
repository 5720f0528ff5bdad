"""A point from its distances to known points: trust region of squared ranges, and two proofs for the ranges themselves.

The declared objective is F = sum ((|P - B| - d) / u)^2. With y = |B|^2 every squared distance s = |P|^2 - 2 P.B + y is
affine and F is convex in (B, y); only y = |B|^2 bends. Letting B and the distances loose in a semidefinite relaxation
amounts to y >= |B|^2: tight only where the readings are too short on the whole, about every second time.
Where it is not, this helps: whatever is no worse than the candidate keeps every residual within u sqrt(F). There F is
so strongly convex that it remains convex with the multiplier of y = |B|^2 added, and the candidate is its minimum.
Source: Beck, Stoica, Li 2008, IEEE Trans. Signal Processing 56, 1770-1778 (squared ranges); Cheung, So, Ma, Chan 2004,
IEEE Trans. Signal Processing 52, 1121-1130 (relaxation).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from calib.blocks import Array
from calib.solve.globally.bound import Bound
from calib.solve.globally.quadratic import QuadraticProgram, lower_bound

FLAT = 1e-9  # extent across, as a share of the whole, below which points lie in a plane or on a line


def squared_ranges(points: ArrayLike, ranges: ArrayLike, u: ArrayLike) -> Array:
    """The point (3,) [m] of the least weighted sum of (|P - B|^2 - d^2)^2, over all points of space.

    points: (n, 3) [m] that do not lie in a plane; ranges, u: (n,) [m]. A residual of squares counts as one of 2 d u.
    """
    p, d = np.asarray(points, float), np.asarray(ranges, float)
    middle = p.mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum((p - middle) ** 2, axis=1))))
    q, d, u = (p - middle) / size, d / size, np.broadcast_to(np.asarray(u, float), d.shape) / size
    weight = (u.min() / u) / (2.0 * np.maximum(d, u))
    design = np.column_stack([-2.0 * q, np.ones(len(q))]) * weight[:, None]
    right = (d**2 - np.sum(q**2, axis=1)) * weight
    bend, slope = np.diag([1.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 0.0, -0.5])
    normal, pull = design.T @ design, design.T @ right

    def at(multiplier: float) -> Array:
        return np.linalg.solve(normal + multiplier * bend, pull - multiplier * slope)

    def excess(multiplier: float) -> float:
        z = at(multiplier)
        return float(z[:3] @ z[:3] - z[3])
    # the normal matrix stays positive down to minus the reciprocal of the largest eigenvalue of (bend, normal)
    lowest = -1.0 / float(np.max(np.linalg.eigvals(np.linalg.solve(normal, bend)).real))
    low, high = lowest * (1.0 - 1e-12), max(1.0, -lowest)
    while excess(high) > 0.0 and high < 1e12:
        high *= 4.0
    for _ in range(200):
        centre = 0.5 * (low + high)
        low, high = (centre, high) if excess(centre) > 0.0 else (low, centre)
    return middle + size * at(0.5 * (low + high))[:3]


def relaxation_bound(points: ArrayLike, ranges: ArrayLike, u: ArrayLike, candidate: ArrayLike) -> Bound:
    """The bound on F of the semidefinite relaxation, counted from a candidate (3,) [m]; arguments as above."""
    p, d, b = (np.asarray(one, float) for one in (points, ranges, candidate))
    u = np.broadcast_to(np.asarray(u, float), d.shape)
    seen = p - b
    g, n = np.linalg.norm(seen, axis=1), len(d)
    unit = float(np.exp(np.mean(np.log(u))))
    quadratic, linear = np.zeros((3 + n, 3 + n)), np.zeros(3 + n)
    quadratic[3:, 3:] = np.diag((unit / u) ** 2)
    linear[3:] = unit * (g - d) / u**2
    conditions, slopes = np.zeros((n, 3 + n, 3 + n)), np.zeros((n, 3 + n))
    for i in range(n):
        conditions[i, 3 + i, 3 + i], conditions[i, :3, :3] = unit / g[i], -np.eye(3) * unit / g[i]
        slopes[i, 3 + i], slopes[i, :3] = 1.0, seen[i] / g[i]
    constant = float(np.sum(((g - d) / u) ** 2))
    # no better point is farther than the ranges and their admissible errors allow
    reach = np.sqrt((2.0 * (d + u * np.sqrt(constant))).min() ** 2 + 4.0 * constant * float(u @ u)) / unit
    program = QuadraticProgram(quadratic, linear, constant, conditions, slopes, float(reach))
    return lower_bound(program, "the semidefinite relaxation of the ranges")


def convexity_bound(points: ArrayLike, ranges: ArrayLike, u: ArrayLike, candidate: ArrayLike) -> Bound:
    """The bound on F from its convexity in (B, y) wherever it is no worse than at a candidate (3,) [m]."""
    p, d, b = (np.asarray(one, float) for one in (points, ranges, candidate))
    u = np.broadcast_to(np.asarray(u, float), d.shape)
    middle = p.mean(axis=0)
    _, extent, directions = np.linalg.svd(p - middle, full_matrices=True)
    axes = directions[: int(np.sum(extent > FLAT * extent[0]))]
    q, base = (p - middle) @ axes.T, axes @ (b - middle)
    beside = float(np.sum((b - middle) ** 2) - base @ base)   # squared height over the plane or line of the points
    g = np.linalg.norm(p - b, axis=1)
    constant = float(np.sum(((g - d) / u) ** 2))
    proof = "convex in the point and its squared length wherever it is no worse"
    away = u * np.sqrt(constant)
    if np.any(d <= 0):
        return Bound(0.0, constant, "a sum of squares is not negative, and a range that is not positive proves no more")
    curvature = d / (2.0 * u**2 * (d + away) ** 3)
    pull = (g - d) / (u**2 * g)                                # dF/ds
    rows = np.column_stack([-2.0 * q, np.ones(len(q))])
    multiplier = float(pull.sum())
    if len(axes) < 3:                                          # the height is free: y >= |B|^2 is all that is asked
        multiplier = 0.0 if beside > 0.0 else max(multiplier, 0.0)
    gradient = rows.T @ pull + multiplier * np.append(2.0 * base, -1.0)
    bend = 2.0 * multiplier * np.diag([*np.ones(len(axes)), 0.0])
    hessian = (rows * curvature[:, None]).T @ rows + bend
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian - bend), 1e-300))
    values, vectors = np.linalg.eigh(hessian * np.outer(scale, scale))
    if values[0] <= 1e-12 * values[-1]:
        return Bound(0.0, constant, "a sum of squares is not negative, and convexity could not be shown: the errors "
                                    "are too large for the figure of the points")
    loss = 0.5 * float(np.sum((vectors.T @ (scale * gradient)) ** 2 / values))
    return Bound(constant - loss, constant, proof)
