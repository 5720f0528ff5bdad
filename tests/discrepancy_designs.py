"""Designs of simulated discrepancy cases: geometry, order of the readings, temperature and blocks, drawn from a seed.

The models and effects are those of the problem modules; a design only says where readings are taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib import Problem, predict
from calib.geometry import Transform
from calib.units import arcsec, degree, minute, mm, nm, um
from instruments import laser_tracker
from problems import axis_points, base_point, plumb, turntable
from problems.base_point.lines import Lines, directions
from problems.circle import in_plane
from problems.locators.campaign import drawn_poses
from problems.locators.errors import Frames
from problems.locators.kinematics import pose
from problems.locators.measured import Locator, Readings, Setup
from problems.locators.measured import declare as declare_locators
from problems.locators.vocabulary import TARGETS, axis_group

Generator = np.random.Generator


@dataclass(frozen=True)
class Design:
    """A scenario laid out: `build(readings)` declares it (readings by group, or None), truth: of its unknowns."""

    scenario: str
    build: Callable[[Any], Problem]
    truth: dict[Any, Any]
    check: dict[str, np.ndarray]


def _temperature(g: Generator, time: np.ndarray) -> np.ndarray:
    """Difference of temperature [K]: a wandering room, a slow wave, one that runs with time (also exactly), or none."""
    hours = (time - time[0]) / 3600.0
    kind = g.choice(5, p=[0.3, 0.2, 0.3, 0.1, 0.1])
    if kind == 3:
        return g.normal(0, 0.5) + g.choice([-1, 1]) * g.uniform(0.5, 3) * hours / max(hours[-1], 0.1)
    if kind == 4:
        return np.full(len(time), g.normal(0, 0.5))
    if kind == 0:
        steps = np.diff(hours, prepend=0.0)
        return g.normal(0, 0.5) + np.cumsum(g.normal(0, 1, len(time)) * np.sqrt(np.maximum(steps, 0)) * 0.7)
    wave = 0.5 * np.sin(2 * np.pi * (hours / max(hours[-1], 0.1) * g.uniform(0.6, 2.0) + g.random()))
    if kind == 1:
        return wave + g.normal(0, 0.5)
    return g.choice([-1, 1]) * g.uniform(0.5, 1.5) * hours / max(hours[-1], 0.1) + 0.1 * wave


def _checked(g: Generator, keys: np.ndarray, share: float = 0.2) -> np.ndarray:
    different = np.unique(keys)
    return np.isin(keys, g.choice(different, max(1, int(share * len(different))), replace=False))


def _time(g: Generator, n: int, step: float) -> np.ndarray:
    return np.cumsum(np.concatenate([[0.0], step * g.uniform(0.8, 1.2, n - 1)]))


def _blocks(g: Generator, laid: np.ndarray, sweep: np.ndarray) -> np.ndarray:
    """Numbers of the blocks: as laid, one a sweep, cut anywhere, or a single one."""
    kind = g.choice(4, p=[0.55, 0.15, 0.2, 0.1])
    if kind == 1:
        return np.minimum(1 + sweep, 6)
    if kind == 2:
        return 1 + (np.arange(len(laid)) >= g.integers(len(laid) // 5 + 1, max(4 * len(laid) // 5, len(laid) // 5 + 2)))
    return laid if kind == 0 else np.ones_like(laid)


def _sweep(g: Generator, grids: list[tuple[int, int]]) -> np.ndarray:
    """Angles of one sweep: an even grid (span, step) [deg], or anywhere on the circle."""
    if g.random() < 0.15:
        return np.sort(g.uniform(0, 2 * np.pi, g.integers(7, 20)))
    span, step = grids[g.integers(len(grids))]
    return np.arange(0, span + 1, step) * degree


def level(g: Generator) -> Design:
    """One or two tables, one or more set-ups, both directions or one; a part turn or a full one."""
    tables = ["T1", "T2"][: g.integers(1, 3)]
    sweep = _sweep(g, [(90, 5), (90, 10), (120, 15), (180, 10), (360, 30), (360, 15), (330, 30)])
    back = -1 if g.random() < 0.8 else 1
    rows = []
    block = number = 0
    for t in tables:
        for setup in range(g.integers(1, 3)):
            block += 1
            tilt = np.zeros(2) if setup == 0 else g.uniform(-80, 80, 2) * arcsec
            for k in range(g.integers(1, 3) if len(sweep) > 12 else 2):
                for a in sweep[:: 1 if k % 2 == 0 else back]:
                    rows.append((t, block, 1 if k % 2 == 0 else back, a, number, *tilt))
                number += 1
    table = [r[0] for r in rows]
    settings, direction, angle, sweeps = (np.array([r[i] for r in rows]) for i in (1, 2, 3, 4))
    applied = np.array([r[5:] for r in rows])
    blocks = _blocks(g, settings, sweeps)
    n = len(rows)
    time = _time(g, n, g.uniform(20, 90)) + (settings - 1) * g.uniform(0, 600)
    cov = {"time": (time, "s"), "temperature_difference": (_temperature(g, time), "K"), "direction": direction,
           "block": blocks}
    u = g.choice([0.15, 0.2, 0.4]) * arcsec

    def build(readings: Any) -> Problem:
        problem = plumb.declare(angle, None if readings is None else readings["level"], u, table, applied, cov)
        have = {*cov, "angle", "table", "inclination"}
        return problem.with_effects(
            *(e for e in plumb.effects(sorted(set(blocks.tolist()))[1:]) if set(e.inputs) <= have))

    truth = {"plumb": g.normal(0, 15, (len(tables), 2)) * arcsec, "zero": g.normal(0, 100, (len(tables), 1)) * arcsec}
    keys = np.array([hash((b, round(a, 6))) % 10**6 for b, a in zip(blocks, angle, strict=True)])
    return Design("level_plumb", build, truth, {"level": _checked(g, keys)})


def theodolite(g: Generator) -> Design:
    """One to four targets on a turning axis, one face or two, equal or different elevations."""
    ids = ["A", "B", "C", "D"][: g.integers(1, 5)]
    elevation = dict(zip(ids, (np.full(4, g.uniform(2, 25)) if g.random() < 0.2 else g.uniform(-12, 30, 4)) * degree,
                         strict=False))
    distance = dict(zip(ids, g.uniform(0.9, 2.2, 4), strict=False))
    two_faces = g.random() < 0.8
    sweep = _sweep(g, [(span, step) for span in (120, 180, 330) for step in (15, 20, 30)])
    back, faces = -1 if g.random() < 0.8 else 1, (1, -1) if two_faces else (1,)
    rows = []
    for number in range(g.integers(1, 3)):
        way = 1 if number % 2 == 0 else back
        for some in (ids,) if g.random() < 0.7 else ((t,) for t in ids):  # all targets at an angle, or one by one
            rows += [(t, f, number, way, a) for a in sweep[::way] for t in some for f in faces]
    target = [r[0] for r in rows]
    face, sweeps, direction, angle = (np.array([r[i] for r in rows]) for i in (1, 2, 3, 4))
    changes = np.cumsum([a != b for a, b in zip(target, target[:1] + target[:-1], strict=True)])
    blocks = _blocks(g, 1 + sweeps, changes if changes[-1] < 6 else sweeps)
    time = _time(g, len(rows), 17)
    cov = {"time": (time, "s"), "temperature_difference": (_temperature(g, time), "K"), "direction": direction,
           "block": blocks}

    def build(readings: Any) -> Problem:
        problem = axis_points.declare(None if readings is None else readings["circles"], target, angle,
                                      distance=distance, elevation=elevation, u=[0.7 * arcsec, 0.9 * arcsec],
                                      face=face.astype(float), covariates=cov)
        found = axis_points.effects(sorted(set(blocks.tolist()))[1:])
        return problem.with_effects(*axis_points._usable(found, problem))

    truth = {"centre": np.column_stack([g.uniform(100, 110, len(ids)), 90 - np.array([elevation[t] for t in ids])
                                        / degree]) * degree, "eccentricity": g.normal(0, 0.3, (len(ids), 2)) * mm}
    keys = np.array([hash((b, round(a, 6))) % 10**6 for b, a in zip(blocks, angle, strict=True)])
    return Design("theodolite_target", build, truth, {"circles": _checked(g, keys)})


def tracker(g: Generator) -> Design:
    """One or two reflectors on a table some metres from a tracker, one way or two, with repetitions."""
    count, step = int(g.integers(1, 3)), [10, 20, 30][g.integers(3)]
    sweep = _sweep(g, [(360, step), (360, step), (200, step), (120, 10)])
    repeats = int(g.integers(1, 3))
    rows = []
    for s in range(2 if g.random() < 0.8 else 1):
        for a in sweep if s == 0 else sweep[::-1]:
            rows += [(a, i, s, 1 - 2 * s) for _ in range(repeats) for i in range(count)]
    command, item, sweeps, direction = (np.array([r[i] for r in rows]) for i in range(4))
    block = _blocks(g, 1 + sweeps, sweeps)
    n = len(rows)
    time = _time(g, n, 12)
    axis = g.normal(0, 1, 3) if g.random() < 0.4 else np.array([*g.normal(0, 0.05, 2), 1.0])
    axis = axis / np.linalg.norm(axis)
    first, second = in_plane(axis, np.eye(3)[np.argmin(np.abs(axis))])
    angle = command + np.array([0.3, 2.4])[item]
    radius, height = (np.array(v)[item][:, None] for v in ((0.25, 0.4), (0.0, g.uniform(0.05, 0.2))))
    centre = np.array([g.uniform(1.5, 4), g.uniform(-1.5, 1.5), g.uniform(-0.6, 0.6)])
    points = centre + radius * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second) + height * axis
    exact = laser_tracker.polar_readings(points)
    cov = {"time": (time, "s"), "temperature_difference": (_temperature(g, time), "K"), "direction": direction,
           "block": block}
    u = [g.choice([4, 8]) * um, 0.8 * arcsec, 1.0 * arcsec]

    def build(readings: Any) -> Problem:
        return turntable.declare(command, exact if readings is None else readings["tracker"], u,
                                 np.array(["1", "2"])[item], axis, None, cov)

    truth = {u_.name: u_.show(u_.ambient) for u_ in build(None).unknowns if u_.name in
             ("centre", "axis", "radius", "phase", "height")}
    keys = np.array([hash((b, round(a, 6))) % 10**6 for b, a in zip(block, command, strict=True)])
    return Design("turntable_tracker", build, truth, {"tracker": _checked(g, keys)})


def lines(g: Generator) -> Design:
    """Three to six lines of a machine, there and back, and in every third design a fine one of a micrometre."""
    size = g.uniform(0.4, 0.9, 3)
    corners = [((0, 0, 0), 0), ((1, 0, 0), 1), ((1, 1, 0), 2), ((0, 1, 0), 0), ((0, 0, 1), 1), ((0, 0, 0), 2)]
    chosen = [corners[i] for i in ([0, 1, 2] if g.random() < 0.4 else sorted(g.choice(6, g.integers(3, 7), False)))]
    points, along, blocks, way, line, zeroing, speed, sigma = [], [], [], [], [], [], [], []
    chosen = [(*one, False) for one in chosen] + ([((0.5, 0.5, 0), 0, True)] if g.random() < 0.35 else [])
    count, ways = int(g.integers(5, 18)), (1, -1) if g.random() < 0.85 else (1,)
    places = np.sort(g.uniform(0.02, 0.98, count)) if g.random() < 0.25 else np.linspace(0.02, 0.98, count)
    for number, (corner, axis, fine) in enumerate(chosen, 1):
        run = 0.5 + np.linspace(0, 1.3 * um, 24) / size[axis] if fine else places
        for way_now in ways:
            for s in run if way_now == 1 else run[::-1]:
                p = np.array(corner, float) * size
                p[axis] = s * size[axis]
                points.append(p)
                along.append(np.eye(3)[axis])
                blocks.append(number)
                way.append(way_now)
                line.append(f"{'xyz'[axis].upper()}{number}")
                zeroing.append(line[-1] if fine else "long")
                speed.append(0.0 if fine else way_now * [0.0, 4.0, 10.0][number % 3] * mm)
                sigma.append((10 * nm, 2 * nm) if fine else (0.6 * um, 0.3 * um))
    points, along, blocks, way, sigma = map(np.array, (points, along, blocks, way, sigma))
    time = _time(g, len(points), 16)
    cov = {"line": np.array(line), "block": blocks, "direction": way, **directions(way, along),
           "time": (time, "s"), "temperature_difference": (_temperature(g, time), "K"),
           "abbe_x": (g.uniform(0.1, 0.4) + 0.1 * (blocks % 3), "m"), "abbe_y": (0.1 + 0.07 * (blocks % 2), "m")}
    velocity = along * np.array(speed)[:, None]
    base = g.uniform(-0.6, 0.9, 3) - np.array([0, 0, 0.7])

    def group(zero: str) -> str:
        return f"tracker {zero}"

    def build(readings: Any) -> Problem:
        given = None
        if readings is not None:
            given = np.zeros(len(points))
            for z in dict.fromkeys(zeroing):
                given[np.array(zeroing) == z] = np.ravel(readings[group(z)])
        laid = Lines(points, given, sigma[:, 0], along, sigma[:, 1], velocity=velocity,
                                      zeroing=zeroing, covariates=cov)
        problem = base_point.declare(laid, base_point.FreeStart(), base_point.ProjectedCoordinates(), begin=base)
        return base_point.with_recorded_effects(problem, laid, size / 2, size / 2)

    keys = np.array([hash((b, round(float(p @ a), 6))) % 10**6
                     for b, p, a in zip(blocks, points, along, strict=True)])
    chosen_rows = _checked(g, keys)
    check = {group(z): chosen_rows[np.array(zeroing) == z] for z in dict.fromkeys(zeroing)}
    return Design("basepoint_multilateration", build, {"base_point": base}, check)


def locators(g: Generator, poses: int | None = None) -> Design:
    """Poses of a part on three locators with a tracker on four to six targets."""
    n = poses or int(g.integers(18, 30))
    setup = Setup(tuple(Locator(k, Frames.with_levers((x + g.normal(0, 0.1), y, 1.0), g.uniform(0.5, 0.9), 0.35),
                                np.array([x, y, 0.0]))
                        for k, x, y in (("A", 1.44, 0.0), ("B", -0.72, 0.59), ("C", -0.72, -0.59))),
                  {f"t{i}": tuple(g.uniform((-1.2, -0.8, 0.2), (1.5, 0.8, 0.7))) for i in range(1, g.integers(5, 8))})
    part = drawn_poses(n, int(g.integers(10**6)))
    frame = Transform(pose((0, 0, 0), 0.002, -0.001, 1.1).rotation, g.uniform(-4, 4, 3))
    temperature = _temperature(g, 300.0 * np.arange(n))
    approach = g.choice([-1.0, 1.0], (n, 3)) if g.random() < 0.8 else np.ones((n, 3))
    block = 1 + (np.arange(n) >= g.integers(n // 4, 3 * n // 4))
    split = np.where(_checked(g, np.arange(n)), "check", "fit")
    keys, names = [locator.key for locator in setup.locators], list(setup.targets)
    per_pose = len(keys) + len(names)

    def laid(items: list[str], first: int, later: np.ndarray, approached: float) -> Readings:
        i = np.repeat(np.arange(n), len(items))
        rows = 1 + first + per_pose * i + np.tile(np.arange(len(items)), n)
        return Readings(1 + i, np.tile(items, n), np.zeros((len(i), 3)), approach[i] * approached,
                        5 * minute * i + np.tile(later, n), temperature[i], block[i], rows, split[i])

    axes, targets = laid(keys, 0, np.zeros(3), 1.0), laid(names, 3, 15.0 * np.arange(1, len(names) + 1), 0.0)

    def build(readings: Any) -> Problem:
        travel = np.zeros((len(axes.rows), 3))
        for k in keys:
            travel[axes.item == k] = readings[axis_group(k)]
        first, second = replace(axes, values=travel), replace(targets, values=readings[TARGETS])
        return declare_locators(setup, first, second, u_axis=8 * um, u_tracker=[6 * um, 0.8 * arcsec, 1.0 * arcsec])

    truth = {"part": list(part), "tracker": frame}
    # Errors are taken at the travel that is read, so travels come first, then the model with its starts at them.
    travels = predict(declare_locators(setup, axes, None, u_axis=8 * um), {"part": list(part)})
    points = np.array([frame @ (part[i - 1] @ np.array(setup.targets[k]))
                       for i, k in zip(targets.pose, targets.item, strict=True)], float)
    problem_at = build({**travels, TARGETS: laser_tracker.polar_readings(points.reshape(-1, 3))})
    check = {o.group: np.isin(o.covariates["split"], "check") for o in problem_at.observations}
    return Design("locator_pose", lambda readings: problem_at if readings is None else build(readings), truth, check)


DESIGNS = {"level_plumb": level, "theodolite_target": theodolite, "turntable_tracker": tracker,
           "basepoint_multilateration": lines, "locator_pose": locators}
