"""Least squares, Huber, L1 and minimum zone on one affine problem (plumb) under four kinds of noise.

Run: python benchmarks/formulations_losses.py [trials]; writes benchmarks/results/formulations_losses.md and .png.
Bias, spread and efficiency over all requested results of the plumb example; efficiency is the Cramer-Rao bound for
Gaussian noise of the stated uncertainty over the mean square error.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import calib
from calib import L1, Convex, GaussNewton, Huber, MinimumZone
from problems import plumb

RESULTS = Path(__file__).parent / "results"
METHODS = {"least squares": GaussNewton(), "Huber": Convex(Huber()), "L1": Convex(L1()),
           "minimum zone": Convex(MinimumZone())}
KINDS = ("Gaussian", "outliers (one in ten, 8 u)", "uniform of the same u", "correlated in order (0.8)",
         "second half three times worse, not stated")


def errors_of(kind: str, n: int, generator: np.random.Generator) -> np.ndarray:
    """Errors (n,) in units of the stated u."""
    draw = generator.normal(size=n)
    if kind.startswith("outliers"):
        return np.where(generator.uniform(size=n) < 0.1, 8.0 * draw, draw)
    if kind.startswith("uniform"):
        return generator.uniform(-np.sqrt(3.0), np.sqrt(3.0), n)
    if kind.startswith("correlated"):
        for k in range(1, n):
            draw[k] = 0.8 * draw[k - 1] + 0.6 * draw[k]
    if kind.startswith("second"):
        return draw * np.where(np.arange(n) < n // 2, 1.0, 3.0)
    return draw


def study(kind: str, trials: int) -> list[dict[str, float | str]]:
    """Bias, spread and efficiency of each loss under one kind of noise, as means over the unknowns."""
    truth = plumb.example(1)
    exact = calib.predict(truth)
    start = calib.linearise(truth)
    names = [u for u in truth.unknowns if not truth.is_held(u).all()]
    reference = calib.covariance(start, *names)
    found: dict[str, list[np.ndarray]] = {name: [] for name in METHODS}
    for seed in range(trials):
        generator = np.random.default_rng(seed)
        readings = {}
        for one in truth.observations:
            u = one.uncertainty.weighting(one.n, exact[one.group].shape[1], one.group).u
            draw = [errors_of(kind, one.n, generator) for _ in range(u.shape[1])]
            readings[one.group] = exact[one.group] + u * np.stack(draw, axis=1)
        problem = truth.with_readings(readings)
        for name, method in METHODS.items():
            fit = calib.linearise(calib.solve(problem, method))
            found[name].append((calib.covariance(fit, *names).values - reference.values) / reference.u)
    rows = []
    for name, errors in found.items():
        error = np.array(errors)
        rows.append({"noise": kind, "loss": name,
                     "largest_bias_in_u_of_it": float(np.abs(error.mean(0) / error.std(0) * trials**0.5).max()),
                     "spread_over_stated_u": float(np.sqrt(np.mean(error.var(0, ddof=1)))),
                     "efficiency": float(1.0 / np.mean(error**2))})
    return rows


def main(trials: int) -> None:
    rows = [row for kind in KINDS for row in study(kind, trials)]
    names = list(rows[0])
    shown = [[value if isinstance(value, str) else f"{value:.3g}" for value in row.values()] for row in rows]
    text = "\n".join([f"# Losses on an affine problem ({trials} trials each)", "", f"| {' | '.join(names)} |",
                      f"|{'---|' * len(names)}", *(f"| {' | '.join(row)} |" for row in shown), ""])
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "formulations_losses.md").write_text(text, encoding="utf-8")
    plot(rows, RESULTS / "formulations_losses.png")
    print(text)


def plot(rows: list[dict[str, float | str]], path: Path) -> None:
    """Spread over stated u: a bar a loss, a group a kind of noise."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    axes = figure.subplots()
    for number, name in enumerate(METHODS):
        mine = [float(row["spread_over_stated_u"]) for row in rows if row["loss"] == name]
        axes.bar(np.arange(len(KINDS)) + 0.2 * (number - 1.5), mine, 0.18, label=name)
    axes.axhline(1.0, color="grey", linewidth=0.8)
    axes.set_xticks(range(len(KINDS)), [kind.replace(" (", "\n(").replace(", ", ",\n") for kind in KINDS], fontsize=8)
    axes.set_ylabel("true spread / stated u")
    axes.legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
