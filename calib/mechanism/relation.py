"""How two axes of a mechanism stand to each other, as results of an identification: angle, distance, parallelism."""

from __future__ import annotations

from typing import Any

import numpy as np
from casadi import vertcat

from calib import geometry
from calib.errors import DeclarationError
from calib.mechanism.axis import Axis
from calib.mechanism.chain import Mechanism
from calib.mechanism.observe import angle_between
from calib.mechanism.resolved import quantity
from calib.observations import Quantity, Shared
from calib.problem import Problem


def _lines(mechanism: Mechanism, first: str, second: str) -> tuple[Axis, Axis, np.ndarray, np.ndarray]:
    """Two axes and their directions in the frames of their references."""
    one, other = mechanism.axis(first), mechanism.axis(second)
    return one, other, *(np.asarray(a.reference).T @ np.asarray(a.direction) for a in (one, other))


def _asked(problem: Problem, mechanism: Mechanism, first: str, second: str, function: Any, **labels: Any) -> Quantity:
    """The quantity at reference conditions: all positions at zero, what drives effects (temperature, approach) too."""
    return quantity(problem, f"{first}_to_{second}", mechanism.pose(second, seen_from=first), function,
                    Shared(np.zeros(len(mechanism.axes))),
                    known={name: 0.0 for effect in problem.effects for name in effect.inputs}, **labels)


def crossing(problem: Problem, mechanism: Mechanism, first: str, second: str) -> Quantity:
    """Angle and distance of two axes that are not parallel, with the effects of a problem: `FIRST_to_SECOND`.

    problem: with the effects attached; first, second: names of axes. Parts: `angle`, the departure from the angle as
    designed [rad], and `distance` along their common perpendicular [m], positive along first x second; all positions at
    zero. Raises DeclarationError for axes that are designed parallel.
    """
    one, other, direction, second_direction = _lines(mechanism, first, second)
    designed = float(angle_between(np.asarray(one.direction), np.asarray(other.direction)))
    if abs(np.sin(designed)) < 1e-6:
        raise DeclarationError(f"the axes '{first}' and '{second}' are designed parallel; ask for `parallelism`.")

    def between(pose: Any, positions: Any) -> Any:
        there = pose(positions)
        turned = there.turn(second_direction)
        return vertcat(angle_between(direction, turned) - designed,
                       geometry.dot(there.translation, geometry.unit(geometry.cross(direction, turned))))
    return _asked(problem, mechanism, first, second, between, unit=["arcsec", "um"], parts=("angle", "distance"))


def parallelism(problem: Problem, mechanism: Mechanism, first: str, second: str) -> Quantity:
    """Tilt and place of an axis against one that it is parallel to, with the effects of a problem: `FIRST_to_SECOND`.

    problem, first, second: as of `crossing`. Parts, about and along the two axes X, Y or Z of the first axis' reference
    that lie across it: the tilt of the second axis [rad] and its displacement from the designed place [m].
    Raises DeclarationError for axes that are not designed parallel.
    """
    one, other, direction, second_direction = _lines(mechanism, first, second)
    sense = float(np.dot(np.asarray(one.direction), np.asarray(other.direction)))
    if abs(sense) < 1 - 1e-9:
        raise DeclarationError(f"the axes '{first}' and '{second}' are not designed parallel; ask for `crossing`.")
    across = [i for i in range(3) if i != one.along]
    designed = np.asarray(one.reference).T @ (np.asarray(other.through) - np.asarray(one.through))

    def between(pose: Any, positions: Any) -> Any:
        there = pose(positions)
        turned = np.sign(sense) * there.turn(second_direction)
        tilt = geometry.cross(direction, turned)
        # where the second line passes the plane across the first one, at the height of its designed point
        height = geometry.dot(direction, there.translation - designed) / geometry.dot(direction, turned)
        moved = there.translation - height * turned - designed
        return vertcat(*(tilt[i] for i in across), *(moved[i] for i in across))
    names = ["XYZ"[i] for i in across]
    return _asked(problem, mechanism, first, second, between, unit=["arcsec", "arcsec", "um", "um"],
                  parts=tuple([f"tilt_{n}" for n in names] + [f"place_{n}" for n in names]))
