"""Where a mechanism stands and how a target sits on it: closed-form start values from measured poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from calib import geometry
from calib.errors import CalibrationError, InputError
from calib.geometry import Transform
from calib.mechanism.axis import Array
from calib.mechanism.chain import Mechanism
from calib.mechanism.observe import measured_point
from calib.observations import Observations, prior
from calib.problem import Problem
from calib.solve.estimate import predict, solve
from calib.unknown import Pose, Unknown

CLOSE = 2e-3        # of the extent of the points: a misfit of errors of manufacture, not of a wrong place


def nearest_rotation(matrix: Array) -> Array:
    """The rotation (3, 3) nearest to a matrix (3, 3). Source: orthogonal Procrustes problem, Schoenemann 1966."""
    left, _, right = np.linalg.svd(matrix)
    return left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right


def nearest_motion(points: ArrayLike, nominal: ArrayLike) -> Transform:
    """The rigid motion (Transform) that brings nominal points (n, 3) nearest to measured ones (n, 3) [m].

    Raises InputError for points on one line, about which they may turn. Source: Schoenemann 1966.
    """
    measured, designed = np.asarray(points, float), np.asarray(nominal, float)
    centre, middle = measured.mean(axis=0), designed.mean(axis=0)
    if len(designed) < 3 or _on_one_line(measured) or _on_one_line(designed):
        raise InputError("the points lie on one line, about which the mechanism may stand at any angle; measure points "
                         "off it.")
    rotation = nearest_rotation((measured - centre).T @ (designed - middle))
    return Transform(rotation, centre - rotation @ middle)


def _on_one_line(points: Array) -> bool:
    """Whether points (n, 3) spread in at most one direction; a point that is repeated spreads by rounding."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return not spread[1] > max(1e-6 * spread[0], 1e-12 * float(np.linalg.norm(points)))


def world_and_target(rotations: ArrayLike, translations: ArrayLike, frame_rotations: ArrayLike,
                     frame_translations: ArrayLike) -> tuple[Transform, Transform]:
    """world_from_base and frame_from_target for which world_from_base @ base_from_frame @ frame_from_target is near to
    measured poses world_from_target.

    rotations (n, 3, 3), translations (n, 3) [m]: measured; frame_rotations, frame_translations: base_from_frame.
    Raises InputError where the poses turn about fewer than two directions, so that no start can be found.
    Source: the robot-world and hand-eye problem, Shah 2013, J. Mechanisms Robotics 5, 031007 (solved by one SVD here).
    """
    measured, moved = np.asarray(translations, float), np.asarray(frame_translations, float)
    turned, frames = np.asarray(rotations, float), np.asarray(frame_rotations, float)
    identity = np.eye(3)
    # R target' = X F for every pose, with target' = frame_from_target.T and X = world_from_base: linear in both
    rows = [np.concatenate([np.kron(r, identity), -np.kron(identity, f.T)], axis=1) for r,
            f in zip(turned, frames, strict=True)]
    _, values, directions = np.linalg.svd(np.concatenate(rows), full_matrices=False)
    if values[-2] < 1e-3 * values[0]:
        raise InputError("the measured poses turn about one direction only, so that neither the place of the "
                         "mechanism nor that of the target can be found; add poses in which another axis moves.")
    target_transposed, world = directions[-1][:9].reshape(3, 3), directions[-1][9:].reshape(3, 3)
    sign = np.sign(np.linalg.det(world))
    world_turn, target_turn = nearest_rotation(sign * world), nearest_rotation(sign * target_transposed).T
    # t = X (F b + p) + x: linear in the target's place b and the world's x
    design = np.concatenate([world_turn @ frames, np.broadcast_to(identity, frames.shape)], axis=2).reshape(-1, 6)
    shift = np.linalg.lstsq(design, (measured - moved @ world_turn.T).ravel(), rcond=None)[0]
    return Transform(world_turn, shift[3:]), Transform(target_turn, shift[:3])


def place_of_points(mechanism: Mechanism, frame: str, positions: ArrayLike, names: Sequence[object] | Array,
                    points: ArrayLike) -> tuple[Transform, dict[str, Array]]:
    """Where a mechanism stands and where points sit on a frame of it, from measured points, by the nominal geometry.

    positions: (n, axes), names: (n,) of the points, points: (n, 3) as measured [m]. Returns world_from_base and
    {name: (3,) in the frame} [m]. No start is needed.
    """
    world, places, _ = _placed(mechanism, frame, positions, names, points)
    return world, places


def misfit_of_points(mechanism: Mechanism, frame: str, positions: ArrayLike, names: Sequence[object] | Array,
                     points: ArrayLike) -> float:
    """Rms [m] by which points miss a mechanism at its best place; arguments as of `place_of_points`."""
    return _placed(mechanism, frame, positions, names, points)[2]


