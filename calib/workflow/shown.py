"""Values of unknowns as people read them: rotations as rotation vectors, directions as their three components."""

from __future__ import annotations

import numpy as np

from calib import geometry
from calib.analyse.covariance import covariance
from calib.blocks import Array
from calib.linearisation import Linearisation
from calib.unknown import Unknown


def parts_of(unknown: Unknown) -> tuple[str, ...]:
    """Names of the columns of `shown`: those of the unknown, x, y, z for a direction."""
    return ("x", "y", "z") if unknown.kind == "direction" else unknown.parts


def shown(fit: Linearisation, unknown: Unknown, u: Array) -> tuple[Array, Array]:
    """Values and standard uncertainties of an unknown as people read them.

    fit: a linearisation; unknown: of it; u: (count, freedom) SI of its small coordinates, not a number where held.
    return: values and u, both (count, parts) in SI. Of a rotation: the rotation vector, with u about the axes of b; of
    a direction: its components, with their u.
    """
    stored = fit.values[unknown]
    if unknown.kind == "vector":
        return stored, u
    value = unknown.show(stored)
    if unknown.kind == "rotation":
        return _turns(np.reshape(np.asarray(value, float), (-1, 3, 3))), u
    if unknown.kind == "direction":
        frames = stored.reshape(-1, 3, 3).transpose(0, 2, 1)
        spread = [_across(fit, unknown, i, frames[i][:, :2], u[i]) for i in range(unknown.count)]
        return np.reshape(np.asarray(value, float), (-1, 3)), np.array(spread)
    poses = [value] if isinstance(value, geometry.Transform) else list(value)  # type: ignore[call-overload]
    turns = _turns(np.array([np.asarray(pose.rotation, float) for pose in poses]))
    return np.hstack([np.array([np.ravel(pose.translation) for pose in poses], float), turns]), u


def values_by_label(fit: Linearisation, unknown: Unknown) -> dict[str, float | None]:
    """The readable value of every small coordinate of an unknown; None for those of a direction, which have none.

    fit: a linearisation; unknown: of it.
    return: {label: value in SI}.
    """
    labels = unknown.labels
    if unknown.kind == "direction":
        return dict.fromkeys(labels)
    values, _ = shown(fit, unknown, np.zeros((unknown.count, unknown.freedom)))
    return dict(zip(labels, (float(value) for value in np.ravel(values))))


def _across(fit: Linearisation, unknown: Unknown, instance: int, frame: Array, u: Array) -> Array:
    """u (3,) of the components from the covariance of the two small angles across the vector."""
    if np.isnan(u).any():
        return np.full(3, np.nan)
    matrix = covariance(fit, unknown[instance]).matrix
    return np.sqrt(np.maximum(np.diag(frame @ matrix @ frame.T), 0.0))


def _turns(matrices: Array) -> Array:
    return np.array([np.asarray(geometry.rotation_vector(matrix), float).ravel() for matrix in matrices])
