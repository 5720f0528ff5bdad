"""Rotation and pose alignment of two clouds of points with a covariance each: the best pose, proven.

minimise the sum of (y - R x - t)' W (y - R x - t) over rotations R and translations t. With full covariances there is
no closed form; the semidefinite relaxation is tight unless the noise is of the size of the figure.
Source: Briales & Gonzalez-Jimenez 2017, CVPR, 5612-5621; start: Umeyama 1991, IEEE Trans. PAMI 13, 376-380.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from calib.blocks import Array
from calib.solve.globally.bound import Bound
from calib.solve.globally.quadratic import QuadraticProgram, lower_bound

FARTHEST = 2.0 * np.sqrt(2.0)  # Frobenius distance of the two rotations that lie farthest apart


def closed_form(points: ArrayLike, seen: ArrayLike, weights: ArrayLike | None = None) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) that carry points (n, 3) onto seen (n, 3) with one weight (n,) a point."""
    x, y = np.asarray(points, float), np.asarray(seen, float)
    w = np.full(len(x), 1.0) if weights is None else np.asarray(weights, float)
    w = w / w.sum()
    middle, its = w @ x, w @ y
    left, _, right = np.linalg.svd((y - its).T @ (w[:, None] * (x - middle)))
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left) * np.linalg.det(right)]) @ right
    return rotation, its - rotation @ middle


def pose_bound(points: ArrayLike, seen: ArrayLike, covariance: ArrayLike, rotation: ArrayLike,
               translation_free: bool = True) -> Bound:
    """How far v'Pv at a rotation (and the best translation for it) can lie above the least over all poses.

    points, seen: (n, 3) [m]; covariance: (n, 3, 3) of what is seen; rotation: (3, 3) the candidate, a rotation.
    translation_free: whether t is sought; else it is zero.
    """
    x, y = np.asarray(points, float), np.asarray(seen, float)
    r0 = _nearest_rotation(np.asarray(rotation, float))
    whitening = np.linalg.inv(np.linalg.cholesky(np.asarray(covariance, float)))
    turned = np.einsum("nij,nk->nijk", whitening, x).reshape(-1, 9)   # of R as (R11, R12, ... R33)
    residual = np.einsum("nij,nj->ni", whitening, y - x @ r0.T).ravel()
    if translation_free:
        basis, _ = np.linalg.qr(whitening.reshape(-1, 3))
        turned, residual = turned - basis @ (basis.T @ turned), residual - basis @ (basis.T @ residual)
    conditions, slopes = _rotation_conditions(r0)
    program = QuadraticProgram(turned.T @ turned, -turned.T @ residual, float(residual @ residual), conditions, slopes,
                               FARTHEST)
    return lower_bound(program, "the semidefinite relaxation over rotations")


def _nearest_rotation(matrix: Array) -> Array:
    left, _, right = np.linalg.svd(matrix)
    return left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right


def _rotation_conditions(r0: Array) -> tuple[Array, Array]:
    """What makes a matrix a rotation, counted from r0: rows and columns orthonormal, columns right-handed."""
    place = np.arange(9).reshape(3, 3)
    conditions, linear = [], []

    def add(pairs: list[tuple[int, int, float]], own: dict[int, float]) -> None:
        matrix, slope = np.zeros((9, 9)), np.zeros(9)
        for i, j, factor in pairs:
            matrix[i, j] += factor / 2
            matrix[j, i] += factor / 2
        for i, factor in own.items():
            slope[i] = factor / 2
        conditions.append(matrix)
        linear.append(slope)
    for table in (place, place.T):
        for i in range(3):
            for j in range(i, 3):
                add([(table[i, k], table[j, k], 1.0) for k in range(3)], {})
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            # component c of column i cross column j is component c of column k
            add([(place[a, i], place[b, j], 1.0), (place[b, i], place[a, j], -1.0)], {place[c, k]: -1.0})
    matrices = np.array(conditions)
    return matrices, matrices @ r0.ravel() + np.array(linear)
