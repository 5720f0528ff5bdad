"""Hexapod: joints and lengths of six legs from leg readings and measured poses of the platform.

Every leg closes a loop between base and platform: its length is the distance of its two joints. A tracker measures the
pose of a target on the platform (base and platform frames are those of tracker and target), the encoders read the legs.
Unknown are the twelve joints, the six zero lengths, and the true pose of the platform in every posture. Compensation
turns a wanted pose into leg commands by the same model.
Source: Masory, Wang, Zhuang, Advanced Robotics 11, 1997 (kinematic calibration of a Stewart platform).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from casadi import vertcat
from numpy.typing import ArrayLike

from calib import (
    Effect,
    Estimate,
    Observations,
    Parameter,
    Pose,
    Problem,
    Quantity,
    Unknown,
    geometry,
    hands_slots_to,
    predict,
    prior,
    simulate,
)
from calib.analyse.shapes import points_of
from calib.job import Job
from calib.mechanism import observe
from calib.mechanism.heldout import misses, rms
from calib.mechanism.inputs import other_quaternion_order
from calib.mechanism.loop import leg_length, refuse_open
from calib.mechanism.scene import placed
from calib.scene import Points, Scene, Sights
from calib.table import written
from calib.units import mm, mrad, ppm, um, urad

accepts = ("problems.hexapod",)
LEGS = 6
BLOCKS = 5
ZERO = 0.30             # reading less distance of the joints, as designed [m]
LARGEST_GAP = 20 * mm   # more than errors of manufacture: another unit, sign, frame or order of the legs
columns = {"poses": {"x, y, z": "place of the target", "qw, qx, qy, qz": "its orientation", "leg1 .. leg6": "encoder "
                                                                                                            "readings"}}
options = {"u_position, u_orientation": "standard uncertainty of a measured pose, each component", "u_leg": "of a leg "
                                                                                                            "reading",
           "u_joint": "tolerance of a joint's place, each component", "u_zero": "tolerance of a zero length"}


def joints() -> tuple[np.ndarray, np.ndarray]:
    """Nominal joints (6, 3) on the base and on the platform [m]: pairs on circles of 0.50 and 0.30 m."""
    def circle(radius: float, angles: np.ndarray) -> np.ndarray:
        return radius * np.stack([np.cos(angles), np.sin(angles), np.zeros(LEGS)], axis=1)
    spread = np.deg2rad([-10, 10, 110, 130, 230, 250])
    return circle(0.50, spread), circle(0.30, spread + np.deg2rad([-40, 40, -40, 40, -40, 40]))


@hands_slots_to(leg_length)
def leg_reading(platform: Any, base_joint: Any, platform_joint: Any, zero: Any, **slots: Any) -> Any:
    """Encoder reading of a leg [m]: the distance of its joints less its zero length. Slots: those of `leg_length`."""
    return leg_length(platform, base_joint, platform_joint, zero, **slots)


def pose_of_target(platform: Any, near: Any) -> Any:
    """Place of the target [m] and its turn away from `near` (3, 3) [rad]."""
    return vertcat(platform.translation, geometry.rotation_vector(geometry.product(near.T, platform.rotation)))


def effects() -> tuple[Effect, ...]:
    """A scale for each leg, and a common one (temperature of all screws)."""
    source = "Masory et al. 1997; ISO 230-2:2014 (positioning)"
    return (Effect("scale", "leg", lambda value, p: p.k * value, (Parameter("k", "ppm", (1 * ppm, 1e-3)),),
                   source=source),
            Effect("scale_of_leg", "leg", lambda value, p: p.k * value, (Parameter("k", "ppm", (1 * ppm, 1e-3)),),
                   per="leg",
                   source=source))


def declare(places: ArrayLike, rotations: ArrayLike, legs: ArrayLike | None, u_position: float, u_orientation: float,
            u_leg: float, u_joint: float, u_zero: float, rows: ArrayLike | None = None) -> Problem:
    """Declare the identification of a hexapod.

    places: (n, 3) [m], rotations: (n, 3, 3) of the target, measured (or planned); legs: (n, 6) readings [m], None to
    plan; u_position [m], u_orientation [rad], u_leg [m]: standard uncertainties; u_joint, u_zero: tolerances [m]; rows:
    numbers in the data file. Unknowns: `base_joint`, `platform_joint`, `zero` for each leg, and `platform`, the pose of
    each posture.
    """
    places, rotations = np.asarray(places, float), np.asarray(rotations, float)
    n, (base, top) = len(places), joints()
    keys = [str(i + 1) for i in range(LEGS)]
    base_joint, platform_joint = Unknown("base_joint", base, "mm", keys=keys), Unknown("platform_joint", top, "mm",
                                                                                       keys=keys)
    zero = Unknown("zero", np.full((LEGS, 1), ZERO), "mm", keys=keys)
    platform = Pose("platform", rotations, places, unit="mm", angle_unit="mrad")
    pose, leg = np.repeat(np.arange(n), LEGS), np.tile(np.arange(LEGS), n)
    measured = None if legs is None else observe.pose_readings(places, rotations)
    observations = [
        Observations(leg_reading, platform[pose], base_joint[leg], platform_joint[leg], zero[leg],
                     readings=None if legs is None else np.ravel(legs), u=u_leg, group="legs", unit="um",
                     covariates={"leg": np.array(keys)[leg]}, rows=None if rows is None else np.repeat(rows, LEGS)),
        Observations(pose_of_target, platform.each, rotations, readings=measured, u=[u_position] * 3 + [u_orientation]
                     * 3,
                     group="poses", unit=["um"] * 3 + ["urad"] * 3, components=("x", "y", "z", "rx", "ry", "rz"),
                     rows=rows),
        prior(base_joint, base, u_joint, name="tolerance of base joints"),
        prior(platform_joint, top, u_joint, name="tolerance of platform joints"),
        prior(zero, ZERO, u_zero, name="tolerance of zero lengths")]
    return Problem(observations, effects=effects(), name="hexapod")


def commands(problem: Problem, wanted: geometry.Transform) -> Quantity:
    """The leg commands (6 instances) [m] for a wanted pose, as a quantity of the calibration: corrected set-points with
    u."""
    base, top, zero = (problem.select(name).unknown for name in ("base_joint", "platform_joint", "zero"))

    def command(base_joint: Any, platform_joint: Any, zero_length: Any) -> Any:
        return leg_length(geometry.Transform(wanted.rotation, wanted.translation), base_joint, platform_joint,
                          zero_length)
    return Quantity("command", command, base.each, top.each, zero.each, unit="mm", keys=base.keys)


def from_job(job: Job) -> Problem:
    """Declare the hexapod of a job: table [data.poses] with the pose and the six leg readings of each posture.

    Raises InputError for quaternions of another length or in the other order, and legs that do not reach from joint to
    joint.
    """
    table, said = job.table("poses"), job.options
    w, x, y, z = (table.number(name) for name in ("qw", "qx", "qy", "qz"))
    places = np.stack([table.number(n, "length") for n in "xyz"], axis=1)
    legs = np.stack([table.number(f"leg{i + 1}", "length") for i in range(LEGS)], axis=1)
    where, rows = str(table.path), table.row_numbers
    rotations, *others = (observe.rotations_from_quaternions(*q, where=where, rows=rows)
                          for q in ((w, x, y, z), (z, w, x, y), (x, y, z, w)))
    gaps = open_legs(places, rotations, legs)
    # a gap at the joints of the platform is a turn of it
    arm = float(np.linalg.norm(joints()[1], axis=1).mean())
    turn, *turns = (float(np.sqrt(np.mean(open_legs(places, r, legs) ** 2))) / arm for r in (rotations, *others))
    other_quaternion_order(turn, min(turns), where)
    refuse_open(gaps, [f"through leg {i + 1}" for i in range(LEGS)], LARGEST_GAP, where, rows)
    return declare(places, rotations, legs, said.quantity("u_position", "length"),
                   said.quantity("u_orientation", "angle"), said.quantity("u_leg", "length"),
                   said.quantity("u_joint", "length"), said.quantity("u_zero", "length"), rows)


def open_legs(places: np.ndarray, rotations: np.ndarray, legs: np.ndarray) -> np.ndarray:
    """By how much (n, 6) [m] each leg misses the distance of its joints, by the nominal geometry."""
    base, top = joints()
    held = {"base_joint": base, "platform_joint": top, "zero": np.full((LEGS, 1), ZERO)}
    planned = declare(places, rotations, None, 1.0, 1.0, 1.0, 1.0, 1.0)
    return legs - predict(planned, held)["legs"].reshape(legs.shape)


def in_columns(observations: Observations) -> tuple[str, dict[str, np.ndarray]] | None:
    """Poses as their table has them: {column: values}."""
    return ("poses", observe.pose_columns(observations)) if observations.group == "poses" else None


def heldout(job: Job, estimate: Estimate) -> list[tuple[str, float, float, str]]:
    """Poses that were not used, found from the legs alone: hexapod as designed before, identified after.

    Every fifth posture is predicted. Returns (quantity, before, after, unit) of the rms miss in place and turn.
    """
    problem, postures = estimate.problem, np.arange(len(job.table("poses")))
    errors = [problem.select(name).unknown for name in ("base_joint", "platform_joint", "zero")]
    before, after = misses(problem, "poses", postures % BLOCKS, errors, estimate)
    return [("rms place residual of a pose not used", rms(before[:, :3]) / um, rms(after[:, :3]) / um, "um"),
            ("rms turn residual of a pose not used", rms(before[:, 3:]) / urad, rms(after[:, 3:]) / urad, "urad")]


TRUTH = {"base_joint": joints()[0] + np.random.default_rng(5).normal(0, 0.5 * mm, (LEGS, 3)),
         "platform_joint": joints()[1] + np.random.default_rng(6).normal(0, 0.5 * mm, (LEGS, 3)),
         "zero": ZERO + np.random.default_rng(7).normal(0, 1 * mm, (LEGS, 1))}


def planned(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Places (count, 3) [m] and rotations (count, 3, 3) over the workspace."""
    generator = np.random.default_rng(seed)
    places = np.array([0.0, 0.0, 0.55]) + generator.uniform(-0.08, 0.08, (count, 3))
    return places, np.array([geometry.rotation_from_rpy(*generator.uniform(-0.25, 0.25, 3)) for _ in range(count)])


