"""Heavy-tailed noise: how often it is recognised, beside what the best test could do with the same readings.

python benchmarks/discrepancy_tails.py [--cases 40] [--first 95000] [--out benchmarks/results/discrepancy_tails.md]

Noise of Student's t with 3 degrees of freedom, of unit scale or of the stated standard deviation, in the simulated
designs of tests/discrepancy_designs.py. The ideal test knows shape and size beforehand and looks at nothing else: the
ratio of the likelihoods of Student's t and of the stated noise, its threshold the 99 % quantile of simulated residuals
of the same geometry (Neyman and Pearson 1933). The second ceiling must also tell tails from one to three blunders of 6
to 15 u, equally likely beforehand.
"""

from __future__ import annotations

import argparse
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.special import gammaln
from scipy.stats import norm, t

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from discrepancy_cases import hide_noise

from calib import solve
from calib.workflow.discrepancy.explain import explain
from calib.workflow.discrepancy.noise import standardised
from calib.workflow.discrepancy.scene import scene_of

SCENARIOS = ("level_plumb", "theodolite_target", "turntable_tracker", "basepoint_multilateration")
KINDS = {"heavy": 1.0, "heavy of stated size": 1 / np.sqrt(3)}
BOUNDS = (0, 45, 80, 150, 10_000)  # degrees of freedom between which cases are counted together
NULL, DRAWS = 2000, 300  # simulated residuals of the stated noise and of Student's t
SMALLEST, LARGEST, MOST = 6.0, 15.0, 3  # sizes and number of the blunders


def ceilings(field, scale: float, seed: int) -> tuple[float, float]:
    """Shares of t noise that the ideal test finds at 1 %: against the stated noise alone, and also against blunders."""
    g, n = np.random.default_rng(seed), len(field.residual)
    outside = [x - field.basis @ (field.basis.T @ x)
               for x in (g.standard_normal((n, NULL)), scale * g.standard_t(3, (n, DRAWS)))]
    root = np.sqrt(np.maximum(field.redundancy, 0.02))[:, None]
    weight = standardised(field)[1]
    null, drawn = (weight * np.sum(t.logpdf(x / root / scale, 3) - np.log(scale) - norm.logpdf(x / root), axis=0)
                   for x in outside)
    found = drawn > np.quantile(null, 0.99)
    return float(found.mean()), float(np.mean(found & (drawn > weight * blunders(outside[1] / root))))


def blunders(standard):
    """Logarithm of the likelihood of one to three blunders among rows (n, draws), less that of the stated noise."""
    size, n = np.abs(standard), len(standard)
    density = (norm.cdf(size - SMALLEST) - norm.cdf(size - LARGEST)) / (2 * (LARGEST - SMALLEST))
    gain = np.log(np.maximum(density, 1e-300)) - norm.logpdf(standard)
    sums = np.full((MOST + 1, standard.shape[1]), -np.inf)  # over all choices of k rows
    sums[0] = 0.0
    for row in gain:
        sums[1:] = np.logaddexp(sums[1:], sums[:-1] + row)
    k = np.arange(1, MOST + 1)
    ways = gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)
    return np.logaddexp.reduce(sums[1:] - ways[:, None], axis=0) - np.log(MOST)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--first", type=int, default=95_000)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "discrepancy_tails.md")
    chosen = parser.parse_args()
    lines = ["| noise | degrees of freedom | cases | ideal test, 1 % | ideal test, 1 %, also told from blunders "
             "| recognised | called blunders | an effect named |", "|---|---|---|---|---|---|---|---|"]
    for kind, scale in KINDS.items():
        rows = []
        for scenario in SCENARIOS:
            for seed in range(chosen.first, chosen.first + chosen.cases):
                case = hide_noise(scenario, seed, kind)
                found = explain(case.problem)
                field = scene_of(case.problem, solve(case.problem), ()).field
                rows.append((field.dof, *ceilings(field, scale, seed), found.verdict == case.verdict,
                             found.verdict == "outliers", bool(found.effects)))
        table = np.array(rows, float)
        for low, high in pairwise(BOUNDS):
            inside = table[(table[:, 0] >= low) & (table[:, 0] < high)]
            if len(inside):
                label = f"below {high}" if not low else f"{low} and more" if high == BOUNDS[-1] else f"{low} to {high}"
                shares = " | ".join(f"{100 * share:.0f} %" for share in inside[:, 1:].mean(axis=0))
                lines.append(f"| t(3), {'unit scale' if scale == 1 else 'of stated size'} | {label} | {len(inside)} "
                             f"| {shares} |")
                print(lines[-1], flush=True)
    chosen.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
