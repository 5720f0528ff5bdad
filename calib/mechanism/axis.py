"""Axes, frames and loads: what a person lists to describe a mechanism, all in base coordinates with every axis at
zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import geometry
from calib.errors import DeclarationError
from calib.geometry import Transform

Array = NDArray[np.float64]
COMPONENTS = ("X", "Y", "Z", "A", "B", "C")      # ISO 230-1: three displacements, three turns about them


@dataclass(frozen=True, eq=False)
class Axis:
    """One axis of a mechanism, in base coordinates with all axes at zero; use `Rotary` or `Linear`.

    name: an identifier; direction: (3,) of positive motion (right-handed), any length; through: (3,) a point of it [m]
    (of a linear axis: the point that its angular errors turn about); carried_by: the axis that carries it, None for the
    base; limits: (lower, upper) commands [rad or m]; reference: (3, 3) whose columns are the X, Y, Z that its errors
    are named by (the base's where the axis is parallel to one of them, else one with Z along the axis).
    Raises DeclarationError for an axis of zero length, a name that is no identifier, or crossed limits.
    """

    name: str
    direction: ArrayLike
    through: ArrayLike = (0.0, 0.0, 0.0)
    carried_by: str | None = None
    limits: tuple[float, float] = (-np.inf, np.inf)
    reference: ArrayLike | None = None
    along: int = field(init=False)
    is_rotary = False

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise DeclarationError(f"axis '{self.name}': the name is used in names of effects; write letters, digits "
                                   "and _ only.")
        direction = np.asarray(self.direction, float).reshape(3)
        length = float(np.linalg.norm(direction))
        if not length > 1e-12:
            raise DeclarationError(f"axis '{self.name}' has zero length {direction.tolist()}: give the direction in "
                                   "which it moves, such as (0, 0, 1).")
        if not self.limits[0] < self.limits[1]:
            raise DeclarationError(f"axis '{self.name}': its lower limit {self.limits[0]:g} lies not below the upper "
                                   f"{self.limits[1]:g}; exchange them.")
        direction = direction / length
        if self.reference is None:
            principal = np.abs(direction).max() > 1.0 - 1e-9
            reference = np.eye(3) if principal else geometry.orthonormal_frame(direction)
        else:
            reference = np.asarray(self.reference, float).reshape(3, 3)
        cosines = reference.T @ direction
        along = int(np.argmax(np.abs(cosines)))
        if abs(cosines[along]) < 1.0 - 1e-9:
            raise DeclarationError(f"axis '{self.name}': none of the columns of its reference is parallel to it; "
                                   "leave the reference out, or turn it so that one is.")
        for name, value in (("direction", direction), ("through", np.asarray(self.through, float).reshape(3)),
                            ("reference", reference), ("along", along)):
            object.__setattr__(self, name, value)

    @property
    def travel(self) -> tuple[float, float]:
        """Range of commands over which error motions are described: the limits, a full turn or a metre without
        limits."""
        half = np.pi if self.is_rotary else 0.5
        lower, upper = self.limits
        return (lower if np.isfinite(lower) else -half, upper if np.isfinite(upper) else half)

    @property
    def unit(self) -> str:
        """SI unit of the command."""
        return "rad" if self.is_rotary else "m"

    def motion(self, position: Any) -> Transform:
        """Transform of what the axis carries, for a position [rad or m], without errors."""
        raise NotImplementedError

    def small(self, vector: Any) -> Transform:
        """A small displacement (6,) along and about X, Y, Z of the reference through the point of the axis [m, rad]."""
        # turned vectors make a turned rotation: cheaper in the trace than a product of three matrices
        frame, through = np.asarray(self.reference), np.asarray(self.through)
        turn = geometry.small_rotation(geometry.product(frame, geometry.column(vector[3], vector[4], vector[5])))
        shift = geometry.product(frame, geometry.column(vector[0], vector[1], vector[2]))
        return Transform(turn, shift + through - geometry.product(turn, through))


class Rotary(Axis):
    """A rotary axis; see Axis. Positions in radians."""

    is_rotary = True

    def motion(self, position: Any) -> Transform:
        turn = geometry.rotation_about(self.direction, position)
        return Transform(turn, np.asarray(self.through) - geometry.product(turn, self.through))


class Linear(Axis):
    """A linear axis; see Axis. Positions in metres."""

    def motion(self, position: Any) -> Transform:
        x, y, z = np.asarray(self.direction)
        return Transform(np.eye(3), geometry.column(x * position, y * position, z * position))


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame that somebody asks the pose of: a table, a tool flange, a spindle nose.

    name: an identifier; at: (3,) its origin [m]; rotation: (3, 3) base_from_frame; both in base coordinates with all
    axes at zero; carried_by: the axis that carries it, None for the base.
    """

    name: str
    at: ArrayLike = (0.0, 0.0, 0.0)
    rotation: ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    carried_by: str | None = None

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise DeclarationError(f"frame '{self.name}': the name is used in names of slots; write letters, digits "
                                   "and _ only.")
        rotation = np.asarray(self.rotation, float).reshape(3, 3)
        error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        if error > 1e-6 or np.linalg.det(rotation) < 0:
            raise DeclarationError(f"frame '{self.name}': its rotation is no rotation matrix (R R' differs from the "
                                   f"identity by {error:.1e}); normalise it or exchange rows and columns.")
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "at", np.asarray(self.at, float).reshape(3))

    @property
    def home(self) -> Transform:
        """base_from_frame with all axes at zero."""
        return Transform(np.asarray(self.rotation), np.asarray(self.at))


@dataclass(frozen=True, eq=False)
class Load:
    """A weight that bends the mechanism.

    name; at: (3,) its centre in base coordinates with all axes at zero [m]; carried_by: the axis that carries it;
    mass: [kg]; only ratios of masses matter where compliances are identified.
    """

    name: str
    at: ArrayLike
    carried_by: str
    mass: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", np.asarray(self.at, float).reshape(3))
        if not self.mass > 0:
            raise DeclarationError(f"load '{self.name}': its mass is {self.mass:g} kg; give a positive one or leave "
                                   "it out.")


def names_of(items: Sequence[Any]) -> str:
    """Names of axes or frames, for messages."""
    return ", ".join(item.name for item in items) or "none"
