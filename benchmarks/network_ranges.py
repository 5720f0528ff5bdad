"""Start values of networks of ranges alone: how often random layouts end at the truth, with nothing given but ranges.

Usage: python benchmarks/network_ranges.py [LAYOUTS] [KIND ...] (200 of each kind); writes results/network_ranges.md.
An adjustment is right where its v'Pv is what the drawn errors let expect (below three times its degrees of freedom,
plus ten): points on the wrong side of their neighbours, or wrong dead paths, miss the ranges by far more.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from calib import solve
from calib.errors import CalibrationError
from problems import network
from problems.network import Batch, Point, Ranging, Survey
from problems.network.survey import CONSTRAINED

U = 1e-5      # m, of every range
LAYOUTS = 200
Layout = Callable[[np.random.Generator], tuple[np.ndarray, np.ndarray]]


def two_sets(stations: int, points: int, flat: float = 1.0, away: float = 0.0, size: float = 10.0) -> Layout:
    """Stations in a cube of 10 m that read points in a cube of their own, away from it; flat: height of the stations
    in parts of the cube."""
    def layout(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        bases = generator.uniform(0.0, 10.0, (stations, 3)) * [1.0, 1.0, flat]
        places = generator.uniform(0.0, size, (points, 3)) + [away, 0.3 * away, 1.0]
        ends = np.array([(a, stations + b) for a in range(stations) for b in range(points)])
        return np.vstack([bases, places]), ends
    return layout


def one_set(points: int, dim: int, share: float, flat: float = 1.0) -> Layout:
    """Points of which each pair is read with a probability."""
    def layout(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        places = generator.uniform(0.0, 20.0, (points, dim)) * np.append(np.ones(dim - 1), flat)
        ends = [(a, b) for a in range(points) for b in range(a) if generator.uniform() < share]
        return places, np.array(ends)
    return layout


KINDS: dict[str, tuple[Layout, bool]] = {       # and whether the first points are instruments with dead paths
    "8 points in a plane, all ranges": (one_set(8, 2, 1.0), False),
    "9 points in space, all ranges": (one_set(9, 3, 1.0), False),
    "9 points nearly in a plane, all ranges": (one_set(9, 3, 1.0, 0.02), False),
    "12 points in space, two ranges of three": (one_set(12, 3, 0.67), False),
    "4 stations, 10 points": (two_sets(4, 10), False),
    "5 stations, 12 points": (two_sets(5, 12), False),
    "6 stations in a plane, 12 points": (two_sets(6, 12, 0.0), False),
    "5 stations, 12 points 60 m away": (two_sets(5, 12, 1.0, 60.0, 3.0), False),
    "4 interferometers, 16 targets": (two_sets(4, 16), True),
    "5 interferometers, 12 targets": (two_sets(5, 12), True),
    "6 interferometers, 14 targets 15 m away": (two_sets(6, 14, 1.0, 15.0, 4.0), True),
    "7 interferometers in a plane, 14 targets": (two_sets(7, 14, 0.0), True),
}


def survey(layout: Layout, dead_paths: bool, seed: int) -> Survey:
    """A free network of ranges with drawn errors, none of whose points has coordinates."""
    generator = np.random.default_rng(seed)
    places, ends = layout(generator)
    ranges = np.linalg.norm(places[ends[:, 0]] - places[ends[:, 1]], axis=1) + U * generator.normal(size=len(ends))
    names = np.array([f"P{i}" for i in range(len(places))])
    space = places.shape[1] == 3
    point = Point(plane=CONSTRAINED, height=CONSTRAINED if space else "")
    first, second = names[ends[:, 0]], names[ends[:, 1]]
    u = np.full(len(ends), U)
    if dead_paths:
        ranges = ranges - generator.uniform(-3.0, 3.0, len(places))[ends[:, 0]]
        return Survey(dict.fromkeys(sorted(set(second)), point), [], ranging=[Ranging(first, second, ranges, u)])
    kind = "slope distance" if space else "distance"
    return Survey(dict.fromkeys(names.tolist(), point), [Batch(kind, first, second, ranges, u)])


def tried(layout: Layout, dead_paths: bool, seed: int) -> tuple[str, float]:
    """"right", "wrong", "ill" (a layout that its ranges do not determine) or "refused", and CPU time [s]."""
    begin = time.process_time()
    try:
        estimate = solve(network.declare(network.started(network.checked(survey(layout, dead_paths, seed)))))
        outcome = "right" if estimate.objective < 3.0 * estimate.dof + 10.0 else "wrong"
    except CalibrationError as error:
        outcome = "refused" if "cannot be known" not in str(error) else "ill"
    return outcome, time.process_time() - begin


def main(arguments: list[str]) -> None:
    count = int(arguments[0]) if arguments else LAYOUTS
    chosen = {name: kind for name, kind in KINDS.items() if not arguments[1:] or name in arguments[1:]}
    lines = ["| layout | right | wrong | refused | not determined | CPU median [s] | CPU longest [s] |",
             "| --- | --- | --- | --- | --- | --- | --- |"]
    for name, (layout, dead_paths) in chosen.items():
        runs = [tried(layout, dead_paths, seed) for seed in range(count)]
        outcomes, times = [one for one, _ in runs], [spent for _, spent in runs]
        counts = " | ".join(str(outcomes.count(one)) for one in ("right", "wrong", "refused", "ill"))
        lines.append(f"| {name} | {counts} | {np.median(times):.2f} | {max(times):.2f} |")
        print(lines[-1], [i for i, one in enumerate(outcomes) if one != "right"][:10], flush=True)
    head = f"Start values from ranges alone, {count} random layouts of each kind, u = 10 um."
    text = "\n".join([head, "", *lines, ""])
    if not arguments[1:]:
        (Path(__file__).parent / "results" / "network_ranges.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
