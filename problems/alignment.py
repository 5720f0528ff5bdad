"""Alignment of two frames by common points: the pose that carries the points of a part onto where they are seen.

Every point is seen with a 3x3 covariance of its own, as a laser tracker gives it, so that no closed form is the
estimate; the semidefinite relaxation proves whether the pose found is the best of all.
Source: Umeyama 1991, IEEE Trans. PAMI 13, 376-380 (equal weights); Briales & Gonzalez-Jimenez 2017, CVPR, 5612-5621.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import Effect, Gaussian, Observations, Parameter, Pose, Problem, Quantity, Unknown, direct, prior, simulate
from calib import covariance as covariance_of
from calib.errors import InputError
from calib.geometry import Transform, rotation_from_rpy
from calib.scene import Points, Scene, Shape, Sights
from calib.solve.globally import rotation as alignment
from calib.table import written, xyz_mm
from calib.units import arcsec, hour, kelvin_from_celsius, minute, ppm, um
from instruments import influence, laser_tracker
from problems import measured_points
from problems.recorded import recorded

if TYPE_CHECKING:
    from calib import Estimate
    from calib.job import Job
    from calib.solve.globally.bound import Bound
    from calib.table import Table
    from calib.workflow.compare.formulation import Formulation

Array = NDArray[np.float64]
STAND = "stand and floor under a measuring instrument, bench experience"
GROWTH = "ISO 1:2022, reference temperature; steel 11.5, aluminium 23 ppm/K"


# --- the physics -------------------------------------------------------------------------------------------------


def seen_point(seen_from_part: Any, point: Any, *, part_point: Any = direct, seen: Any = direct) -> Any:
    """Where a point (3,) [m] of the part is seen. Slots: `part_point`, the point on the part; `seen`, as it is seen."""
    return seen(seen_from_part @ part_point(point))


def effects(blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """Scale and thermal growth of the part; drift and steps of the measuring frame.

    blocks: values of covariate `block` at which the frame may have jumped. Inputs: covariates `time` [s],
    `temperature_difference` [K], `block`.
    """
    axes = (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1)))
    return (
        Effect("scale", "part_point", lambda value, p: p.k * value, (Parameter("k", "ppm", (0.5 * ppm, 200 * ppm)),),
               "part", source="scale of the range against that of the part's drawing, bench experience"),
        Effect("thermal", "part_point",
               lambda value, p, temperature_difference: p.coef * temperature_difference * value,
               (Parameter("coef", "ppm/K", (0.5 * ppm, 30 * ppm)),), "part", source=GROWTH),
        *(influence.drift("seen", "um", (1.0 * um / hour, 200.0 * um / hour), channel=name, along=along, source=STAND)
          for name, along in axes),
        *(step for name, along in axes
          for step in influence.steps("seen", "um", (2.0 * um, 500.0 * um), blocks, channel=name, along=along,
                                      source=STAND)))


# --- the declaration ---------------------------------------------------------------------------------------------


def start(points: ArrayLike, seen: ArrayLike) -> Transform:
    """The pose of least squares with equal weights, in closed form.

    points, seen: (n, 3) [m] on the part and where they are seen. Raises InputError for fewer than three points, or
    points on a line, about which the part may turn.
    """
    points, seen = np.asarray(points, float), np.asarray(seen, float)
    if len(points) < 3:
        raise InputError(f"a pose needs three points that are not on a line; there are {len(points)}. Measure more "
                         "common points.")
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if extent[1] <= 1e-9 * max(extent[0], 1.0):
        raise InputError("all points lie on a line, about which the part may turn unseen; add a point off that line")
    return Transform(*alignment.closed_form(points, seen))


def declare(points: ArrayLike, seen: ArrayLike, covariance: ArrayLike, u_points: float = 0.0,
            names: Sequence[str] | None = None, targets: Mapping[str, ArrayLike] | None = None,
            covariates: Mapping[str, Any] | None = None, rows: ArrayLike | None = None) -> Problem:
    """The pose of a part from points on it that are seen elsewhere.

    points: (n, 3) on the part [m]; seen: (n, 3) [m]; covariance: (n, 3, 3) of what is seen [m^2]; u_points: standard
    uncertainty of the coordinates on the part [m], alike in all directions, so that it turns with the part unchanged
    and adds to the covariance. names: (n,), all sightings of one name share its error on the part. targets: {name: (3,)
    [m]} further points of the part, whose place is wanted. covariates: time [s], temperature_difference [K], block,
    which bring their effects; rows: (n,) of the file. Every effect is attached, zero and held.
    Raises InputError as `start`.
    """
    points = np.asarray(points, float)
    pose = _unknown_pose(points, seen)
    labels = np.array([str(name) for name in names or range(1, len(points) + 1)])
    measured = Observations(seen_point, pose, points, readings=seen, group="points", unit="mm",
                            u=_stated(np.asarray(covariance, float), u_points, labels), components=("x", "y", "z"),
                            rows=rows, covariates={"point": labels, **(covariates or {})})
    blocks = np.unique(measured.covariates["block"])[1:].tolist() if "block" in measured.covariates else []
    drivers = {"time", "temperature_difference", "block"}
    candidates = [e for e in effects(blocks) if set(e.inputs) & drivers <= set(measured.covariates)]
    wanted = [] if not targets else [
        Quantity("target", lambda pose, point: pose @ point, pose, np.array(list(targets.values()), float), unit="mm",
                 parts=("x", "y", "z"), keys=list(targets))]
    return Problem([measured], quantities=wanted, effects=candidates, name="alignment of two frames")


def _stated(covariance: Array, u_points: float, names: NDArray[np.str_]) -> Gaussian:
    """Covariance of seen less carried points; the error of a point on the part is common to its sightings."""
    if u_points == 0.0 or len(set(names)) == len(names):
        return Gaussian.matrix(covariance + u_points**2 * np.eye(3))
    of_name = {}
    for name in dict.fromkeys(names.tolist()):
        mine = covariance[names == name]
        k = len(mine)
        own = np.einsum("aij,ab->aibj", mine, np.eye(k)).reshape(3 * k, 3 * k)
        of_name[name] = own + u_points**2 * np.kron(np.ones((k, k)), np.eye(3))
    return Gaussian.groups(names, of_name)


def declare_adjusted(points: ArrayLike, seen: ArrayLike, covariance: ArrayLike, u_points: float,
                     names: Sequence[str]) -> Problem:
    """The same pose with the points of the part adjusted too (errors in variables); arguments as for `declare`."""
    points = np.asarray(points, float)
    keys, first, of_key = np.unique(np.array(names), return_index=True, return_inverse=True)
    adjusted = Unknown("part_point", points[first], unit="mm", parts=("x", "y", "z"), keys=keys.tolist())
    measured = Observations(seen_point, _unknown_pose(points, seen), adjusted[of_key], readings=seen, unit="mm",
                            u=Gaussian.matrix(covariance), group="points", components=("x", "y", "z"))
    return Problem([measured, prior(adjusted, points[first], u_points)], name="alignment, points adjusted")


def _unknown_pose(points: Array, seen: ArrayLike) -> Pose:
    near = start(points, seen)
    return Pose("seen_from_part", near.rotation, near.translation, unit="mm", angle_unit="arcsec")


# --- formulations ------------------------------------------------------------------------------------------------


def formulations(job: Job) -> dict[str, Formulation]:
    """Closed forms, points of the part adjusted or taken as exact, and the relaxation that proves a pose."""
    from calib.workflow.compare.formulation import ClosedForm, Global

    common = Common.read(job)

    def closed(weights: Array | None) -> ClosedForm:
        def values(declared: Problem) -> dict[str, Any]:
            seen = np.asarray(declared.observations[0].readings)
            return {"seen_from_part": Transform(*alignment.closed_form(common.points, seen, weights))}
        return ClosedForm(values, "Umeyama 1991")

    variance = np.trace(common.covariance, axis1=1, axis2=2) + 3.0 * common.u_points**2
    found: dict[str, Formulation] = {
        "closed form, equal weights": closed(None),
        "closed form, a weight a point": closed(1.0 / variance),
        "semidefinite relaxation": Global(lambda declared: {}, lambda estimate: bound(estimate, common.points),
                                          "Briales, Gonzalez-Jimenez 2017")}
    if common.u_points > 0.0:
        these = common.points, common.seen, common.covariance
        found["points adjusted too"] = declare_adjusted(*these, common.u_points, common.names)
        found["points taken as exact"] = declare(*these, targets=common.targets)
    return found


def bound(estimate: Estimate, points: ArrayLike) -> Bound:
    """How far v'Pv of an estimated alignment of points (n, 3) [m] can lie above the least over all poses.

    Raises InputError where an effect is free, or sightings of one point share its error: neither has a place in the
    relaxation.
    """
    problem = estimate.problem
    if any(not problem.is_held(one.unknown).all() for one in problem.attached):
        raise InputError("an effect is estimated too, for which the relaxation has no place")
    group = estimate.fit.groups[0]
    (whitening, *further) = group.weighting.whitening
    if further or whitening.rows.shape[1] > 1:
        raise InputError("sightings of one point share its error on the part, for which the relaxation has no place")
    spread = np.linalg.inv(whitening.matrix.transpose(0, 2, 1) @ whitening.matrix)
    return alignment.pose_bound(points, np.asarray(group.readings), spread, estimate["seen_from_part"].rotation)


# --- jobs and examples -------------------------------------------------------------------------------------------

accepts = ("alignment",)


@dataclass(frozen=True)
class Common:
    """What a job says of the points that both tables name, in the order in which they were seen."""

    names: tuple[str, ...]
    points: Array
    seen: Array
    covariance: Array
    u_points: float
    targets: Mapping[str, Array]

    @staticmethod
    def read(job: Job) -> Common:
        """From the tables `part` and `seen` of a job. Raises InputError for a point that the part does not have."""
        part, seen = job.table("part"), job.table("seen")
        nominal = dict(zip(part.text("point"), _coordinates(part), strict=True))
        names = tuple(seen.text("point"))
        strange = [name for name in names if name not in nominal]
        if strange:
            raise InputError(f"{seen.path}: point '{strange[0]}' is seen but is not in {part.path} (there: "
                             f"{', '.join(nominal)}); add its coordinates there, or take its row out")
        places = _coordinates(seen)
        return Common(names, np.array([nominal[name] for name in names]), places,
                      measured_points.covariance(job.instrument("seen"), places),
                      job.options.quantity("u_points", "length", 0.0),
                      {name: place for name, place in nominal.items() if name not in names})


def _coordinates(table: Table) -> Array:
    return np.column_stack([table.number(name, "length") for name in ("x", "y", "z")])


def from_job(job: Job) -> Problem:
    """An alignment from a job.

    Table `part`: point, x, y, z (length), as drawn or calibrated; points that are not seen are carried over. Table
    `seen`: point, x, y, z, optionally time, temp, block. Instrument of `seen`: as `measured_points.stated` takes it.
    Options: u_points of the coordinates on the part (0), reference_temperature (20 degC).
    """
    common, seen = Common.read(job), job.table("seen")
    return declare(common.points, common.seen, common.covariance, common.u_points, common.names, common.targets,
                   recorded(job, seen), seen.row_numbers)


def scene(job: Job, estimate: Estimate) -> Scene:
    """Points as seen, and those carried over, with their uncertainty; the lines of sight of a tracker."""
    common = Common.read(job)
    shapes: list[Shape] = [Points("seen", common.seen, common.names, common.covariance)]
    if job.instrument("seen").text("kind") == "laser_tracker":
        origin = np.zeros(3)
        shapes += [Points("tracker", origin, ["tracker"]), Sights("points", origin, common.seen)]
    if common.targets:
        carried = covariance_of(estimate.fit, "target")
        blocks = carried.matrix.reshape(len(common.targets), 3, len(common.targets), 3)
        shapes.append(Points("carried over", carried.values, list(common.targets), np.einsum("aiaj->aij", blocks)))
    return Scene(tuple(shapes))


PART = np.array([[x, y, z] for x in (0.0, 0.6, 1.2) for y in (0.0, 0.8) for z in (0.0, 0.5)])
TRACKER = (4.0 * um, 1.5 * arcsec, 1.5 * arcsec)     # of range, azimuth, zenith angle
U_POINTS = 5.0 * um
PLACE = Transform(rotation_from_rpy(0.02, -0.03, 2.1), np.array([3.1, -0.9, -0.3]))


def _covariance(seen: Array) -> Array:
    return laser_tracker.cartesian_covariance(laser_tracker.polar_readings(seen), TRACKER)


def example(seed: int) -> Problem:
    """Twelve points of a part 3 m from a tracker, in two blocks, and a tool that is not seen; simulated readings.

    seed: of the errors.
    """
    exact = np.array([PLACE @ point for point in PART])
    covariates = {"time": (np.arange(12) * 2.0 * minute, "min"), "block": np.repeat([1, 2], 6),
                  "temperature_difference": (0.5 + 0.8 * np.sin(np.arange(12.0)), "K")}
    order = np.argsort(np.arange(12) % 2, kind="stable")     # neither block sees one side of the part only
    problem = declare(PART[order], exact[order], _covariance(exact[order]), U_POINTS, [f"P{k + 1}" for k in order],
                      {"tool": np.array([0.6, 0.4, 0.9])}, covariates)
    return simulate(problem, None, seed)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with the readings of `example`: {file name: text}."""
    measured = example(seed).observations[0]
    c = measured.covariates
    part = {"point": np.array([*(f"P{k + 1}" for k in range(len(PART))), "tool"]),
            **xyz_mm(np.vstack([PART, (0.6, 0.4, 0.9)]))}
    seen = {"point": c["point"], "time_min": c["time"], "block": c["block"],
            "temp_C": kelvin_from_celsius(20.0 + c["temperature_difference"]), **xyz_mm(measured.recorded)}
    return {
        "job.toml": 'problem = "problems.alignment"\n\n[data.part]\nfile = "part.csv"\n\n'
                    '[data.seen]\nfile = "seen.csv"\ninstrument = "tracker"\n\n'
                    '[instruments.tracker]\nkind = "laser_tracker"\nsigma_range_um = 4.0\nsigma_azimuth_arcsec = 1.5\n'
                    'sigma_zenith_arcsec = 1.5\n\n[options]\nu_points = "5 um"\n\n'
                    '[report]\nquantities = ["seen_from_part", "target"]\n',
        "part.csv": written("simulated part with twelve points and a tool", part),
        "seen.csv": written(f"simulated, seed {seed}", seen)}
