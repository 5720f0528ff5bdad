"""The datum of every kind of network: fixed, known with uncertainty, free; what can be estimated is the same in all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib import Estimate, Problem, Quantity, Unknown, covariance, linearise, prior, simulate, solve
from calib.geometry import norm
from calib.units import arcsec, mm
from problems import network
from problems.network import Batch, Point, Survey
from problems.network.survey import ADJUSTED, CONSTRAINED

PLACES = {"A": (0.0, 0.0, 0.0), "B": (100.0, 5.0, 3.0), "C": (110.0, 90.0, -4.0), "D": (-5.0, 80.0, 8.0),
          "E": (45.0, 50.0, 20.0), "F": (60.0, -30.0, 11.0)}
KEYS = list(PLACES)
PAIRS = [(a, b) for i, a in enumerate(KEYS) for b in KEYS[i + 1 :]]
SIGHTS = [(a, b) for a in KEYS for b in KEYS if a != b]


def batch(kind: str, pairs: list[tuple[str, str]], u: float) -> Batch:
    station, target = (list(keys) for keys in zip(*pairs, strict=True))
    setting = station if kind == "direction" else None
    return Batch(kind, station, target, None, np.full(len(pairs), u), orientation=setting, group=kind)


def length(a: Any, b: Any) -> Any:
    return norm(b - a)


def height(a: Any, b: Any) -> Any:
    return b[-1] - a[-1]


def ratio(a: Any, b: Any, c: Any) -> Any:
    return norm(b - a) / norm(c - a)


# Readings, coordinates of the network, what the readings leave open, and what can be estimated of them.
NETWORKS: dict[str, tuple[list[Batch], str, list[str], Callable[..., Any]]] = {
    "in space": ([batch("direction", SIGHTS, 4 * arcsec), batch("slope distance", PAIRS, 2 * mm),
                  batch("zenith angle", SIGHTS, 6 * arcsec)], "xyz", ["A.x", "A.y", "A.z", "B.y"], length),
    "ranges in space": ([batch("slope distance", PAIRS, 2 * mm)], "xyz",
                        ["A.x", "A.y", "A.z", "B.y", "B.z", "C.z"], length),
    "ranges in the plane": ([batch("distance", PAIRS, 2 * mm)], "xy", ["A.x", "A.y", "B.y"], length),
    "levelled": ([batch("height difference", PAIRS, 1 * mm)], "z", ["A.z"], height),
    "directions": ([batch("direction", SIGHTS, 4 * arcsec)], "xy", ["A.x", "A.y", "B.x", "B.y"], ratio),
}


def survey(name: str, seed: int) -> Survey:
    """A free network with drawn readings."""
    batches, parts, _, _ = NETWORKS[name]
    role = {"plane": CONSTRAINED if "x" in parts else "", "height": CONSTRAINED if "z" in parts else ""}
    free = Survey({key: Point(place, **role) for key, place in PLACES.items()}, batches)
    drawn = {o.group: o.readings for o in simulate(network.declare(free), None, seed).observations}
    return replace(free, batches=[replace(one, readings=drawn[one.group]) for one in batches])


def asked(problem: Problem, name: str) -> tuple[Problem, Unknown]:
    """The problem with what can be estimated of all points."""
    point = next(unknown for unknown in problem.unknowns if unknown.name == "point")
    function = NETWORKS[name][3]
    rows = [(0, i, 1) for i in range(2, 6)] if function is ratio else [(i, j) for i in range(6) for j in range(i)]
    columns = np.array(rows).T
    return problem.with_quantities(Quantity("seen", function, *(point[column] for column in columns),
                                            unit="1" if function is ratio else "mm")), point


def results(name: str) -> tuple[list[Estimate], list[str]]:
    """The network in its three datums."""
    free = network.settle(survey(name, 7))
    inner, _ = asked(network.declare(free), name)
    bare = replace(free, points={key: replace(p, plane=p.plane and ADJUSTED, height=p.height and ADJUSTED)
                                 for key, p in free.points.items()})
    problem, point = asked(network.declare(bare), name)
    held, known = problem, problem
    for text in NETWORKS[name][2]:
        key, part = text.split(".")
        chosen = point[point.keys.index(key)].part(part)
        place = free.points[key].position["xyz".index(part)]
        held = held.hold(chosen)
        known = known.with_observations(prior(chosen, place, 0.5 * mm, name=f"known {text}"))
    return [solve(inner), solve(held), solve(known)], NETWORKS[name][2]


@pytest.mark.parametrize("name", list(NETWORKS))
def test_what_can_be_estimated_is_the_same_in_every_datum(name):
    (inner, held, known), open_ways = results(name)
    assert len(open_ways) == len(inner.problem.constraints[0].model.coefficients)
    first = covariance(linearise(inner), "seen")
    for other in (held, known):
        c = covariance(linearise(other), "seen")
        assert np.abs(c.values - first.values).max() < 1e-4 * first.u.min()
        assert np.abs(c.matrix - first.matrix).max() < 1e-5 * np.abs(first.matrix).max()
        assert other.objective == pytest.approx(inner.objective, rel=1e-6)
        assert other.dof == inner.dof
