"""Algebraic circle fits after Kasa, Pratt and Taubin: starts for the geometric fit of `problems.circle`.

All three minimise the sum of squares of a (x^2 + y^2) + b x + c y + d over the points and differ only in what keeps
(a, b, c, d) from shrinking to zero. They are biased on short arcs and know no uncertainty: starts, not results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SpaceCircle:
    """A circle in space as numbers: centre (3,) [m], unit normal (3,), radius [m], foot angles (n,) [rad].

    reference: (3,) the direction in the plane from which the foot angles count, right-handed about the normal.
    """

    centre: Array
    normal: Array
    radius: float
    foot: Array
    reference: Array


def kasa(points: Array) -> Array:
    """Centre and radius (3,) [m] of plane points (n, 2) [m] with a = 1. Source: Kasa 1976, IEEE Trans. IM 25, 8-14."""
    return _algebraic(points, lambda x, y, z: np.diag([1.0, 0.0, 0.0, 0.0]))


def pratt(points: Array) -> Array:
    """Centre and radius (3,) [m] of plane points (n, 2) [m] with b^2 + c^2 - 4 a d = 1.

    Source: Pratt 1987, Computer Graphics 21, 145-152.
    """
    return _algebraic(points, lambda x, y, z: np.array(
        [[0.0, 0.0, 0.0, -2.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [-2.0, 0.0, 0.0, 0.0]]))


def taubin(points: Array) -> Array:
    """Centre and radius (3,) [m] of plane points (n, 2) [m] with the mean squared gradient 1.

    Source: Taubin 1991, IEEE Trans. PAMI 13, 1115-1138.
    """
    def mean_squared_gradient(x: Array, y: Array, z: Array) -> Array:
        zero, one = np.zeros_like(x), np.ones_like(x)
        gradient = np.stack([np.stack([2.0 * x, one, zero, zero], 1), np.stack([2.0 * y, zero, one, zero], 1)])
        return np.einsum("gni,gnj->ij", gradient, gradient) / len(x)
    return _algebraic(points, mean_squared_gradient)


def checked(points: ArrayLike) -> Array:
    """Points as an array (n, 3) [m]. Raises InputError for another shape."""
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"points have shape {points.shape}; give (n, 3): x, y and z of each point in metres")
    return points


def space_circle(points: ArrayLike, fit: Callable[[Array], Array] = pratt, command: ArrayLike | None = None,
                 axis: ArrayLike | None = None) -> SpaceCircle:
    """A space circle: the plane by the least squares of the offsets, the circle in it by an algebraic fit.

    points: (n, 3) [m]; fit: kasa, pratt or taubin; command: (n,) [rad] commanded angles, which carry the foot angles
    through whole turns and choose the sense of the normal; axis: (3,) approximate direction, which chooses it instead.
    Without either, the points are taken to follow each other by less than half a turn, right-handed about the normal.
    Raises InputError for fewer than three points, points at one position or on a line.
    """
    points = checked(points)
    if len(points) < 3:
        raise InputError(f"{len(points)} points do not fix a circle in space; measure at least three positions")
    middle = points.mean(axis=0)
    _, extent, directions = np.linalg.svd(points - middle, full_matrices=False)
    if extent[0] == 0.0:
        raise InputError(f"all {len(points)} points are at one position; a circle needs three different ones")
    if extent[1] < 1e-9 * extent[0]:
        raise InputError(f"the {len(points)} points lie on a straight line, so no plane of the circle is defined; "
                         "measure over a longer arc")
    normal = np.cross(directions[0], directions[1])
    planar = (points - middle) @ directions[:2].T
    x, y, radius = fit(planar)
    centre = middle + np.array([x, y]) @ directions[:2]
    foot = np.unwrap(np.arctan2(planar[:, 1] - y, planar[:, 0] - x))
    if _runs_backwards(foot, normal, command, axis):
        normal, foot = -normal, -foot
    reference = points[0] - centre
    reference = reference - normal * (normal @ reference)
    foot = foot - foot[0]
    if command is not None:
        turned = np.asarray(command, float) - np.asarray(command, float)[0]
        foot = turned + (foot - turned + np.pi) % (2.0 * np.pi) - np.pi
    return SpaceCircle(centre, normal, float(radius), foot, reference / np.linalg.norm(reference))


def _runs_backwards(foot: Array, normal: Array, command: ArrayLike | None, axis: ArrayLike | None) -> bool:
    """Whether the normal must be turned over so that the foot angles grow as asked."""
    if axis is not None:
        return bool(normal @ np.asarray(axis, float) < 0.0)
    if command is None:
        return bool(foot[-1] < foot[0])
    phase = foot - np.asarray(command, float)
    opposite = foot + np.asarray(command, float)
    return bool(np.abs(np.exp(1j * phase).mean()) < np.abs(np.exp(1j * opposite).mean()))


def _algebraic(points: ArrayLike, normalisation: Callable[[Array, Array, Array], Array]) -> Array:
    points = np.asarray(points, float)
    middle = points.mean(axis=0)
    scale = np.sqrt(np.mean(np.sum((points - middle) ** 2, axis=1)))
    if scale == 0.0:
        raise InputError(f"all {len(points)} points are at one position; a circle needs three different ones")
    x, y = ((points - middle) / scale).T
    z = x * x + y * y
    design = np.stack([z, x, y, np.ones_like(x)], axis=1)
    moments = design.T @ design / len(x)
    values, vectors = _pencil(moments, normalisation(x, y, z))
    a, b, c, d = vectors[:, np.argmin(values)]
    if abs(a) < 1e-9 * np.hypot(b, c):
        raise InputError(f"the {len(points)} points lie on a straight line; a circle needs points off one line")
    centre = -np.array([b, c]) / (2.0 * a)
    return np.append(centre * scale + middle, np.sqrt(max(centre @ centre - d / a, 0.0)) * scale)


def _pencil(moments: Array, condition: Array) -> tuple[Array, Array]:
    """Real finite solutions of moments @ v = value condition @ v with v' condition v > 0."""
    from scipy.linalg import eig

    values, vectors = eig(moments, condition)
    usable = np.isfinite(values) & (np.abs(values.imag) < 1e-9 * (1.0 + np.abs(values.real)))
    vectors = vectors[:, usable].real
    positive = np.einsum("ik,ij,jk->k", vectors, condition, vectors) > 0.0
    return values[usable].real[positive], vectors[:, positive]
