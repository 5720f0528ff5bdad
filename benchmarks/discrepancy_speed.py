"""Time of one discovery: the public cases with start-up, and 60 candidates on 10,000 readings.

python benchmarks/discrepancy_speed.py [--cases FOLDER] [--out benchmarks/results]

FOLDER holds case folders; without it only the large problem is timed. Wall clock and CPU time of whole processes.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import calib
from calib import Problem, simulate
from calib.units import arcsec, degree, minute, um
from calib.workflow.discrepancy.answer import answer
from instruments import laser_tracker
from problems import turntable
from problems.circle import in_plane

READINGS, BLOCKS = 10_000, 17


def large(seed: int, hidden: bool) -> Problem:
    """A tracker follows two reflectors on a turning table: 10,000 scalar readings in 17 blocks, some 60 candidates."""
    n = -(-READINGS // 3)
    g = np.random.default_rng(seed)
    sweep = np.concatenate([np.arange(0.0, 360.0, 5.0), np.arange(360.0, 0.0, -5.0)])
    command = np.resize(sweep, n) * degree
    covariates = {"time": (np.arange(n) * 0.2 * minute, "min"), "direction": np.where(np.arange(n) % 144 < 72, 1, -1),
                  "temperature_difference": (0.5 * np.sin(np.arange(n) / 900) + 0.05 * g.normal(size=n), "K"),
                  "block": 1 + np.arange(n) * BLOCKS // n}
    example = turntable.EXAMPLE
    axis = np.array(example["axis"]) / np.linalg.norm(example["axis"])
    first, second = in_plane(axis, np.array([1.0, 0.0, 0.0]))
    item = np.arange(n) % 2
    angle = command + item * 130 * degree
    radius, height = (np.array(example[name])[item][:, None] for name in ("radius", "height"))
    points = (np.array(example["centre"]) + height * axis
              + radius * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second))
    problem = turntable.declare(command, laser_tracker.polar_readings(points), [4 * um, arcsec, arcsec],
                                np.array(["1", "2"])[item], axis, None, covariates)
    values = {}
    if hidden:
        values[problem.parameters("drift (azimuth)")] = np.array([[0.2 * arcsec / 3600]])
        values[problem.parameters("encoder_2nd (theta)")] = np.array([[0.5 * arcsec, -0.4 * arcsec]])
    return simulate(problem, {u: v.reshape(u.shape) for u, v in values.items()}, seed)


def timed(command: list[str]) -> tuple[float, float]:
    """Wall clock and CPU time [s] of a process."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.perf_counter() - begin, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=Path)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    chosen = parser.parse_args()
    rows = []
    for case in sorted(chosen.cases.glob("*/case.toml")) if chosen.cases else []:
        with tempfile.TemporaryDirectory() as folder:
            wall, cpu = timed([sys.executable, "-m", "calib", "discover", str(case.parent), "--out", folder])
        rows.append((f"`calib discover`, {case.parent.name}", "start-up and report included", wall, cpu))
    for name, hidden in (("nothing hidden", False), ("two effects hidden", True)):
        problem = large(1, hidden)
        scalars = sum(np.asarray(o.readings).size for o in problem.observations)
        begin, spent = time.perf_counter(), time.process_time()
        found = calib.explain(problem)
        content = answer("large", found)
        wall, cpu = time.perf_counter() - begin, time.process_time() - spent
        candidates = sum(a.unknown.count for a in problem.attached)
        rows.append((f"{candidates} candidates on {scalars} readings, {name}",
                     f"{content['verdict']}: " + (", ".join(f"{e['name']} ({e['channel']})" for e in content["effects"])
                                                  or "nothing"), wall, cpu))
    lines = ["| what | result | wall clock / s | CPU / s |", "| --- | --- | --- | --- |",
             *(f"| {what} | {result} | {wall:.2f} | {cpu:.2f} |" for what, result, wall, cpu in rows),
             "", f"{os.cpu_count()} cores, {os.getloadavg()[0]:.0f} other processes at work: CPU is what a free core "
             "takes."]
    (chosen.out / "discrepancy_speed.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    print(json.dumps({"peak_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}))


if __name__ == "__main__":
    main()
