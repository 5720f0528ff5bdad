"""Two-axis positioner: both axes in space, their angle and their offset, from measured poses of a target on the table.

A tilting axis A carries a turning table C. An instrument that stands still (camera, tracker) measures the pose of a
target on the table. Base frame: X along the axis A, at its zero Z along the table's axis; the instrument's place and
the target's place are unknown, so that of the table's location only its offset from A (`EY0C`) and its tilt against A
(`EB0C`) remain, which readings see whatever the mounting. Everything else that a mechanism may do (scales, encoders,
error motions, deflection) are candidates: off, held or free by the option `free`.
Source: ISO 230-1:2012 (location errors); data of ROS-Industrial, industrial_calibration, example kinematic_calibration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from casadi import vertcat
from numpy.typing import ArrayLike

from calib import (
    Effect,
    Estimate,
    Observations,
    Pose,
    Problem,
    Quantity,
    Shared,
    covariance,
    geometry,
    simulate,
    solve,
)
from calib.analyse.score import scores
from calib.job import Job
from calib.linearisation import Linearisation
from calib.mechanism import (
    Frame,
    Load,
    Mechanism,
    Rotary,
    encoder_harmonic,
    error_motion,
    location_errors,
    observe,
    sag,
    scale,
)
from calib.mechanism.heldout import misses, rms
from calib.mechanism.inputs import checked_positions, other_quaternion_order
from calib.mechanism.read import measured_poses
from calib.mechanism.resolved import quantity
from calib.mechanism.scene import measured
from calib.mechanism.smooth import Smooth, distances, smooth_errors
from calib.mechanism.start import misfit, world_and_target
from calib.scene import Scene
from calib.table import written
from calib.units import degree, mm, mrad

accepts = ("problems.positioner",)
LOCATION = ("EY0C (C)", "EB0C (C)")      # what every measurement of poses sees of the second axis
BLOCKS = 5
options = {
    "measurements": "YAML of poses and joint values, beside the job, under --data or $CALIB_REFERENCE_DATA",
    "u_position, u_orientation": "standard uncertainty of a measured place and turn, each component, by itself",
    "u_smooth_position, u_smooth_orientation": "of what neighbouring poses have in common and no effect explains",
    "reach_position, reach_orientation": "how far in the axes' positions that reaches (fallen to exp(-1/2)), 0.5 rad",
    "errors": "\"free\" (if not given), or \"held\": the axes as designed, each error a candidate for discover",
    "free": "names of further effects to estimate, such as [\"scale_A\", \"ECC\"]",
}
columns = {"poses": {"A, C": "positions of the axes", "x, y, z": "place of the target",
                     "qw, qx, qy, qz": "its orientation"}}


@lru_cache(maxsize=1)
def positioner() -> Mechanism:
    """The mechanism as designed: two axes that cross at a right angle; the table's weight rests off the axis A."""
    return Mechanism("positioner", axes=[Rotary("A", direction=(1, 0, 0)),
                                         Rotary("C", direction=(0, 0, 1), carried_by="A")],
                     frames=[Frame("table", carried_by="C")], loads=[Load("table", (0, 0, 0.5), "A")])


@lru_cache(maxsize=1)
def effects() -> tuple[Effect, ...]:
    """Candidates: location of C, scale and encoder of both axes, error motions, deflection of A under the table's
    weight."""
    mechanism = positioner()
    drives = [effect for axis in mechanism.axes
              for effect in (scale(axis), encoder_harmonic(axis, 1), encoder_harmonic(axis, 2))]
    motions = [error_motion(axis, component, (2, 3)) for axis in mechanism.axes for component in "XYZABC"
               if axis.name == "C" or component in "ABC"]
    return (*(e for e in location_errors(mechanism, ["C"]) if e.label in LOCATION), *drives, *motions,
            sag(mechanism, mechanism.axis("A")))


