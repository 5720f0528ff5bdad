"""Fits of the published readings, and where each printed number stands in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib import (
    Estimate,
    Linearisation,
    Problem,
    VarianceComponents,
    covariance,
    linearise,
    solve,
    variance_components,
)
from calib.analyse.covariance import Covariance
from calib.units import arcsec, mm
from problems.circle_sharing import Agreement, sharing

from . import joint, step_by_step
from .joint import Sharing
from .readings import HORIZONTAL, T2_HORIZONTAL, VERTICAL, WIRES, Readings

TABLES = ("table 1", "table 2", "table 3", "table 4")

# Where a printed number stands: a sum of quantities with factors, less an origin.
Place = Mapping[str, float]
_PLUMB = {
    "lev3_thx": "plumb[three_axis].x",
    "lev3_thy": "plumb[three_axis].y",
    "lev2_thx": "plumb[two_axis].x",
    "lev2_thy": "plumb[two_axis].y",
    "lev_dx": "plumb difference.x",
    "lev_dy": "plumb difference.y",
    "lev_par": "plumb difference.parallelism",
    "it8a": "plumb difference.x",
    "it8b": "plumb difference.y",
}
_POINTS = {f"{t}_{part}": f"point[{t}].{part}" for t in "ABCDEF" for part in "yz"}
STEP: dict[str, Place] = {
    key: {name: 1.0}
    for key, name in {
        **_PLUMB,
        **_POINTS,
        **{f"{i}_{w}_hz": f"reading[{i} {w}]" for i in ("T1", "T2") for w in WIRES},
        **{f"{t}_hz": f"reading[{t} H]" for t in "ABCD"},
        **{f"{t}_v": f"reading[{t} V]" for t in "ABCD"},
        "dX_ang": "yaw angle[T1]",
        "dY_ang": "yaw angle[T2]",
        "dX": "yaw offset[T1]",
        "dY": "yaw offset[T2]",
        **{
            f"{line}_d{part}": f"line[{axis}].d{part}"
            for line, axis in (("l8", "pitch"), ("l9", "roll"), ("l10", "two_axis_pitch"))
            for part in "xyz"
        },
        "l9_y0": "point[C].y",
        "y1": "line[pitch].y",
        "z1": "line[pitch].z",
        "y2": "line[roll].y",
        "z2": "line[roll].z",
        "y3": "line[two_axis_pitch].y",
        "yaw2_y": "yaw offset[T1]",
        "it1": "square[pitch]",
        "it2": "square in plan",
        "it3": "line[pitch].y",
        "it4": "roll over pitch",
        "it5": "line[roll].y",
        "it6": "square[two_axis_pitch]",
        "it7": "two-axis intersection",
        "it9a": "yaw offset[T1]",
        "it9b": "yaw offset[T2]",
        "it10": "pitch over pitch",
    }.items()
}
_AT = "axis at the yaw axis"
JOINT: dict[str, Place] = {
    key: {name: 1.0}
    for key, name in {
        **_PLUMB,
        **_POINTS,
        **{f"{i}_{w}_hz": f"wire reading[{i} {w}]" for i in ("T1", "T2") for w in WIRES},
        **{f"{t}_hz": f"reading[{t}].H" for t in "ABCD"},
        **{f"{t}_v": f"reading[{t}].V" for t in "ABCD"},
        "dX": "yaw offset.y",
        "dY": "yaw offset.x",
        "yaw2_y": "yaw offset.y",
        "l9_y0": "point[C].y",
        "y1": f"{_AT}[pitch].y",
        "z1": f"{_AT}[pitch].z",
        "y2": f"{_AT}[roll].y",
        "z2": f"{_AT}[roll].z",
        "y3": f"{_AT}[two_axis_pitch].y",
        "it1": "square[pitch]",
        "it2": "square in plan",
        "it3": "intersection[pitch]",
        "it4": "roll over pitch",
        "it5": "intersection[roll]",
        "it6": "square[two_axis_pitch]",
        "it9a": "yaw offset.y",
        "it9b": "yaw offset.x",
        "it10": "pitch over pitch",
    }.items()
}
JOINT |= {
    "it7": {"intersection[two_axis_pitch]": -1.0},
    "dX_ang": {"wire reading[T1 S2]": 1.0, "wire reading[T1 S3]": -1.0},
    "dY_ang": {"wire reading[T2 S2]": 1.0, "wire reading[T2 S3]": -1.0},
}
JOINT |= {
    f"{line}_d{part}": {f"point[{far}].{part}": 1.0, f"point[{near}].{part}": -1.0}
    for line, near, far in (("l8", "A", "B"), ("l9", "C", "D"), ("l10", "E", "F"))
    for part in "yz"
}
TO_THE_PLUMB_LINE: dict[str, Place] = {
    "it1": {"square to the plumb line[pitch]": 1.0},
    "it6": {"square to the plumb line[two_axis_pitch]": 1.0},
}
ITEMS = ("it1", "it2", "it3", "it4", "it5", "it6", "it7", "it8a", "it8b", "it9a", "it9b", "it10")
USUAL = "circles of the usual make: Z down"
UNIT = {"arcsec": arcsec, "mm": mm}


def origin(unit: str) -> float:
    """The direction that a printed reading is counted from [rad]."""
    if "27d" in unit:
        return T2_HORIZONTAL
    return HORIZONTAL if "185d" in unit else VERTICAL if "90d" in unit else 0.0


@dataclass(frozen=True)
class Fit:
    """An estimate with its covariances, by the stated uncertainties and by the scatter found in each table."""

    estimate: Estimate
    linear: Linearisation
    scatter: VarianceComponents
    stated: Covariance
    found: Covariance

    @staticmethod
    def of(problem: Problem) -> Fit:
        """Solve and linearise a problem whose groups are the tables 1 to 4."""
        estimate = solve(problem)
        linear = linearise(estimate)
        scatter = variance_components(linear, TABLES)
        wanted = (*linear.results, "plumb")
        return Fit(
            estimate, linear, scatter, covariance(linear, *wanted), covariance(scatter.rescaled(linear), *wanted)
        )

    def at(self, place: Place, unit: str) -> tuple[float, float, float]:
        """Value, u and u by the scatter found, of a printed number in its unit."""
        rows = [self.stated.names.index(name) for name in place]
        factors, scale = np.array(list(place.values())), UNIT[unit.split()[0]]
        u = [
            float(np.sqrt(factors @ c.matrix[np.ix_(rows, rows)] @ factors)) / scale for c in (self.stated, self.found)
        ]
        return (float(factors @ self.stated.values[rows]) - origin(unit)) / scale, u[0], u[1]


@dataclass(frozen=True)
class Fits:
    """The step-by-step fit, the tests of sharing, and the joint fits: the accepted one and its alternatives by name."""

    step: Fit
    circles: tuple[Agreement, ...]
    wires: tuple[Agreement, ...]
    turns: int
    joint: Fit
    alternatives: Mapping[str, Fit]


def accepted(readings: Readings) -> list[str]:
    """Targets whose horizontal and vertical circle may share r and phase, tested at 1 %."""
    step = Fit.of(step_by_step.declare(readings))
    return [one.target for one in sharing(step.linear, step.scatter) if one.accepted]


def fits(readings: Readings, *, alternatives: bool = True) -> Fits:
    """Fit the readings step by step, test what may be shared, and fit them jointly.

    readings: of all tables; alternatives: whether to fit those too.
    """
    step = Fit.of(step_by_step.declare(readings))
    circles = sharing(step.linear, step.scatter)
    accepted = [one.target for one in circles if one.accepted]
    # The sense in which the yaw axes turn is not printed; the one that suits the readings better is tested.
    senses = {
        turns: sharing(step.linear, step.scatter, name)
        for turns, name in ((1, "wire difference"), (-1, "wire difference, turned backwards"))
    }
    turns = min(senses, key=lambda sense: sum(one.statistic for one in senses[sense]))
    wires = [one.target for one in senses[turns] if one.accepted]
    others = {"nothing shared": Sharing(()), USUAL: Sharing(accepted, up=-1)}
    if wires:
        others[f"shared also between T1 and T2: {', '.join(wires)}"] = Sharing(accepted, wires, turns)
    named = {name: Fit.of(joint.declare(readings, one)) for name, one in others.items()} if alternatives else {}
    return Fits(step, circles, senses[turns], turns, Fit.of(joint.declare(readings, Sharing(accepted))), named)