def example(seed: int) -> Problem:
    """Forty postures with simulated errors of all joints and lengths. seed: of the readings."""
    problem = declare(*planned(40, 3), None, 20 * um, 0.05 * mrad, 2 * um, 0.5 * mm, 1 * mm)
    drawn = simulate(problem, TRUTH, seed)
    # tolerances are statements on the design, not readings: they stay where they are
    design = {o.group: o.recorded for o in problem.observations if o.is_prior}
    return drawn.with_readings(design)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with simulated readings: {file name: text}. seed: of the errors."""
    legs, poses = example(seed).observations[:2]
    lengths = {f"leg{i + 1}_mm": length for i, length in enumerate(legs.recorded.reshape(-1, LEGS).T)}
    table = written("simulated, tracker on a hexapod's platform", observe.written_poses(poses) | lengths)
    job = 'problem = "problems.hexapod"\n\n[data.poses]\nfile = "poses.csv"\n\n[options]\nu_position = "20 um"\n' \
          'u_orientation = "50 urad"\nu_leg = "2 um"\nu_joint = "0.5 mm"\nu_zero = "1 mm"\n'
    return {"job.toml": job, "poses.csv": table}


def scene(job: Job, estimate: Estimate) -> Scene:
    """The joints of base and platform with their uncertainty and the six legs, in the first posture."""
    base, top, platform = (estimate.problem.select(name).unknown for name in ("base_joint", "platform_joint",
                                                                              "platform"))
    below, above = points_of(estimate.fit, base), placed(points_of(estimate.fit, top), estimate[platform][0])
    return Scene((below, above, Sights("legs", below.places, above.places),
                  Points("platform in every posture", [np.ravel(pose.translation) for pose in estimate[platform]])))
