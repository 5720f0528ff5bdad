"""What instruments see of a mechanism: poses, points, distances, directions, contact; each a model with the mechanism's
slots."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from casadi import asin, atan2, fmax, fmin, sqrt, vertcat
from numpy.typing import ArrayLike

from calib import geometry
from calib.effect import hands_slots_to, positional_of, slots_of
from calib.errors import InputError
from calib.mechanism.axis import Array
from calib.observations import Observations

Model = Callable[..., Any]     # the builders below return the same model for the same pose, so that it is traced once


def _named(model: Model, pose: Model, what: str) -> Model:
    model.__name__ = f"{what}_{getattr(pose, '__name__', 'pose')}"
    return hands_slots_to(pose)(model)


@lru_cache(maxsize=256)
def measured_pose(pose: Model) -> Model:
    """Model of a measured pose of a target: `(world_from_base, positions, frame_from_target, near) -> (6,)`.

    world_from_base: Transform of the instrument's frame from the base; positions: (axes,); frame_from_target:
    Transform; near: (3, 3) any rotation near the measured one. Returns the place of the target (3,) [m] and its turn
    away from `near`, a rotation vector about the axes of `near` (3,) [rad]. `pose_readings` turns measured poses into
    readings.
    """
    def model(world_from_base: Any, positions: Any, frame_from_target: Any, near: Any, **slots: Any) -> Any:
        target = world_from_base @ pose(positions, **slots) @ frame_from_target
        return vertcat(target.translation, geometry.rotation_vector(geometry.product(near.T, target.rotation)))
    return _named(model, pose, "measured")


def pose_readings(translations: ArrayLike, rotations: ArrayLike, near: ArrayLike | None = None) -> Array:
    """Readings (n, 6) of measured poses: place [m], turn away from `near` [rad] (zero where near is the measured
    rotation)."""
    places, turns = np.asarray(translations, float), np.asarray(rotations, float)
    if near is None:
        return np.concatenate([places, np.zeros_like(places)], axis=1)
    away = [geometry.rotation_vector(n.T @ r) for n, r in zip(np.asarray(near, float), turns, strict=True)]
    return np.concatenate([places, np.array(away)], axis=1)


def pose_columns(observations: Observations, near: str = "near") -> dict[str, Array]:
    """Measured poses as a file has them, {"x", "y", "z" [m], "qw", "qx", "qy", "qz": (n,)}: `pose_readings` undone.

    observations: with readings (n, 6), of a model with an argument `near`.
    """
    bound = next(a for a in observations.arguments if a.name == near)
    rotations, readings = bound.data.reshape(-1, 3, 3).transpose(0, 2, 1), observations.recorded
    quaternions = []
    for rotation, vector in zip(rotations, readings[:, 3:], strict=True):
        angle = float(np.linalg.norm(vector))
        turn = geometry.rotation_about(vector / angle, angle) if angle > 0 else np.eye(3)
        quaternions.append(quaternion(rotation @ turn))
    columns = [*readings[:, :3].T, *np.array(quaternions).T]
    return dict(zip(("x", "y", "z", "qw", "qx", "qy", "qz"), columns, strict=True))


def written_poses(observations: Observations) -> dict[str, Array]:
    """The columns of measured poses by the header of a file: {"x_mm", "y_mm", "z_mm", "qw", ...: (n,) SI}."""
    return {name if name.startswith("q") else f"{name}_mm": v for name, v in pose_columns(observations).items()}


@lru_cache(maxsize=256)
def measured_point(pose: Model) -> Model:
    """Model of a measured point of a part, such as a reflector: `(world_from_base, positions, point) -> (3,)` [m]."""
    def model(world_from_base: Any, positions: Any, point: Any, **slots: Any) -> Any:
        return world_from_base @ (pose(positions, **slots) @ point)
    return _named(model, pose, "measured_point_on")


@lru_cache(maxsize=256)
def seen_by(pose: Model, instrument: Model) -> Model:
    """Model of a point of a part seen by an instrument that stands still, whatever the instrument reads.

    instrument: model whose first argument is a point in the instrument's frame, such as `theodolite.circles` or
    `laser_tracker.polar`. Returns `(instrument_from_base, positions, point, *further arguments of the instrument)` with
    the slots of both.
    """
    further = positional_of(instrument)[1:]
    slots_of_pose = set(slots_of(pose))

    def model(instrument_from_base: Any, positions: Any, point: Any, *more: Any, **slots: Any) -> Any:
        there = pose(positions, **{k: v for k, v in slots.items() if k in slots_of_pose}) @ point
        rest = {k: v for k, v in slots.items() if k not in slots_of_pose}
        return instrument(instrument_from_base @ there, *more, **rest)
    kind = inspect.Parameter
    model.__name__ = f"{getattr(instrument, '__name__', 'instrument')}_on_{getattr(pose, '__name__', 'pose')}"
    model.__signature__ = inspect.Signature(                                              # type: ignore[attr-defined]
        [kind(n, kind.POSITIONAL_OR_KEYWORD) for n in ("instrument_from_base", "positions", "point", *further)])
    return hands_slots_to(pose, instrument)(model)


@lru_cache(maxsize=256)
def measured_distance(pose: Model) -> Model:
    """Model of a distance, such as a ball bar or a range-only tracker: `(station, positions, point) -> distance` [m].

    station: (3,) fixed end in base coordinates; point: (3,) moved end in the frame.
    """
    def model(station: Any, positions: Any, point: Any, **slots: Any) -> Any:
        return geometry.norm(pose(positions, **slots) @ point - station)
    return _named(model, pose, "distance_to")


@lru_cache(maxsize=256)
def contact(pose: Model) -> Model:
    """Model of a ball seated in a socket: `(socket, positions, ball) -> (3,)`, socket less ball in base coordinates.

    socket: (3,) centre of the seated ball, often an unknown; ball: (3,) in the frame. The readings are zero, and their
    uncertainty is that of the seat and of what the axes repeat.
    """
    def model(socket: Any, positions: Any, ball: Any, **slots: Any) -> Any:
        return socket - pose(positions, **slots) @ ball
    return _named(model, pose, "contact_of")


def distance_between(first: Any, second: Any) -> Any:
    """Distance of two points (3,) [m]: two sockets of which somebody measured the distance."""
    return geometry.norm(second - first)


@lru_cache(maxsize=256)
def sighted_mirror(pose: Model) -> Model:
    """Model of an autocollimator on a mirror of the part: `(world_from_base, positions, normal) -> (2,)` [rad].

    world_from_base: Transform whose z looks along the line of sight to the mirror; normal: (3,) of the mirror in the
    frame.
    Returns the turns of the mirror about x and y of the autocollimator.
    """
    def model(world_from_base: Any, positions: Any, normal: Any, **slots: Any) -> Any:
        seen = (world_from_base @ pose(positions, **slots)).turn(normal)
        return vertcat(atan2(seen[1], -seen[2]), atan2(-seen[0], -seen[2]))
    return _named(model, pose, "mirror_on")


@lru_cache(maxsize=256)
def level_on(pose: Model) -> Model:
    """Model of a level on the part: `(positions, sensitive, down, zero) -> inclination` [rad].

    sensitive: (3,) unit direction of the level in the frame; down: (3,) unit plumb direction in base coordinates.
    """
    def model(positions: Any, sensitive: Any, down: Any, zero: Any, **slots: Any) -> Any:
        raised = -geometry.dot(pose(positions, **slots).turn(sensitive), down)
        return zero + asin(fmin(fmax(raised, -1.0), 1.0))
    return _named(model, pose, "level_on")


@lru_cache(maxsize=256)
def line_of_sight(pose: Model) -> Model:
    """Model of a sighting instrument that is the mechanism: `(positions, sight, station, target) -> (2,)` [rad].

    sight: (3,) unit line of sight in the frame; station: (3,) where it passes, in the frame; target: (3,) in base
    coordinates. Returns the two small angles by which the line of sight misses the target, across the line.
    """
    def model(positions: Any, sight: Any, station: Any, target: Any, **slots: Any) -> Any:
        local = pose(positions, **slots).inverse() @ target - station
        side = geometry.cross(sight, vertcat(sight[1], sight[2], sight[0]))
        across = geometry.unit(side)
        over = geometry.cross(sight, across)
        ahead = geometry.dot(local, sight)
        return vertcat(atan2(geometry.dot(local, across), ahead), atan2(geometry.dot(local, over), ahead))
    return _named(model, pose, "sight_of")


@lru_cache(maxsize=256)
def encoders(axes: tuple[int, ...]) -> Model:
    """Model of the encoders of some axes: `(positions) -> (k,)`, for positions that are unknown themselves.

    axes: places of the axes that are read, `mechanism.index(name)`. Passive axes of a loop have none; an encoder that
    is noisy against the other instruments is read like this, so that its noise is counted. What an encoder does wrong
    (harmonics, scale) are effects on the position of the axis and act where the pose is used.
    """
    def model(positions: Any) -> Any:
        return vertcat(*(positions[i] for i in axes))
    return model


def angle_between(first: Any, second: Any) -> Any:
    """Angle of two directions (3,) [rad], from sine and cosine so that small ones are exact."""
    cross = geometry.cross(first, second)
    return atan2(sqrt(geometry.dot(cross, cross) + 1e-300), geometry.dot(first, second))


def rotations_from_quaternions(w: ArrayLike, x: ArrayLike, y: ArrayLike, z: ArrayLike, where: str,
                               rows: ArrayLike | None = None) -> Array:
    """Rotation matrices (n, 3, 3) of unit quaternions w + xi + yj + zk, each (n,).

    where: file or table, rows: (n,) numbers in it, both for messages.
    Raises InputError for a quaternion that is not of unit length (to 1e-3).
    """
    q = np.stack([np.asarray(v, float) for v in (w, x, y, z)], axis=1)
    length = np.linalg.norm(q, axis=1)
    wrong = np.flatnonzero(~(np.abs(length - 1.0) < 1e-3))
    if len(wrong):
        row = wrong[0] + 1 if rows is None else np.asarray(rows)[wrong[0]]
        raise InputError(f"{where}, pose {row}: the quaternion {np.round(q[wrong[0]], 4).tolist()} (w, x, y, z) has "
                         "length "
                         f"{length[wrong[0]]:.4g}, not 1; check the columns, or divide it by its length where it was "
                         "rounded.")
    a, b, c, d = (q / length[:, None]).T
    return np.stack([np.stack([1 - 2 * (c * c + d * d), 2 * (b * c - d * a), 2 * (b * d + c * a)], 1),
                     np.stack([2 * (b * c + d * a), 1 - 2 * (b * b + d * d), 2 * (c * d - b * a)], 1),
                     np.stack([2 * (b * d - c * a), 2 * (c * d + b * a), 1 - 2 * (b * b + c * c)], 1)], 1)


def quaternion(rotation: ArrayLike) -> Array:
    """Unit quaternion (w, x, y, z) of a rotation (3, 3), w not negative."""
    vector = geometry.rotation_vector(np.asarray(rotation, float))
    half = 0.5 * float(np.linalg.norm(vector))
    return np.concatenate([[np.cos(half)], 0.5 * vector * np.sinc(half / np.pi)])
