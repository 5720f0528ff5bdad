"""A simulated six-axis arm with seated balls: postures, truth, and a runnable job; see problems.serial_arm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calib import Observations, Problem, Unknown, linearise, simulate
from calib.mechanism import observe, urdf
from calib.units import mm, mrad
from problems.serial_arm.model import Arm, Tolerances, arm_from_urdf, declare, effects

_EXAMPLE_LINKS = ((0.0, 0.0, 0.0, 0.30, "0 0 1", 80), (-np.pi / 2, 0.0, 0.0, 0.0, "0 0 1", 80),
                  (np.pi / 2, 0.0, -0.32, 0.0, "0 0 1", 80), (np.pi / 2, 0.08, 0.0, 0.0, "0 0 1", 80),
                  (-np.pi / 2, -0.08, 0.36, 0.0, "0 0 1", 12), (np.pi / 2, 0.0, 0.0, 0.0, "0 0 1", 12))


def example_urdf() -> str:
    """A six-axis arm with weights, as URDF text."""
    lines = ['<?xml version="1.0"?>', '<robot name="example_arm">', '  <link name="link0"/>']
    for i, (roll, x, y, z, axis, effort) in enumerate(_EXAMPLE_LINKS, 1):
        lines += [f'  <link name="link{i}"><inertial><origin xyz="0 -0.05 0.05"/><mass '
                  f'value="{4.0 - 0.5 * i}"/></inertial></link>',
                  f'  <joint name="joint{i}" type="revolute"><parent link="link{i - 1}"/><child link="link{i}"/>',
                  f'    <origin rpy="{roll!r} 0 0" xyz="{x} {y} {z}"/><axis xyz="{axis}"/>',
                  f'    <limit effort="{effort}" lower="-2.9" upper="2.9" velocity="2"/></joint>']
    lines += ['  <link name="ball"/>', '  <joint name="ball_joint" type="fixed"><parent link="link6"/><child '
                                       'link="ball"/>',
              '    <origin rpy="0 0 0" xyz="0.02 0.01 0.15"/></joint>', '</robot>']
    return "\n".join(lines) + "\n"


def example_arm() -> Arm:
    """The arm of `example_urdf`."""
    return arm_from_urdf(urdf.parse(example_urdf(), "example.urdf"), "ball")


EXAMPLE_SIZES = Tolerances(0.2 * mm, 1.0 * mrad, 5 * mrad, sag=5e-3, encoder=0.2 * mrad)


def example_postures(seed: int, count: int) -> list[np.ndarray]:
    """For each of two sockets `count` postures (count, 6) [rad] that hold the ball there by the nominal geometry."""
    generator, seats = np.random.default_rng(seed), []
    for y in (-0.025, 0.025):
        found = reaching(example_arm(), np.array([0.40, y, 0.10]), generator.uniform(-1.5, 1.5, (20 * count, 6)), {})
        seats.append(found[np.all(np.abs(found) < 2.8, axis=1)][:count])
    return seats


def reaching(arm: Arm, place: np.ndarray, positions: np.ndarray, truth: Mapping[str, Any]) -> np.ndarray:
    """Postures (m, axes) that hold the ball at a place, from nearby ones (n, axes), by damped steps of the declared
    model.

    place: (3,) or (n, 3) in the base frame [m]; truth: {name: value} of `ball` and effects. Those that cannot are left
    out.
    """
    moved, places = Unknown("positions", positions, "rad"), np.broadcast_to(place, (len(positions), 3))
    problem = Problem([Observations(observe.contact(arm.mechanism.pose(arm.tip)), places, moved.each,
                                    Unknown("ball", np.zeros(3)), readings=np.zeros((len(positions), 3)), u=1.0,
                                    group="seat")],
                      effects=effects(arm) if truth else ())
    for _ in range(15):
        group = linearise(problem, {**truth, "positions": positions}).group("seat")
        if np.abs(group.residual).max() < 1e-9:
            break
        jacobian = next(part.jacobian for part in group.parts if part.jacobian.shape[2] == len(arm.mechanism.axes))
        across = jacobian.transpose(0, 2, 1)
        positions = positions + (across @ np.linalg.solve(jacobian @ across + 1e-6 * np.eye(3),
                                                          group.residual[:, :, None]))[:, :, 0]
    missed = np.linalg.norm(linearise(problem, {**truth, "positions": positions}).group("seat").residual, axis=1)
    return positions[missed < 1e-7]


def example(seed: int) -> Problem:
    """Forty seats of a six-axis arm with simulated errors of every family. seed: of the errors and their truth."""
    return simulated(seed, seed)[0]


def simulated(seed: int, truth_seed: int, count: int = 20) -> tuple[Problem, dict[str, Any]]:
    """A simulated calibration and its truth {name of unknown: value}: errors drawn from their tolerances."""
    arm = example_arm()
    problem = declare(arm, {"bench": example_postures(7, count)}, 0.05 * mm, None, 0.02 * mm, EXAMPLE_SIZES)
    generator = np.random.default_rng(truth_seed)
    truth: dict[str, Any] = {"ball": np.array([0.4, -0.3, 0.2]) * mm}
    for observations in problem.observations:
        if observations.is_prior:
            sizes = observations.uncertainty.weighting(1, len(observations.recorded[0]), "tolerance").u[0]
            drawn = list(generator.standard_normal(len(sizes)) * sizes)
            for unknown in observations.unknowns:
                truth[unknown.name] = np.array([[drawn.pop(0) for _ in range(unknown.freedom)]])
    return simulate(problem, truth, seed), truth


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with a simulated arm: {file name: text}. seed: of the errors of the arm and of the seats."""
    arm, generator = example_arm(), np.random.default_rng(seed)
    _, truth = simulated(seed, seed)
    truth = {name: value for name, value in truth.items() if name != "socket"}
    files = {"arm.urdf": example_urdf()}
    for placement, shift in (("bench", (0.0, 0.0, 0.0)), ("shelf", (-0.05, 0.25, 0.15))):
        for number, nominal in enumerate(example_postures(7, 20), 1):
            place = np.array([0.40, -0.075 + 0.05 * number, 0.10]) + shift
            start = reaching(arm, place, nominal, {})
            start = start[np.all(np.abs(start) < 2.8, axis=1)]
            seated = reaching(arm, place + generator.normal(0.0, 0.05 * mm, (len(start), 3)), start, truth)
            files[f"{placement}_{number}.csv"] = "\n".join(",".join(f"{v:.9f}" for v in row) for row in seated) + "\n"
    files["job.toml"] = """problem = "problems.serial_arm"

[options]
urdf = "arm.urdf"
tip = "ball"
distance = "50 mm"
u_distance = "0.02 mm"
u_seat = "0.05 mm"
u_length = "0.2 mm"
u_tilt = "1 mrad"
u_zero = "5 mrad"
u_sag = "5 mrad/m"
u_encoder = "0.2 mrad"

[[options.placements]]
name = "bench"
files = ["bench_1.csv", "bench_2.csv"]

[[options.placements]]
name = "shelf"
files = ["shelf_1.csv", "shelf_2.csv"]
heldout = true
"""
    return files
