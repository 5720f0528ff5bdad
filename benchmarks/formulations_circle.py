"""Algebraic, pairwise and orthogonal fits of a circle on arcs from 20 to 330 degrees and under five kinds of noise.

Run: python benchmarks/formulations_circle.py [trials]; writes benchmarks/results/formulations_circle.md and .png.
24 points on a radius of 100 mm, u = 50 um on each coordinate. Bias, spread and efficiency are those of the radius;
efficiency is the Cramer-Rao bound of the declared problem over the mean square error.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

import calib
from calib import Gaussian
from calib.errors import CalibrationError
from calib.units import degree, um
from problems import circle, circle_formulations

RESULTS = Path(__file__).parent / "results"
RADIUS, NOISE, POINTS = 0.1, 50.0 * um, 24
ARCS = (20, 45, 90, 180, 330)
Fit = Callable[[calib.Problem], float]


def fits() -> dict[str, Fit]:
    """The radius [m] that each formulation gives to a declared circle."""
    found: dict[str, Fit] = {"orthogonal distance": lambda problem: float(calib.solve(problem)["radius"])}
    for name, one in circle_formulations.formulations(None).items():
        if hasattr(one, "values") and name != "mean of positions":
            found[name] = lambda problem, one=one: float(one.values(problem)["radius"])
        elif hasattr(one, "declare") and name != "equation 14":
            found[name] = lambda problem, one=one: float(calib.solve(one.declare(problem))["radius"])
    return found


def points_on(arc: float) -> tuple[np.ndarray, np.ndarray]:
    """Angles (n,) [rad] and exact points (n, 3) [m] of an arc [deg] about the origin."""
    angle = np.linspace(0.0, arc * degree, POINTS)
    return angle, RADIUS * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(POINTS)])


def errors_of(kind: str, generator: np.random.Generator) -> np.ndarray:
    """Errors (n, 3) [m] of a kind of noise; the declared problem always states NOISE on each coordinate, except for
    `heteroscedastic`, where it states what is there."""
    draw = generator.normal(size=(POINTS, 3))
    if kind == "heteroscedastic":
        return draw * uneven()[:, None]
    if kind == "one in ten eight times larger":
        return NOISE * draw * np.where(generator.uniform(size=(POINTS, 1)) < 0.1, 8.0, 1.0)
    if kind == "correlated from point to point (0.8)":
        for k in range(1, POINTS):
            draw[k] = 0.8 * draw[k - 1] + 0.6 * draw[k]
    return NOISE * draw


def uneven() -> np.ndarray:
    """Standard uncertainties (n,) [m] of points whose second half is five times worse."""
    return NOISE * np.where(np.arange(POINTS) < POINTS // 2, 1.0, 5.0)


KINDS = ("Gaussian", "heteroscedastic", "one in ten eight times larger", "correlated from point to point (0.8)")


def study(arc: float, kind: str, trials: int) -> list[dict[str, float | str]]:
    """Bias, spread and efficiency of every fit on one arc under one kind of noise."""
    angle, exact = points_on(arc)
    u = np.tile(uneven()[:, None], 3) if kind == "heteroscedastic" else NOISE
    declared = circle.declare(exact, u if np.ndim(u) == 0 else Gaussian.standard(u), angle)
    stated = calib.covariance(calib.linearise(declared), "radius").u[0]
    found: dict[str, list[float]] = {name: [] for name in fits()}
    for seed in range(trials):
        generator = np.random.default_rng([seed, int(arc)])
        problem = circle.declare(exact + errors_of(kind, generator), u if np.ndim(u) == 0 else Gaussian.standard(u),
                                 angle)
        for name, fit in fits().items():
            try:
                found[name].append(fit(problem) - RADIUS)
            except CalibrationError:
                continue
    rows = []
    for name, errors in found.items():
        error = np.array(errors)
        rows.append({"noise": kind, "arc_deg": arc, "formulation": name, "stated_u_um": stated / um,
                     "bias_in_stated_u": error.mean() / stated, "u_of_bias": error.std() / stated / len(error) ** 0.5,
                     "spread_over_stated_u": error.std(ddof=1) / stated,
                     "efficiency": stated**2 / np.mean(error**2), "failures": trials - len(error)})
    return rows


def as_table(rows: list[dict[str, float | str]]) -> str:
    """A Markdown table."""
    names = list(rows[0])
    shown = [[value if isinstance(value, str) else f"{value:.3g}" for value in row.values()] for row in rows]
    lines = [f"| {' | '.join(row)} |" for row in shown]
    return "\n".join([f"| {' | '.join(names)} |", f"|{'---|' * len(names)}", *lines, ""])


def plot(rows: list[dict[str, float | str]], path: Path) -> None:
    """Bias and efficiency against the arc under Gaussian noise."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    for number, name in enumerate(dict.fromkeys(str(row["formulation"]) for row in rows)):
        mine = [row for row in rows if row["formulation"] == name]
        arcs = [float(row["arc_deg"]) for row in mine]
        mark, dash = "osD^vx*"[number % 7], ("-", "--", ":")[number % 3]
        left.plot(arcs, [float(row["bias_in_stated_u"]) for row in mine], dash, marker=mark, label=name)
        right.plot(arcs, [float(row["efficiency"]) for row in mine], dash, marker=mark, label=name)
    left.axhline(0.0, color="grey", linewidth=0.8)
    left.set(xlabel="arc / degree", ylabel="bias of the radius / stated u", title="bias", xscale="log")
    right.set(xlabel="arc / degree", ylabel="Cramér-Rao bound / mean square error", title="efficiency", xscale="log")
    for axes in (left, right):
        axes.minorticks_off()
        axes.set_xticks(ARCS, [str(arc) for arc in ARCS])
    left.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main(trials: int) -> None:
    arcs = [row for arc in ARCS for row in study(arc, "Gaussian", trials)]
    noises = [row for kind in KINDS[1:] for row in study(180, kind, trials)]
    RESULTS.mkdir(exist_ok=True)
    text = "\n".join([f"# Formulations of a circle ({trials} trials each)", "", "## Arc, Gaussian noise", "",
                      as_table(arcs), "## Other noise, half a turn", "", as_table(noises)])
    (RESULTS / "formulations_circle.md").write_text(text, encoding="utf-8")
    plot(arcs, RESULTS / "formulations_circle.png")
    print(text)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
