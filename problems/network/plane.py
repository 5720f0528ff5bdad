"""A plane frame that grows: points placed from those already there, and one frame laid onto another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from problems.network.start import Sketch

FLAT = 0.05  # sine of the angle below which two lines do not meet well
SAME = 0.02  # misfit, relative to the size of the figure, up to which a second solution is as good as the first


class Frame:
    """Positions {key: complex} in one frame; guessed: points of which the mirrored position fits as well."""

    def __init__(self, drawn: Sketch, placed: dict[str, complex], free_scale: bool = False):
        if free_scale:                # lengths do not hold in a frame whose scale is nobody's
            drawn = replace(drawn, lengths={}, vectors={})
        self.drawn, self.placed, self.free_scale = drawn, placed, free_scale
        self.guessed: set[str] = set()

    @staticmethod
    def seed(drawn: Sketch, wanted: set[str]) -> tuple[str, Frame] | None:
        """A frame of two points, from the wanted point that is joined to most others; None where there is none."""
        partners: dict[str, dict[str, float | None]] = {}
        for a, b in drawn.lengths:
            partners.setdefault(a, {})[b] = drawn.lengths[a, b]
        for station, targets, _ in drawn.settings:
            for target in targets:
                partners.setdefault(station, {}).setdefault(target, None)
                partners.setdefault(target, {}).setdefault(station, None)
        best = max((key for key in wanted if key in partners), key=lambda k: len(partners[k]), default=None)
        if best is None:
            return None
        # The partner that shares most partners, so that the next point closes a triangle.
        second = max(partners[best], key=lambda k: (partners[best][k] is not None,
                                                    len(partners[best].keys() & partners.get(k, {}).keys())))
        length = partners[best][second]
        return best, Frame(drawn, {best: 0j, second: complex(length or 1.0)}, length is None)

    def grow(self) -> None:
        """Place whatever follows from what is placed; ambiguous points only where nothing else is left."""
        points = {a for a, _ in (*self.drawn.lengths, *self.drawn.bearings, *self.drawn.vectors)}
        points |= {k for station, targets, _ in self.drawn.settings for k in (station, *targets)}
        while True:
            progress = False
            for bold in (False, True):
                turns = self._orientations()
                for key in sorted(points - self.placed.keys()):
                    place = self._place(key, turns, bold)
                    if place is not None:
                        self.placed[key] = place
                        progress = True
                        turns = self._orientations()
                        if bold:
                            self.guessed.add(key)
                            break
                if progress:
                    break
            if not progress:
                return

    def _orientations(self) -> list[float | None]:
        """Bearing of the zero of each setting; None where its station or all its targets are still unknown."""
        found: list[float | None] = []
        for station, targets, readings in self.drawn.settings:
            here = self.placed.get(station)
            total = 0j
            for target, reading in zip(targets, readings, strict=True):
                bearing = self.drawn.bearings.get((station, target))
                if bearing is not None:
                    total += np.exp(1j * (bearing - reading))
                elif here is not None and target in self.placed and self.placed[target] != here:
                    total += np.exp(1j * (np.angle(self.placed[target] - here) - reading))
            found.append(float(np.angle(total)) if abs(total) > 1e-9 else None)
        return found

    def _evidence(self, key: str, turns: list[float | None]) -> tuple[list[Any], list[Any], list[Any]]:
        """Rays (origin, bearing) that lead to a point, circles (centre, radius) it lies on, and settings of its own
        as (positions, readings)."""
        rays = [(self.placed[a], bearing) for (a, b), bearing in self.drawn.bearings.items()
                if b == key and a in self.placed]
        circles = [(self.placed[a], length) for (a, b), length in self.drawn.lengths.items()
                   if b == key and a in self.placed]
        own = []
        for (station, targets, readings), turn in zip(self.drawn.settings, turns, strict=True):
            if station == key:
                seen = [(self.placed[t], r) for t, r in zip(targets, readings, strict=True) if t in self.placed]
                if len(seen) > 1:
                    own.append(([p for p, _ in seen], [r for _, r in seen]))
                if turn is not None:
                    rays += [(p, turn + r + np.pi) for p, r in seen]
            elif turn is not None and station in self.placed:
                rays += [(self.placed[station], turn + r) for t, r in zip(targets, readings, strict=True) if t == key]
        return rays, circles, own

    def _place(self, key: str, turns: list[float | None], bold: bool) -> complex | None:
        for (a, b), difference in self.drawn.vectors.items():
            if b == key and a in self.placed:
                return self.placed[a] + difference
        rays, circles, own = self._evidence(key, turns)
        candidates = [c for c in _candidates(rays, circles, own) if np.isfinite(c)]
        if not candidates:
            return None
        misfits = np.array([_misfit(c, rays, circles, own) for c in candidates])
        best = int(np.argmin(misfits))
        place = candidates[best]
        origins = [p for p, _ in (*rays, *circles)] + [p for seen, _ in own for p in seen]
        size = max(abs(place - p) for p in origins)
        rivals = [c for c, m in zip(candidates, misfits, strict=True) if m < misfits[best] + SAME * size]
        apart = max(abs(c - place) for c in rivals)
        return place if bold or apart < 0.1 * size else None


def _candidates(rays: list[Any], circles: list[Any], own: list[Any]) -> Iterator[complex]:
    for origin, bearing in rays:
        for centre, radius in circles:
            if origin == centre:
                yield origin + radius * np.exp(1j * bearing)
            else:
                yield from _ray_and_circle(origin, bearing, centre, radius)
    for (a, first), (b, second) in combinations(rays, 2):
        place = _intersection(a, first, b, second)
        if place is not None:
            yield place
    for (a, r), (b, s) in combinations(circles[:6], 2):
        yield from _two_circles(a, r, b, s)
    angles = [(p[i], p[j], r[j] - r[i]) for p, r in own for i, j in combinations(range(len(p)), 2)]
    inscribed = [_inscribed(a, b, turn) for a, b, turn in angles[:8]]
    inscribed = [c for c in inscribed if c is not None]
    for first, second in combinations([*inscribed, *circles[:4]], 2):
        yield from _two_circles(*first, *second)


def _misfit(place: complex, rays: list[Any], circles: list[Any], own: list[Any]) -> float:
    """Root mean square [m] by which a place misses its rays, circles and directions."""
    misses = [abs(place - c) - r for c, r in circles]
    misses += [abs(place - p) * np.abs(np.exp(1j * (np.angle(place - p) - b)) - 1) for p, b in rays if place != p]
    for seen, readings in own:
        turn = np.exp(1j * (np.angle(np.array(seen) - place) - np.array(readings)))
        misses += (np.abs(np.array(seen) - place) * np.abs(turn - turn.sum() / max(abs(turn.sum()), 1e-12))).tolist()
    return float(np.sqrt(np.mean(np.square(misses)))) if misses else 0.0


def _intersection(a: complex, first: float, b: complex, second: float) -> complex | None:
    u, v = np.exp(1j * first), np.exp(1j * second)
    across = (np.conj(u) * v).imag
    if abs(across) < FLAT:
        return None
    along = (np.conj(b - a) * v).imag / across
    return a + along * u if along > 0 else None


def _ray_and_circle(origin: complex, bearing: float, centre: complex, radius: float) -> Iterator[complex]:
    u = np.exp(1j * bearing)
    along, off = (np.conj(u) * (centre - origin)).real, (np.conj(u) * (centre - origin)).imag
    half = radius**2 - off**2
    if half > -((0.05 * radius) ** 2):
        for side in (-1, 1):
            distance = along + side * np.sqrt(max(half, 0.0))
            if distance > 0:
                yield origin + distance * u


def _two_circles(a: complex, r: float, b: complex, s: float) -> Iterator[complex]:
    gap = abs(b - a)
    if gap < 1e-9:
        return
    along = (gap**2 + r**2 - s**2) / (2.0 * gap)
    square = r**2 - along**2
    if square < -((0.1 * max(r, s)) ** 2):
        return
    unit = (b - a) / gap
    for side in (-1, 1):
        yield a + unit * (along + side * 1j * np.sqrt(max(square, 0.0)))


def _inscribed(a: complex, b: complex, turn: float) -> tuple[complex, float] | None:
    """Centre and radius of the circle from which b appears by `turn` beyond a."""
    if abs(np.sin(turn)) < FLAT:
        return None
    centre = (a + b) / 2 + 1j * (b - a) / (2.0 * np.tan(turn))
    return centre, abs(centre - a)


def laid_onto(frame: Frame, main: Frame) -> bool:
    """Lay a frame onto the main one by the points both have, and take its other points over; False where it cannot."""
    common = sorted(frame.placed.keys() & main.placed.keys())
    if len(common) < 2:
        return False
    target = np.array([main.placed[k] for k in common])
    mirrors = (False, True) if not frame.drawn.settings and not frame.drawn.bearings else (False,)
    best, choice = np.inf, None
    for mirror in mirrors:
        own = np.array([frame.placed[k] for k in common])
        own = np.conj(own) if mirror else own
        a, b = own - own.mean(), target - target.mean()
        turn = np.vdot(a, b) / max(float(np.vdot(a, a).real), 1e-300)
        if not frame.free_scale and abs(turn) > 0:
            turn /= abs(turn)
        miss = float(np.linalg.norm(b - turn * a))
        if miss < best:
            best, choice = miss, (mirror, turn, own.mean())
    if choice is None:
        return False
    mirror, turn, middle = choice
    for key, place in frame.placed.items():
        moved = target.mean() + turn * ((np.conj(place) if mirror else place) - middle)
        main.placed.setdefault(key, complex(moved))
    return True
