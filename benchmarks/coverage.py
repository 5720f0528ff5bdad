"""Coverage of stated 95 % intervals for every shipped problem and instrument: 500 simulated repetitions each.

Run: python benchmarks/coverage.py [repetitions]; writes benchmarks/results/coverage.csv.
"""

from __future__ import annotations

import csv
import importlib
import pkgutil
import sys
from pathlib import Path

import numpy as np

import instruments
import problems
from calib import solve
from calib.workflow.coverage import coverage

RESULTS = Path(__file__).parent / "results" / "coverage.csv"


def modules_with_examples():
    """Every module of `problems` and `instruments` that offers an example."""
    for package in (problems, instruments):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            module = importlib.import_module(found.name)
            offered = getattr(module, "example", None)
            if offered is not None and offered.__module__ == found.name and getattr(module, "measures", True):
                yield module


def main(repetitions: int) -> None:
    rows = []
    for module in modules_with_examples():
        found = coverage(solve(module.example(1)), range(1, repetitions + 1))
        rows.append(
            [
                module.__name__,
                len(found.names),
                repetitions,
                found.failures,
                f"{found.covered.mean():.4f}",
                f"{found.covered.min():.3f}",
                f"{found.covered.max():.3f}",
                f"{np.sqrt(np.mean(found.errors**2)):.4f}",
            ]
        )
        print(*rows[-1], flush=True)
    RESULTS.parent.mkdir(exist_ok=True)
    with RESULTS.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(
            [
                "module",
                "results",
                "repetitions",
                "failures",
                "covered_mean",
                "covered_least",
                "covered_most",
                "true_spread_over_stated_u",
            ]
        )
        writer.writerows(rows)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500)
