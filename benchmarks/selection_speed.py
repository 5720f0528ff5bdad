"""Time, value and certified gap of choosing k of n rows with p unknowns, beside a plain greedy and figaroh.

    python benchmarks/selection_speed.py [--figaroh]

Writes benchmarks/results/selection_speed.md. CPU seconds of one process; set OMP_NUM_THREADS=1 for one thread. figaroh
(`pip install figaroh`) gets the same whitened candidates; its exchange
(1.0.2) leaves chosen rows in its pool, so it may take one row several times; its value can then lie beyond the bound of
k different rows (a negative gap), and it returns the value only, not the rows.
"""

from __future__ import annotations

import os
import random
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

import calib
from calib import A, Conic, D, E, Exchange, G, Observations, Problem, Relaxation, Unknown
from calib.analyse.selection.exact import enumerated
from calib.analyse.selection.exchange import exchange
from calib.analyse.selection.greedy import greedy
from calib.analyse.selection.relaxation import relax
from calib.analyse.selection.request import requested
from calib.analyse.selection.starts import rounded

RESULTS = Path(__file__).parent / "results"
CASES = ((84, 6, 20), (84, 12, 30), (1000, 30, 60), (10_000, 60, 120))
CONIC, PLAIN, FIGAROH = 84, 1000, 84      # candidates up to which the slower peers are asked


def smooth_rows(n: int, p: int, seed: int) -> np.ndarray:
    """Derivatives (n, p) as of real instruments: smooth functions of four settings, rows of unequal size."""
    generator = np.random.default_rng(seed)
    settings = generator.uniform(-1, 1, (n, 4))
    angle = settings @ generator.normal(size=(4, p)) * generator.uniform(0.3, 2, p) + generator.uniform(0, 6, p)
    return np.sin(angle) * generator.lognormal(0, 0.5, (n, 1))


def linear(coefficients: Any, row: Any) -> Any:
    """A reading that is a linear function of the unknowns."""
    return ca.dot(coefficients, row)


def plan(n: int, p: int, seed: int) -> calib.Linearisation:
    """A linearisation with n candidate rows and p unknowns."""
    unknown = Unknown("c", np.zeros(p), "mm")
    return calib.linearise(Problem([Observations(linear, unknown, smooth_rows(n, p, seed), u=1.0, group="rows")]))


def timed(what: Callable[[], Any]) -> tuple[Any, float]:
    """A result and the CPU seconds it took."""
    begin = time.process_time()
    return what(), time.process_time() - begin


def plain_greedy(rows: np.ndarray, keep: int) -> list[int]:
    """The greedy choice as one would write it first: the determinant of every candidate at every step."""
    information, chosen = 1e-10 * np.eye(rows.shape[1]), []
    outer = np.einsum("ni,nj->nij", rows, rows)
    for _ in range(keep):
        gain = np.linalg.slogdet(information + outer)[1]
        gain[chosen] = -np.inf
        best = int(np.argmax(gain))
        chosen.append(best)
        information = information + outer[best]
    return chosen


def figaroh_exchange(rows: np.ndarray, keep: int) -> float:
    """det^(1/p) that figaroh's Detmax reaches on the same candidates; it returns its values, not its choice."""
    from figaroh.optimal.base_optimal_calibration import Detmax

    random.seed(1)
    search = Detmax({i: np.outer(a, a) for i, a in enumerate(rows)}, keep)
    return float(search.main_algo()[-1])


