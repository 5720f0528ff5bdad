"""The turntable paper's own way from coordinates to angles: circle, frame change, turned angle without the axial part.

Source: Li, Cao, Qu 2020, Metrology and Measurement Technology 40(2), 14-19 ("the paper"), section 1.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from calib import Problem, Quantity, Shared
from calib.geometry import Transform, matrix, norm, product
from problems.circle import in_plane, pairwise


def table_frame(centre: Any, normal: Any, first: Any) -> Transform:
    """The frame of the table from that of the tracker: origin at the centre, z along the normal, x to a first point.

    centre, first: (3,) points [m]; normal: unit (3,). The paper points x at the first point itself, which only a point
    exactly in the plane allows; here at its foot in the plane. Source: the paper, equation 15 and figure 3.
    """
    x, y = in_plane(normal, first - centre)
    rotation = matrix([[x[0], x[1], x[2]], [y[0], y[1], y[2]], [normal[0], normal[1], normal[2]]])
    return Transform(rotation, -product(rotation, centre))


def angles_in_table(point: Any, first: Any, centre: Any, normal: Any) -> Any:
    """Angle turned [rad], right-handed about the normal, axial angle [rad] and distance [m] of a point (3,) [m].

    first: (3,) the first point [m]; centre (3,) [m]; normal: unit (3,). The axial part leaves the angle turned.
    Source: the paper, equation 18, with the sign and the quadrant that its arc tangent loses.
    """
    seen = table_frame(centre, normal, first) @ point
    return ca.vertcat(ca.atan2(seen[1], seen[0]), ca.atan2(seen[2], ca.sqrt(seen[0]**2 + seen[1]**2)), norm(seen))


def declare(points: ArrayLike, weights: ArrayLike | None = None) -> Problem:
    """The paper's procedure: circle by equation 8, or 14 with weights, then frame change and angles as a quantity.

    points: (n, 3) [m]; weights: (n,) of equations 9 to 13, or None. Quantity `angles`: turned, axial, distance.
    """
    points = np.asarray(points, float)
    problem = (pairwise.pairwise(points) if weights is None
               else pairwise.weighted_pairwise(points, weights))
    centre, plane = (problem.select(name).unknown for name in ("centre", "plane"))

    def angles(point: Any, first: Any, centre: Any, plane: Any) -> Any:
        return angles_in_table(point, first, centre, plane[:3] / norm(plane[:3]))
    return problem.with_quantities(Quantity("angles", angles, points, Shared(points[0]), centre, plane,
                                            parts=("turned", "axial", "distance"), unit=("deg", "arcsec", "mm")))
