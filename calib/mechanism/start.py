"""Where a mechanism stands and how a target sits on it: closed-form start values from measured poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from calib import geometry
from calib.errors import InputError
from calib.geometry import Transform
from calib.mechanism.axis import Array


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
    spread = np.linalg.svd(designed - middle, compute_uv=False)
    if len(designed) < 3 or spread[1] < 1e-6 * spread[0]:
        raise InputError("the points lie on one line, about which the mechanism may stand at any angle; measure points "
                         "off it.")
    rotation = nearest_rotation((measured - centre).T @ (designed - middle))
    return Transform(rotation, centre - rotation @ middle)


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


def misfit(rotations: ArrayLike, translations: ArrayLike, frame_rotations: ArrayLike,
           frame_translations: ArrayLike) -> float:
    """Rms angle [rad] by which measured poses miss a mechanism after `world_and_target`; arguments as there."""
    world, target = world_and_target(rotations, translations, frame_rotations, frame_translations)
    away = [geometry.rotation_vector((world.rotation @ f @ target.rotation).T @ r)
            for f, r in zip(np.asarray(frame_rotations), np.asarray(rotations), strict=True)]
    return float(np.sqrt(np.mean(np.sum(np.square(away), axis=1))))
