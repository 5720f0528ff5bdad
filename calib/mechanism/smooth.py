"""Errors that vary smoothly with the positions of the axes: what neighbouring postures have in common and no effect
explains, such as the distortion of a camera or the waviness of a bearing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import DeclarationError
from calib.mechanism.axis import Array
from calib.mechanism.chain import Mechanism
from calib.uncertainty import Gaussian


@dataclass(frozen=True)
class Smooth:
    """One component of readings: u of each by itself, u of what varies smoothly, and how far that reaches.

    own, smooth: standard uncertainties in the SI unit of the component; reach: distance of positions [rad or m] over
    which the smooth part falls to exp(-1/2) of itself.
    """

    own: float
    smooth: float = 0.0
    reach: float = 1.0


def smooth_errors(mechanism: Mechanism, positions: ArrayLike, components: Sequence[Smooth]) -> Gaussian:
    """Uncertainty of readings in postures whose errors are partly alike where positions are near.

    mechanism: whose rotary axes close after a turn; positions: (n, axes) [rad or m]; components: of a reading.
    Returns the uncertainty for Observations of n rows. Raises DeclarationError for a reach that is not positive.
    Source: squared-exponential covariance, Rasmussen and Williams, Gaussian Processes for Machine Learning, eq. 4.9.
    """
    apart = distances(mechanism, positions)
    count, size = len(apart), len(components)
    whole = np.zeros((count, size, count, size))
    for k, one in enumerate(components):
        if one.smooth and not one.reach > 0:
            raise DeclarationError(f"smooth errors that reach {one.reach:g} reach nowhere; give a positive distance.")
        whole[:, k, :, k] = one.own ** 2 * np.eye(count)
        if one.smooth:
            whole[:, k, :, k] += one.smooth ** 2 * np.exp(-0.5 * (apart / one.reach) ** 2)
    if not any(one.smooth for one in components):
        return Gaussian.standard([one.own for one in components])
    return Gaussian.groups(np.zeros(count, int), {"0": whole.reshape(count * size, count * size)})


def distances(mechanism: Mechanism, positions: ArrayLike) -> Array:
    """Distances (n, n) between postures: chords of the turns of rotary axes [rad], ways of linear axes [m]."""
    rows = np.asarray(positions, float)
    steps = rows[:, None] - rows
    for k, axis in enumerate(mechanism.axes):
        if axis.is_rotary:
            steps[:, :, k] = 2.0 * np.sin(0.5 * steps[:, :, k])
    return np.asarray(np.sqrt(np.sum(steps ** 2, axis=2)))
