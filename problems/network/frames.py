"""Frames that move rigidly: bodies whose points keep their places in them, and that stand elsewhere in every epoch.

A point of a frame stands in the parent at Rz(rz) Ry(ry) Rx(rx) p + (x, y, z): turned about the fixed axes x, y, z of
the parent in this order, then shifted. Each of the six numbers is free or held, and what is held is exact: one free
number is a guide or an axis of rotation. An axis that is itself unknown is a frame around that one.
Source: Jones (2015), LGC2 user guide, CERN, for frames with single free parameters; ISO 9787 for the order of turns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from calib import units
from calib.errors import InputError

if TYPE_CHECKING:
    from problems.network.survey import Survey

PARTS = ("x", "y", "z", "rx", "ry", "rz")
UNITS = ("m", "m", "m", "deg", "deg", "deg")
MOVES = {"xyz": PARTS, "xy": ("x", "y", "rz"), "z": ("z",)}     # what a frame can do in a network of these coordinates


@dataclass(frozen=True)
class RigidFrame:
    """Where a frame stands in one epoch.

    name; epoch: "" where it stands the same in all; place: x, y, z [m], rx, ry, rz [rad] in the parent, start values
    where they are free; free: names of those; parent: name of the frame around it, "" for the network.
    """

    name: str
    free: tuple[str, ...] = ()
    place: tuple[float, ...] = (0.0,) * 6
    epoch: str = ""
    parent: str = ""

    @property
    def key(self) -> str:
        """Name in results: of the frame, and the epoch after an @."""
        return f"{self.name}@{self.epoch}" if self.epoch else self.name


def moved(point: Any, frame: Any) -> tuple[Any, Any, Any]:
    """Coordinates x, y, z in the parent of a point given in a frame; frame: its six numbers. Symbols, numbers or
    arrays."""
    x, y, z = point
    y, z = _turned(y, z, frame[3])
    z, x = _turned(z, x, frame[4])
    x, y = _turned(x, y, frame[5])
    return x + frame[0], y + frame[1], z + frame[2]


def moved_back(point: Any, frame: Any) -> tuple[Any, Any, Any]:
    """Coordinates in a frame of a point given in its parent: `moved` the other way."""
    x, y, z = (point[i] - frame[i] for i in range(3))
    x, y = _turned(x, y, -frame[5])
    z, x = _turned(z, x, -frame[4])
    y, z = _turned(y, z, -frame[3])
    return x, y, z


def _turned(a: Any, b: Any, angle: Any) -> tuple[Any, Any]:
    of = ca if isinstance(angle, ca.SX) else np
    c, s = of.cos(angle), of.sin(angle)
    return c * a - s * b, s * a + c * b


def checked_frames(frames: Sequence[RigidFrame], parts: str) -> tuple[RigidFrame, ...]:
    """The frames, where they make sense together.

    parts: coordinates of the network. Raises InputError naming a frame that stands twice, in an unknown frame, in
    itself, or that moves as nothing in this network can.
    """
    names = {one.name for one in frames}
    seen: set[str] = set()
    for one in frames:
        if one.key in seen:
            raise InputError(f"frame '{one.key}' is described twice; give each epoch of a frame once")
        seen.add(one.key)
        wrong = [part for part in one.free if part not in PARTS]
        if wrong:
            raise InputError(f"frame '{one.key}': '{wrong[0]}' cannot be free; write any of {', '.join(PARTS)}")
        needless = [part for part in one.free if part not in MOVES[parts]]
        if needless:
            raise InputError(f"frame '{one.key}': '{needless[0]}' is free, and this network has the coordinates "
                             f"{', '.join(parts)} only; free {' or '.join(MOVES[parts])}, or hold it")
        if one.parent and one.parent not in names:
            raise InputError(f"frame '{one.key}' stands in '{one.parent}', which is not among the frames"
                             f"{near(one.parent, names)}")
        if one.name in _around(frames, one):
            raise InputError(f"frame '{one.key}' stands in itself ({' in '.join(_around(frames, one))}); name the "
                             "frame around it, or none")
    whole = {one.name for one in frames if not one.epoch} & {one.name for one in frames if one.epoch}
    if whole:
        raise InputError(f"frame '{min(whole)}' is described with epochs and without; give each of its epochs a line")
    return tuple(frames)


def near(word: str, names: Any) -> str:
    """A hint at the nearest spelling, and what there is."""
    found = units.near_matches(word, sorted(names))
    return (f"; did you mean '{found[0]}'?" if found else "") + f" There are: {', '.join(sorted(names)) or 'none'}"


def _around(frames: Sequence[RigidFrame], one: RigidFrame) -> list[str]:
    """Names of the frames around a frame, from the inside, as long as none repeats."""
    found: list[str] = []
    parent = one.parent
    while parent and parent not in found:
        found.append(parent)
        parent = next((other.parent for other in frames if other.name == parent), "")
    return found


def chain(frames: Sequence[RigidFrame], name: str, epoch: str) -> tuple[int, ...]:
    """Numbers of the frames from that of a point to the outermost, as they stand in an epoch.

    Raises InputError where there is no such frame, or it is not described for that epoch.
    """
    found: list[int] = []
    while name:
        place = {one.epoch: i for i, one in enumerate(frames) if one.name == name}
        if not place:
            raise InputError(f"there is no frame '{name}'{near(name, {one.name for one in frames})}")
        number = place.get("", place.get(epoch))
        if number is None:
            what = f"is not described for epoch '{epoch}'" if epoch else \
                "moves from epoch to epoch, and a reading to its points says no epoch; add the column epoch"
            raise InputError(f"frame '{name}' {what}. Its epochs are: {', '.join(place)}")
        found.append(number)
        name = frames[number].parent
    return tuple(found)


def standing(survey: Survey, keys: Any, epochs: Any) -> list[tuple[int, ...]]:
    """The frames that each of n points stands in when it is read: keys (n,), epochs (n,) or None."""
    found: dict[tuple[str, str], tuple[int, ...]] = {}
    when = [""] * len(keys) if epochs is None else np.asarray(epochs).astype(str).tolist()
    pairs = list(zip(np.asarray(keys).astype(str).tolist(), when, strict=True))
    for key, epoch in dict.fromkeys(pairs):
        try:
            found[key, epoch] = chain(survey.frames, survey.points[key].frame, epoch)
        except InputError as error:
            raise InputError(f"point '{key}': {error.sentence}") from None
    return [found[pair] for pair in pairs]


def label(survey: Survey, key: str, inside: Sequence[int]) -> str:
    """Name of a point as it stands in some frames, such as "P in cart@2"; its own name where it is in none."""
    return f"{key} in {'/'.join(survey.frames[i].key for i in inside)}" if inside else key


def labels(survey: Survey, keys: Any, epochs: Any) -> Any:
    """Names (n,) of points as they stand when they are read: keys (n,), epochs (n,) or None."""
    names = np.asarray(keys).astype(str)
    if not survey.frames:
        return names
    return np.array([label(survey, key, inside) for key, inside in
                     zip(names.tolist(), standing(survey, names, epochs), strict=True)])


def everywhere(survey: Survey, keys: Sequence[str]) -> list[str]:
    """Names of all places of some points."""
    taken = places_taken(survey)
    return [*keys, *(name for name, (key, _) in taken.items() if key in keys)]


def places_taken(survey: Survey) -> dict[str, tuple[str, tuple[int, ...]]]:
    """{label: (point, frames)} of every place at which the points of frames are read, in order of appearance."""
    found: dict[str, tuple[str, tuple[int, ...]]] = {}
    if survey.frames:
        for keys, epochs in _ends(survey):
            for key, inside in zip(keys, standing(survey, keys, epochs), strict=True):
                if inside:
                    found.setdefault(label(survey, key, inside), (key, inside))
    return found


def _ends(survey: Survey) -> list[tuple[list[str], Any]]:
    found = [(keys.tolist(), batch.epoch) for batch in survey.every_batch for keys in batch.ends]
    found += [(np.asarray(one.target).astype(str).tolist(), one.epoch) for one in survey.sightings]
    return found + [(np.asarray(one.target).astype(str).tolist(), one.epoch) for one in survey.ranging]


def unrolled(survey: Survey) -> Survey:
    """The survey without frames: what is read of a point at every place of its frame is a point of its own.

    Its places are those that follow from the frames as they stand; a place that is nowhere follows from none.
    """
    if not survey.frames:
        return survey

    def batch(one: Any) -> Any:
        ends = {"station": one.station, "target": one.target, "back": one.back}
        given = {name: labels(survey, keys, one.epoch) for name, keys in ends.items() if keys is not None and len(keys)}
        return replace(one, **given, epoch=None)

    points = {key: point for key, point in survey.points.items() if not point.frame}
    for name, (key, inside) in places_taken(survey).items():
        point, frames = survey.points[key], [survey.frames[i] for i in inside]
        there = outside(point.position, [one.place for one in frames], survey.parts)
        points[name] = replace(point, position=there, frame="",
                               **({} if not any(one.free for one in frames) else
                                  {"plane": point.plane and "adjusted", "height": point.height and "adjusted"}))
    return replace(
        survey, frames=(), points=points, batches=[batch(one) for one in survey.batches],
        correlated=[replace(one, members=tuple(batch(member) for member in one.members)) for one in survey.correlated],
        sightings=[replace(one, target=labels(survey, one.target, one.epoch), epoch=None)
                   for one in survey.sightings],
        ranging=[replace(one, target=labels(survey, one.target, one.epoch), epoch=None) for one in survey.ranging],
    )


def outside(position: Sequence[float], places: Sequence[Any], parts: str,
            move: Callable[..., Any] = moved) -> tuple[float, float, float]:
    """Where a point of nested frames, innermost first, stands in the network; coordinates it has not are left."""
    point: Any = [c if part in parts else 0.0 for c, part in zip(position, "xyz", strict=True)]
    for place in places:
        point = move(point, place)
    x, y, z = (float(c) if part in parts else np.nan for c, part in zip(point, "xyz", strict=True))
    return x, y, z
