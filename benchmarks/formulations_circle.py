"""Algebraic, pairwise and orthogonal fits of a circle on arcs from 20 to 330 degrees and under six kinds of noise.

Run: python benchmarks/formulations_circle.py [trials]; writes benchmarks/results/formulations_circle.md and .png.
24 points on a radius of 100 mm, u = 50 um on each coordinate. Bias, spread and efficiency are those of the radius;
efficiency is the Cramer-Rao bound of the declared problem over the mean square error.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import calib
from calib import Gaussian
from calib.units import degree, um
from calib.workflow.compare.again import again
from calib.workflow.compare.answer import Wanted, results
from calib.workflow.compare.formulation import Global
from calib.workflow.compare.study import AS_STATED, NOISES, Noise, study
from problems import circle
from problems.circle import alternatives

RESULTS = Path(__file__).parent / "results"
RADIUS, NOISE, POINTS = 0.1, 50.0 * um, 24
ARCS = (20, 45, 90, 180, 330)
OBJECTIVES = {name: one for name, one in alternatives.formulations(None).items()
              if not isinstance(one, Global) and name not in ("equation 14", "mean of positions")}


def points_on(arc: float) -> tuple[np.ndarray, np.ndarray]:
    """Angles (n,) [rad] and exact points (n, 3) [m] of an arc [deg] about the origin."""
    angle = np.linspace(0.0, arc * degree, POINTS)
    return angle, RADIUS * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(POINTS)])


def uneven() -> np.ndarray:
    """Standard uncertainties (n, 3) [m] of points whose second half is five times worse, which is stated."""
    return NOISE * np.where(np.arange(POINTS) < POINTS // 2, 1.0, 5.0)[:, None] * np.ones(3)


def studied(arc: float, u: float | np.ndarray, label: str, noises: Sequence[Noise],
            trials: int) -> list[dict[str, float | str]]:
    """Bias, spread and efficiency of the radius by every fit on one arc."""
    angle, exact = points_on(arc)
    truth = calib.solve(circle.declare(exact, u if np.ndim(u) == 0 else Gaussian.standard(u), angle))
    wanted = Wanted.of(truth.problem, [truth.problem.select("radius")])
    values, bound = results(truth.fit, wanted)
    runs = {name: again(one, wanted, truth) for name, one in
            {"orthogonal distance": calib.GaussNewton(), **OBJECTIVES}.items()}
    found = study(truth, bound, values, runs, trials, int(arc), noises)
    return [{"noise": label if one.noise == AS_STATED.name else one.noise, "arc_deg": arc, "formulation": name,
             "stated_u_um": one.u[0] / um, "bias_in_stated_u": one.bias[0], "u_of_bias": one.u_of_bias[0],
             "spread_over_stated_u": one.spread[0], "efficiency": one.efficiency[0], "failures": one.failures}
            for noise in noises for name, each in found.items() for one in each if one.noise == noise.name]


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
    arcs = [row for arc in ARCS for row in studied(arc, NOISE, "Gaussian", [AS_STATED], trials)]
    noises = [*studied(180, uneven(), "second half five times worse, stated", [AS_STATED], trials),
              *studied(180, NOISE, "", NOISES[1:], trials)]
    RESULTS.mkdir(exist_ok=True)
    text = "\n".join([f"# Formulations of a circle ({trials} trials each)", "", "## Arc, Gaussian noise", "",
                      as_table(arcs), "## Other noise, half a turn", "", as_table(noises)])
    (RESULTS / "formulations_circle.md").write_text(text, encoding="utf-8")
    plot(arcs, RESULTS / "formulations_circle.png")
    print(text)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
