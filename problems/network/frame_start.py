"""Start values of frames: from where the readings put their points, and from the axis about which these turn.

A frame is laid onto the points whose places in it are known (a scan of its free turns, then least squares); places in a
frame follow from where it stands; an axis or guide that is unknown, from the circles or lines that its points describe.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from casadi import vertcat
from numpy.typing import NDArray

from calib import Observations, Problem, Shared, Unknown, geometry, solve
from calib.errors import CalibrationError
from problems.network import frames
from problems.network.frames import PARTS
from problems.network.survey import FIXED, Survey

Array = NDArray[np.float64]
Known = dict[str, Array]
ANGLES = (1, 72, 24, 16)     # of each free turn, by their number: a sixteenth of a circle is near enough to go on from
SAME = 1e-9                  # of a direction or a place: what is nearer is the same
FAR = 50                     # points of a frame that place it


class Standing:
    """What is known so far of a survey with frames: where they stand, points in them, and points in the network."""

    def __init__(self, survey: Survey, grown: Callable[[Survey], Known]):
        self.survey, self.grown = survey, grown
        self.taken = frames.places_taken(survey)
        self.whole = frames.unrolled(survey)
        self.columns = ["xyz".index(part) for part in survey.parts]
        self.places = [np.array(one.place, float) for one in survey.frames]
        self.located = {i for i, one in enumerate(survey.frames) if not one.free}
        self.local = {key: np.array(survey.points[key].position, float) for key, _ in self.taken.values()}
        self.known: Known = {key: np.array(point.position, float) for key, point in self.whole.points.items()}
        for name, (_, inside) in self.taken.items():
            if not set(inside) <= self.located:
                self.known[name] = np.full(3, np.nan)

    def there(self, place: Array) -> bool:
        """Whether a point has all coordinates of the network."""
        return bool(np.isfinite(place[self.columns]).all())

    def survey_placed(self) -> Survey:
        """The survey at these places."""
        here = {key: self.local.get(key, self.known.get(key, np.array(point.position)))
                for key, point in self.survey.points.items()}
        standing = [replace(one, place=tuple(place.tolist()))
                    for one, place in zip(self.survey.frames, self.places, strict=True)]
        return replace(self.survey.placed(here), frames=standing)

    def advance(self) -> bool:
        """Take one more step from what is known; False where none is left."""
        before = self._count()
        self.known = self.grown(self.whole.placed(self.known))
        if self._datum():
            return True
        self._inwards()
        if self._count() == before and not self._locate() and not self._axes():
            waiting = [i for i in range(len(self.places)) if i not in self.located]
            if not waiting:
                return False
            self.located.add(min(waiting, key=lambda i: len(self._outer(i))))      # as it was said to stand
        self._inwards()
        return True

    def _count(self) -> int:
        return sum(map(self.there, self.known.values())) + sum(map(self.there, self.local.values()))

    def _outer(self, i: int) -> tuple[int, ...]:
        """The frames around a frame."""
        one = self.survey.frames[i]
        return frames.chain(self.survey.frames, one.parent, one.epoch)

    def _inwards(self) -> None:
        """Points in frames that stand, from the network, and the other way round."""
        for name, (key, inside) in self.taken.items():
            if not set(inside) <= self.located or self.there(self.known[name]) == self.there(self.local[key]):
                continue
            places = [self.places[i] for i in inside]
            if self.there(self.known[name]):
                self.local[key] = self._moved(self.known[name], places[::-1], frames.moved_back)
            else:
                self.known[name] = self._moved(self.local[key], places, frames.moved)

    def _moved(self, point: Array, places: Sequence[Array], move: Callable[..., Any]) -> Array:
        return np.array(frames.outside(point.tolist(), places, self.survey.parts, move))

    def _locate(self) -> bool:
        """Lay frames onto their points, the outer ones first."""
        found = False
        for i in sorted(range(len(self.places)), key=lambda i: len(self._outer(i))):
            outer = self._outer(i)
            if i in self.located or not set(outer) <= self.located:
                continue
            own, there = [], []
            for name, (key, inside) in self.taken.items():
                inner = inside[: inside.index(i)] if i in inside else ()
                if i in inside and set(inner) <= self.located and self.there(self.local[key]) \
                        and self.there(self.known[name]):
                    own.append(self._moved(self.local[key], [self.places[k] for k in inner], frames.moved))
                    there.append(self._moved(self.known[name], [self.places[k] for k in outer[::-1]],
                                             frames.moved_back))
            place = laid(self.places[i], self.survey.frames[i].free, np.array(own[:FAR]), np.array(there[:FAR]),
                         self.columns) if own else None
            if place is not None:
                self.places[i], found = place, True
                self.located.add(i)
        return found

    def _moving(self) -> Iterator[tuple[list[int], tuple[int, ...], str]]:
        """Each frame that turns about one axis or slides along one guide: its settings, the frames around it, and what
        is free."""
        for name in dict.fromkeys(one.name for one in self.survey.frames if "z" in self.survey.parts):
            settings = [i for i, one in enumerate(self.survey.frames) if one.name == name]
            parts = {part for i in settings for part in self.survey.frames[i].free}
            around = {self._outer(i) for i in settings}
            if len(parts) == len(around) == 1:
                yield settings, around.pop(), parts.pop()

    def _axes(self) -> bool:
        """Put a frame around one that turns about an axis, or slides along a guide, where its points say."""
        for settings, around, part in self._moving():
            waiting = [i for i in around if i not in self.located]
            axis = self._axis(settings, part) if len(waiting) == 1 else None
            if axis is not None:
                self._put(waiting[0], around, settings[0], part, *axis)
                self.located.add(waiting[0])
                return True
        return False

    def _datum(self) -> bool:
        """Turn the network, where nothing but a moving frame is its datum, so that its axis lies as the frame says."""
        if any(FIXED in (point.plane, point.height) for point in self.whole.points.values()) or any(
                batch.model.points == 1 for batch in self.survey.every_batch):
            return False
        for settings, around, part in self._moving():
            axis = self._axis(settings, part) if not around else None
            if axis is not None and self._turned(settings[0], part, *axis):
                return True
        return False

    def _paths(self, settings: Sequence[int]) -> list[Array]:
        """Places (k, 3) in the network that each point of a frame takes, of those with two or more."""
        of_point: dict[str, list[Array]] = {}
        for name, (key, inside) in self.taken.items():
            if inside[0] in settings and self.there(self.known[name]):
                of_point.setdefault(key, []).append(self.known[name])
        return [np.array(places) for places in of_point.values() if len(places) > 1]

    def _axis(self, settings: Sequence[int], part: str) -> tuple[Array, Array] | None:
        """A point of the axis (or anywhere, of a guide) and its direction, in the network."""
        paths = self._paths(settings)
        if not paths:
            return None
        apart = np.concatenate([path - path.mean(axis=0) for path in paths])
        _, sizes, axes = np.linalg.svd(apart, full_matrices=True)
        if part in ("x", "y", "z"):
            return paths[0].mean(axis=0), axes[0]
        if len(sizes) < 2 or sizes[1] < 1e-3 * sizes[0]:
            return None
        # |w - c| is the same in all epochs: linear in c, of which the part along the axis is free.
        rows = np.concatenate([2.0 * (path[1:] - path[0]) for path in paths])
        right = np.concatenate([np.sum(path[1:] ** 2, axis=1) - np.sum(path[0] ** 2) for path in paths])
        along = axes[2]
        middle = np.concatenate(paths).mean(axis=0)
        centre = np.linalg.lstsq(np.vstack([rows, along]), np.append(right, along @ middle), rcond=None)[0]
        return centre, along

    def _own_axis(self, i: int, part: str) -> tuple[Array, Array]:
        """A point and the direction of the axis of a frame in the frame around it."""
        place = self.places[i]
        turns = np.zeros(6)
        turns[3:] = np.where(np.arange(3) > PARTS.index(part) - 3, place[3:], 0.0) if part[0] == "r" else 0.0
        return place[:3].copy(), np.array(frames.moved(np.eye(3)[PARTS.index(part) % 3], turns))

    def _put(self, i: int, around: Sequence[int], child: int, part: str, through: Array, along: Array) -> None:
        outer = [self.places[k] for k in around[around.index(i) + 1 :]]
        first, second = (self._moved(p, outer[::-1], frames.moved_back) for p in (through, through + along))
        inner = [self.places[k] for k in around[: around.index(i)]]
        own, direction = self._own_axis(child, part)
        ends = np.array([self._moved(p, inner, frames.moved) for p in (own, own + direction)])
        self.places[i] = aligned(self.places[i], self.survey.frames[i].free, ends, first, second - first,
                                 part[0] == "r")

    def _turned(self, child: int, part: str, through: Array, along: Array) -> bool:
        """Turn all that is known so that an axis of the network lies where a frame says; False where it does."""
        own, direction = self._own_axis(child, part)
        along = along if along @ direction >= 0 else -along
        across = np.cross(along, direction)
        size = float(np.linalg.norm(across))
        turn = np.eye(3) if size < SAME else np.asarray(geometry.rotation_about(
            across / size, float(np.arctan2(size, along @ direction))))
        gap = own - turn @ through if part[0] == "r" else np.zeros(3)
        gap -= direction * (direction @ gap)
        if size < SAME and np.linalg.norm(gap) < SAME * (1.0 + np.linalg.norm(through)):
            return False
        self.known = {key: turn @ place + gap for key, place in self.known.items()}
        return True


def placed(survey: Survey, grown: Callable[[Survey], Known]) -> tuple[Survey, Known]:
    """A survey with its frames and points where the readings put them, and all places of its points in the network.

    grown: positions of all points of a survey without frames, as far as its readings say.
    """
    standing = Standing(survey, grown)
    while standing.advance():
        pass
    return standing.survey_placed(), standing.known


def _there(point: Any, frame: Any) -> Any:
    return vertcat(*frames.moved([point[i] for i in range(3)], frame))


def _off_line(point: Any, frame: Any, line: Any) -> Any:
    return geometry.cross(line[:, 1], _there(point, frame) - line[:, 0])


def _solved(model: Any, arguments: Sequence[Any], frame: Unknown, free: Sequence[str], readings: Array, *,
            further: Sequence[Any] = ()) -> Array | None:
    """The six numbers of a frame by least squares; None where they do not follow."""
    seen = Observations(model, *arguments, frame, *further, readings=readings, u=1.0, unit="m")
    try:
        return np.asarray(solve(Problem([seen]).hold(*(frame.part(p) for p in PARTS if p not in free)))[frame], float)
    except CalibrationError:
        return None


def laid(place: Array, free: Sequence[str], own: Array, there: Array, columns: Sequence[int]) -> Array | None:
    """The six numbers of a frame that lays its points (n, 3) onto those of its parent (n, 3); None where they do not
    follow. columns: of the coordinates that count."""
    own, there = (np.where(np.isin(np.arange(3), columns), points, 0.0) for points in (own, there))
    start = _scanned(place, free, own, there)
    found = _solved(_there, [own], Unknown("frame", start, frames.UNITS, PARTS), free, there)
    return None if found is None else principal(found, free)


def principal(place: Array, free: Sequence[str]) -> Array:
    """The same place with free turns within half a circle, and, where all three are free, ry within a quarter."""
    found = place.copy()
    turns = [i for i in (3, 4, 5) if PARTS[i] in free]
    if len(turns) == 3 and np.cos(found[4]) < 0.0:
        found[3:] = found[3] + np.pi, np.pi - found[4], found[5] + np.pi
    found[turns] = np.pi - (np.pi - found[turns]) % (2.0 * np.pi)
    return found


def _scanned(place: Array, free: Sequence[str], own: Array, there: Array) -> Array:
    """The best of a grid of turns, each with the shift that fits it best; the turns as given where they fit as well."""
    turns = [i for i in (3, 4, 5) if PARTS[i] in free]
    grid = np.pi - np.arange(ANGLES[len(turns)]) * 2.0 * np.pi / ANGLES[len(turns)]
    trial = np.tile(place, (1 + len(grid) ** len(turns), 1))
    trial[1:, turns] = np.array(list(product(grid, repeat=len(turns))))
    still = np.array([part in free for part in PARTS[:3]])
    trial[:, :3][:, still] = 0.0
    turned = np.stack(frames.moved(own.T[:, None, :], trial.T[:, :, None]), axis=2)
    shift = np.where(still, (there - turned).mean(axis=1), 0.0)
    cost = np.sum((turned + shift[:, None, :] - there) ** 2, axis=(1, 2))
    best = 0 if cost[0] <= cost.min() * (1.0 + 1e-6) else int(np.argmin(cost))
    trial[best, :3] += shift[best]
    return np.asarray(trial[best])


def aligned(place: Array, free: Sequence[str], own: Array, through: Array, along: Array, turns: bool) -> Array:
    """The six numbers of a frame that lays a line of it (two points (2, 3)) onto a line of its parent; of a guide only
    the direction counts. Of the two senses the one nearer to the given numbers."""
    found = []
    for sense in (1.0, -1.0):
        towards = np.array([np.zeros(3), sense * along])
        start = _scanned(place, [part for part in free if part[0] == "r"] + list("xyz"), own - own[0], towards)
        start[:3] = np.where([part in free for part in PARTS[:3]], place[:3] if not turns else
                             through - np.array(frames.moved(own[0], np.append(np.zeros(3), start[3:]))), place[:3])
        frame = Unknown("frame", start, frames.UNITS, PARTS)
        line = Shared(np.column_stack([through, sense * along]))
        refined = _solved(_off_line, [own], frame, free, np.zeros((2, 3)), further=[line]) if turns else None
        found.append(start if refined is None else refined)
    apart = [float(np.sum(1.0 - np.cos(one[3:] - place[3:]))) for one in found]
    return found[int(np.argmin(apart))]
