"""Layouts for the calibration of base points: the studies of the 2007 paper, and what they do to coordinates.

Run: python benchmarks/base_point_layouts.py [trials]; writes benchmarks/results/base_point_layouts.md and .png.
Standard uncertainties are for readings of 1 um unless a table says otherwise.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import calib
from calib.errors import RankDefect
from calib.units import degree, um
from problems import base_point, base_point_layout, multilateration
from problems.base_point import paper
from problems.base_point.lines import Lines
from problems.base_point.paper import FEET, NOISE_NEEDED, NOISE_PRINTED, OFF, layout_targets, travel
from problems.base_point_layout import FREE, KNOWN, TIED
from problems.multilateration import Calibration, Ranges

RESULTS = Path(__file__).parent / "results"
STARTS = {"tied": TIED, "free": FREE, "known": KNOWN}
Rows = list[dict[str, object]]


# --- section 3: which noise and which unknowns give the printed 0.41 and 2.7 um? ----------------------------------


def readings_of_section_3(trials: int) -> Rows:
    """sigma_x of both layouts for every reading of the noise and of the unknowns."""
    rows: Rows = []
    for noise in (NOISE_PRINTED, NOISE_NEEDED):
        for start, zero in STARTS.items():
            for unknowns in ("x, y", "x"):
                u = {name: u_of(foot, zero, unknowns, noise) / um for name, foot in FEET.items()}
                rows.append({"noise_um": noise / um, "start_length": start, "unknowns": unknowns, "sym_um": u["sym"],
                             "half_um": u["half"], "ratio": u["half"] / u["sym"]})
    sampled = {name: paper.simulated_sigma_x(foot, NOISE_NEEDED, trials, 1)
               for name, foot in FEET.items()}
    rows.append({"noise_um": 1.0, "start_length": "tied", "unknowns": f"Monte Carlo of equation 1, {trials} trials",
                 "sym_um": sampled["sym"], "half_um": sampled["half"], "ratio": sampled["half"] / sampled["sym"]})
    rows.append({"noise_um": 0.1, "start_length": "", "unknowns": "printed", "sym_um": 0.41, "half_um": 2.7,
                 "ratio": 2.7 / 0.41})
    return rows


def u_of(foot: float, zero: base_point.Zero, unknowns: str, noise: float) -> float:
    """u of x [m] with y estimated or known."""
    plan = base_point_layout.planar(layout_targets(), (foot, OFF), zero, noise)
    base = plan.select("base_point").unknown
    if unknowns == "x":
        plan = plan.hold(base.part("y"))
    return float(calib.covariance(calib.linearise(plan), base.part("x")).u[0])


# --- where the base point stands beside the line ------------------------------------------------------------------


def along_the_line() -> Rows:
    """u of both coordinates and the turn of the mirror, base point 500 mm off the line, by its foot on the line."""
    rows: Rows = []
    for foot in np.arange(-0.2, 1.61, 0.1):
        row: dict[str, object] = {"foot_mm": round(1e3 * foot),
                                  "mirror_deg": base_point_layout.mirror_rotation(travel(), foot, OFF) / degree}
        for start in ("tied", "free"):
            u = base_point_layout.uncertainties(layout_targets(), (foot, OFF), STARTS[start], NOISE_NEEDED) / um
            row.update({f"u_x_{start}_um": u[0], f"u_y_{start}_um": u[1]})
        rows.append(row)
    return rows


def off_the_line() -> Rows:
    """The same above the middle of the line, by the distance from it."""
    rows: Rows = []
    for off in (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0):
        row: dict[str, object] = {"off_mm": round(1e3 * off)}
        for start in ("tied", "free"):
            u = base_point_layout.uncertainties(layout_targets(), (0.7, off), STARTS[start], NOISE_NEEDED) / um
            row.update({f"u_x_{start}_um": u[0], f"u_y_{start}_um": u[1]})
        rows.append(row)
    return rows


# --- three targets (figure 4) -------------------------------------------------------------------------------------


def opening_angle() -> Rows:
    """sqrt(Q11 + Q22) of targets at 0 and +-a: the printed layout has a = 60 deg."""
    rows: Rows = []
    for a in (20, 40, 50, 60, 70, 90, 100, 120, 140):
        angles = np.radians([0.0, a, -a])
        targets = -np.column_stack([np.cos(angles), np.sin(angles)])
        rows.append({"a_deg": a, **{start: base_point_layout.root_of_trace(targets, (0.0, 0.0), STARTS[start])
                                    for start in ("known", "free")}})
    return rows


def best_layouts() -> Rows:
    """The smallest value found from 20 starts, beside the bound that proves it."""
    rows: Rows = []
    for start in ("known", "free"):
        best = base_point_layout.best_layout(STARTS[start], starts=20, seed=1)
        rows.append({"start_length": start, "value": best.value, "bound": best.bound, "gap": best.gap,
                     "angles_deg": ", ".join(f"{a / degree:.2f}" for a in best.angles),
                     "starts_that_led_there": f"{best.found} of {best.starts}"})
    return rows


# --- lines in space -----------------------------------------------------------------------------------------------


def lines_in_space() -> Rows:
    """u of a base point by one to four lines of a machine, ten points each, for the base point of the experiment."""
    run, zero, far = np.linspace(0.08, 0.8, 10), np.zeros(10), np.full(10, 0.8)
    lines = {"x": (run, zero, zero), "y at x end": (far, run, zero), "x at y end": (run, far, zero),
             "z at x end": (far, zero, run)}
    base = np.array([-0.2039, 1.4010, -0.2290])
    rows: Rows = []
    for names in (("x",), ("x", "y at x end"), ("x", "y at x end", "x at y end"), ("x", "y at x end", "z at x end"),
                  tuple(lines)):
        points = np.vstack([np.column_stack(lines[name]) for name in names])
        for start, choice in (("tied", base_point.TiedStart()), ("free", base_point.FreeStart())):
            plan = base_point.declare(Lines(points, None, 1.0 * um), choice, begin=base)
            try:
                u = [f"{v / um:.1f}" for v in calib.covariance(calib.linearise(plan), "base_point").u]
            except RankDefect:
                u = ["not seen"] * 3
            rows.append({"lines": " + ".join(names), "start": start, "u_x_um": u[0], "u_y_um": u[1], "u_z_um": u[2]})
    return rows


# --- what the base points do to measured coordinates --------------------------------------------------------------


TRACKERS = {"A": (0.0, 0.0, 0.0), "B": (1.6, 0.1, 0.0), "C": (0.2, 1.5, 0.1), "D": (0.6, 0.5, 1.4)}
READING = 0.5 * um


def calibrations() -> dict[str, calib.Problem]:
    """Plans to calibrate four trackers: on lines of known points, or by themselves on unknown targets."""
    run, zero, low, far = np.linspace(0.0, 1.5, 12), np.zeros(12), np.full(12, 0.3), np.full(12, 1.5)
    lines = [(run, zero, low), (far, run, low), (far, far, low + run)]
    plans: dict[str, calib.Problem] = {}
    for name, columns in (("one line", lines[:1]), ("two perpendicular lines", lines[:2]),
                          ("three perpendicular lines", lines)):
        places = np.vstack([np.column_stack(c) for c in columns])
        targets = {f"L{k:03d}": place for k, place in enumerate(places)}
        ranges = Ranges.every(tuple(TRACKERS), tuple(targets), READING)
        plans[name] = multilateration.declare(ranges, TRACKERS, targets, known=tuple(targets))
        if len(columns) == 3:
            plans[f"{name}, each coordinate with u = 0.5 um"] = multilateration.declare(
                ranges, TRACKERS, targets, known=tuple(targets), u_known=0.5 * um)
    for count in (10, 16, 30, 100):
        places = np.random.default_rng(5).uniform((0.1, 0.1, 0.2), (1.5, 1.5, 1.3), (count, 3))
        targets = {f"T{k:03d}": place for k, place in enumerate(places)}
        plans[f"by themselves, {count} unknown targets"] = multilateration.declare(
            Ranges.every(tuple(TRACKERS), tuple(targets), READING), TRACKERS, targets)
    return plans


def over_the_volume() -> Rows:
    """Standard uncertainty of a coordinate over 1.2 m x 1.2 m x 0.9 m, and of its distance from one corner."""
    grid = [np.linspace(0.2, 1.4, 5), np.linspace(0.2, 1.4, 5), np.linspace(0.3, 1.2, 4)]
    targets = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
    rows: Rows = []
    for name, plan in calibrations().items():
        try:
            calibration = Calibration.of(calib.linearise(plan))
        except RankDefect as error:
            rows.append({"calibration": name, "from_readings_um": "", "from_trackers_um": f"not determined: "
                         f"{len(error.directions)} directions", "worst_um": "", "distance_um": ""})
            continue
        volume = multilateration.over_volume(calibration, targets, READING)
        keys = [f"{k:04d}" for k in range(len(targets))]
        measured = multilateration.measure(calibration, Ranges.every(calibration.keys, keys, READING),
                                           dict(zip(keys, targets)))
        distance = calib.covariance(calib.linearise(measured), "distance").u
        rows.append({"calibration": name, "from_readings_um": rms(volume.from_readings) / um,
                     "from_trackers_um": rms(volume.from_trackers) / um, "worst_um": volume.u.max() / um,
                     "distance_um": rms(distance) / um})
    return rows


def rms(values: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


# --- files --------------------------------------------------------------------------------------------------------


def table(rows: Sequence[dict[str, object]]) -> str:
    """Rows as a Markdown table."""
    def cell(value: object) -> str:
        return f"{value:.4g}" if isinstance(value, (float, np.floating)) else str(value)
    names = list(rows[0])
    lines = ["| " + " | ".join(names) + " |", "|" + " --- |" * len(names)]
    return "\n".join([*lines, *("| " + " | ".join(cell(row[name]) for name in names) + " |" for row in rows)])


def draw(along: Rows, opening: Rows, path: Path) -> None:
    """Uncertainty by the place of the base point beside the line, and the three-target layout."""
    import matplotlib
    matplotlib.use("Agg")
    from matplotlib import pyplot
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(11, 4.2))
    styles = {"u_x_tied_um": "C0-", "u_x_free_um": "C0--", "u_y_tied_um": "C1-", "u_y_free_um": "C1--"}
    for name, style in styles.items():
        left.semilogy([row["foot_mm"] for row in along], [row[name] for row in along], style, label=name[:-3])
    left.plot([700, 1400], [0.41, 2.7], "ko", label="printed sigma_x")
    left.set(xlabel="foot of the base point on the line [mm]", ylabel="u [um], readings of 1 um")
    for start in ("known", "free"):
        right.plot([row["a_deg"] for row in opening], [row[start] for row in opening], label=f"start length {start}")
    right.axhline(base_point_layout.bound(3), color="k", lw=0.8, label="bound 2/sqrt(3)")
    right.axhline(1.169, color="r", lw=0.8, ls=":", label="printed 1.169")
    right.set(xlabel="targets at 0 and +-a, a [deg]", ylabel="sqrt(Q11 + Q22)", ylim=(1.0, 4.0))
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main(trials: int) -> None:
    """Run all studies and write table and plot."""
    along, opening = along_the_line(), opening_angle()
    parts = [
        ("Section 3: sigma_x under every reading of noise and unknowns", readings_of_section_3(trials)),
        ("Base point 500 mm off the line, by its foot", along),
        ("Base point above the middle, by its distance", off_the_line()),
        ("Three targets at 0 and +-a", opening), ("Best layout of three targets", best_layouts()),
        ("Lines in space, base point (-203.9, 1401.0, -229.0) mm, readings of 1 um", lines_in_space()),
        ("Four trackers, readings of 0.5 um: rms over 100 points of a volume", over_the_volume())]
    text = "\n\n".join([f"## {title}\n\n{table(rows)}" for title, rows in parts])
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "base_point_layouts.md").write_text(
        "# Layouts for the calibration of base points\n\n"
        f"`python benchmarks/base_point_layouts.py {trials}`\n\n{text}\n", encoding="utf-8")
    draw(along, opening, RESULTS / "base_point_layouts.png")
    print(text)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5000)
