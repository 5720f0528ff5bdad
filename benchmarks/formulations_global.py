"""How often the global bounds are tight, by the size of the noise; random problems.

Run: python benchmarks/formulations_global.py [problems]; writes benchmarks/results/formulations_global.md and .png.
Ranges: 10 points of a cube of 2 m, the point within 2 m. Increments: two lines, and three, of 0.7 m, 1.4 m away.
Poses: 8 points of spread 1 m, each with its own covariance of ratio up to 10. Spheres: 20 points on a radius of 0.2 m.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import calib
from calib import Gaussian, Observations, Pose, Problem, Unknown
from calib.geometry import norm, rotation_about
from calib.solve.globally.bound import Bound
from calib.solve.globally.increments import bisection_bound
from calib.solve.globally.ranges import convexity_bound, relaxation_bound, squared_ranges
from calib.solve.globally.rotation import closed_form, pose_bound
from calib.solve.globally.spheres import sphere_bound

RESULTS = Path(__file__).parent / "results"
NOISES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
Timed = dict[str, tuple[Bound, float]]


def timed(bound: Callable[[], Bound]) -> tuple[Bound, float]:
    """A bound and the seconds it took."""
    begun = time.perf_counter()
    return bound(), time.perf_counter() - begun


def of_ranges(seed: int, u: float) -> Timed:
    """A point from distances to points of a volume."""
    generator = np.random.default_rng(seed)
    places, truth = generator.uniform(-1, 1, (10, 3)), generator.uniform(-2, 2, 3)
    readings = np.linalg.norm(places - truth, axis=1) + u * generator.normal(size=10)
    point = Unknown("point", squared_ranges(places, readings, u))
    estimate = calib.solve(Problem([Observations(lambda point, place: norm(place - point), point, places,
                                                 readings=readings, u=u, group="ranges")]))
    arguments = (places, readings, u, estimate[point])
    return {"ranges: semidefinite relaxation": timed(lambda: relaxation_bound(*arguments)),
            "ranges: convexity": timed(lambda: convexity_bound(*arguments))}


def of_increments(seed: int, u: float) -> Timed:
    """A base point from increments along two lines and three."""
    run, zero, far = np.linspace(0.05, 0.75, 15), np.zeros(15), np.full(15, 0.75)
    found: Timed = {}
    for lines in (2, 3):
        places = np.vstack([np.column_stack(one)
                            for one in ((run, zero, zero), (far, run, zero), (far, far, run))[:lines]])
        truth, generator = np.array([-0.2, 1.4, -0.23]), np.random.default_rng(seed)
        readings = np.linalg.norm(places - truth, axis=1) - np.linalg.norm(truth) + u * generator.normal(
            size=len(places))
        point, length = Unknown("point", truth), Unknown("length", np.linalg.norm(truth))
        estimate = calib.solve(Problem([Observations(
            lambda point, length, place: norm(place - point) - length, point, length, places, readings=readings, u=u,
            group="increments")]))
        found[f"increments on {lines} lines: bisection"] = timed(
            lambda p=places, r=readings, e=estimate, b=point, s=length: bisection_bound(p, r, u, e[b], e[s]))
    return found


def of_poses(seed: int, noise: float) -> Timed:
    """Points carried by a pose, each with its own covariance."""
    generator = np.random.default_rng(seed)
    points, root = generator.normal(size=(8, 3)), noise * generator.normal(size=(8, 3, 3))
    covariance = root @ root.transpose(0, 2, 1) + 1e-2 * noise**2 * np.eye(3)
    axis = generator.normal(size=3)
    turn = np.asarray(rotation_about(axis / np.linalg.norm(axis), generator.uniform(0.0, np.pi)), float)
    seen = points @ turn.T + np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), generator.normal(size=(8, 3)))
    pose = Pose("pose", *closed_form(points, seen))
    estimate = calib.solve(Problem([Observations(lambda pose, point: pose @ point, pose, points, readings=seen,
                                                 u=Gaussian.matrix(covariance), group="seen")]))
    return {"poses: semidefinite relaxation": timed(
        lambda: pose_bound(points, seen, covariance, estimate[pose].rotation))}


def of_spheres(seed: int, u: float) -> Timed:
    """A sphere from points all round."""
    generator = np.random.default_rng(seed)
    direction = generator.normal(size=(20, 3))
    places = 0.2 * direction / np.linalg.norm(direction, axis=1)[:, None] + u * generator.normal(size=(20, 3))
    centre, radius = Unknown("centre", np.zeros(3)), Unknown("radius", 0.2)
    estimate = calib.solve(Problem([Observations(
        lambda centre, radius, place: norm(place - centre) - radius, centre, radius, places, readings=np.zeros(20),
        u=u, group="off")]))
    return {"spheres: eigenvalue": timed(lambda: sphere_bound(places, u, estimate[centre], estimate[radius]))}


def main(problems: int) -> None:
    rows: list[tuple[str, float, float, float, float, float]] = []
    for study in (of_ranges, of_increments, of_poses, of_spheres):
        for noise in NOISES:
            found: dict[str, list[tuple[Bound, float]]] = {}
            for seed in range(problems):
                try:
                    for name, one in study(seed, noise).items():
                        found.setdefault(name, []).append(one)
                except calib.errors.CalibrationError:
                    continue
            for name, several in found.items():
                gaps = np.array([bound.gap for bound, _ in several])
                rows.append((name, noise, 100.0 * float(np.mean([bound.proven for bound, _ in several])),
                             float(np.median(gaps)), float(gaps.max()),
                             1e3 * float(np.median([seconds for _, seconds in several]))))
    header = ("bound", "noise_m", "proven_percent", "median_gap", "largest_gap", "milliseconds")
    shown = [f"| {row[0]} | " + " | ".join(f"{value:.3g}" for value in row[1:]) + " |" for row in sorted(rows)]
    text = "\n".join([f"# Global bounds ({problems} random problems each)", "", f"| {' | '.join(header)} |",
                      f"|{'---|' * len(header)}", *shown, ""])
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "formulations_global.md").write_text(text, encoding="utf-8")
    plot(rows, RESULTS / "formulations_global.png")
    print(text)


def plot(rows: list[tuple[str, float, float, float, float, float]], path: Path) -> None:
    """Share of proven problems and largest gap against the noise."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    for number, name in enumerate(dict.fromkeys(row[0] for row in rows)):
        mine = [row for row in rows if row[0] == name]
        noise = [row[1] for row in mine]
        left.semilogx(noise, [row[2] for row in mine], marker="osD^vx"[number % 6], label=name)
        right.loglog(noise, [max(row[3], 1e-14) for row in mine], marker="osD^vx"[number % 6], label=name)
    left.set(xlabel="noise / m", ylabel="proven global / %", ylim=(-4, 104))
    right.set(xlabel="noise / m", ylabel="median relative gap (below 1e-14: drawn there)")
    right.axhline(1e-8, color="grey", linewidth=0.8)
    left.legend(fontsize=7)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
