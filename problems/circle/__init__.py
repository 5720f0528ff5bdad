"""Space circle: orthogonal distance through points with a covariance each.

Every point has its foot on the circle, whose angle is an unknown of its own (errors in variables): the residual is the
whole vector from the foot to the point, weighed by the 3x3 covariance of that point.
Source: Forbes 1989, NPL report DITC 140/89, least-squares best-fit geometric elements; `problems.circle.pairwise` holds
the objectives of Li, Cao, Qu 2020 for the same circle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import (
    Direction,
    Effect,
    Estimate,
    Gaussian,
    Observations,
    Parameter,
    Problem,
    Quantity,
    Shared,
    Unknown,
    direct,
    simulate,
)
from calib.analyse.shapes import scene as follows
from calib.geometry import cross, dot, unit
from calib.scene import Points, Scene, Track
from calib.table import written, xyz_mm
from calib.units import arcsec, degree, hour, minute, um
from instruments import influence, laser_tracker
from problems import measured_points
from problems.circle import algebraic, alternatives
from problems.circle.algebraic import SpaceCircle
from problems.recorded import recorded

if TYPE_CHECKING:
    from calib.job import Job
    from calib.workflow.compare.formulation import Formulation

Array = NDArray[np.float64]
AXIS = "ISO 230-7:2015, error motions of an axis of rotation"
STAND = "stand and floor under a measuring instrument, bench experience"


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


def effects(blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """Second harmonics of the circle, in the plane and along the axis; drift and steps of the measuring frame.

    blocks: values of covariate `block` at which the frame may have jumped. Inputs: covariates `time` [s], `block`.
    """
    size = (0.2 * um, 100.0 * um)
    pair = (Parameter("c", "um", size), Parameter("s", "um", size))
    axes = (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1)))
    return (
        Effect("ovality", "point", lambda value, p, foot, centre:
               (p.c * ca.cos(2.0 * foot) + p.s * ca.sin(2.0 * foot)) * unit(value - centre), pair, "radius",
               source=AXIS),
        Effect("axial_runout_2x", "point", lambda value, p, foot, normal:
               (p.c * ca.cos(2.0 * foot) + p.s * ca.sin(2.0 * foot)) * normal, pair, "axis", source=AXIS),
        *(influence.drift("point", "um", (1.0 * um / hour, 200.0 * um / hour), channel=name, along=along, source=STAND)
          for name, along in axes),
        *(step for name, along in axes
          for step in influence.steps("point", "um", (2.0 * um, 500.0 * um), blocks, channel=name, along=along,
                                      source=STAND)))


# --- the declaration ---------------------------------------------------------------------------------------------


def start(points: ArrayLike, command: ArrayLike | None = None) -> SpaceCircle:
    """An algebraic start (Pratt) for the circle through points (n, 3) [m]; command: (n,) [rad] angles as commanded."""
    return algebraic.space_circle(points, algebraic.pratt, command)


def declare(points: ArrayLike, u: ArrayLike | Gaussian, command: ArrayLike | None = None,
            begin: SpaceCircle | None = None, rows: ArrayLike | None = None,
            covariates: Mapping[str, Any] | None = None) -> Problem:
    """A space circle by orthogonal distance; quantity `angle` is the turn from the first point to each other.

    points: (n, 3) [m]; u: standard uncertainties [m], a number, (3,) or (n, 3), or Gaussian.matrix of (n, 3, 3) [m^2].
    command: (n,) [rad] commanded angles, where the points do not follow each other by less than half a turn.
    begin: start values; the algebraic start where None. rows: (n,) row numbers of the file; covariates: time [s],
    block, each (n,), which bring their effects. Every effect is attached, zero and held.
    Raises InputError for fewer than three points, points at one position or on a line.
    """
    points = algebraic.checked(points)
    begin = start(points, command) if begin is None else begin
    n = len(points)
    centre = Unknown("centre", begin.centre, unit="mm", parts=("x", "y", "z"))
    normal = Direction("normal", begin.normal)
    radius = Unknown("radius", begin.radius, unit="mm")
    foot = Unknown("foot", begin.foot[:, None], unit="deg")
    measured = Observations(point_on_circle, foot.each, centre, normal, radius, Shared(begin.reference),
                            readings=points, u=u, group="points", unit="mm", components=("x", "y", "z"), rows=rows,
                            covariates={"position": np.arange(1, n + 1), **(covariates or {})})
    blocks = np.unique(measured.covariates["block"])[1:].tolist() if "block" in measured.covariates else []
    candidates = [e for e in effects(blocks) if set(e.inputs) & {"time", "block"} <= set(measured.covariates)]
    angle = Quantity("angle", turned, foot[np.arange(1, n)], foot[np.zeros(n - 1, dtype=int)], unit="deg",
                     keys=range(2, n + 1))
    return Problem([measured], quantities=[angle], effects=candidates, name="space circle")


# --- jobs and examples -------------------------------------------------------------------------------------------

accepts = ("circle",)


def from_job(job: Job) -> Problem:
    """A space circle from a job.

    Table `points`: x, y, z (length), optionally command (angle), time, block. Its instrument: kind = "coordinates"
    with one u for all coordinates, or kind = "laser_tracker" with sigma_range, sigma_azimuth, sigma_zenith, or with
    u = "a + b L".
    """
    table = job.table("points")
    points = np.column_stack([table.number(name, "length") for name in ("x", "y", "z")])
    command = table.number("command", "angle") if table.has("command") else None
    u = measured_points.stated(job.instrument("points"), points)
    return declare(points, u, command, rows=table.row_numbers, covariates=recorded(job, table))


def formulations(job: Job) -> dict[str, Formulation]:
    """The objectives of the paper, algebraic fits and a bound beside the orthogonal distance, for the points of a job.

    Weights by equations 9 to 13, from the stated covariance of each point.
    """
    table = job.table("points")
    return alternatives.formulations(table.number("command", "angle") if table.has("command") else None)


def example_points(seed: int) -> tuple[Array, Array]:
    """Thirteen points (13, 3) [m] on a radius of 200 mm, 3 m from a tracker, and their covariances (13, 3, 3)."""
    command = np.arange(13) * 30.0 * degree
    centre, normal = np.array([2.6, -1.4, 0.4]), np.array([0.10, -0.05, 0.99])
    first, second = in_plane(normal / np.linalg.norm(normal), np.array([1.0, 0.0, 0.0]))
    points = centre + 0.2 * (np.cos(command)[:, None] * first + np.sin(command)[:, None] * second)
    polar = laser_tracker.polar_readings(points)
    covariance = laser_tracker.cartesian_covariance(polar, [2.0 * um, 1.0 * arcsec, 1.0 * arcsec])
    noisy = simulate(declare(points, Gaussian.matrix(covariance)), None, seed)
    return np.asarray(noisy.observations[0].readings), covariance


def example(seed: int) -> Problem:
    """The circle of `example_points` with its covariances, one point every two minutes."""
    points, covariance = example_points(seed)
    return declare(points, Gaussian.matrix(covariance), covariates={"time": (np.arange(13) * 2.0 * minute, "min")})


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with the points of `example_points`: {file name: text}."""
    points, _ = example_points(seed)
    i = np.arange(len(points))
    table = {"i": i + 1, "command_deg": i * 30 * degree, **xyz_mm(points)}
    return {
        "job.toml": 'problem = "problems.circle"\n\n[data.points]\nfile = "points.csv"\ninstrument = "tracker"\n\n'
                    '[instruments.tracker]\nkind = "laser_tracker"\nsigma_range_um = 2.0\nsigma_azimuth_arcsec = 1.0\n'
                    'sigma_zenith_arcsec = 1.0\n\n[report]\nquantities = ["centre", "radius", "angle"]\n',
        "points.csv": written(f"simulated, seed {seed}", table)}


def scene(job: Job, estimate: Estimate) -> Scene:
    """The points as measured, the circle through them, its centre with its uncertainty and its axis."""
    measured, problem = estimate.problem.observations[0], estimate.problem
    centre, normal, radius = (estimate[problem.select(name).unknown] for name in ("centre", "normal", "radius"))
    first, second = np.linalg.svd(np.reshape(normal, (1, 3)))[2][1:]
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    around = np.ravel(centre) + float(radius) * (np.outer(np.cos(angle), first) + np.outer(np.sin(angle), second))
    return Scene((*follows(estimate.fit).shapes, Points("measured", measured.recorded), Track("circle", around)))