def declare(positions: ArrayLike, places: ArrayLike, rotations: ArrayLike, u_position: float, u_orientation: float,
            free: Sequence[str] = (), rows: ArrayLike | None = None, measured: bool = True,
            smooth: tuple[Smooth, Smooth] | None = None) -> Problem:
    """Declare the identification of the positioner.

    positions: (n, 2) of A and C [rad]; places: (n, 3) [m] and rotations: (n, 3, 3) of the target as measured (or
    roughly, with measured=False, to plan or simulate); u_position [m], u_orientation [rad]: standard uncertainty of
    each component; free: effects to estimate beside the location of C; rows: numbers in the data file; smooth: in place
    of the uncertainties, those of a place [m] and of a turn [rad] with what neighbouring poses have in common.
    Returns the problem with the unknowns `instrument_from_base` and `table_from_target`, the location of C free, and
    the quantities `angle` and `offset` between the axes and `axis_A`, `axis_C` (direction and a point, instrument's
    frame).
    """
    mechanism = positioner()
    positions = checked_positions(mechanism, positions, rows)
    world, target = world_and_target(rotations, places, *mechanism.poses("table", positions))
    instrument_from_base = Pose("instrument_from_base", world.rotation, world.translation, unit="mm", angle_unit="mrad")
    table_from_target = Pose("table_from_target", target.rotation, target.translation, unit="mm", angle_unit="mrad")
    readings = observe.pose_readings(places, rotations) if measured else None
    place, turn = smooth or (Smooth(u_position), Smooth(u_orientation))
    observations = Observations(
        observe.measured_pose(mechanism.pose("table")), instrument_from_base, positions, table_from_target,
        np.asarray(rotations),
        readings=readings, u=smooth_errors(mechanism, positions, [place] * 3 + [turn] * 3), group="pose",
        rows=rows,
        components=("x", "y", "z", "rx", "ry", "rz"), unit=["mm"] * 3 + ["mrad"] * 3,
        covariates={name: (positions[:, i], "rad") for i, name in enumerate(("A", "C"))})
    problem = Problem([observations], effects=effects(), name="two-axis positioner")
    problem = problem.free(*(problem.parameters(name) for name in (*LOCATION, *free)))
    return problem.with_quantities(*_quantities(mechanism.pose("table"), problem, instrument_from_base))


def _quantities(table: Any, problem: Problem, instrument_from_base: Pose) -> list[Quantity]:
    """Angle and offset of the axes, and both as lines in the instrument's frame, all positions at zero."""
    def axes(pose: Any, positions: Any) -> Any:
        second, origin, first = pose(positions), np.zeros(3), np.array([1.0, 0.0, 0.0])
        return vertcat(observe.angle_between(first, second.rotation[:, 2]),
                       geometry.signed_line_distance(origin, first, second.translation, second.rotation[:, 2]))

    def tilting_axis(world: Any) -> Any:
        return vertcat(world.rotation[:, 0], world.translation)

    def table_axis(pose: Any, world: Any, positions: Any) -> Any:
        line = world @ pose(positions)
        return vertcat(line.rotation[:, 2], line.translation)
    at_zero = Shared(np.zeros(2))
    line: dict[str, Any] = {"unit": ["1"] * 3 + ["mm"] * 3, "parts": ("dx", "dy", "dz", "x", "y", "z")}
    return [quantity(problem, "axes", table, axes, at_zero, unit=["deg", "mm"], parts=("angle", "offset")),
            Quantity("axis_A", tilting_axis, instrument_from_base, **line),
            quantity(problem, "axis_C", table, table_axis, instrument_from_base, at_zero, **line)]


def from_job(job: Job) -> Problem:
    """Declare the positioner of a job: `[options] measurements` (YAML) or the table [data.poses].

    Raises InputError for missing columns, positions that cannot be, or quaternions of the wrong length or order.
    """
    positions, places, rotations, rows = _read(job)
    u_position = job.options.quantity("u_position", "length")
    u_orientation = job.options.quantity("u_orientation", "angle")
    said, length, angle = job.options, "length", "angle"
    smooth = (Smooth(u_position, said.quantity("u_smooth_position", length, 0.0),
                     said.quantity("reach_position", angle, 0.5)),
              Smooth(u_orientation, said.quantity("u_smooth_orientation", angle, 0.0),
                     said.quantity("reach_orientation", angle, 0.5)))
    problem = declare(positions, places, rotations, u_position, u_orientation, job.options.texts("free", ()), rows,
                      smooth=smooth)
    if job.options.text("errors", "free", ("free", "held")) == "free":
        return problem
    return problem.hold(*(a.unknown for a in problem.attached))