def compared(n: int, p: int, keep: int, criterion: Any, with_figaroh: bool) -> dict[str, object]:
    """One line of the table."""
    fit = plan(n, p, 1)
    request, prepared = timed(lambda: requested(fit, keep, criterion))
    objective, limits = request.objective, request.limits
    first, t_greedy = timed(lambda: greedy(objective, limits))
    better, t_exchange = timed(lambda: exchange(objective, limits, first))
    relaxed, t_bound = timed(lambda: relax(objective, limits, request.candidates.indicator(better)))
    best, t_rounded = timed(lambda: rounded(objective, limits, relaxed.weights))

    def gap(chosen: list[int]) -> float:
        return 1.0 - float(np.exp(relaxed.bound - objective.loss(chosen)))

    line: dict[str, object] = {
        "n, p, k": f"{n}, {p}, {keep}", "criterion": criterion.name, "prepare [s]": prepared, "greedy [s]": t_greedy,
        "gap greedy": gap(first), "exchange [s]": t_exchange, "gap exchange": gap(better), "bound [s]": t_bound,
        "rounding [s]": t_rounded, "gap best": gap(best)}
    if n <= CONIC:
        judge, line["CVXPY/Clarabel [s]"] = timed(lambda: calib.select(fit, keep, criterion, method=Conic()))
        ours = calib.select(fit, keep, criterion, method=Relaxation())
        line["its bound against ours"] = judge.bound / ours.bound - 1.0
    rows = request.candidates.rows[:, 0]
    if n <= PLAIN and criterion.name == "D":
        chosen, line["plain greedy [s]"] = timed(lambda: plain_greedy(rows, keep))
        line["gap plain greedy"] = gap(chosen)
    if with_figaroh and n <= FIGAROH and criterion.name == "D":
        reached, line["figaroh Detmax [s]"] = timed(lambda: figaroh_exchange(rows, keep))
        best_possible = np.exp(-relaxed.bound - request.candidates.log_scale / p)
        line["gap figaroh, rows repeated"] = 1.0 - reached / float(best_possible)
    line["peak memory so far [MB]"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return line


def of_the_worst(n: int, p: int, keep: int, criterion: Any) -> dict[str, object]:
    """One line of the table of criteria that are the largest of several values."""
    fit = plan(n, p, 1)
    request = requested(fit, keep, criterion)
    start = greedy(request.objective.stand_in, request.limits)
    relaxed, t_bound = timed(lambda: relax(request.objective, request.limits, request.candidates.indicator(start)))
    reached = request.objective.terms[0]
    loss = float(reached.loss(reached.information(relaxed.weights)[None])[0])
    choice, t_whole = timed(lambda: calib.select(fit, keep, criterion))
    return {"n, p, k": f"{n}, {p}, {keep}", "criterion": criterion.name, "bound [s]": t_bound,
            "relaxation above its bound": float(np.expm1(loss - relaxed.bound)), "whole select [s]": t_whole,
            "gap best": choice.gap}


def eighty_four() -> dict[str, object]:
    """All 84 choices of six of nine, after linearisation."""
    fit = plan(9, 6, 2)
    begin = time.perf_counter()
    request = requested(fit, 6, D())
    count = sum(len(losses) for _, losses in enumerated(request.objective, request.limits))
    seconds = time.perf_counter() - begin
    return {"subsets": count, "seconds": seconds,
            "whole select [s]": calib.select(fit, 6, D(), method=Exchange()).seconds}


def table(rows: list[dict[str, object]]) -> str:
    """Rows as a Markdown table."""
    names = list(dict.fromkeys(name for row in rows for name in row))

    def cell(value: object) -> str:
        return f"{value:.3g}" if isinstance(value, (float, np.floating)) else str(value)

    lines = ["| " + " | ".join(names) + " |", "|" + " --- |" * len(names)]
    return "\n".join([*lines, *("| " + " | ".join(cell(row.get(n, "")) for n in names) + " |" for row in rows)])


def main(with_figaroh: bool) -> None:
    """Run all cases and write the table."""
    import scipy.linalg
    import scipy.optimize

    assert scipy.linalg and scipy.optimize      # their import is not what is timed
    calib.select(plan(20, 3, 1), 8, D(), method=Conic())
    rows = [compared(*case, criterion, with_figaroh) for case in CASES for criterion in (D(), A("c"))]
    worst = [of_the_worst(*case, criterion) for case in CASES[:3] for criterion in (E("c"), G())]
    threads = os.environ.get("OMP_NUM_THREADS", "all")
    text = (f"CPU seconds, OMP_NUM_THREADS={threads}. gap: 1 - value/bound for D, 1 - bound/value for A. "
            "figaroh may take one row several times, which the bound does not allow: its gap is then negative.\n\n"
            f"{table(rows)}\n\n{table(worst)}\n\n{table([eighty_four()])}")
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "selection_speed.md").write_text(
        "# Choosing k of n rows with p unknowns\n\n`python benchmarks/selection_speed.py --figaroh`\n\n" + text + "\n",
        encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main("--figaroh" in sys.argv)
