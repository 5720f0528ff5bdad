"""Rates of the discrepancy workflow on simulated cases: false alarms, detection, naming, aliases, coverage, time.

python benchmarks/discrepancy_rates.py [--clean 1000] [--cases 60] [--scenario NAME ...] [--out benchmarks/results]

The cases are those of tests/discrepancy_cases.py: other seeds and geometry than the public examples, simulated with the
models and effects of the problem modules. discrepancy_rates_SCENARIO.csv: one line a kind of case;
discrepancy_promises_SCENARIO.csv: one line a promise of the workflow; discrepancy_promises.md: those of all scenarios.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from discrepancy_cases import NOISES, Case, hide_blunders, hide_effects, hide_noise, hide_structure
from discrepancy_designs import DESIGNS
from discrepancy_outcomes import Outcome, outcome

COLUMNS = ("scenario", "hidden", "size", "cases", "alarm", "right_verdict", "effect_named", "exact", "exact_or_alias",
           "exact_where_separable", "ideal_power", "alias_set_complete", "spurious_aliases", "rows_exact",
           "within_2u", "u_over_informed_u", "u_within_09_12", "gap_shrink_095", "seconds")
FIRST = 70_000  # seed of the first case; thresholds were chosen looking at smaller ones
APART = 5_000  # seeds from one kind of case to the next: the same noise may not fail at every size


def few(scenario: str, seed: int, size: float) -> Case:
    """An effect in a design of few readings, as papers print tables; a single pose has too many rows for that."""
    if scenario == "locator_pose":
        raise ValueError(f"{scenario} has no design of so few rows")
    return hide_effects(scenario, seed, 1, size, small=True)


def kinds(clean: int, cases: int):
    """(name, size, number of cases, maker(scenario, seed))."""
    yield "nothing", 0.0, clean, lambda sc, seed: hide_effects(sc, seed, 0, 0.0)
    for size in (0.3, 0.5, 1.0, 3.0, 10.0):
        yield "one effect", size, cases, lambda sc, seed, size=size: hide_effects(sc, seed, 1, size)
    for size in (3.0, 10.0):
        yield "one effect, few readings", size, cases, lambda sc, seed, size=size: few(sc, seed, size)
    for count, name in ((2, "two effects"), (3, "three effects")):
        for size in (3.0, 10.0):
            yield name, size, cases, lambda sc, seed, count=count, size=size: hide_effects(sc, seed, count, size)
    yield "effect, larger noise", 5.0, cases, lambda sc, seed: hide_effects(sc, seed, 1, 5.0, factor=2.0)
    for size in (1.0, 3.0):
        yield "structure", size, cases, lambda sc, seed, size=size: hide_structure(sc, seed, size)
    for kind in NOISES:
        yield f"noise: {kind}", 1.0, cases, lambda sc, seed, kind=kind: hide_noise(sc, seed, kind)
    yield "effect, blunders", 3.0, cases, lambda sc, seed: hide_effects(sc, seed, 1, 3.0, 2)
    yield "blunders", 6.0, cases, lambda sc, seed: hide_blunders(sc, seed, 6.0)


def inside(field: str, low: float, high: float) -> Callable[[Outcome], float]:
    """Whether a figure lies between two; not a number where there is none."""
    def passed(one: Outcome) -> float:
        value = getattr(one, field)
        return float(low <= value <= high) if np.isfinite(value) else np.nan
    return passed


def line(scenario: str, name: str, size: float, found: list[Outcome]) -> list[object]:
    """One line of the table."""
    def mean(figure: str | Callable[[Outcome], float]) -> float:
        values = np.array([getattr(one, figure) if isinstance(figure, str) else figure(one) for one in found], float)
        return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")

    figures = [mean(f) for f in ("alarmed", "right", "named", "exact", "or_alias",
                                   "exact_where_separable", "ideal")]
    listed, wrong = (sum(getattr(one, f) for one in found) for f in ("listed_aliases", "spurious_aliases"))
    figures += [1 - mean("missed_aliases"), wrong / listed if listed else float("nan"), mean("rows"),
                mean("within"), mean("u_ratio"), mean(inside("u_ratio", 0.9, 1.2)),
                mean(inside("shrink", 0.95, np.inf)), mean("seconds")]
    return [scenario, name, size, len(found), *("" if np.isnan(f) else f"{f:.3f}" for f in figures)]


@dataclass(frozen=True)
class Promise:
    """What the workflow promises over many cases: a share at least or at most, of which kinds of case, as counted."""

    words: str
    asked: str
    kinds: tuple[str, ...]
    sizes: tuple[float, ...] | None
    passed: Callable[[Outcome], float]
    out_of: Callable[[Outcome], float] = lambda one: 1.0

    def count(self, found: dict[tuple[str, float], list[Outcome]]) -> tuple[float, float]:
        """How much passed, and out of how much; a case where the promise does not apply counts in neither."""
        cases = [one for (name, size), some in found.items() if name.startswith(self.kinds)
                 and (self.sizes is None or size in self.sizes) for one in some]
        pairs = np.array([(self.passed(one), self.out_of(one)) for one in cases], float).reshape(-1, 2)
        return tuple(pairs[np.isfinite(pairs).all(axis=1)].sum(axis=0).tolist())


CLEAR = (1.0, 3.0, 5.0, 10.0)
PECULIAR = ("noise", "blunders")
PROMISES = (
    Promise("alarm where nothing is hidden", "at most 0.01", ("nothing",), None, lambda one: one.alarmed),
    Promise("a clean case within 0.3 s", "1", ("nothing",), None, inside("seconds", 0, 0.3)),
    Promise("any case within 0.3 s", "", ("",), None, inside("seconds", 0, 0.3)),
    Promise("effect named for blunders or peculiar noise", "at most 0.03", PECULIAR, None, lambda one: one.named),
    Promise("right verdict for these", "0.90", PECULIAR, None, lambda one: one.right),
    Promise("one effect of 1 u named, or its alias", "0.95", ("one effect",), (1.0,), lambda one: one.or_alias),
    Promise("one effect of 3 or 10 u named, or its alias", "0.95", ("one effect",), (3.0, 10.0),
            lambda one: one.or_alias),
    Promise("one effect named exactly where separable", "0.95", ("one effect",), CLEAR,
            lambda one: one.exact_where_separable),
    Promise("two and three effects: all and nothing else", "0.90", ("two", "three"), None, lambda one: one.or_alias),
    Promise("effect beside blunders or in larger noise", "0.95", ("effect,",), None, lambda one: one.or_alias),
    Promise("0.3 u: named over the power of the ideal test", "0.75", ("one effect",), (0.3,),
            lambda one: one.or_alias, lambda one: one.ideal),
    Promise("0.5 u: named over the power of the ideal test", "0.75", ("one effect",), (0.5,),
            lambda one: one.or_alias, lambda one: one.ideal),
    Promise("structure recognised as unknown", "0.95", ("structure",), None, lambda one: one.right),
    Promise("alias set complete where there is one", "0.95", ("one", "two", "three"), CLEAR,
            lambda one: 1.0 - one.missed_aliases),
    Promise("spurious members of alias sets", "at most 0.05", ("one", "two", "three"), CLEAR,
            lambda one: one.spurious_aliases, lambda one: one.listed_aliases),
    Promise("rows of blunders exact", "", ("blunders", "effect, blunders"), None, lambda one: one.rows),
    Promise("parameters within 2 u of the truth", "0.91 to 0.99", ("one", "two", "three"), CLEAR,
            lambda one: one.within),
    Promise("u within 0.9 to 1.2 of the informed fit", "1", ("one", "two", "three"), CLEAR,
            inside("u_ratio", 0.9, 1.2)),
    Promise("gap shrinks by 0.95 of the informed fit's", "0.95", ("one", "two", "three"), CLEAR,
            inside("shrink", 0.95, np.inf)),
)


def write_promises(folder: Path, scenario: str, found: dict[tuple[str, float], list[Outcome]]) -> None:
    """The promises of one scenario, and the table of all that lie in the folder."""
    with (folder / f"discrepancy_promises_{scenario}.csv").open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(("promise", "asked", "passed", "of"))
        for promise in PROMISES:
            table.writerow((promise.words, promise.asked, *(f"{value:.10g}" for value in promise.count(found))))
    shares: dict[str, list[tuple[float, float]]] = {promise.words: [] for promise in PROMISES}
    scenarios = [name for name in DESIGNS if (folder / f"discrepancy_promises_{name}.csv").exists()]
    for name in scenarios:
        with (folder / f"discrepancy_promises_{name}.csv").open(newline="", encoding="utf-8") as stream:
            for row in csv.DictReader(stream):
                shares[row["promise"]].append((float(row["passed"]), float(row["of"])))
    lines = [f"| {' | '.join(('promise', 'asked', 'all', *scenarios))} |", "|---" * (3 + len(scenarios)) + "|"]
    for promise in PROMISES:
        pairs = np.array(shares[promise.words])
        every = (pairs.sum(axis=0), *pairs)
        cells = [f"{passed / out_of:.3f} of {out_of:.4g}" if out_of else "" for passed, out_of in every]
        lines.append(f"| {' | '.join((promise.words, promise.asked, *cells))} |")
    (folder / "discrepancy_promises.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


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
            everything: dict[tuple[str, float], list[Outcome]] = {}
            for number, (name, size, count, make) in enumerate(kinds(chosen.clean, chosen.cases)):
                found = everything[name, size] = []
                for seed in range(FIRST + APART * number, FIRST + APART * number + count):
                    try:
                        case = make(scenario, seed)
                    except ValueError:  # this design cannot show such a thing
                        continue
                    found.append(outcome(case))
                row = line(scenario, name, size, found)
                table.writerow(row)
                stream.flush()
                print(*row, sep="\t", flush=True)
        write_promises(chosen.out, scenario, everything)


if __name__ == "__main__":
    main()
