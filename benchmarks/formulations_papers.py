"""The papers' comparisons as studies: step by step against joint, theodolite against tracker, six axes against nine.

Run: python benchmarks/formulations_papers.py; writes benchmarks/results/formulations_papers.md and .png. The five-axis
numbers come from the paper's own readings, the locators' from the simulated example, the tracker's are planned.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from types import ModuleType

import numpy as np

import calib
from calib.job import Job
from calib.units import arcsec, um
from problems import five_axis, locators
from problems.five_axis.tracker_simulation import ARC, ARC_90, Assumed, predicted

RESULTS = Path(__file__).parent / "results"
Row = dict[str, float | str]


def job_of(module: ModuleType, folder: Path) -> Job:
    """The example job of a problem module, written to a folder."""
    for name, text in module.example_job(1).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return Job.read(folder / "job.toml")


def results_of(problem: calib.Problem) -> tuple[calib.Estimate, dict[str, tuple[float, float, str]]]:
    """The estimate, and {name: (value, u, unit)} of all quantities in display units."""
    estimate = calib.solve(problem)
    found = calib.covariance(calib.linearise(estimate), *problem.quantities)
    return estimate, {name: (float(v), float(u), unit) for name, v, u, unit in found.displayed}


def step_by_step(folder: Path) -> list[Row]:
    """u of every result that both ways to evaluate the five-axis readings give, and their difference."""
    problems = five_axis.formulations(job_of(five_axis, folder))
    found = {name: results_of(problem)[1] for name, problem in problems.items()}
    single, joint, apart = found["step by step"], found["jointly, sharing tested"], found["jointly, sharing none"]
    return [{"result": name, "unit": single[name][2], "step_by_step": single[name][0], "u": single[name][1],
             "jointly": joint[name][0], "u_jointly": joint[name][1], "u_jointly_nothing_shared": apart[name][1],
             "difference_over_u_step_by_step": (joint[name][0] - single[name][0]) / single[name][1]}
            for name in single if name in joint and single[name][1] > 0.0]


def theodolite_against_tracker(folder: Path) -> list[Row]:
    """Roll against pitch: u of the angle and of the distance of the axes, by theodolite and by a planned tracker."""
    joint = results_of(five_axis.formulations(job_of(five_axis, folder))["jointly, sharing tested"])[1]
    rows: list[Row] = [{"instrument": "theodolite, the paper's readings, jointly",
                        "u_perpendicularity_arcsec": joint["square in plan"][1],
                        "u_distance_of_axes_um": 1e3 * joint["roll over pitch"][1]}]
    for distance in (0.5, 1.0, 1.5, 3.0):
        for name, arc in (("full turn and 90 deg", ARC), ("90 deg both", ARC_90)):
            square, apart = predicted(arc, Assumed(distance=distance))
            rows.append({"instrument": f"tracker at {distance:g} m, 5 um/m, {name}",
                         "u_perpendicularity_arcsec": square / arcsec, "u_distance_of_axes_um": apart / um})
    return rows


def six_or_nine(folder: Path) -> list[Row]:
    """u of the pose of a part from six or nine axes, with and without a tracker; errors of the axes taken as known."""
    rows = []
    for name, problem in locators.formulations(job_of(locators, folder)).items():
        estimate, found = results_of(problem)
        row: Row = {"readings": name, "dof": estimate.dof, "p_value": estimate.p_value or float("nan")}
        for part in ("x", "y", "z"):
            row[f"u_{part}_um"] = rms([1e3 * u for key, (_, u, _) in found.items() if key.endswith(f".{part}")])
        for part in ("alpha", "beta", "gamma"):
            row[f"u_{part}_arcsec"] = rms([3600.0 * u for key, (_, u, _) in found.items() if key.endswith(part)])
        rows.append(row)
    return rows


def rms(values: list[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def as_table(title: str, rows: list[Row]) -> str:
    """A titled Markdown table."""
    names = list(rows[0])
    shown = [[value if isinstance(value, str) else f"{value:.4g}" for value in row.values()] for row in rows]
    lines = [f"| {' | '.join(row)} |" for row in shown]
    return "\n".join([f"## {title}", "", f"| {' | '.join(names)} |", f"|{'---|' * len(names)}", *lines, ""])


def plot(steps: list[Row], trackers: list[Row], axes_read: list[Row], path: Path) -> None:
    """One panel a study."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 4.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    place = np.arange(len(steps))
    left.barh(place, [float(row["u_jointly"]) / float(row["u"]) for row in steps], 0.6)
    left.axvline(1.0, color="grey", linewidth=0.8)
    left.set_yticks(place, [str(row["result"]) for row in steps], fontsize=7)
    left.invert_yaxis()
    left.set(xlabel="u jointly / u step by step", title="five axes")
    for row in trackers:
        mark = "*" if "theodolite" in str(row["instrument"]) else "o" if "full" in str(row["instrument"]) else "s"
        x, y = float(row["u_perpendicularity_arcsec"]), float(row["u_distance_of_axes_um"])
        middle.plot(x, y, mark, color="C1" if mark == "*" else "C0", markersize=11 if mark == "*" else 6)
        middle.annotate(str(row["instrument"]).split(",")[0].replace("tracker at ", ""), (x, y), fontsize=7,
                        xytext=(5, 3), textcoords="offset points")
    middle.set(xlim=(0.0, 12.0), ylim=(0.0, 30.0), xlabel="u of the perpendicularity / arcsec",
               ylabel="u of the distance of the axes / um",
               title="theodolite (star), tracker (dot: full turn and 90°,\nsquare: 90° both)")
    names = [key for key in axes_read[0] if key.startswith("u_")][:3]
    for number, row in enumerate(axes_read):
        right.bar(np.arange(3) + 0.2 * (number - 1.5), [float(row[key]) for key in names], 0.18,
                  label=str(row["readings"]))
    right.set_xticks(range(3), ["x", "y", "z"])
    right.set(ylabel="u of the part / um", title="locators")
    right.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        steps = step_by_step(Path(folder) / "steps")
        trackers = theodolite_against_tracker(Path(folder) / "trackers")
        axes_read = six_or_nine(Path(folder) / "axes")
    text = "\n".join(["# The papers' comparisons", "", as_table("Step by step against jointly, five axes", steps),
                      as_table("Theodolite against tracker, roll and pitch", trackers),
                      as_table("Six axes or nine, locators", axes_read)])
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "formulations_papers.md").write_text(text, encoding="utf-8")
    plot(steps, trackers, axes_read, RESULTS / "formulations_papers.png")
    print(text)


if __name__ == "__main__":
    main()