def _placed(mechanism: Mechanism, frame: str, positions: ArrayLike, names: Sequence[object] | Array,
            points: ArrayLike) -> tuple[Transform, dict[str, Array], float]:
    """Place, points and rms misfit [m]: in closed form, adjusted where the postures leave some of its products open."""
    world, places = _closed_form(mechanism, frame, positions, names, points)
    index, start = np.array([list(places).index(str(n)) for n in names]), np.array(list(places.values()))
    where, stand = Unknown("point", start, keys=list(places)), Pose("world", world.rotation, world.translation)
    observations = Observations(measured_point(mechanism.pose(frame)), stand, np.asarray(positions, float),
                                where[index], readings=points, u=1.0, group="points")
    measured = observations.recorded
    rms = _rms(measured - predict(Problem([observations]))["points"])
    if rms < CLOSE * _rms(measured - measured.mean(axis=0)):
        return world, places, rms
    # points that the postures leave open stay where they are
    try:
        estimate = solve(Problem([observations, prior(where, start, 1e3, name="start")]))
    except CalibrationError:
        return world, places, rms
    adjusted = _rms(estimate.residuals["points"])
    if adjusted >= rms:
        return world, places, rms
    return estimate[stand], dict(zip(places, np.asarray(estimate[where]).reshape(-1, 3), strict=True)), adjusted


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(np.asarray(vectors) ** 2, axis=1))))


def _closed_form(mechanism: Mechanism, frame: str, positions: ArrayLike, names: Sequence[object] | Array,
                 points: ArrayLike) -> tuple[Transform, dict[str, Array]]:
    """The products of an entry of the rotation with a coordinate of a point, found linearly; the rotation as their best
    factor."""
    measured, keys = np.asarray(points, float), [str(n) for n in names]
    known = list(dict.fromkeys(keys))
    rotations, origins = mechanism.poses(frame, positions)
    index = np.array([known.index(key) for key in keys])
    # point = R (F b + p) + t is linear in R[i, j] b[k] for each point b, in R[i, j] alone, and in t
    design = np.zeros((len(measured), 3, 27 * len(known) + 12))
    for row, turned in enumerate(rotations):
        design[row, :, 27 * index[row]:27 * (index[row] + 1)] = np.kron(np.eye(3), turned.reshape(1, 9)).reshape(3, 27)
    design[:, :, -12:-3] = np.einsum("ab,nj->nabj", np.eye(3), origins).reshape(-1, 3, 9)
    design[:, :, -3:] = np.eye(3)
    solution = np.linalg.lstsq(design.reshape(-1, design.shape[2]), measured.ravel(), rcond=None)[0]
    products = np.concatenate([solution[:-12].reshape(len(known), 9, 3).transpose(1, 0, 2).reshape(9, -1),
                               solution[-12:-3, None]], axis=1)
    factor = np.linalg.svd(products, full_matrices=False)[0][:, 0].reshape(3, 3)
    turn = nearest_rotation(np.sign(np.linalg.det(factor)) * factor)
    fixed = np.zeros((len(measured), 3, 3 * len(known) + 3))
    for row, turned in enumerate(turn @ rotations):
        fixed[row, :, 3 * index[row]:3 * (index[row] + 1)] = turned
    fixed[:, :, -3:] = np.eye(3)
    places = np.linalg.lstsq(fixed.reshape(-1, fixed.shape[2]), (measured - origins @ turn.T).ravel(), rcond=None)[0]
    return Transform(turn, places[-3:]), dict(zip(known, places[:-3].reshape(-1, 3), strict=True))


def places_on(mechanism: Mechanism, frame: str, positions: ArrayLike, names: Sequence[object] | Array,
              points: ArrayLike, world: Transform) -> dict[str, Array]:
    """Where measured points sit on a frame, {name: mean (3,) [m]}, if the mechanism stands at world_from_base.

    Other arguments as of `place_of_points`.
    """
    keys = np.array([str(n) for n in names])
    rotations, origins = mechanism.poses(frame, positions)
    local = np.einsum("nji,nj->ni", rotations, world.inverse() @ np.asarray(points, float) - origins)
    return {str(key): local[keys == key].mean(axis=0) for key in dict.fromkeys(keys)}


def misfit(rotations: ArrayLike, translations: ArrayLike, frame_rotations: ArrayLike,
           frame_translations: ArrayLike) -> float:
    """Rms angle [rad] by which measured poses miss a mechanism after `world_and_target`; arguments as there."""
    world, target = world_and_target(rotations, translations, frame_rotations, frame_translations)
    away = [geometry.rotation_vector((world.rotation @ f @ target.rotation).T @ r)
            for f, r in zip(np.asarray(frame_rotations), np.asarray(rotations), strict=True)]
    return float(np.sqrt(np.mean(np.sum(np.square(away), axis=1))))
