"""Time of a network of laser trackers: solve, covariance block of every point and station, all redundancy numbers.

Medians of repeated runs (set OMP_NUM_THREADS=1 for one thread), beside GTSAM where its wheel is installed (native C++
factors of bearing and range). Usage: OMP_NUM_THREADS=1 python benchmarks/network_speed.py [--points 100 300 1000]
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from calib import Problem, linearise, reliability, simulate, solve
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


def median(run: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Median time [s] of a run, and its last answer."""
    times, answer = [], None
    for _ in range(repeats):
        begin = time.perf_counter()
        answer = run()
        times.append(time.perf_counter() - begin)
    return float(np.median(times)), answer


def ours(problem: Problem, repeats: int) -> tuple[float, float, float, Any]:
    """Times [s] of the solve, of all covariance blocks, and of all redundancy numbers; the estimate."""
    spent, estimate = median(lambda: solve(problem), repeats)

    def blocks() -> list[Any]:
        fit = linearise(estimate)
        found = []
        for unknown in problem.unknowns:
            columns = fit.layout.position[fit.layout.span(unknown)].reshape(unknown.count, -1)
            free = columns[np.all(columns >= 0, axis=1)]
            found.append(fit.factor.between(free, free))
        return found

    covariances, _ = median(blocks, repeats)
    whole, tests = median(lambda: reliability(linearise(estimate)), repeats)
    assert abs(tests.redundancy.sum() - estimate.dof) < 1e-6 * estimate.dof
    return spent, covariances, whole, estimate


def gtsam_time(problem: Problem, repeats: int) -> tuple[float, np.ndarray] | None:
    """Time [s] of GTSAM for the solve and the marginal covariance of every point, and its points; None where it is not
    installed. Its bearing is a unit vector, so that its optimum is ours only to second order in the noise."""
    try:
        import gtsam
    except ImportError:
        return None
    observed = problem.observations[0]
    assert observed.readings is not None
    station, point = observed.arguments[0].unknown, observed.arguments[1].unknown
    assert station is not None
    assert point is not None
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([U_ANGLE, U_ANGLE, U_RANGE]))
    start, graph = gtsam.Values(), gtsam.NonlinearFactorGraph()
    poses = station.show(station.ambient)
    for i, pose in enumerate(poses):
        turn, shift = np.asarray(pose.rotation), np.asarray(pose.translation).ravel()
        start.insert(gtsam.symbol("s", i), gtsam.Pose3(gtsam.Rot3(turn.T), -turn.T @ shift))
    for j, place in enumerate(point.ambient):
        start.insert(gtsam.symbol("p", j), gtsam.Point3(place))
    tight = gtsam.noiseModel.Isotropic.Sigma(6, 1e-8)          # its marginals refuse a pose that is held exactly
    graph.add(gtsam.PriorFactorPose3(gtsam.symbol("s", 0), start.atPose3(gtsam.symbol("s", 0)), tight))
    r, azimuth, zenith = observed.readings.T
    sight = np.column_stack([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])
    for i, j, length, line in zip(observed.arguments[0].index, observed.arguments[1].index, r, sight, strict=True):
        ends = (gtsam.symbol("s", int(i)), gtsam.symbol("p", int(j)))
        graph.add(gtsam.BearingRangeFactor3D(*ends, gtsam.Unit3(line), float(length), noise))

    def run() -> Any:
        answer = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
        marginals = gtsam.Marginals(graph, answer)
        for j in range(point.count):
            marginals.marginalCovariance(gtsam.symbol("p", j))
        return answer

    spent, answer = median(run, repeats)
    return spent, np.array([answer.atPoint3(gtsam.symbol("p", j)) for j in range(point.count)])


def main() -> None:
    """Write a table of times to standard output."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stations", type=int, default=10)
    parser.add_argument("--points", type=int, nargs="+", default=[100, 300, 1000])
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    out = sys.stdout
    header = ("stations x points", "readings", "solve [s]", "covariance blocks [s]", "redundancy [s]", "memory [MB]",
              "GTSAM solve + covariance [s]", "points differ [um]")
    out.write(f"| {' | '.join(header)} |\n|{' --- |' * len(header)}\n")
    ours(network(3, 10, seed=1), 1)          # what is traced and imported once is not part of any time
    sizes, totals = [], []
    for points in options.points:
        problem = network(options.stations, points, seed=1)
        spent, covariances, whole, estimate = ours(problem, options.repeats)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        peer = gtsam_time(problem, options.repeats)
        other = ("not installed", "") if peer is None else (
            f"{peer[0]:.3f}", f"{1e6 * np.abs(peer[1] - estimate['point']).max():.3g}")
        cells = (f"{options.stations} x {points}", str(3 * options.stations * points), f"{spent:.3f}",
                 f"{covariances:.3f}", f"{whole:.3f}", f"{peak:.0f}", *other)
        out.write(f"| {' | '.join(cells)} |\n")
        out.flush()
        sizes.append(points)
        totals.append(spent + whole)
    if len(sizes) > 1:
        exponent = np.polyfit(np.log(sizes), np.log(totals), 1)[0]
        out.write(f"\nTime of solve and redundancy against readings: exponent {exponent:.2f}\n")


if __name__ == "__main__":
    main()
