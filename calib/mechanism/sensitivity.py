"""How far a point of a mechanism moves when the position of an axis is a little wrong."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from calib.mechanism.axis import Array
from calib.mechanism.chain import Mechanism
from calib.rows import Program


def place_by_positions(mechanism: Mechanism, frame: str, positions: ArrayLike, point: ArrayLike = (0.0, 0.0, 0.0)
                       ) -> Array:
    """Derivative (n, 3, axes) of the place of a point with respect to the positions, at the nominal geometry.

    mechanism; frame: that carries the point; positions: (n, axes) [rad or m]; point: (3,) in the frame [m]. In metres
    a radian, or metres a metre. With the uncertainty of positions it gives the covariance of the place.
    """
    rows = np.asarray(positions, float).reshape(-1, len(mechanism.axes))
    symbols = ca.SX.sym("positions", len(mechanism.axes))
    place = mechanism.pose(frame)(symbols) @ np.asarray(point, float)
    derivative = ca.densify(ca.vec(ca.jacobian(ca.SX(place), symbols).T))
    numbers = Program([symbols], derivative)(list(np.ascontiguousarray(rows.T)), len(rows)).T
    return numbers.reshape(len(rows), 3, len(mechanism.axes))
