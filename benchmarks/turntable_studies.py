"""The simulation studies of section 2 of the turntable paper, with numbers: points, arc, radius, and weights.

Run: python benchmarks/turntable_studies.py [trials]; writes benchmarks/results/turntable_studies.md and .png.
The paper's figures 4, 6 and 9 are pictures without numbers and name no noise; here the noise is 10 um on each
coordinate for figures 4 and 6, and the stated U of the tracker for figure 9 (at 3 m) and for the large table.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import calib
from calib.units import arcsec, degree, mm, um
from instruments import laser_tracker
from problems import circle
from problems.circle import pairwise

RESULTS = Path(__file__).parent / "results"
NOISE = 10.0 * um
TRACKER = laser_tracker.from_coordinate_statement(15.0 * um, 6e-6)


def points_of(command: np.ndarray, radius: float, distance: float = 3.0) -> np.ndarray:
    """Points (n, 3) [m] of a level circle whose centre stands a distance from the tracker and 0.4 m below it."""
    return np.column_stack([distance + radius * np.cos(command), radius * np.sin(command), np.full(len(command), -0.4)])


def of_circle(problem: calib.Problem) -> calib.Problem:
    """The circle with its centre as a quantity, so that Monte Carlo samples it too."""
    centre, radius = (problem.select(name).unknown for name in ("centre", "radius"))
    return problem.with_quantities(calib.Quantity("centre", lambda c: c, centre, unit="um"),
                                   calib.Quantity("radius", lambda r: r, radius, unit="um"))


def row(command: np.ndarray, radius: float, u: object, trials: int, seed: int) -> dict[str, float]:
    """u of the radius, of the centre in its worst direction [um], of the angle [arcsec], also by Monte Carlo."""
    problem = of_circle(circle.declare(points_of(command, radius), u, command))
    fit = calib.linearise(problem)
    centre = calib.covariance(fit, "centre")
    worst = np.sqrt(np.linalg.eigvalsh(centre.matrix)[-1])
    sampled = calib.montecarlo(calib.solve(problem), trials, seed)
    spread = dict(zip(sampled.names, sampled.u))
    cloud = np.cov(sampled.samples[:, [sampled.names.index(f"centre.{axis}") for axis in "xyz"]].T)
    return {"u_radius_um": calib.covariance(fit, "radius").u[0] / um, "monte_carlo_radius_um": spread["radius"] / um,
            "u_centre_um": worst / um, "monte_carlo_centre_um": np.sqrt(np.linalg.eigvalsh(cloud)[-1]) / um,
            "u_angle_arcsec": float(np.median(calib.covariance(fit, "angle").u)) / arcsec,
            "failures": sampled.failures}


def number_of_points(trials: int) -> list[dict[str, float]]:
    """Figure 4: more points on the whole circle, radius 100 mm."""
    return [{"points": n, **row(np.arange(n) * 2 * np.pi / n, 0.1, NOISE, trials, n)}
            for n in (4, 6, 8, 12, 24, 48, 96)]


def arc(trials: int) -> list[dict[str, float]]:
    """Figure 6: twelve points on an arc, radius 100 mm."""
    ends = {a: a * 11 / 12 if a == 360 else a for a in (15, 30, 60, 90, 120, 180, 270, 360)}   # no point twice
    return [{"arc_deg": a, **row(np.linspace(0.0, end, 12) * degree, 0.1, NOISE, trials, a)} for a, end in ends.items()]


def radius(trials: int) -> list[dict[str, float]]:
    """Figure 9: every 60 degrees on radii of 100, 200, 500 mm, tracker at 3 m with its stated U."""
    command, rows = np.arange(7) * 60.0 * degree, []
    for r in (0.1, 0.2, 0.5):
        polar = laser_tracker.polar_readings(points_of(command, r))
        u = calib.Gaussian.matrix(laser_tracker.cartesian_covariance(polar, TRACKER.at(polar)))
        rows.append({"radius_mm": r / mm, **row(command, r, u, trials, int(1000 * r))})
    return rows


def large_table(trials: int) -> list[dict[str, float | str]]:
    """Section 1.3: a table of 4 m radius, tracker 5 m from its centre; formulations on the same simulated readings.

    Two kinds of noise: the stated U on each coordinate alike, which equal and weighted fits meet, and a tracker whose
    range is ten times surer than its angles, which only a covariance of each point can say.
    """
    command, r = np.arange(12) * 30.0 * degree, 4.0
    points = points_of(command, r, 5.0)
    polar = laser_tracker.polar_readings(points)
    stated = TRACKER.at(polar)
    kinds = {"U on each coordinate": stated, "range ten times surer": stated * [0.1, 1.0, 1.0]}
    rows: list[dict[str, float | str]] = []
    for kind, u in kinds.items():
        covariance = laser_tracker.cartesian_covariance(polar, u)
        of_point = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3.0)
        weight = pairwise.weights(of_point)
        full = circle.declare(points, calib.Gaussian.matrix(covariance), command)
        formulations = {
            "equal weights": lambda p, s=of_point: circle.declare(p, float(np.sqrt(np.mean(s**2))), command),
            "weight of each point": lambda p, s=of_point: circle.declare(p, np.tile(s[:, None], 3), command),
            "covariance of each point": lambda p, c=covariance: circle.declare(p, calib.Gaussian.matrix(c), command),
            "equation 8": pairwise.pairwise,
            "equation 14 repaired": lambda p, w=weight: pairwise.repaired_pairwise(p, w),
            "equation 14 as printed": lambda p, w=weight: pairwise.weighted_pairwise(p, w)}
        errors: dict[str, list[tuple[float, float]]] = {name: [] for name in formulations}
        for seed in range(trials):
            seen = calib.simulate(full, None, seed).observations[0].readings
            for name, declare in formulations.items():
                estimate = calib.solve(declare(seen))
                away = float(np.linalg.norm(estimate["centre"] - [5.0, 0.0, -0.4]))
                errors[name].append((away, estimate["radius"] - r))
        for name, found in errors.items():
            centre, size = np.sqrt(np.mean(np.square(found), axis=0)) / um
            rows.append({"noise": kind, "formulation": name, "rms_error_of_centre_um": centre,
                         "rms_error_of_radius_um": size})
    return rows


def as_table(title: str, rows: Sequence[dict[str, float | str]]) -> str:
    """A Markdown table."""
    def shown(value: float | str) -> str:
        return value if isinstance(value, str) else f"{value:.4g}"
    names = list(rows[0])
    return "\n".join([f"## {title}", "", f"| {' | '.join(names)} |", f"|{'---|' * len(names)}",
                      *(f"| {' | '.join(shown(r[name]) for name in names)} |" for r in rows), ""])


def plot(studies: dict[str, list[dict[str, float]]], path: Path) -> None:
    """One panel a study: u by linear propagation as lines, Monte Carlo as marks."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullLocator

    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    for axes, (title, rows) in zip(figure.subplots(1, len(studies)), studies.items()):
        name = next(iter(rows[0]))
        x = [r[name] for r in rows]
        for what in ("centre", "radius"):
            line, = axes.loglog(x, [r[f"u_{what}_um"] for r in rows], "-", label=f"{what} [um]")
            axes.loglog(x, [r[f"monte_carlo_{what}_um"] for r in rows], "o", color=line.get_color())
        axes.loglog(x, [r["u_angle_arcsec"] for r in rows], "--", label="angle [arcsec]")
        axes.set(title=title, xlabel=name.replace("_", " "), ylabel="standard uncertainty")
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xticks(x, [f"{value:g}" for value in x])
        axes.legend()
    figure.savefig(path, dpi=100)


def main(trials: int) -> None:
    studies = {"Number of points (figure 4)": number_of_points(trials), "Arc (figure 6)": arc(trials),
               "Radius (figure 9)": radius(trials)}
    large = large_table(max(trials // 20, 10))
    text = "\n".join([f"# Studies of section 2 of the turntable paper ({trials} trials)", "",
                      "u: linear propagation of the declared problem; monte_carlo: re-solved simulated readings.", "",
                      *(as_table(title, rows) for title, rows in studies.items()),
                      as_table("Large table, radius 4 m, tracker 5 m from its centre (section 1.3)", large)])
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "turntable_studies.md").write_text(text, encoding="utf-8")
    plot(studies, RESULTS / "turntable_studies.png")
    print(text)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
