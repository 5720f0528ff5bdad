"""Least squares, Huber, L1 and minimum zone on one affine problem (plumb) under five kinds of noise.

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
from calib.workflow.compare.again import again
from calib.workflow.compare.answer import Wanted, results
from calib.workflow.compare.study import NOISES, study
from problems import plumb

RESULTS = Path(__file__).parent / "results"
METHODS = {"least squares": GaussNewton(), "Huber": Convex(Huber()), "L1": Convex(L1()),
           "minimum zone": Convex(MinimumZone())}


def studied(trials: int) -> list[dict[str, float | str]]:
    """Bias, spread and efficiency of each loss under every kind of noise, as means over the unknowns."""
    declared = plumb.example(1)
    truth = calib.solve(declared.with_readings(calib.predict(declared)))
    wanted = Wanted.of(declared, [u for u in declared.unknowns if not declared.is_held(u).all()])
    values, bound = results(truth.fit, wanted)
    found = study(truth, bound, values, {name: again(method, wanted, truth) for name, method in METHODS.items()},
                  trials, 1)
    return [{"noise": one.noise, "loss": name,
             "largest_bias_in_u_of_it": float(np.abs(one.bias / one.u_of_bias).max()),
             "spread_over_stated_u": float(np.sqrt(np.mean(one.spread**2))),
             "efficiency": float(1.0 / np.mean(1.0 / one.efficiency))}
            for noise in NOISES for name, each in found.items() for one in each if one.noise == noise.name]


def main(trials: int) -> None:
    rows = studied(trials)
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

    kinds = [noise.name for noise in NOISES]
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    axes = figure.subplots()
    for number, name in enumerate(METHODS):
        mine = [float(row["spread_over_stated_u"]) for row in rows if row["loss"] == name]
        axes.bar(np.arange(len(kinds)) + 0.2 * (number - 1.5), mine, 0.18, label=name)
    axes.axhline(1.0, color="grey", linewidth=0.8)
    axes.set_xticks(range(len(kinds)), [kind.replace(" (", "\n(").replace(", ", ",\n") for kind in kinds], fontsize=8)
    axes.set_ylabel("true spread / stated u")
    axes.legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
