"""An example of `problems.mechanism`: a slide with two rotary axes, by a tracker, a ball bar and two levels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib import Observations, Pose, Problem, Shared, geometry, simulate
from calib.mechanism import Frame, Linear, Mechanism, Rotary, location_errors, observe, tabulated
from calib.table import written, xyz_mm
from calib.units import arcsec, degree, mm, um

STAND = Mechanism("stand", axes=[Linear("X", (1, 0, 0), limits=(-0.4, 0.4)),
                                 Rotary("C", (0, 0, 1), (0.0, 0.0, 0.1), carried_by="X"),
                                 Rotary("A", (1, 0, 0), (0.0, 0.0, 0.35), carried_by="C", limits=(-1.0, 1.0))],
                  frames=[Frame("table", (0.0, 0.0, 0.45), carried_by="A")])
PLACES = {"S1": (1.2, 0.1, 0.1), "S2": (-0.3, 1.1, 0.2), "E1": (0.05, 0.12, 0.06), "L1": (1.0, 0.0, 0.0),
          "L2": (0.0, 1.0, 0.0)}
POINTS = {"P1": (0.2, 0.0, 0.05), "P2": (-0.1, 0.15, 0.1), "P3": (-0.05, -0.18, 0.02)}
TRUTH = {"EA0C (C)": 0.12e-3, "EB0C (C)": -0.2e-3, "EY0A (A)": 80 * um, "EB0A (A)": 0.15e-3}


def job_files(seed: int) -> dict[str, str]:
    """The job and its tables with simulated readings: {file name: text}. seed: of the errors."""
    generator = np.random.default_rng(seed)
    pose, base = STAND.pose("table"), Pose("tracker", geometry.rotation_from_rpy(0.02, -0.01, 2.0), (2.0, -1.0, 0.5))

    def drawn(count: int, tilt: float = 1.0) -> np.ndarray:
        q = np.random.default_rng(17).uniform([-0.4, -3.1, -tilt], [0.4, 3.1, tilt], (count, 3))
        return np.round(q / (mm, degree, degree), 3) * (mm, degree, degree)

    def table(rows: np.ndarray, source: str, names: Mapping[str, ArrayLike], headers: Sequence[str], model: Any,
              arguments: Sequence[Any], u: float) -> str:
        problem = Problem([Observations(model, *arguments, u=u, group="r")], effects=location_errors(STAND))
        truth = {problem.parameters(label).name: [[value]] for label, value in TRUTH.items()}
        readings = simulate(problem, truth, int(generator.integers(1 << 31))).observations[0].recorded
        return written(f"simulated, {source}", {**dict(zip(("X_mm", "C_deg", "A_deg"), rows.T, strict=True)), **names,
                                                **dict(zip(headers, readings.T, strict=True))})
    q, bars, slow = drawn(45), drawn(60), drawn(24, 0.6)
    at, stations = np.arange(45) % 3, np.arange(60) % 2
    level = np.arange(24) % 2
    files = {"axes.csv": tabulated.write_axes(STAND, "source: designed"), "points.csv": table(
        q, "tracker", {"point": np.array(list(POINTS))[at]}, ("x_mm", "y_mm", "z_mm"), observe.measured_point(pose),
        (base, q, np.array(list(POINTS.values()))[at]), 10 * um)}
    files["distances.csv"] = table(
        bars, "ball bar", {"station": np.array(["S1", "S2"])[stations], "point": np.full(60, "E1")}, ("distance_mm",),
        observe.measured_distance(pose),
        (np.array([PLACES["S1"], PLACES["S2"]])[stations], bars, Shared(PLACES["E1"])), 2 * um)
    files["levels.csv"] = table(
        slow, "levels", {"level": np.array(["L1", "L2"])[level]}, ("inclination_arcsec",), observe.level_on(pose),
        (slow, np.array([PLACES["L1"], PLACES["L2"]])[level], Shared([0.0, 0.0, -1.0]), Shared(0.0)),
        1 * arcsec)
    files["places.csv"] = written("roughly", {"name": np.array(list(PLACES)), **xyz_mm(list(PLACES.values()))})
    instruments = {"points": "tracker", "distances": "bar", "levels": "level", "places": "", "axes": ""}
    data = "".join(f'[data.{kind}]\nfile = "{kind}.csv"\n' + (f'instrument = "{one}"\n\n' if one else "\n")
                   for kind, one in instruments.items())
    return {"job.toml": f"""problem = "problems.mechanism"

{data}[instruments.tracker]
u = "10 um"

[instruments.bar]
u = "2 um"

[instruments.level]
u = "1 arcsec"

[options]
frame = "table"
errors = ["location"]
""", **files}
