"""Rates of the discrepancy workflow on simulated cases: false alarms, detection, naming, aliases, coverage, time.

python benchmarks/discrepancy_rates.py [--clean 1000] [--cases 60] [--scenario NAME ...] [--out benchmarks/results]

The cases are those of tests/discrepancy_cases.py: other seeds and geometry than the public examples, simulated with the
models and effects of the problem modules. One line of the table a scenario and kind of case.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from discrepancy_cases import NOISES, hide_blunders, hide_effects, hide_noise, hide_structure
from discrepancy_designs import DESIGNS
from discrepancy_outcomes import Outcome, outcome

COLUMNS = ("scenario", "hidden", "size", "cases", "alarm", "right_verdict", "effect_named", "exact", "exact_or_alias",
           "exact_where_separable", "ideal_power", "alias_set_complete", "spurious_aliases", "rows_exact",
           "within_2u", "u_over_informed_u", "gap_shrink_095", "seconds")
FIRST = 70_000  # seed of the first case; thresholds were chosen looking at smaller ones


def kinds(clean: int, cases: int):
    """(name, size, number of cases, maker(scenario, seed))."""
    yield "nothing", 0.0, clean, lambda sc, seed: hide_effects(sc, seed, 0, 0.0)
    for size in (0.3, 0.5, 1.0, 3.0, 10.0):
        yield "one effect", size, cases, lambda sc, seed, size=size: hide_effects(sc, seed, 1, size)
    for count, name in ((2, "two effects"), (3, "three effects")):
        yield name, 3.0, cases, lambda sc, seed, count=count: hide_effects(sc, seed, count, 3.0)
    for size in (1.0, 3.0):
        yield "structure", size, cases, lambda sc, seed, size=size: hide_structure(sc, seed, size)
    for kind in NOISES:
        yield f"noise: {kind}", 1.0, cases, lambda sc, seed, kind=kind: hide_noise(sc, seed, kind)
    yield "effect, blunders", 3.0, cases, lambda sc, seed: hide_effects(sc, seed, 1, 3.0, 2)
    yield "blunders", 6.0, cases, lambda sc, seed: hide_blunders(sc, seed, 6.0)


def line(scenario: str, name: str, size: float, found: list[Outcome]) -> list[object]:
    """One line of the table."""
    def mean(field: str) -> float:
        values = np.array([getattr(one, field) for one in found], float)
        return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")

    shrinks = np.array([one.shrink for one in found])
    enough = float(np.mean(shrinks[np.isfinite(shrinks)] >= 0.95)) if np.isfinite(shrinks).any() else float("nan")
    figures = [mean(f) for f in ("alarmed", "right", "named", "exact", "or_alias",
                                   "exact_where_separable", "ideal")]
    listed, wrong = (sum(getattr(one, f) for one in found) for f in ("listed_aliases", "spurious_aliases"))
    figures += [1 - mean("missed_aliases"), wrong / listed if listed else float("nan"), mean("rows"),
                mean("within"), mean("u_ratio"), enough, mean("seconds")]
    return [scenario, name, size, len(found), *("" if np.isnan(f) else f"{f:.3f}" for f in figures)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clean", type=int, default=1000)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--scenario", nargs="*", default=list(DESIGNS))
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    chosen = parser.parse_args()
    for scenario in chosen.scenario:
        with (chosen.out / f"discrepancy_rates_{scenario}.csv").open("w", newline="", encoding="utf-8") as stream:
            table = csv.writer(stream)
            table.writerow(COLUMNS)
            for name, size, count, make in kinds(chosen.clean, chosen.cases):
                found = []
                for seed in range(FIRST, FIRST + count):
                    try:
                        case = make(scenario, seed)
                    except ValueError:  # this design cannot show such a thing
                        continue
                    found.append(outcome(case))
                row = line(scenario, name, size, found)
                table.writerow(row)
                stream.flush()
                print(*row, sep="\t", flush=True)


if __name__ == "__main__":
    main()
