"""The pairwise objectives and weights of the turntable paper for a space circle, declared for the engine.

They stand beside the orthogonal distance of `problems.circle` for comparison; docs/slips/turntable.md says what is
wrong with them. Source: Li, Cao, Qu 2020, Metrology and Measurement Technology 40(2), 14-19 ("the paper"), section 1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import Constraint, Observations, Problem, Quantity, Unknown
from calib.geometry import dot, norm
from problems.circle.algebraic import SpaceCircle, checked, space_circle

Array = NDArray[np.float64]



def distance_difference(point: Any, other: Any, centre: Any) -> Any:
    """Difference of the distances [m] of two points (3,) from the centre (3,). Source: the paper, equations 4 and 5."""
    return norm(point - centre) - norm(other - centre)


def weighted_square_difference(point: Any, other: Any, weight: Any, other_weight: Any, centre: Any) -> Any:
    """Difference of weighted squared distances [m^2], as printed. Source: the paper, first term of equation 14."""
    return weight * dot(point - centre, point - centre) - other_weight * dot(other - centre, other - centre)


def plane_distance(point: Any, plane: Any) -> Any:
    """Distance [m] of a point (3,) from the plane A x + B y + C z + D = 0. Source: the paper, equation 6."""
    return (dot(plane[:3], point) + plane[3]) / norm(plane[:3])


def squared_length_of_normal(plane: Any) -> Any:
    """A^2 + B^2 + C^2 of a plane (4,), which equation 6 leaves open."""
    return dot(plane[:3], plane[:3])


def pairwise(points: ArrayLike, begin: SpaceCircle | None = None) -> Problem:
    """The objective of equation 8: all differences of distances, and distances from the plane, in metres, u = 1 m.

    points: (n, 3) [m]; begin: start values. v'Pv is F of equation 8: a pair counts twice, a plane distance n times.
    The stated u are those counts and no uncertainty: what `covariance` says of this problem is not that of the circle.
    The two constraints are not printed; without them the centre slides along the axis and the plane's scale is free.
    """
    points, (i, j) = checked(points), np.triu_indices(len(points), 1)
    return _pairwise(points, begin, "equation 8", distance_difference, (points[i], points[j]), np.sqrt(0.5),
                     np.sqrt(1.0 / len(points)))


def weighted_pairwise(points: ArrayLike, weights: ArrayLike, begin: SpaceCircle | None = None) -> Problem:
    """The objective of equation 14 as printed, which is not zero on an exact circle unless all weights are equal.

    points: (n, 3) [m]; weights: (n,) that sum to one; begin: start values. Readings as in `pairwise`.
    """
    points, w, (i, j) = checked(points), np.asarray(weights, float), np.triu_indices(len(points), 1)
    return _pairwise(points, begin, "equation 14", weighted_square_difference, (points[i], points[j], w[i], w[j]),
                     np.sqrt(0.5), 1.0 / np.sqrt(len(points) * w))


def repaired_pairwise(points: ArrayLike, weights: ArrayLike, begin: SpaceCircle | None = None) -> Problem:
    """Equation 14 as it must be meant: a pair weighs as the product of its weights, a plane distance as its weight.

    points: (n, 3) [m]; weights: (n,) that sum to one; begin: start values. The sum of w_i w_j (d_i - d_j)^2 over the
    pairs is the weighted variance of the distances, so this is the weighted orthogonal fit up to the axial part of d.
    """
    points, w, (i, j) = checked(points), np.asarray(weights, float), np.triu_indices(len(points), 1)
    return _pairwise(points, begin, "equation 14 repaired", distance_difference, (points[i], points[j]),
                     1.0 / np.sqrt(w[i] * w[j]), 1.0 / np.sqrt(w))


def _pairwise(points: Array, begin: SpaceCircle | None, name: str, difference: Callable[..., Any],
              rows: tuple[Array, ...], u_pairs: ArrayLike, u_plane: ArrayLike) -> Problem:
    begin = space_circle(points) if begin is None else begin
    centre = Unknown("centre", begin.centre, unit="mm", parts=("x", "y", "z"))
    plane = Unknown("plane", np.append(begin.normal, -begin.normal @ begin.centre), parts=("A", "B", "C", "D"))
    count = len(points) * (len(points) - 1) // 2
    pairs = Observations(difference, *rows, centre, readings=np.zeros(count), u=np.broadcast_to(u_pairs, (count,)),
                         group="pairs", unit="mm" if difference is distance_difference else "mm^2")
    offsets = Observations(plane_distance, points, plane, readings=np.zeros(len(points)),
                           u=np.broadcast_to(u_plane, (len(points),)), group="plane", unit="mm")
    conditions = (Constraint("unit normal", squared_length_of_normal, plane, lower=1.0, upper=1.0, tolerance=1e-12),
                  Constraint("centre in plane", plane_distance, centre, plane, tolerance=1e-12, unit="mm"))

    def mean_distance(centre: Any) -> Any:
        return sum(norm(ca.DM(point) - centre) for point in points) / len(points)
    return Problem([pairs, offsets], conditions, [Quantity("radius", mean_distance, centre, unit="mm")], name=name)


# --- the paper's weights -----------------------------------------------------------------------------------------


def weights(u: ArrayLike) -> Array:
    """The weights that equations 9 to 13 lead to: inverse squares of the combined uncertainty, summing to one.

    u: (n,) or (n, 3) standard uncertainties of the points [m]. The equations are linear with this one solution;
    the printed "several solutions, of which one meets the requirements" are not there.
    """
    u = np.asarray(u, float)
    square = u**2 if u.ndim == 1 else np.sum(u**2, axis=1)
    return (1.0 / square) / np.sum(1.0 / square)


def weight_problem(u: ArrayLike) -> Problem:
    """Equations 10 to 12 declared: the sum of squares of weight times uncertainty is least, the weights sum to one.

    u: (n,) combined standard uncertainties of the points [m]; only their ratios matter, so they enter as such.
    """
    ratio = np.asarray(u, float) / np.min(u)
    n = len(ratio)
    weight = Unknown("weight", np.full(n, 1.0 / n), parts=[str(i + 1) for i in range(n)])
    terms = Observations(lambda weight, ratio: weight * ratio, weight, ratio[None, :], readings=np.zeros((1, n)), u=1.0,
                         group="weighted uncertainty")
    total = Constraint("sum of weights", lambda weight: ca.sum1(weight), weight, lower=1.0, upper=1.0, tolerance=1e-12)
    return Problem([terms], [total], name="equations 10 to 13")
