"""What a measurement looks like in space: points with their covariance, axes, lines of sight, tracks and frames.

A problem module says more than its unknowns do by a function `scene(job, estimate)` that returns a Scene; all of its
shapes stand in one frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import DeclarationError

Array = NDArray[np.float64]


def _places(values: ArrayLike, what: str) -> Array:
    places = np.asarray(values, float).reshape(-1, 3)
    if not np.isfinite(places).all():
        raise DeclarationError(f"scene: {what} have coordinates that are no numbers; leave those out.")
    return places


def _keys(keys: Sequence[Any] | None, count: int) -> tuple[str, ...]:
    found = ("",) * count if keys is None else tuple(str(key) for key in keys)
    if len(found) != count:
        raise DeclarationError(f"scene: {len(found)} names for {count} shapes; give one each.")
    return found


@dataclass(frozen=True, eq=False)
class Points:
    """Points of one kind.

    name: of the kind; places: (n, 3) [m]; keys: their n names, None for none; covariance: (n, 3, 3) [m²], zero or None
    where a point is exact.
    Raises DeclarationError for a coordinate that is no number, or another number of names.
    """

    name: str
    places: Any
    keys: Any = None
    covariance: Any = None

    def __post_init__(self) -> None:
        places = _places(self.places, self.name)
        object.__setattr__(self, "places", places)
        object.__setattr__(self, "keys", _keys(self.keys, len(places)))
        if self.covariance is not None:
            object.__setattr__(self, "covariance", np.asarray(self.covariance, float).reshape(len(places), 3, 3))


@dataclass(frozen=True, eq=False)
class Axes:
    """Straight axes of one kind: through: (n, 3) [m] a point of each; directions: (n, 3), any length; keys: n names."""

    name: str
    through: Any
    directions: Any
    keys: Any = None

    def __post_init__(self) -> None:
        through, directions = _places(self.through, self.name), _places(self.directions, self.name)
        length = np.linalg.norm(directions, axis=1, keepdims=True)
        if len(through) != len(directions) or not np.all(length > 0):
            raise DeclarationError(f"scene: {self.name} need a point and a direction each.")
        object.__setattr__(self, "through", through)
        object.__setattr__(self, "directions", directions / length)
        object.__setattr__(self, "keys", _keys(self.keys, len(through)))


@dataclass(frozen=True, eq=False)
class Sights:
    """Lines of sight of one kind: starts, ends: (n, 3) [m]."""

    name: str
    starts: Any
    ends: Any

    def __post_init__(self) -> None:
        ends = _places(self.ends, self.name)
        object.__setattr__(self, "ends", ends)
        object.__setattr__(self, "starts", np.broadcast_to(_places(self.starts, self.name), ends.shape))


@dataclass(frozen=True, eq=False)
class Track:
    """A path through space: places: (n, 3) [m] in order; closed: back to the first."""

    name: str
    places: Any
    closed: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "places", _places(self.places, self.name))


Shape = Points | Axes | Sights | Track

SWAPPED = [1, 0, 2]


@dataclass(frozen=True, eq=False)
class Scene:
    """Shapes in one frame.

    shapes; left_handed: whether x, y, z make a left-handed frame, as where x is north, y east and z up.
    """

    shapes: tuple[Shape, ...]
    left_handed: bool = False

    @property
    def upright(self) -> tuple[Shape, ...]:
        """The shapes in a right-handed frame: those of a left-handed one with x and y exchanged."""
        return tuple(_swapped(one) for one in self.shapes) if self.left_handed else tuple(self.shapes)


def _swapped(shape: Shape) -> Shape:
    if isinstance(shape, Points):
        spread = None if shape.covariance is None else shape.covariance[:, SWAPPED][:, :, SWAPPED]
        return replace(shape, places=shape.places[:, SWAPPED], covariance=spread)
    if isinstance(shape, Axes):
        return replace(shape, through=shape.through[:, SWAPPED], directions=shape.directions[:, SWAPPED])
    if isinstance(shape, Sights):
        return replace(shape, starts=shape.starts[:, SWAPPED], ends=shape.ends[:, SWAPPED])
    return replace(shape, places=shape.places[:, SWAPPED])
