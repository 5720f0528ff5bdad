"""Time and memory of networks of laser trackers: solve, covariance block of every point and station, all redundancy
numbers.

Every measurement is a process of its own, one thread, CPU seconds; ours and the peers take turns, medians are printed.
What is imported, compiled or loaded once is not part of any time: a network of other readings goes before.
Peers: native Ceres where g++ and libceres-dev are there (network_ceres.cpp), GTSAM where an interpreter with its wheel
is named. Optimum and covariance of the points are compared with those of Ceres. The limit is what the arithmetic takes
at the rate of this machine's matrix products, or, if that is longer, what has to pass through memory at that of copies.
Usage: python benchmarks/network_speed.py [--cases 10x1000 30x10000 100x50000/10] [--repeats 3] [--gtsam PYTHON]
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib import Estimate, Problem, linearise, reliability, simulate, solve
from calib.compiled import available, row_back_end
from calib.system import System
from calib.units import arcsec, um
from problems.network import Point, Survey, declare
from problems.network.stations import Sightings
from problems.network.survey import ADJUSTED

U_RANGE, U_ANGLE = 10 * um, 1.0 * arcsec


def network(stations: int, points: int, seed: int, each: int | None = None) -> Problem:
    """Trackers and points in a hall of 20 m; readings simulated, the first tracker is the frame.

    each: how many trackers see a point, drawn for every point; all of them where it is not given.
    """
    generator = np.random.default_rng(seed)
    places = generator.uniform([-10, -10, 0], [10, 10, 4], (points, 3))
    keys = [f"P{i}" for i in range(points)]
    where = np.column_stack([generator.uniform(-12, 12, (stations, 2)), np.full(stations, 5.0)])
    turns = generator.uniform(-np.pi, np.pi, stations)
    i, j = (part.ravel() for part in np.meshgrid(np.arange(stations), np.arange(points), indexing="ij"))
    if each is not None:
        rank = np.argsort(np.argsort(generator.random((stations, points)), axis=0), axis=0)
        i, j = np.nonzero(rank < each)
    station, target = np.array([f"S{k}" for k in range(stations)])[i], np.array(keys)[j]
    from instruments.laser_tracker import polar_readings

    away, c, s = (places[j] - where[i]).T, np.cos(turns[i]), np.sin(turns[i])
    readings = polar_readings(np.stack([c * away[0] + s * away[1], c * away[1] - s * away[0], away[2]], axis=1))
    u = np.column_stack([np.full(len(readings), U_RANGE), U_ANGLE / np.sin(readings[:, 2]),
                         np.full(len(readings), U_ANGLE)])
    survey = Survey({key: Point(tuple(p), ADJUSTED, ADJUSTED) for key, p in zip(keys, places, strict=True)}, [],
                    sightings=[Sightings(station, target, readings, u)])
    return simulate(declare(survey), None, seed)


def everything(problem: Problem) -> tuple[dict[str, float], Estimate, dict[str, Any]]:
    """CPU times [s] of the solve, of all covariance blocks and of all redundancy numbers; the estimate, the blocks."""
    begin = time.process_time()
    estimate = solve(problem)
    solved = time.process_time()
    fit, blocks = linearise(estimate), {}
    for unknown in problem.unknowns:
        columns = fit.layout.position[fit.layout.span(unknown)].reshape(unknown.count, -1)
        free = columns[np.all(columns >= 0, axis=1)]
        blocks[unknown.name] = fit.factor.between(free, free)
    covered = time.process_time()
    tests = reliability(fit)
    tested = time.process_time()
    assert abs(tests.redundancy.sum() - estimate.dof) < 1e-6 * estimate.dof
    return ({"solve": solved - begin, "covariance": covered - solved, "redundancy": tested - covered}, estimate, blocks)


def limit(problem: Problem, passes: int) -> float:
    """Time [s] that arithmetic or memory traffic need at least: `passes` evaluations of all rows, each with a factor,
    then the covariance and one more pass for the redundancy numbers."""
    system = System(problem)
    term = system.terms[0]
    wanted = [c.shape[1] for c, free in zip(term.columns, term.any_free, strict=True) if free]
    station, point = (a.index for a in problem.observations[0].arguments[:2])
    g, f, n, d = wanted[0], wanted[1], term.n, term.dim
    met = g * np.bincount(point[station > 0]).astype(float)  # outer columns of every point; the first station is held
    instructions = len(term.traced.program(term.any_free))
    products = 2 * d * (f * (f + 1) / 2 + f * g + g * (g + 1) / 2 + f + g + 1)
    weighing = 2 * d * (2 * f * f + f * g + g * (g + 1) / 2)
    operations = (passes * (n * (instructions + products) + f * np.sum(met * (met + 1)))
                  + 2 * f * np.sum(met**2) + n * (instructions + weighing))
    traffic = 8 * ((passes + 1) * n * (2 * d + 4) + (2 * passes + 3) * f * met.sum())
    matrix, stream, room = np.ones((800, 800)), np.ones(1 << 23), np.empty(1 << 23)

    def least(run: Callable[[], object]) -> float:
        times = []
        for _ in range(7):
            begin = time.process_time()
            run()
            times.append(time.process_time() - begin)
        return min(times)

    return float(max(operations * least(lambda: matrix @ matrix) / (2 * 800**3),
                     traffic * least(lambda: np.copyto(room, stream)) / (2 * stream.nbytes)))


def memory(name: str) -> float:
    """VmRSS or VmHWM (its peak) of this process [MB]; not a number where the system does not say."""
    status = Path("/proc/self/status")
    lines = status.read_text(encoding="ascii").splitlines() if status.exists() else []
    return next((float(line.split()[1]) / 1024 for line in lines if line.startswith(f"{name}:")), float("nan"))


def measured_gtsam(problem: Problem) -> tuple[dict[str, float], np.ndarray]:
    """CPU times [s] of GTSAM for the solve and the marginal covariance of every point (of 200 of them, in proportion),
    points eliminated first; its points. Its bearing is a unit vector: its optimum is ours to second order in the
    noise."""
    import gtsam

    observed = problem.observations[0]
    station, point = (a.unknown for a in observed.arguments[:2])
    assert observed.readings is not None and station is not None and point is not None
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([U_ANGLE, U_ANGLE, U_RANGE]))
    start, graph, order = gtsam.Values(), gtsam.NonlinearFactorGraph(), gtsam.Ordering()
    poses = station.show(station.ambient)
    for j, place in enumerate(point.ambient):
        start.insert(gtsam.symbol("p", j), gtsam.Point3(place))
        order.push_back(gtsam.symbol("p", j))
    for i, pose in enumerate(poses):
        turn, shift = np.asarray(pose.rotation), np.asarray(pose.translation).ravel()
        start.insert(gtsam.symbol("s", i), gtsam.Pose3(gtsam.Rot3(turn.T), -turn.T @ shift))
        order.push_back(gtsam.symbol("s", i))
    tight = gtsam.noiseModel.Isotropic.Sigma(6, 1e-8)  # its marginals refuse a pose that is held exactly
    graph.add(gtsam.PriorFactorPose3(gtsam.symbol("s", 0), start.atPose3(gtsam.symbol("s", 0)), tight))
    r, azimuth, zenith = observed.readings.T
    sight = np.column_stack([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])
    for i, j, length, line in zip(observed.arguments[0].index, observed.arguments[1].index, r, sight, strict=True):
        ends = (gtsam.symbol("s", int(i)), gtsam.symbol("p", int(j)))
        graph.add(gtsam.BearingRangeFactor3D(*ends, gtsam.Unit3(line), float(length), noise))
    settings = gtsam.GaussNewtonParams()
    settings.setOrdering(order)
    begin = time.process_time()
    answer = gtsam.GaussNewtonOptimizer(graph, start, settings).optimize()
    solved = time.process_time()
    marginals = gtsam.Marginals(graph, answer)
    factored = time.process_time()
    some = min(200, point.count)
    for j in range(some):
        marginals.marginalCovariance(gtsam.symbol("p", j))
    each = (time.process_time() - factored) / some
    return ({"solve": solved - begin, "covariance": factored - solved + each * point.count},
            np.array([answer.atPoint3(gtsam.symbol("p", j)) for j in range(point.count)]))


def measured(case: str, way: str, answer: Path) -> dict[str, float]:
    """CPU times [s] and memory [MB] of one case by one row back end, or by GTSAM, in this process; points and their
    covariance go to a file."""
    stations, points, each = parsed(case)
    if way == "gtsam":
        times, found = measured_gtsam(network(stations, points, 1, each))
        np.savez(answer, points=found)
        return {**times, "peak": memory("VmHWM")}
    with row_back_end(way):
        imported = memory("VmRSS")
        everything(network(10, 1000, 2))
        problem = network(stations, points, 1, each)
        declared = memory("VmRSS")
        times, estimate, blocks = everything(problem)
        peak = memory("VmHWM")
    np.savez(answer, points=estimate["point"], covariance=blocks["point"])
    return {**times, "peak": peak, "over imports": peak - imported, "over problem": peak - declared,
            "limit": limit(problem, estimate.iterations + 1)}


def parsed(case: str) -> tuple[int, int, int | None]:
    """Stations, points, and how many stations see a point, of "30x10000" or "100x50000/10"."""
    sizes, _, each = case.partition("/")
    stations, points = sizes.split("x")
    return int(stations), int(points), int(each) if each else None


def in_a_process(case: str, way: str, folder: Path, python: str = sys.executable) -> dict[str, float]:
    """`measured`, in a process of its own with one thread."""
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "CALIB_THREADS": "1",
                  "PYTHONPATH": str(Path(__file__).resolve().parent.parent)}     # for a peer in a place of its own
    found = subprocess.run([python, __file__, "--measure", case, way, str(folder / f"{way}.npz")],
                           env={**os.environ, **one_thread}, check=True, capture_output=True, text=True)
    return json.loads(found.stdout.splitlines()[-1])


def native_ceres(folder: Path) -> Path | None:
    """The peer in C++, compiled; None where there is no compiler or no Ceres."""
    source, program = Path(__file__).with_name("network_ceres.cpp"), folder / "network_ceres"
    if shutil.which("g++") is None:
        return None
    done = subprocess.run(["g++", "-O3", "-march=native", "-DNDEBUG", "-I/usr/include/eigen3", str(source), "-o",
                           str(program), "-lceres", "-lglog"], capture_output=True, check=False)
    return program if done.returncode == 0 else None


def ceres(program: Path, case: str, with_covariance: bool, folder: Path) -> tuple[dict[str, float], Any, Any]:
    """CPU times [s] of Ceres on the same readings from the same start; its points and their covariance."""
    stations, points, each = parsed(case)
    problem = network(stations, points, 1, each)
    observed = problem.observations[0]
    station, point = (a.unknown for a in observed.arguments[:2])
    assert observed.readings is not None and station is not None and point is not None
    poses = station.show(station.ambient)  # of the hall in the frame of each station
    turn = np.array([p.rotation for p in poses]).transpose(0, 2, 1)
    place = -np.einsum("nij,nj->ni", turn, np.array([np.ravel(p.translation) for p in poses]))
    u = System(problem).weightings(System(problem).layout.start())[0].u
    rows = np.column_stack([observed.arguments[0].index, observed.arguments[1].index, observed.readings, u])
    start = np.column_stack([Rotation.from_matrix(turn).as_rotvec(), place])
    np.concatenate([[stations, points, len(rows), with_covariance], rows.ravel(), start.ravel(),
                    point.ambient.ravel()]).tofile(folder / "problem.bin")
    subprocess.run([str(program), str(folder / "problem.bin"), str(folder / "answer.bin")], check=True,
                   env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}, capture_output=True)
    answer = np.fromfile(folder / "answer.bin")
    found = answer[4 : 4 + 3 * points].reshape(-1, 3)
    blocks = answer[4 + 3 * points :].reshape(-1, 3, 3) if with_covariance else None
    return {"solve": answer[0], "covariance": answer[1]}, found, blocks


def main() -> None:
    """Write a table of times to standard output."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", nargs="+", default=["10x1000", "30x10000", "100x50000/10"])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--gtsam", metavar="PYTHON", help="interpreter with GTSAM, a peer once a case")
    parser.add_argument("--measure", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        case, way, answer = options.measure
        print(json.dumps(measured(case, way, Path(answer))))
        return
    header = ("stations x points", "readings", "by", "solve [s]", "covariance [s]", "redundancy [s]",
              "all: times limit", "memory: peak [MB]", "over imports", "over problem", "Ceres solve [s]",
              "Ceres covariance [s]", "solve: part of Ceres", "all: part of Ceres", "points differ [nm]",
              "covariance differs")
    print(f"| {' | '.join(header)} |\n|{' --- |' * len(header)}")
    sizes: dict[str, list[tuple[float, float]]] = {}
    more: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program = native_ceres(folder)
        for case in options.cases:
            stations, points, each = parsed(case)
            readings = 3 * points * (each or stations)
            with_covariance = points <= 1000  # quadratic in the points: hours for the others
            runs: dict[str, list[dict[str, float]]] = {}
            peer_points = peer_blocks = None
            differ: dict[str, tuple[float, float]] = {}
            for _ in range(options.repeats):
                if program is not None:
                    times, peer_points, peer_blocks = ceres(program, case, with_covariance, folder)
                    runs.setdefault("Ceres", []).append(times)
                for back_end in ("numpy", "compiled") if available() else ("numpy",):
                    runs.setdefault(back_end, []).append(in_a_process(case, back_end, folder))
                    found = np.load(folder / f"{back_end}.npz")
                    away = np.nan if peer_points is None else np.abs(found["points"] - peer_points).max()
                    wrong = np.nan if peer_blocks is None else float(np.max(
                        np.linalg.norm(found["covariance"] - peer_blocks, axis=(1, 2))
                        / np.linalg.norm(peer_blocks, axis=(1, 2))))
                    differ[back_end] = away, wrong
            middle = {who: {key: float(np.median([r[key] for r in times])) for key in times[0]}
                      for who, times in runs.items()}
            peer = middle.get("Ceres", {"solve": np.nan, "covariance": np.nan})
            for who in [w for w in middle if w != "Ceres"]:
                mine = middle[who]
                whole = mine["solve"] + mine["covariance"] + mine["redundancy"]
                sizes.setdefault(who, []).append((readings, whole))
                of_all = whole / (peer["solve"] + peer["covariance"]) if with_covariance else np.nan
                cells = (case, str(readings), who, f"{mine['solve']:.3f}", f"{mine['covariance']:.3f}",
                         f"{mine['redundancy']:.3f}", f"{whole / mine['limit']:.1f}", f"{mine['peak']:.0f}",
                         f"{mine['over imports']:.0f}", f"{mine['over problem']:.0f}",
                         f"{peer['solve']:.3f}", f"{peer['covariance']:.3f}" if with_covariance else "",
                         _part(peer["solve"] / mine["solve"]), _part(1 / of_all),
                         f"{1e9 * differ[who][0]:.2g}", f"{differ[who][1]:.1g}" if with_covariance else "")
                print(f"| {' | '.join(cells)} |", flush=True)
            if options.gtsam:
                times, ours = in_a_process(case, "gtsam", folder, options.gtsam), sizes[who][-1][1]
                away = np.abs(np.load(folder / "gtsam.npz")["points"] - found["points"]).max()
                more.append(f"GTSAM, {case}: solve {times['solve']:.2f} s, covariance {times['covariance']:.2f} s, "
                            f"peak {times['peak']:.0f} MB, points differ {1e9 * away:.2g} nm; all of {who} takes "
                            f"{_part((times['solve'] + times['covariance']) / ours)}")
    for who, pairs in sizes.items():
        if len(pairs) > 1:
            exponent = np.polyfit(*np.log(np.array(pairs)).T, 1)[0]
            more.append(f"{who}: time of everything against readings, exponent {exponent:.2f}")
    print("".join(f"\n{line}\n" for line in more))


def _part(times: float) -> str:
    return "" if np.isnan(times) else f"1/{times:.1f}"


if __name__ == "__main__":
    main()
