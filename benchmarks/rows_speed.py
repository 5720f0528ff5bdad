"""Rows with all derivatives: CasADi's map, the NumPy program and compiled rows side by side, one thread, one run.

Run: python benchmarks/rows_speed.py [rows]; writes benchmarks/results/rows_speed.md. CPU time, medians of interleaved
rounds. What is compared is checked first: compiled rows are those of CasADi to the last digit.
"""

from __future__ import annotations

import os

os.environ["CALIB_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import importlib
import platform
import statistics
import sys
import tempfile
import time
from pathlib import Path

import casadi as ca
import numpy as np

from calib.system import System

RESULTS = Path(__file__).parent / "results" / "rows_speed.md"
MODELS = ("problems.circle", "instruments.laser_tracker", "instruments.theodolite", "problems.multilateration",
          "problems.base_point", "problems.three_axis_turntable", "problems.serial_arm")
ROUNDS = 7


def first_model(name, rows):
    """Program of the first observations of an example, its CasADi twin, and columns for so many rows."""
    system = System(importlib.import_module(name).example(1))
    term = system.terms[0]
    inputs = [np.resize(np.asarray(x, float), rows) for x in term._inputs(system.layout.start())]
    generator = np.random.default_rng(1)
    inputs = [x * (1 + 1e-9 * generator.uniform(size=rows)) for x in inputs]
    program, symbols = term.traced.program(term.any_free), term.traced.symbols
    local = [s for s, want in zip(symbols.local, term.any_free, strict=True) if want]
    at_rest = ca.substitute([term.traced.prediction, *term.traced.derivatives(local)], symbols.local,
                            [ca.SX.zeros(s.shape) for s in symbols.local])
    one = ca.Function("row", [ca.vertcat(*symbols.ambient)], [ca.vertcat(*[ca.densify(ca.vec(e)) for e in at_rest])])
    return program, one, inputs


def mapped(one, inputs, rows):
    """CasADi's map over all rows without copies in or out; the arrays live as long as the call."""
    function = one.map(rows)
    given = np.ascontiguousarray(np.array(inputs).T)      # row after row, as CasADi stores columns
    result = np.empty((rows, one.numel_out(0)))
    buffer, trigger = function.buffer()
    buffer.set_arg(0, memoryview(given.reshape(-1)))
    buffer.set_res(0, memoryview(result.reshape(-1)))

    def run(kept=(buffer, given)):
        trigger()
        return result.T
    return run


def seconds(call):
    begin = time.process_time()
    call()
    return time.process_time() - begin


def main(rows: int) -> None:
    lines = []
    for name in MODELS:
        program, one, inputs = first_model(name, rows)
        with tempfile.TemporaryDirectory() as folder:
            os.environ["CALIB_CACHE"] = folder
            compiling = seconds(lambda program=program: program.compiled)
        by_casadi = mapped(one, inputs, rows)
        ways = (by_casadi, lambda p=program, i=inputs: p.run(i, rows, compiled=False),
                lambda p=program, i=inputs: p.run(i, rows, compiled=True))
        exact = by_casadi()
        if not np.array_equal(ways[2](), exact):
            raise SystemExit(f"{name}: compiled rows differ from those of CasADi")
        rounds = [[seconds(way) for way in ways] for _ in range(ROUNDS)]
        casadi, numpy, compiled = (statistics.median(times) / rows * 1e9 for times in zip(*rounds, strict=True))
        traffic = 8 * (len(inputs) + program.outputs)
        lines.append(f"| {name} | {len(program)} | {casadi:.0f} | {numpy:.0f} | {compiled:.1f} "
                     f"| {casadi / compiled:.0f} | {numpy / compiled:.1f} | {compiling * 1e3:.0f} "
                     f"| {traffic / compiled:.1f} |")
        print(lines[-1])
    RESULTS.write_text(
        f"# Rows: ns a row of one evaluation with all derivatives\n\n{rows} rows, one thread, CPU time, medians of "
        f"{ROUNDS} interleaved rounds in one run; {platform.machine()}, Python {platform.python_version()}, NumPy "
        f"{np.__version__}, CasADi {ca.__version__}. Compiled rows equal CasADi's to the last digit in every line. "
        "Compiling: the program once, without cache (the first line bears the loading of the compiler). Traffic: "
        "columns read and written once; a core streams some 5 to 10 GB/s, so that lines near that are bound by memory, "
        "the others by arithmetic and by the functions of the C library.\n\n"
        "| model | instructions | CasADi map | NumPy | compiled | CasADi / compiled | NumPy / compiled | compiling, ms "
        "| traffic, GB/s |\n| --- | --- | --- | --- | --- | --- | --- | --- | --- |\n" + "\n".join(lines) + "\n",
        encoding="utf-8")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20_000)
