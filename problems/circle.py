"""Space circle: orthogonal distance through points with a covariance each, and the paper's pairwise objectives.

Every point has its foot on the circle, whose angle is an unknown of its own (errors in variables): the residual is the
whole vector from the foot to the point, weighed by the 3x3 covariance of that point.
Source of the pairwise objectives and of the weights: Li, Cao, Qu 2020, equations 8 to 14 ("the paper").
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import Constraint, Direction, Gaussian, Observations, Problem, Quantity, Shared, Unknown, direct, simulate
from calib.errors import InputError
from calib.geometry import cross, dot, norm, unit
from calib.units import arcsec, degree, mm, um
from instruments import laser_tracker
from problems import algebraic_circle
from problems.algebraic_circle import SpaceCircle

if TYPE_CHECKING:
    from calib.job import Job
    from calib.settings import Settings

Array = NDArray[np.float64]


# --- the physics -------------------------------------------------------------------------------------------------


def in_plane(normal: Any, reference: Any) -> tuple[Any, Any]:
    """Two unit vectors (3,) across a unit normal (3,): the first nearest a reference (3,), the second right-handed."""
    first = unit(reference - normal * dot(reference, normal))
    return first, cross(normal, first)


def point_on_circle(foot: Any, centre: Any, normal: Any, radius: Any, reference: Any, *, point: Any = direct) -> Any:
    """The point (3,) [m] of a circle at a foot angle [rad] counted from a reference (3,) about the normal (3,)."""
    first, second = in_plane(normal, reference)
    return point(centre + radius * (ca.cos(foot) * first + ca.sin(foot) * second), foot=foot, normal=normal)


def turned(foot: Any, first_foot: Any) -> Any:
    """Angle [rad] from the foot of the first point to another foot."""
    return foot - first_foot


# --- the declaration ---------------------------------------------------------------------------------------------


def start(points: ArrayLike, command: ArrayLike | None = None) -> SpaceCircle:
    """An algebraic start (Pratt) for the circle through points (n, 3) [m]; command: (n,) [rad] angles as commanded."""
    return algebraic_circle.space_circle(points, algebraic_circle.pratt, command)


def declare(points: ArrayLike, u: ArrayLike | Gaussian, command: ArrayLike | None = None,
            begin: SpaceCircle | None = None, rows: ArrayLike | None = None,
            covariates: Mapping[str, Any] | None = None) -> Problem:
    """A space circle by orthogonal distance; quantity `angle` is the turn from the first point to each point.

    points: (n, 3) [m]; u: standard uncertainties [m], a number, (3,) or (n, 3), or Gaussian.matrix of (n, 3, 3) [m^2].
    command: (n,) [rad] commanded angles, where the points do not follow each other by less than half a turn.
    begin: start values; the algebraic start where None. rows: (n,) row numbers of the file; covariates: {name: (n,)}.
    Raises InputError for fewer than three points, points at one position or on a line.
    """
    points = _checked(points)
    begin = start(points, command) if begin is None else begin
    n = len(points)
    centre = Unknown("centre", begin.centre, unit="mm", parts=("x", "y", "z"))
    normal = Direction("normal", begin.normal)
    radius = Unknown("radius", begin.radius, unit="mm")
    foot = Unknown("foot", begin.foot[:, None], unit="deg")
    measured = Observations(point_on_circle, foot.each, centre, normal, radius, Shared(begin.reference),
                            readings=points, u=u, group="points", unit="mm", components=("x", "y", "z"), rows=rows,
                            covariates={"position": np.arange(1, n + 1), **(covariates or {})})
    angle = Quantity("angle", turned, foot.each, foot[np.zeros(n, dtype=int)], unit="deg", keys=range(1, n + 1))
    return Problem([measured], quantities=[angle], name="space circle")


def _checked(points: ArrayLike) -> Array:
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"points have shape {points.shape}; give (n, 3): x, y and z of each point in metres")
    return points


# --- the paper's objectives, solved by the engine ----------------------------------------------------------------


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
    points, (i, j) = _checked(points), np.triu_indices(len(points), 1)
    return _pairwise(points, begin, "equation 8", distance_difference, (points[i], points[j]), np.sqrt(0.5),
                     np.sqrt(1.0 / len(points)))


def weighted_pairwise(points: ArrayLike, weights: ArrayLike, begin: SpaceCircle | None = None) -> Problem:
    """The objective of equation 14 as printed, which is not zero on an exact circle unless all weights are equal.

    points: (n, 3) [m]; weights: (n,) that sum to one; begin: start values. Readings as in `pairwise`.
    """
    points, w, (i, j) = _checked(points), np.asarray(weights, float), np.triu_indices(len(points), 1)
    return _pairwise(points, begin, "equation 14", weighted_square_difference, (points[i], points[j], w[i], w[j]),
                     np.sqrt(0.5), 1.0 / np.sqrt(len(points) * w))


def repaired_pairwise(points: ArrayLike, weights: ArrayLike, begin: SpaceCircle | None = None) -> Problem:
    """Equation 14 as it must be meant: a pair weighs as the product of its weights, a plane distance as its weight.

    points: (n, 3) [m]; weights: (n,) that sum to one; begin: start values. The sum of w_i w_j (d_i - d_j)^2 over the
    pairs is the weighted variance of the distances, so this is the weighted orthogonal fit up to the axial part of d.
    """
    points, w, (i, j) = _checked(points), np.asarray(weights, float), np.triu_indices(len(points), 1)
    return _pairwise(points, begin, "equation 14 repaired", distance_difference, (points[i], points[j]),
                     1.0 / np.sqrt(w[i] * w[j]), 1.0 / np.sqrt(w))


def _pairwise(points: Array, begin: SpaceCircle | None, name: str, difference: Callable[..., Any],
              rows: tuple[Array, ...], u_pairs: ArrayLike, u_plane: ArrayLike) -> Problem:
    begin = start(points) if begin is None else begin
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


# --- jobs and examples -------------------------------------------------------------------------------------------

accepts = ("circle",)


def from_job(job: Job) -> Problem:
    """A space circle from a job.

    Table `points`: x, y, z (length), optionally `command` (angle). Its instrument: kind = "coordinates" with one u
    for all coordinates, or kind = "laser_tracker" with sigma_range, sigma_azimuth, sigma_zenith, or u = "a + b L".
    """
    table = job.table("points")
    points = np.column_stack([table.number(name, "length") for name in ("x", "y", "z")])
    command = table.number("command", "angle") if table.has("command") else None
    instrument = job.instrument("points")
    kind = instrument.text("kind", among=("coordinates", "laser_tracker"))
    if kind == "coordinates":
        u: Any = instrument.quantity("u", "length")
    else:
        polar = laser_tracker.polar_readings(points)
        u = Gaussian.matrix(laser_tracker.cartesian_covariance(polar, stated_by_tracker(instrument, polar)))
    return declare(points, u, command, rows=table.row_numbers)


def stated_by_tracker(instrument: Settings, polar: Array) -> Array:
    """Standard uncertainties (n, 3) of polar readings (n, 3) [m, rad, rad] from the settings of a laser tracker.

    instrument: with sigma_range, sigma_azimuth, sigma_zenith, or u = "a + b L" for each coordinate at distance L.
    """
    if "u" in instrument:
        fixed, rate = instrument.uncertainty("u", "length")
        return laser_tracker.from_coordinate_statement(fixed, rate, coverage_factor=1.0).at(polar)
    sigma = [instrument.quantity("sigma_range", "length"), instrument.quantity("sigma_azimuth", "angle"),
             instrument.quantity("sigma_zenith", "angle")]
    return np.broadcast_to(sigma, polar.shape)


def example_points(seed: int) -> tuple[Array, Array]:
    """Thirteen points (13, 3) [m] on a radius of 200 mm, 3 m from a tracker, and their covariances (13, 3, 3)."""
    command = np.arange(13) * 30.0 * degree
    centre, normal = np.array([2.6, -1.4, 0.4]), np.array([0.10, -0.05, 0.99])
    first, second = in_plane(normal / np.linalg.norm(normal), np.array([1.0, 0.0, 0.0]))
    points = centre + 0.2 * (np.cos(command)[:, None] * first + np.sin(command)[:, None] * second)
    polar = laser_tracker.polar_readings(points)
    covariance = laser_tracker.cartesian_covariance(polar, [2.0 * um, 1.0 * arcsec, 1.0 * arcsec])
    noisy = simulate(declare(points, Gaussian.matrix(covariance)), None, seed)
    return noisy.observations[0].readings, covariance


def example(seed: int) -> Problem:
    """The circle of `example_points` with its covariances."""
    points, covariance = example_points(seed)
    return declare(points, Gaussian.matrix(covariance))


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with the points of `example_points`: {file name: text}."""
    points, _ = example_points(seed)
    lines = [f"{k + 1},{30 * k},{x / mm:.5f},{y / mm:.5f},{z / mm:.5f}" for k, (x, y, z) in enumerate(points)]
    return {
        "job.toml": 'problem = "problems.circle"\n\n[data.points]\nfile = "points.csv"\ninstrument = "tracker"\n\n'
                    '[instruments.tracker]\nkind = "laser_tracker"\nsigma_range_um = 2.0\nsigma_azimuth_arcsec = 1.0\n'
                    'sigma_zenith_arcsec = 1.0\n\n[report]\nquantities = ["angle"]\n',
        "points.csv": f"# source: simulated, seed {seed}\ni,command_deg,x_mm,y_mm,z_mm\n" + "\n".join(lines) + "\n"}
