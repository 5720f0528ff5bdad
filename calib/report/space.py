"""The geometry of a solved job as a drawing that can be turned; without a script, and in print, it stands still."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.report import numbers
from calib.scene import Axes, Points, Scene, Shape, Sights, Track

Array = NDArray[np.float64]
WIDTH, HEIGHT = 720, 480        # of the still drawing; with script it fills its column
VIEW, ABOVE = (-55.0, 22.0), (-90.0, 90.0)     # azimuth and elevation of the eye at first [degrees]
AXIS = 0.7                      # half length of a drawn axis, in radii of the scene
LABELLED = 40                   # names that can be read in one drawing
ELLIPSOIDS = 150                # of one kind of points
DRAWN = 1500                    # points or lines of one shape
LONGEST = 24                    # characters of a name
FINE = 1e4                      # steps of a coordinate in the radius of the scene
ROUND = np.linspace(0.0, 2.0 * np.pi, 33)
KINDS = ("one", "two", "three", "four")


@dataclass(frozen=True)
class Item:
    """One drawn thing: a line (n, 3) or a mark (3,) in radii of the scene, with style, label and name.

    view: azimuth and elevation of the eye in the still drawing [degrees]; size: pixels of a radius there.
    """

    kind: str
    places: Array
    style: str
    label: str = ""
    name: str = ""
    view: tuple[float, float] = VIEW
    size: float = 1.0

    @property
    def still(self) -> str:
        """Where it stands in the drawing that nobody turned."""
        seen = _seen(np.atleast_2d(self.places), self.size, self.view)
        if self.kind == "mark":
            return f"translate({seen[0, 0]:.1f} {seen[0, 1]:.1f})"
        return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in seen)

    @property
    def coordinates(self) -> str:
        """The places as the script reads them."""
        return " ".join(f"{value:.0f}" for value in np.ravel(self.places) * FINE)


@dataclass(frozen=True)
class Space:
    """The drawing: items from back to front, the corner of directions, what it shows in words."""

    items: Sequence[Item]
    corner: Sequence[tuple[str, str, str, str]]
    metre: float
    bar: tuple[str, float]
    view: str
    legend: Sequence[tuple[str, str]]
    caption: str


def space(scene: Scene) -> Space | None:
    """The drawing of a scene; None where it spans no space.

    scene: shapes in one frame [m].
    return: what the template draws.
    """
    shapes = [one for one in scene.upright if len(_extent(one))]
    if not shapes:
        return None
    everything = np.concatenate([_extent(one) for one in shapes])
    low, high = everything.min(axis=0), everything.max(axis=0)
    centre = (low + high) / 2.0
    radius = float(np.linalg.norm(everything - centre, axis=1).max())
    if not radius > 0:
        return None
    larger = _magnification(shapes, radius)
    items: list[Item] = []
    names = list(dict.fromkeys(one.name for one in shapes if not isinstance(one, Sights)))
    legend = []
    for shape in sorted(shapes, key=lambda one: (Sights, Track, Axes, Points).index(type(one))):
        colour = "sight" if isinstance(shape, Sights) else KINDS[names.index(shape.name) % len(KINDS)]
        items += _items(shape, centre, radius, larger, colour)
        if not isinstance(shape, Sights):
            legend.append((_what(shape), colour))
    sights = [one for one in shapes if isinstance(one, Sights)]
    if sights:
        counted = ", ".join(f"{one.name} ({len(one.ends)})" for one in sights)
        legend.append((f"lines of sight: {counted}", "sight"))
    view = ABOVE if (high - low)[2] < 1e-9 * radius else VIEW
    size = _fitting(items, view)
    return Space([replace(one, view=view, size=size) for one in items], list(_corner(view, scene.left_handed)),
                 1.0 / radius, _bar(radius, size), f"{view[0]:g} {view[1]:g}", legend, _caption(shapes, larger))


def _fitting(items: Sequence[Item], view: tuple[float, float]) -> float:
    """Pixels of the radius of the scene, so that the still drawing holds all of it."""
    x, y = np.abs(np.concatenate([_seen(np.atleast_2d(one.places), 1.0, view) for one in items])).max(axis=0)
    return float(min(0.45 * WIDTH / max(x, 1e-9), 0.42 * HEIGHT / max(y, 1e-9)))


def _extent(shape: Shape) -> Array:
    if isinstance(shape, Sights):
        return np.concatenate([shape.starts, shape.ends])
    if isinstance(shape, Axes):
        return np.asarray(shape.through)
    return np.asarray(shape.places)


def _what(shape: Shape) -> str:
    count = len(_extent(shape))
    if isinstance(shape, Track):
        return f"{shape.name}: track"
    return f"{shape.name}: {count} {'axes' if isinstance(shape, Axes) else 'points'}" if count > 1 else shape.name


def _caption(shapes: Sequence[Shape], larger: float) -> str:
    words = []
    if larger:
        size = numbers.plain(larger, 1)
        words.append(f"Error ellipsoids: semi-axes are standard uncertainties, drawn {size} times as large.")
    cut = [one.name for one in shapes if not isinstance(one, Axes) and len(_extent(one)) > DRAWN]
    if cut:
        words.append(f"Of {', '.join(cut)} only some are drawn.")
    return " ".join(words)


def _magnification(shapes: Sequence[Shape], radius: float) -> float:
    """How many times as large ellipsoids are drawn, a round number; zero where there are none."""
    sizes = [math.sqrt(max(float(np.linalg.eigvalsh(one)[-1]), 0.0)) / radius
             for shape in shapes if isinstance(shape, Points) and shape.covariance is not None
             for one in shape.covariance if one.any()]
    sizes = [size for size in sizes if size > 0]
    if not sizes:
        return 0.0
    return _nice(min(0.1 / float(np.median(sizes)), 0.4 / max(sizes)))


def _nice(value: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above a number."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9))


# --- from shapes to items --------------------------------------------------------------------------------------------


def _items(shape: Shape, centre: Array, radius: float, larger: float, colour: str) -> Iterator[Item]:
    def normal(places: Array) -> Array:
        return (np.asarray(places, float) - centre) / radius

    if isinstance(shape, Sights):
        step = max(1, -(-len(shape.ends) // DRAWN))
        for start, end in zip(normal(shape.starts)[::step], normal(shape.ends)[::step]):
            yield _line(np.stack([start, end]), colour)
    elif isinstance(shape, Track):
        places = normal(shape.places)
        yield _line(np.concatenate([places, places[:1]]) if shape.closed else places, f"track {colour}")
    elif isinstance(shape, Axes):
        for through, direction, key in zip(normal(shape.through), shape.directions, shape.keys):
            ends = np.stack([through - AXIS * direction, through + AXIS * direction])
            yield _line(ends, f"axis {colour}", shape.name)
            yield _mark(ends[1], f"end {colour}", key, shape.name)
    else:
        yield from _points(shape, normal(shape.places), radius, larger, colour)


def _points(shape: Points, places: Array, radius: float, larger: float, colour: str) -> Iterator[Item]:
    step = max(1, -(-len(places) // DRAWN))
    if shape.covariance is not None and larger:
        uncertain = np.flatnonzero(shape.covariance.any(axis=(1, 2)))
        for i in uncertain[:: max(1, -(-len(uncertain) // ELLIPSOIDS))]:
            for ring in _ellipses(shape.covariance[i]):
                yield _line(places[i] + larger / radius * ring, f"ellipsoid {colour}", shape.name)
    labelled = len(places) <= LABELLED
    for place, key in zip(places[::step], shape.keys[::step]):
        yield _mark(place, f"place {colour}", key if labelled else "", f"{shape.name} {key}".strip())


def _ellipses(covariance: Array) -> Iterator[Array]:
    """The three principal ellipses (33, 3) of an ellipsoid; those without area are left out."""
    squares, directions = np.linalg.eigh((covariance + covariance.T) / 2.0)
    arms = directions * np.sqrt(np.maximum(squares, 0.0))
    for first, second in ((2, 1), (2, 0), (1, 0)):
        if squares[first] > 0:
            yield np.outer(np.cos(ROUND), arms[:, first]) + np.outer(np.sin(ROUND), arms[:, second])


def _line(places: Array, style: str, name: str = "") -> Item:
    return Item("line", places, style, "", name)


def _mark(place: Array, style: str, label: str, name: str) -> Item:
    return Item("mark", place, style, label if len(label) <= LONGEST else label[: LONGEST - 1] + "…", name)


def _seen(places: Array, size: float, view: tuple[float, float]) -> Array:
    """Pixels (n, 2) of normalised places (n, 3) in a view; templates/space.js has the same two lines."""
    a, e = np.radians(view)
    right = np.cos(a) * places[:, 1] - np.sin(a) * places[:, 0]
    up = np.cos(e) * places[:, 2] - np.sin(e) * (np.cos(a) * places[:, 0] + np.sin(a) * places[:, 1])
    return size * np.stack([right, -up], axis=1) + 0.0


def _corner(view: tuple[float, float], left_handed: bool) -> Iterator[tuple[str, str, str, str]]:
    """Name, still line, still place of the name, and direction of x, y, z."""
    for name, direction in zip("yxz" if left_handed else "xyz", np.eye(3)):
        (x, y), (a, b) = _seen(np.stack([direction, 1.35 * direction]), 26.0, view)
        yield name, f"M0 0L{x:.1f} {y:.1f}", f"translate({a:.1f} {b:.1f})", " ".join(f"{v:g}" for v in direction)


def _bar(radius: float, size: float) -> tuple[str, float]:
    """Text and pixels of the scale bar."""
    length = _nice(0.25 * WIDTH / size * radius)
    scale, unit = next(((s, u) for s, u in ((1e3, "km"), (1.0, "m"), (1e-3, "mm")) if length >= s), (1e-6, "µm"))
    return f"{length / scale:g} {unit}", length / radius * size


# --- the script ------------------------------------------------------------------------------------------------------


@cache
def script() -> str:
    """The script that turns the drawings of a page."""
    return (Path(__file__).parent / "templates" / "space.js").read_text(encoding="utf-8")


@cache
def script_hash() -> str:
    """What a page allows to run: this script and no other."""
    return "sha256-" + base64.b64encode(hashlib.sha256(script().encode()).digest()).decode()


def marked(text: str) -> Any:
    """Our own script as markup; nothing else may pass here."""
    from markupsafe import Markup

    return Markup(text)
