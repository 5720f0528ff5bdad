"""Mechanism: axes that carry each other, and the pose of one frame seen from another as a model with slots."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from calib import geometry
from calib.effect import direct
from calib.errors import DeclarationError
from calib.frozen import Frozen
from calib.geometry import Transform
from calib.mechanism.axis import Array, Axis, Frame, Load, names_of
from calib.rows import Program

STANDARD_GRAVITY = 9.80665      # m/s2; only its direction matters where compliances are identified


class Mechanism(Frozen):
    """A tree of rotary and linear axes with frames on it.

    name; axes: in the order in which positions are given; frames: whose poses are asked for (`base` is always there);
    loads: weights that bend it; down: (3,) direction of gravity in base coordinates.
    Raises DeclarationError for a name used twice, a carrier that does not exist, or axes that carry each other in a
    ring.
    """

    def __init__(self, name: str, axes: Sequence[Axis], frames: Sequence[Frame] = (), loads: Sequence[Load] = (),
                 down: ArrayLike = (0.0, 0.0, -1.0)):
        self.name, self.axes, self.loads = name, tuple(axes), tuple(loads)
        self.frames = (*frames, *([] if any(f.name == "base" for f in frames) else [Frame("base")]))
        self._frames_of_axes = {a.name: Frame(a.name, a.through, np.asarray(a.reference), a.name) for a in self.axes}
        self.down = geometry.unit(np.asarray(down, float))
        names = [a.name for a in self.axes]
        for what, given in (("axes", names), ("frames", [f.name for f in self.frames]),
                            ("loads", [x.name for x in loads])):
            twice = sorted({n for n in given if given.count(n) > 1})
            if twice:
                raise DeclarationError(f"mechanism '{name}': two {what} are called '{twice[0]}'; give each its own "
                                       "name.")
        items: list[Any] = [*self.axes, *self.frames, *self.loads]
        for item in items:
            if item.carried_by is not None and item.carried_by not in names:
                near = difflib.get_close_matches(item.carried_by, names, 1)
                raise DeclarationError(f"mechanism '{name}': '{item.name}' is carried by '{item.carried_by}', which "
                                       "is no axis; "
                                       + (f"did you mean '{near[0]}'? " if near else "")
                                       + f"There are: {names_of(self.axes)}.")
        base = next(f for f in self.frames if f.name == "base")
        if base.carried_by is not None or np.any(base.at) or np.any(base.rotation != np.eye(3)):
            raise DeclarationError(f"mechanism '{name}': 'base' is the name of the frame in which all else is given, "
                                   "and the frame of this name stands elsewhere; call it otherwise.")
        self._paths = {axis.name: self._ancestors(axis) for axis in self.axes}

    def _ancestors(self, axis: Axis) -> tuple[Axis, ...]:
        path, here = [axis], axis
        while here.carried_by is not None:
            here = self.axis(here.carried_by)
            if here in path:
                raise DeclarationError(f"mechanism '{self.name}': the axes {names_of(path[::-1])} carry each other in "
                                       "a ring; let one be carried by the base (a parallel mechanism is closed by a "
                                       "constraint, see calib.mechanism.loop).")
            path.append(here)
        return tuple(reversed(path))

    def axis(self, name: str) -> Axis:
        """An axis by name."""
        return self._one(self.axes, name, "axis")

    def frame(self, name: str) -> Frame:
        """A frame by name; the name of an axis means the frame of its reference at its point, which moves with it."""
        known = any(f.name == name for f in self.frames)
        return self._frames_of_axes[name] if not known and name in self._frames_of_axes else \
            self._one(self.frames, name, "frame")

    def _one(self, items: Sequence[Any], name: str, what: str) -> Any:
        for item in items:
            if item.name == name:
                return item
        near = difflib.get_close_matches(name, [i.name for i in items], 1)
        raise DeclarationError(f"mechanism '{self.name}' has no {what} '{name}'; "
                               + (f"did you mean '{near[0]}'? " if near else "")
                               + f"There are: {names_of(items)}.")

    def path(self, frame: str) -> tuple[Axis, ...]:
        """The axes between the base and a frame, base first."""
        carrier = self.frame(frame).carried_by
        return () if carrier is None else self._paths[carrier]

    def path_of(self, load: Load) -> tuple[Axis, ...]:
        """The axes that carry a load, base first."""
        return self._paths[load.carried_by]

    def index(self, axis: str) -> int:
        """Place of an axis among the positions."""
        return self.axes.index(self.axis(axis))

    # --- the model ------------------------------------------------------------------------------------------------

    @lru_cache(maxsize=256)     # noqa: B019 - the same model for the same question, so that it is traced once
    def pose(self, frame: str, seen_from: str = "base") -> Callable[..., Transform]:
        """The model `pose(positions) -> Transform` seen_from_from_frame, with slots for every error.

        frame, seen_from: names of frames. positions: (axes,) [rad or m], in the order of `axes`.
        Slots, for every axis NAME on the way: `NAME_position` (command in, actual position out), `NAME_location` and
        `NAME_motion` ((6,) small displacement along and about X, Y, Z of its reference, before the axis and with it),
        and `FRAME_mounting` for the two frames (not for `base` and not for the frame of an axis). Effects there may ask
        for `position`, `positions`, `levers` ((loads,) horizontal lever arm of each load about the axis [m]).
        An axis moves by location, error motion, motion (rotary) or location, motion, error motion (linear): ISO 230-1.
        Source: product of exponentials, Brockett 1984, with a small displacement before each.
        """
        ahead, behind = self.path(frame), self.path(seen_from)
        shared = 0
        while shared < min(len(ahead), len(behind)) and ahead[shared] is behind[shared]:
            shared += 1
        branches = ((behind[shared:], self.frame(seen_from)), (ahead[shared:], self.frame(frame)))
        on_the_way = [axis for branch, _ in branches for axis in branch]
        slots = [f"{axis.name}_{kind}" for axis in on_the_way for kind in ("position", "location", "motion")]
        slots += [f"{end.name}_mounting" for end in dict.fromkeys(end for _, end in branches if self._is_mounted(end))]

        def model(positions: Any, **taps: Any) -> Transform:
            tap = {name: taps.get(name, direct) for name in slots}
            gravity = self._gravity(positions, on_the_way)
            from_base, to_frame = (self._branch(axes, end, positions, gravity, tap) for axes, end in branches)
            return to_frame if not branches[0][0] and branches[0][1].name == "base" else from_base.inverse() @ to_frame
        kind = inspect.Parameter
        model.__signature__ = inspect.Signature(                                          # type: ignore[attr-defined]
            [kind("positions", kind.POSITIONAL_OR_KEYWORD)]
                                                + [kind(s, kind.KEYWORD_ONLY, default=direct) for s in slots])
        model.__name__ = f"pose_of_{frame}"
        return model

    def _is_mounted(self, frame: Frame) -> bool:
        """Whether somebody mounted the frame, so that it may sit elsewhere than designed."""
        return frame.name != "base" and frame not in self._frames_of_axes.values()

    def _branch(self, axes: Sequence[Axis], end: Frame, positions: Any, gravity: dict[str, Any],
                tap: dict[str, Any]) -> Transform:
        pose = Transform.identity()
        for axis in axes:
            command = positions[self.index(axis.name)]
            known = {"position": command, "positions": positions, **gravity[axis.name]}
            location = tap[f"{axis.name}_location"](ca.DM.zeros(6), **known)
            motion = tap[f"{axis.name}_motion"](ca.DM.zeros(6), **known)
            moved = axis.motion(tap[f"{axis.name}_position"](command, **known))
            parts = (location, motion, moved) if axis.is_rotary else (location, moved, motion)
            for part in parts:
                if isinstance(part, Transform):
                    pose = pose @ part
                elif not isinstance(part, ca.DM):          # a slot without effects hands back the plain zeros
                    pose = pose @ axis.small(part)
        pose = pose @ end.home
        if self._is_mounted(end):
            mounting = tap[f"{end.name}_mounting"](ca.DM.zeros(6), positions=positions)
            if not isinstance(mounting, ca.DM):
                turn = geometry.small_rotation([mounting[3], mounting[4], mounting[5]])
                pose = pose @ Transform(turn, mounting[:3])
        return pose

    def _gravity(self, positions: Any, axes: Sequence[Axis]) -> dict[str, dict[str, Any]]:
        """What gravity does to each axis, per unit weight of each load, at the nominal geometry.

        `levers` (loads,): work on a unit of motion, a lever arm [m] of a rotary axis, a cosine of a linear one;
        `moments` (3, loads): moment about the point of the axis, along X, Y, Z of its reference [m]; zero for loads not
        carried.
        """
        if not self.loads:
            return {axis.name: {"levers": ca.DM.zeros(0), "moments": ca.DM.zeros(3, 0)} for axis in axes}
        nominal: dict[str | None, Transform] = {None: Transform.identity()}
        for axis in sorted(self.axes, key=lambda a: len(self._paths[a.name])):
            nominal[axis.name] = nominal[axis.carried_by] @ axis.motion(positions[self.index(axis.name)])
        acting = {}
        for axis in axes:
            carrier = nominal[axis.carried_by]
            direction, point = carrier.turn(axis.direction), carrier @ axis.through
            levers, moments = [], []
            for load in self.loads:
                if axis in self._paths[load.carried_by]:
                    moment = geometry.cross(nominal[load.carried_by] @ load.at - point, self.down)
                    levers.append(geometry.dot(direction, moment if axis.is_rotary else self.down))
                    moments.append(geometry.product(geometry.product(carrier.rotation, axis.reference).T, moment))
                else:
                    levers.append(0.0)
                    moments.append(ca.DM.zeros(3))
            acting[axis.name] = {"levers": ca.vertcat(*levers), "moments": ca.horzcat(*moments)}
        return acting

    # --- numbers --------------------------------------------------------------------------------------------------

    def home(self, frame: str) -> Transform:
        """base_from_frame with all axes at zero, as numbers."""
        return self.frame(frame).home

    def poses(self, frame: str, positions: ArrayLike, seen_from: str = "base") -> tuple[Array, Array]:
        """Nominal poses at many positions: rotations (n, 3, 3) and translations (n, 3) [m].

        positions: (n, axes) [rad or m]; frame, seen_from: as of `pose`.
        """
        rows = np.asarray(positions, float).reshape(-1, len(self.axes))
        numbers = self._nominal(frame, seen_from)(list(np.ascontiguousarray(rows.T)), len(rows)).T
        return numbers[:, :9].reshape(-1, 3, 3), numbers[:, 9:]

    @lru_cache(maxsize=256)     # noqa: B019 - compiled once for searches that ask again and again
    def _nominal(self, frame: str, seen_from: str) -> Program:
        symbols = ca.SX.sym("positions", len(self.axes))
        transform = self.pose(frame, seen_from)(symbols)
        flat = ca.vertcat(ca.vec(ca.SX(ca.DM(transform.rotation) if isinstance(transform.rotation, np.ndarray)
                                       else transform.rotation).T), ca.SX(transform.translation))
        return Program([symbols], ca.densify(flat))

    def check_positions(self, positions: ArrayLike, rows: ArrayLike | None = None) -> Array:
        """Positions (n, axes) after a look at them.

        positions: (n, axes) [rad or m]; rows: (n,) numbers in the data file, for messages.
        Raises DeclarationError for a wrong number of columns, a value that is not finite, values outside limits (with a
        word where degrees seem to be given as radians), or positions in which only one axis of several ever moves.
        """
        from calib.mechanism.inputs import checked_positions
        return checked_positions(self, positions, rows)
