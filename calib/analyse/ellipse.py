"""Error ellipses of two coordinates.

Source: Ghilani, Adjustment Computations, 5th edition (2010), chapter 19; JCGM 102:2011, 7.7, for the factors of 95 %.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.blocks import Array

PLANE_95, SPACE_95 = 2.4477468, 2.7954835    # roots of the 95 % quantiles of chi-squared with 2 and 3 dof


@dataclass(frozen=True)
class Ellipse:
    """The standard ellipse (k = 1): semi-axes in the unit of the coordinates, bearing of the longer one from the first
    coordinate towards the second, 0 to pi [rad]."""

    major: float
    minor: float
    bearing: float


def ellipse(matrix: Array) -> Ellipse:
    """The standard ellipse of two coordinates with a covariance (2, 2)."""
    values, axes = np.linalg.eigh(matrix)
    minor, major = np.sqrt(np.maximum(values, 0.0))
    return Ellipse(float(major), float(minor), float(np.arctan2(axes[1, 1], axes[0, 1]) % np.pi))
