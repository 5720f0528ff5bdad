"""A small three-dimensional network to start from: two stations, four marks, simulated readings."""

from __future__ import annotations

import numpy as np

from calib import Problem, linearise, simulate
from calib.units import arcsec, degree, minute, mm
from problems.network.declare import declare
from problems.network.effects import with_candidates
from problems.network.survey import ADJUSTED, FIXED, Batch, Point, Survey

PLACES = {"A": (0.0, 0.0, 10.0), "B": (80.0, 10.0, 12.0), "1": (20.0, 50.0, 15.0), "2": (60.0, 60.0, 11.0),
          "3": (45.0, -40.0, 14.0), "4": (110.0, 40.0, 13.0)}
SIGHTS = [("A", t) for t in "B1234"] + [("B", t) for t in "A1234"]


def survey() -> Survey:
    """Directions, slope distances, zenith angles and levelled differences, without readings; A is fixed, and B in x and
    y."""
    points = {key: Point(place, ADJUSTED, ADJUSTED) for key, place in PLACES.items()}
    points["A"], points["B"] = Point(PLACES["A"], FIXED, FIXED), Point(PLACES["B"], FIXED, ADJUSTED)
    station, target = (np.array(keys) for keys in zip(*SIGHTS, strict=True))
    n = len(station)
    recorded = {"time": (5.0 * minute * np.arange(n), "min"), "block": 1 + np.arange(n) % 5 // 3}
    levelled = (["A", "1", "2", "4", "B", "3"], ["1", "2", "4", "B", "3", "A"])
    return Survey(points, [
        Batch("direction", station, target, None, np.full(n, 2.0 * arcsec), orientation=station, group="directions",
              unit="deg", covariates=recorded | {"face": 1.0 - 2.0 * (np.arange(n) % 2)}),
        Batch("slope distance", station, target, None, np.full(n, 1.0 * mm), station_height=1.6, target_height=1.3,
              group="slope_distances", covariates=recorded),
        Batch("zenith angle", station, target, None, np.full(n, 3.0 * arcsec), station_height=1.6, target_height=1.3,
              group="zenith_angles", unit="deg", covariates=recorded),
        Batch("height difference", *levelled, None, np.full(6, 0.5 * mm), group="height_differences"),
    ], name="network of two stations")


def example(seed: int) -> Problem:
    """The network with simulated readings. seed: of the errors."""
    return with_candidates(simulate(declare(survey()), None, seed))


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with simulated readings: {file name: text}. seed: of the errors."""
    problem = example(seed)
    groups = {group.name: group for group in linearise(problem).groups}
    files = {
        "job.toml": JOB,
        "points.csv": "# source: simulated\npoint,role,x_m,y_m,z_m\nA,fixed,0,0,10\n",
    }
    for name, header, factor in (("directions", "reading_deg", degree), ("slope_distances", "reading_m", 1.0),
                                 ("zenith_angles", "reading_deg", degree), ("height_differences", "reading_m", 1.0)):
        group = groups[name]
        readings = np.zeros(0) if group.readings is None else group.readings[:, 0]
        heights = ",1.6,1.3" if name in ("slope_distances", "zenith_angles") else ""
        further = ",station_height_m,target_height_m" if heights else ""
        timed = [f",{t / minute:.0f},{b}" for t, b in zip(group.covariates.get("time", ()),
                                                          group.covariates.get("block", ()), strict=True)]
        if name == "directions":
            timed = [f"{one},{1 if face > 0 else 2}" for one, face in zip(timed, group.covariates["face"], strict=True)]
        faced = ",face" if name == "directions" else ""
        lines = [f"# source: simulated\nstation,target,{header}{further}{',time_min,block' if timed else ''}{faced}"]
        ends = (group.covariates[name] for name in ("station", "target"))
        for station, target, value, when in zip(*ends, readings, timed or [""] * len(readings), strict=True):
            shown = value / factor % 360.0 if name == "directions" else value / factor
            lines.append(f"{station},{target},{shown:.7f}{heights}{when}")
        files[f"{name}.csv"] = "\n".join(lines) + "\n"
    files["azimuths.csv"] = "# source: known bearing of the line A B\nstation,target,reading_deg\nA,B,7.1250163\n"
    return files


JOB = """problem = "problems.network"

[data.points]
file = "points.csv"

[data.directions]
file = "directions.csv"
instrument = "circle"

[data.slope_distances]
file = "slope_distances.csv"
instrument = "distance_meter"

[data.zenith_angles]
file = "zenith_angles.csv"
instrument = "vertical_circle"

[data.height_differences]
file = "height_differences.csv"
instrument = "level"

[data.azimuths]
file = "azimuths.csv"
instrument = "gyroscope"

[instruments.circle]
kind = "theodolite"
u = "2 arcsec"
target_centring = "0.2 mm"

[instruments.vertical_circle]
kind = "theodolite"
u = "3 arcsec"

[instruments.distance_meter]
kind = "distance_meter"
u = "0.8 mm + 2 um/m"

[instruments.level]
kind = "level"
u = "0.5 mm"

[instruments.gyroscope]
kind = "gyroscope"
u = "5 arcsec"
"""
