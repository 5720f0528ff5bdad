"""The geometry that was identified: a mechanism whose axes and frames stand where the location errors put them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from calib.effect import Effect
from calib.geometry import Transform
from calib.mechanism.axis import Array, Axis, Frame, Load
from calib.mechanism.chain import Mechanism


@dataclass(frozen=True)
class Identified:
    """mechanism: with the identified geometry; left_out: labels of effects that no geometry can hold, which a
    controller must compensate for by itself (scales, harmonics, error motions, deflection)."""

    mechanism: Mechanism
    left_out: tuple[str, ...]


def identified(mechanism: Mechanism, effects: Mapping[Effect, Any]) -> Identified:
    """The mechanism with location errors, zero offsets and mounting errors turned into geometry.

    effects: {effect: its parameters}, such as {e: estimate[e] for e in problem.effects}; all zero ones change nothing.
    """
    left_out = [e.label for e, p in effects.items() if np.any(np.asarray(p) != 0.0) and not _is_constant(mechanism, e)]
    constant = {e: np.ravel(np.asarray(p, float)) for e, p in effects.items() if _is_constant(mechanism, e)}
    moved: dict[str | None, Transform] = {None: Transform.identity()}
    axes: dict[str, Axis] = {}
    for axis in sorted(mechanism.axes, key=lambda a: len(mechanism._paths[a.name])):
        carrier = moved[axis.carried_by] @ _numbers(axis.small(_sum(constant, f"{axis.name}_location", 6)))
        offset = float(_sum(constant, f"{axis.name}_position", 1)[0])
        moved[axis.name] = carrier @ axis.motion(offset)
        axes[axis.name] = type(axis)(axis.name, carrier.turn(axis.direction), carrier @ axis.through, axis.carried_by,
                                     axis.limits,
                                     carrier.rotation @ np.asarray(axis.reference))
    frames = []
    for frame in mechanism.frames:
        home = moved[frame.carried_by] @ frame.home
        if frame.name != "base":
            shift = _sum(constant, f"{frame.name}_mounting", 6)
            home = home @ _numbers(_small(shift))
        frames.append(Frame(frame.name, home.translation, home.rotation, frame.carried_by))
    loads = [Load(x.name, moved[x.carried_by] @ x.at, x.carried_by, x.mass) for x in mechanism.loads]
    ordered = [axes[a.name] for a in mechanism.axes]
    return Identified(Mechanism(mechanism.name, ordered, frames, loads, mechanism.down), tuple(left_out))


def _is_constant(mechanism: Mechanism, effect: Effect) -> bool:
    """Whether an effect is part of the geometry: it asks for nothing, and its contribution does not depend on the
    value."""
    if effect.inputs or effect.slot.endswith("_motion"):
        return False
    if not effect.slot.endswith("_position"):
        return True
    value = ca.SX.sym("value")
    total = ca.SX(effect.function(value, effect.bundle(*[ca.SX.sym(p.name) for p in effect.parameters])))
    return not bool(ca.depends_on(total, value))


def _sum(effects: Mapping[Effect, Array], slot: str, size: int) -> Array:
    total = np.zeros(size)
    for effect, parameters in effects.items():
        if effect.slot == slot:
            amount = ca.DM(ca.evalf(ca.SX(effect.function(ca.SX.zeros(size), effect.bundle(*map(float, parameters))))))
            total = total + np.asarray(amount).ravel()
    return total


def _small(vector: Array) -> Transform:
    from calib import geometry
    return Transform(geometry.small_rotation(vector[3:]), np.asarray(vector[:3], float))


def _numbers(transform: Transform) -> Transform:
    return Transform(np.asarray(transform.rotation, float), np.asarray(transform.translation, float).ravel())
