"""Compensation: axis commands for which a calibrated mechanism stands where it is wanted, and what then remains."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from casadi import vertcat
from numpy.typing import ArrayLike

from calib import geometry
from calib.errors import DeclarationError
from calib.geometry import Transform
from calib.mechanism.axis import Array
from calib.mechanism.chain import Mechanism
from calib.mechanism.observe import pose_readings
from calib.mechanism.resolved import resolved
from calib.observations import Observations, Quantity, Shared, prior
from calib.problem import Problem
from calib.unknown import Unknown


def inverse_problem(mechanism: Mechanism, frame: str, wanted: Transform, near: ArrayLike, calibrated: Problem,
                    values: Mapping[Any, Any], place: float, turn: float | None, target: ArrayLike = (0.0, 0.0, 0.0),
                    known: Mapping[str, float] | None = None, stay: float | None = None) -> Problem:
    """The problem whose solution is the commands that a calibrated mechanism needs for a wanted pose.

    mechanism, frame: as calibrated; wanted: base_from_frame, of which the place of `target` (3,) in the frame counts;
    near: (axes,) commands to start from [rad or m], which also pick the branch; calibrated: the problem with the
    effects; values: {effect or its name: parameters}, such as an Estimate's; place [m], turn [rad]: how a miss in place
    weighs against one in orientation (turn None: the place alone counts); known: covariates that effects ask for; stay
    [rad or m]: where more axes than needed leave a choice, how loosely the commands are tied to `near` (large against
    what the miss may be). The unknown `commands` has the limits of the axes as bounds. Solve it with Ipopt(), or with
    GaussNewton() where no limit is near. With fewer axes than asked for, the weighted miss is as small as can be.
    Raises DeclarationError where `near` lies outside the limits.
    """
    start = np.asarray(near, float).reshape(len(mechanism.axes))
    limits = np.array([axis.limits for axis in mechanism.axes])
    outside = np.flatnonzero((start < limits[:, 0]) | (start > limits[:, 1]))
    if len(outside):
        axis = mechanism.axes[outside[0]]
        raise DeclarationError(f"the start of '{axis.name}' is {start[outside[0]]:.5g} {axis.unit}, outside its limits "
                               f"{axis.limits[0]:.5g} .. {axis.limits[1]:.5g}; start inside.")
    commands = Unknown("commands", start, [a.unit for a in mechanism.axes], [a.name for a in mechanism.axes],
                       lower=limits[:, 0], upper=limits[:, 1])

    def reached(pose: Any, positions: Any, point: Any, aim: Any) -> Any:
        there = pose(positions)
        at = there @ point
        if turn is None:
            return at
        return vertcat(at, geometry.rotation_vector(geometry.product(aim.T, there.rotation)))
    model, unknowns = resolved(mechanism.pose(frame), calibrated, reached, known)
    held = [np.asarray(_value(calibrated, values, x), float).ravel() for x in unknowns]
    aim = np.asarray(wanted.rotation, float)
    readings = pose_readings([wanted @ np.asarray(target, float)], aim[None])[:, :3 if turn is None else 6]
    u = [place] * 3 + ([] if turn is None else [turn] * 3)
    wish = Observations(model, commands, Shared(target), Shared(aim), *(Shared(h) for h in held), readings=readings,
                        u=u,
                        group="wanted pose", components=("x", "y", "z", "rx", "ry", "rz")[:len(u)],
                        unit=(["mm"] * 3 + ["mrad"] * 3)[:len(u)])
    ties = [] if stay is None else [prior(commands, start, stay, name="stay near")]
    return Problem([wish, *ties], name=f"commands of {mechanism.name}")


def _value(calibrated: Problem, values: Mapping[Any, Any], unknown: Unknown) -> Any:
    for attached in calibrated.attached:
        if attached.unknown is unknown:
            for key in (attached.effect, attached.effect.label, attached.effect.name, unknown):
                if key in values:
                    return values[key]
    return np.zeros(unknown.freedom)


def pose_error(mechanism: Mechanism, frame: str, wanted: Transform, commands: ArrayLike, calibrated: Problem,
               target: ArrayLike = (0.0, 0.0, 0.0), known: Mapping[str, float] | None = None,
               name: str = "pose error") -> Quantity:
    """The pose reached with some commands less the wanted one, as a quantity of the calibration.

    Add it to the calibrated problem (`problem.with_quantities`): its value is the residual pose error and its
    covariance what the calibration does not know. Arguments as of `inverse_problem`; commands: (axes,) or (n, axes).
    Parts: dx, dy, dz of the target [m], rx, ry, rz about the axes of the wanted frame [rad].
    """
    def error(pose: Any, positions: Any, point: Any, at: Any, aim: Any) -> Any:
        there = pose(positions)
        return vertcat(there @ point - at, geometry.rotation_vector(geometry.product(aim.T, there.rotation)))
    model, unknowns = resolved(mechanism.pose(frame), calibrated, error, known)
    rows = np.atleast_2d(np.asarray(commands, float))
    at = np.asarray(wanted @ np.asarray(target, float), float)
    return Quantity(name, model, rows if len(rows) > 1 else Shared(rows[0]), Shared(target), Shared(at),
                    Shared(np.asarray(wanted.rotation, float)), *unknowns, unit=["mm"] * 3 + ["mrad"] * 3,
                    parts=("dx", "dy", "dz", "rx", "ry", "rz"))


def wanted_pose(mechanism: Mechanism, frame: str, positions: ArrayLike) -> Transform:
    """The nominal pose at some positions (axes,): what a controller without compensation believes to reach."""
    rotations, places = mechanism.poses(frame, np.atleast_2d(positions))
    return Transform(rotations[0], places[0])


def commands_of(estimate: Any) -> Array:
    """Commands (axes,) of a solved inverse problem, in SI."""
    return np.asarray(estimate["commands"], float)
