"""Start values from the readings: positions of points that have none, found by growing from what is known.

Polar points, intersections of rays and circles, resections and vectors are placed one after the other; where nothing
more can be placed, a frame of its own is grown from a station and laid onto the points both have in common (traverses,
free stations). Networks of ranges alone start from multidimensional scaling. Positions are good to some per cent.
Source: Kahmen, Faig (1988), Surveying; Torgerson (1952), Psychometrika 17, for classical scaling.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from calib.errors import InputError
from problems.network import frame_start, frames, heights, ranges
from problems.network.lacking import Lacking
from problems.network.plane import Frame, laid_onto
from problems.network.stations import spread
from problems.network.survey import Survey

RANGES = {"distance", "slope distance", "scale bar"}


@dataclass
class Sketch:
    """What the readings say about the plane, with positions as complex numbers x + i sense y [m].

    settings: (station, targets, readings) of each setting of a circle, angles among them; bearings: {(a, b): rad};
    lengths: {(a, b): horizontal distance}; vectors: {(a, b): difference}.
    """

    settings: list[tuple[str, list[str], list[float]]] = field(default_factory=list)
    bearings: dict[tuple[str, str], float] = field(default_factory=dict)
    lengths: dict[tuple[str, str], float] = field(default_factory=dict)
    vectors: dict[tuple[str, str], complex] = field(default_factory=dict)

    def both_ways(self, a: str, b: str, length: float) -> None:
        """Note a horizontal distance."""
        self.lengths[a, b] = self.lengths[b, a] = length


def positions(survey: Survey) -> Survey:
    """The survey with an approximate position for every point that takes part.

    Positions that are given stay. Raises InputError naming the points that cannot be placed, what they are read by and
    what would place them.
    """
    if survey.frames:
        found, known = frame_start.placed(survey, grown)
        whole = frames.unrolled(found)
    else:
        whole, known = survey, grown(survey)
        found = survey.placed(known)
    left = {part: [key for key in _missing(whole, part) if np.isnan(known[key]["xyz".index(part)])]
            for part in survey.parts}
    lost = list(dict.fromkeys(key for keys in left.values() for key in keys))
    if lost:
        raise Lacking("; ".join(_lack(whole, key, known, left) for key in lost[:5])
                      + (f"; and {len(lost) - 5} more points" if lost[5:] else ""), lost)
    return found


def grown(survey: Survey) -> dict[str, np.ndarray]:
    """Positions (3,) of the points of a survey without frames, as far as its readings say; those that are given
    stay."""
    parts = survey.parts
    known = {key: np.array(point.position, float) for key, point in survey.points.items()}
    if any(_missing(survey, part) for part in parts):
        if not survey.sightings and {b.kind for b in survey.every_batch} <= RANGES:
            known.update(ranges.scaled(survey, known))
        else:
            _grow(survey, known, parts)
            if survey.ranging and any(np.isnan(known[key]).any() for one in survey.ranging for key in one.targets):
                with suppress(InputError):           # what no range places either is named by the caller
                    known.update(ranges.scaled(replace(survey, correlated=(), batches=[
                        batch for batch in survey.batches if batch.kind in RANGES]), known))
    return known


def _missing(survey: Survey, part: str) -> list[str]:
    read = survey.read
    return [key for key, point in survey.points.items()
            if key in read and point.role(part) and np.isnan(point.position["xyz".index(part)])]


def _lack(survey: Survey, key: str, known: dict[str, np.ndarray], left: dict[str, list[str]]) -> str:
    """Which point, what it has, and what would place it."""
    kinds: dict[str, int] = {}
    for batch in survey.every_batch:
        count = int(np.sum(np.any([keys == key for keys in batch.ends], axis=0)))
        if count:
            kinds[batch.kind] = kinds.get(batch.kind, 0) + count
    has = ", ".join(f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in kinds.items())
    what = "its height" if key not in left.get("x", []) else "its position"
    cure = (
        "add a height difference to a point of known height" if what == "its height" else
        "add a distance and a direction from one placed station, or readings from two, or approximate coordinates"
    )
    return f"point '{key}': {what} does not follow from its readings ({has}); {cure}"


def sketch(survey: Survey, known: dict[str, np.ndarray]) -> Sketch:
    """What the readings say about the plane; slope distances are reduced by zenith angles or known heights."""
    found, zenith = Sketch(), heights.zenith_angles(survey)
    circles: dict[str, tuple[str, list[str], list[float]]] = {}
    for batch in survey.every_batch:
        values = batch.values
        if values is None:
            continue
        ends = [keys.tolist() for keys in batch.ends]
        for i, value in enumerate(values):
            a, b = ends[0][i], ends[-1][i]
            if batch.kind == "direction":
                setting = circles.setdefault(str(np.asarray(batch.orientation)[i]), (a, [], []))
                setting[1].append(b)
                setting[2].append(value[0])
            elif batch.kind == "angle":
                found.settings.append((a, [ends[1][i], b], [0.0, value[0]]))
            elif batch.kind == "azimuth":
                found.bearings[a, b] = value[0] + survey.north
                found.bearings[b, a] = value[0] + survey.north + np.pi
            elif batch.kind == "distance":
                found.both_ways(a, b, value[0])
            elif batch.kind == "vector":
                found.vectors[a, b] = complex(value[0], survey.sense * value[1])
                found.vectors[b, a] = -found.vectors[a, b]
            elif batch.kind in ("slope distance", "scale bar") and (a, b) not in found.lengths:
                up = batch.heights("target_height")[i] - batch.heights("station_height")[i]
                rise = known[b][2] - known[a][2] + up
                if (a, b) in zenith:
                    found.both_ways(a, b, value[0] * np.sin(zenith[a, b]))
                elif np.isfinite(rise) and abs(rise) < value[0]:
                    found.both_ways(a, b, float(np.sqrt(value[0] ** 2 - rise**2)))
    found.settings += list(circles.values())
    return found


def _grow(survey: Survey, known: dict[str, np.ndarray], parts: str) -> None:
    """Place points, heights and plane in turn, as far as the readings allow."""
    for batch in survey.every_batch:                  # what was read of the coordinates themselves
        if batch.model.points == 1 and batch.values is not None:
            places = ["xyz".index(c) for c in batch.model.components]
            for key, value in zip(batch.ends[0].tolist(), batch.values, strict=True):
                known[key][places] = np.where(np.isnan(known[key][places]), value, known[key][places])
    for _ in range(len(survey.points) + 1):
        before = sum(int(np.isfinite(place).sum()) for place in known.values())
        if survey.sightings:
            spread(known, survey.sightings)
        if "x" in parts:
            _plane(survey, known)
        if "z" in parts:
            heights.level(survey, known)
        if sum(int(np.isfinite(place).sum()) for place in known.values()) == before:
            break


def _plane(survey: Survey, known: dict[str, np.ndarray]) -> None:
    drawn = sketch(survey, known)
    wanted = set(_missing(survey, "x")) | {k for k, p in survey.points.items() if p.plane}
    placed = {key: complex(place[0], survey.sense * place[1]) for key, place in known.items()
              if np.isfinite(place[0]) and key in wanted}
    main = Frame(drawn, dict(placed))
    main.grow()
    tried: set[str] = set()
    while not wanted <= main.placed.keys():
        seed = Frame.seed(drawn, wanted - main.placed.keys() - tried)
        if seed is None:
            break
        station, frame = seed
        tried.add(station)
        frame.grow()
        if not main.placed:
            main = frame
        elif laid_onto(frame, main):
            main.grow()
    for key, place in main.placed.items():
        if np.isnan(known[key][0]):
            known[key][:2] = place.real, survey.sense * place.imag
