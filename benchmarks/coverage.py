"""Coverage of stated 95 % intervals for every shipped problem and instrument: 500 simulated repetitions each.

Run: python benchmarks/coverage.py [repetitions [module ...]]; writes benchmarks/results/coverage.csv, where lines of
modules that were not asked for stay as they are.
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


HEADER = ("module", "results", "repetitions", "failures", "covered_mean", "covered_least", "covered_most",
          "true_spread_over_stated_u")


def main(repetitions: int, chosen: list[str]) -> None:
    lines = {}
    if chosen and RESULTS.exists():
        with RESULTS.open(newline="") as file:
            lines = {line[0]: line for line in list(csv.reader(file))[1:]}
    known = {module.__name__: module for module in modules_with_examples()}
    for name in chosen or known:
        found = coverage(solve(known[name].example(1)), range(1, repetitions + 1))
        spread = f"{np.sqrt(np.mean(found.errors**2)):.4f}"
        shares = (f"{found.covered.mean():.4f}", f"{found.covered.min():.3f}", f"{found.covered.max():.3f}")
        lines[name] = [name, len(found.names), repetitions, found.failures, *shares, spread]
        print(*lines[name], flush=True)
        # written after each module: a run that is stopped keeps what it has
        RESULTS.parent.mkdir(exist_ok=True)
        with RESULTS.open("w", newline="") as file:
            csv.writer(file).writerows([HEADER, *(lines[n] for n in known if n in lines)])


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500, sys.argv[2:])
