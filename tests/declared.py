"""Small declared problems that several tests look at from different sides."""

from __future__ import annotations

import casadi as ca
import numpy as np
from casadi import atan2, sqrt

from calib import Observations, Pose, Problem, Unknown, direct, simulate
from calib.geometry import rotation_about
from calib.problem import Problem as ProblemType
from calib.uncertainty import Gaussian


def straight(offset, slope, x):
    return offset + slope * x


def line(readings=None, u=0.1, x=(0.0, 1.0, 2.0, 3.0, 4.0)) -> tuple[ProblemType, Unknown, Unknown]:
    """offset + slope x."""
    offset, slope = Unknown("offset", 0.0, "mm"), Unknown("slope", 0.0, "mm/m")
    values = np.zeros(len(x)) if readings is None else readings
    return (
        Problem([Observations(straight, offset, slope, np.array(x), readings=values, u=u, group="line")]),
        offset,
        slope,
    )


def polar(station, point, *, range=direct):
    seen = station.inverse() @ point
    return [range(sqrt(ca.dot(seen, seen))), atan2(seen[1], seen[0]), atan2(sqrt(seen[0] ** 2 + seen[1] ** 2), seen[2])]


def network(
    stations: int, points: int, seed: int, u: Gaussian | list[float] | None = None
) -> tuple[ProblemType, Pose, Unknown]:
    """Stations of six degrees of freedom around points, the first one held; start values a millimetre off."""
    generator = np.random.default_rng(seed)
    truth = generator.uniform(-5, 5, (points, 3))
    angle = np.linspace(0, 2 * np.pi, stations, endpoint=False)
    place = np.stack([12 * np.cos(angle), 12 * np.sin(angle), generator.uniform(-1, 1, stations)], axis=1)
    turn = np.stack(
        [
            np.asarray(rotation_about(v / np.linalg.norm(v), np.linalg.norm(v)), float)
            for v in generator.normal(0, 0.5, (stations, 3))
        ]
    )
    station = Pose("station", turn, place, keys=range(stations))
    point = Unknown("point", truth + generator.normal(0, 1e-3, truth.shape), "mm", keys=range(points))
    i, j = np.divmod(np.arange(stations * points), points)
    seen = Observations(
        polar,
        station[i],
        point[j],
        u=u if u is not None else [5e-6, 5e-6, 5e-6],
        group="polar",
        period=(None, 2 * np.pi, 2 * np.pi),
        unit=("mm", "arcsec", "arcsec"),
        covariates={"station": i, "point": j},
    )
    return simulate(Problem([seen], name="network").hold(station[0]), {point: truth}, seed), station, point