def _read(job: Job) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    if "measurements" in job.options:
        found = measured_poses(job.file(job.options.text("measurements")))
        rows, positions, places, quaternions, where = (np.arange(1, len(found.names) + 1), found.positions,
                                                       found.places,
                                                       found.quaternions, str(found.path))
    else:
        table = job.table("poses")
        rows, where = table.row_numbers, str(table.path)
        positions = np.stack([table.number(name, "angle") for name in "AC"], axis=1)
        places = np.stack([table.number(name, "length") for name in "xyz"], axis=1)
        quaternions = np.stack([table.number(name) for name in ("qw", "qx", "qy", "qz")], axis=1)
    positions = checked_positions(positioner(), positions, rows, where)
    w, x, y, z = quaternions.T
    rotations = observe.rotations_from_quaternions(w, x, y, z, where, rows)
    frames = positioner().poses("table", positions)
    other = observe.rotations_from_quaternions(z, w, x, y, where, rows)
    other_quaternion_order(misfit(rotations, places, *frames), misfit(other, places, *frames), where)
    return positions, places, rotations, rows


def blocks_of(positions: ArrayLike) -> np.ndarray:
    """Which of BLOCKS held-out sets each pose belongs to: neighbours in both axes stay together (patches of 3 by 4
    levels)."""
    levels = [np.unique(np.round(column, 2), return_inverse=True)[1] for column in np.asarray(positions).T]
    return (levels[0] // 3 * 4 + levels[1] // 4) % BLOCKS


def in_columns(observations: Observations) -> tuple[str, Mapping[str, np.ndarray]] | None:
    """Table and columns (SI) that hold the readings of a group, for a job of simulated poses."""
    return ("poses", observe.pose_columns(observations)) if observations.group == "pose" else None


def blocks(problem: Problem) -> Mapping[str, np.ndarray]:
    """Poses that are neighbours, which are left out together: {group: (n,) block}."""
    pose = next(o for o in problem.observations if o.group == "pose")
    return {"pose": blocks_of(np.stack([pose.covariates[name] for name in "AC"], axis=1))}


def heldout(job: Job, estimate: Estimate) -> list[tuple[str, float, float, str]]:
    """Residuals of poses that were not used: designed axes before, identified axes after; each block predicted from the
    rest.

    Returns (quantity, before, after, unit) of the rms place and turn residual of a pose.
    """
    problem = estimate.problem
    free = [a.unknown for a in problem.attached if not problem.is_held(a.unknown).all()]
    designed, identified = misses(problem, "pose", blocks(problem)["pose"], free, estimate)
    return [(f"rms {what} residual of a pose not used", rms(designed[:, part]) / scale,
             rms(identified[:, part]) / scale, unit)
            for what, part, scale, unit in (("place", slice(0, 3), mm, "mm"), ("turn", slice(3, 6), degree, "deg"))]


def uncertainty_by_blocks(estimate: Estimate) -> dict[str, tuple[float, float, float]]:
    """Value, stated uncertainty and uncertainty by leaving out blocks of the angle and the offset of the axes [rad, m].

    Where residuals of neighbouring poses are alike and poses are stated to be independent, the stated uncertainty is
    too small; the jackknife over blocks of neighbours is not.
    Source: Efron and Stein, Annals of Statistics 9(3), 1981 (the jackknife estimate of variance).
    """
    block_of = blocks(estimate.problem)["pose"]
    found = np.array([solve(estimate.problem.keep({"pose": block_of != block}), start=estimate)["axes"]
                      for block in np.unique(block_of)])
    spread = np.sqrt((len(found) - 1) / len(found) * np.sum((found - np.mean(found, axis=0)) ** 2, axis=0)).ravel()
    stated = covariance(estimate.fit, "axes")
    return {name: (float(value), float(u_stated), float(u_blocks)) for name, value, u_stated, u_blocks
            in zip(stated.names, stated.values, stated.u, spread, strict=True)}


def advice(fit: Linearisation) -> tuple[str, ...]:
    """What remains after the identification, and whether it has structure: sentences with numbers."""
    poses = fit.group("pose")
    place, turn = (np.sqrt(np.sum(poses.residual[:, part] ** 2, axis=1)) for part in (slice(0, 3), slice(3, 6)))
    said = [f"A pose misses the identified axes by {np.sqrt(np.mean(place ** 2)) / mm:.3f} mm and "
            f"{np.sqrt(np.mean(turn ** 2)) / degree:.4f} degrees (rms of {len(place)}; largest {place.max() / mm:.2f} "
            f"mm, {turn.max() / degree:.3f} degrees)."]
    found = scores(fit)
    level = 0.01 / max(len(found), 1)
    telling = [s for s in found if s.p_value < level and s.separability > 0.01][:3]
    if telling:
        said.append("What remains has structure: " + "; ".join(
            f"freeing {s.candidate.effect.label} would take {s.statistic:.0f} of v'Pv = {fit.objective:.0f} (p = "
            f"{s.p_value:.1g})"
            for s in telling) + ". Such an effect may be of the axes or of the instrument that measured them; a "
                                "held-out check decides.")
    else:
        said.append(f"None of the {len(found)} held effects explains what remains at 1 % over all of them.")
    similar = _neighbours(fit, "pose")
    unlike = 3 / np.sqrt(len(place))
    words = [f"{name} {value:+.2f}" for name, value in zip(poses.components, similar, strict=True)
             if abs(value) > unlike]
    chance = f"(by chance below {unlike:.2f})"
    if words and poses.weighting.whitening[0].rows.shape[1] > 1:
        said.append(f"Residuals/u of neighbouring poses are still alike beyond what is stated as smooth: correlation "
                    f"{', '.join(words)} {chance}.")
    elif words:
        said.append(f"Residuals/u of neighbouring poses are alike: correlation {', '.join(words)} {chance}. They vary "
                    "smoothly with the position, so that uncertainties stated for independent poses are too small: say "
                    "u_smooth_position and u_smooth_orientation.")
    else:
        said.append(f"Residuals/u of neighbouring poses are not alike {chance}: what they have in common is stated.")
    return tuple(said)


def _neighbours(fit: Linearisation, group: str) -> np.ndarray:
    """Correlation (6,) of the whitened residuals of each pose with those of the pose nearest to it in A and C."""
    poses = fit.group(group)
    apart = distances(positioner(), np.stack([poses.covariates[name] for name in "AC"], axis=1))
    np.fill_diagonal(apart, np.inf)
    whitened = np.concatenate([block.residual.reshape(-1, 6) for block in poses.whitened])
    other = whitened[np.argmin(apart, axis=1)]
    return np.asarray(np.sum(whitened * other, axis=0) / np.sum(whitened ** 2, axis=0))


def example(seed: int) -> Problem:
    """48 poses over both axes measured by a camera, with simulated errors of the axes. seed: of the errors."""
    a, c = np.meshgrid(np.linspace(-30, 30, 6) * degree, np.linspace(0, 315, 8) * degree, indexing="ij")
    return simulated(np.stack([a.ravel(), c.ravel()], axis=1), seed)


def simulated(positions: np.ndarray, seed: int, smooth: tuple[Smooth, Smooth] | None = None) -> Problem:
    """Poses at positions (n, 2) [rad] of axes with simulated errors; smooth: as of `declare`."""
    frames, translations = positioner().poses("table", positions)
    world = geometry.Transform(geometry.rotation_from_rpy(0.3, 0.1, 2.0), np.array([0.4, -0.2, 1.9]))
    target = geometry.Transform(geometry.rotation_from_rpy(0.1, -0.2, 0.5), np.array([0.30, 0.15, 0.05]))
    rough = [world @ geometry.Transform(r, t) @ target for r, t in zip(frames, translations, strict=True)]
    problem = declare(positions, np.array([p.translation for p in rough]), np.array([p.rotation for p in rough]),
                      0.2 * mm, 0.4 * mrad, free=("scale_A",), measured=False, smooth=smooth)
    truth = {"EY0C (C)": 0.63 * mm, "EB0C (C)": 0.43 * mrad, "scale_A (A)": 1.1e-3}
    return simulate(problem, {problem.parameters(name): [[value]] for name, value in truth.items()}, seed)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with simulated measured poses: {file name: text}. seed: of the errors."""
    problem = example(seed)
    observations = problem.observations[0]
    positions = {f"{axis}_deg": observations.covariates[axis] for axis in "AC"}
    job = """problem = "problems.positioner"

[data.poses]
file = "poses.csv"

[options]
u_position = "0.2 mm"
u_orientation = "0.4 mrad"
free = ["scale_A"]
"""
    return {"job.toml": job, "poses.csv": written("simulated, camera on a two-axis positioner",
                                                  positions | observe.written_poses(observations))}


def scene(job: Job, estimate: Estimate) -> Scene:
    """The axes as designed, the target in every measured pose and the instrument."""
    positions, _, _, _ = _read(job)
    table, instrument = (estimate.problem.select(name).unknown for name in ("table_from_target",
                                                                            "instrument_from_base"))
    return measured(positioner(), estimate.fit, "table", positions, np.ravel(estimate[table].translation), instrument)
