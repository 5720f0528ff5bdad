"""Monte Carlo of the space circle: compiled, NumPy, and scipy's least_squares in a loop, one thread, one run.

Run: python benchmarks/montecarlo_speed.py [trials]; writes benchmarks/results/montecarlo_speed.md. Thirteen points with
3x3 covariances, 19 unknowns, errors in variables. The peer solves the same readings with the same start (the truth), an
exact Jacobian by CasADi, and no uncertainty; its estimates are compared with ours first.
"""

from __future__ import annotations

import os

os.environ["CALIB_THREADS"] = os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import platform
import statistics
import sys
import tempfile
import time
from pathlib import Path

import casadi as ca
import numpy as np
import scipy
from scipy.optimize import least_squares

from calib import montecarlo, solve
from calib.compiled import row_back_end
from calib.workflow.trials import BLOCK, streams
from problems import circle

RESULTS = Path(__file__).parent / "results" / "montecarlo_speed.md"
SEED, PEER, ROUNDS = 1, 200, 5


def peer_model(estimate, covariance):
    """Whitened residuals and their Jacobian as CasADi functions of 19 parameters and 13 points, about the estimate."""
    values = {u.name: v for u, v in estimate.values.items()}
    problem = estimate.problem
    reference = next(a.data[0] for a in problem.observations[0].arguments if a.unknown is None)
    frame = values["normal"].reshape(3, 3).T
    x, points = ca.SX.sym("x", 19), ca.SX.sym("points", 3, 13)
    normal = frame[:, 2] + x[16] * frame[:, 0] + x[17] * frame[:, 1]
    normal = normal / ca.norm_2(normal)
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    feet = [circle.point_on_circle(x[i], x[13:16], normal, x[18], ca.SX(reference)) for i in range(13)]
    residual = ca.vertcat(*[ca.mtimes(root[i], feet[i] - points[:, i]) for i in range(13)])
    begin = np.concatenate([values["foot"].ravel(), values["centre"].ravel(), [0.0, 0.0], values["radius"].ravel()])
    given = [x, points]
    return ca.Function("r", given, [residual]), ca.Function("J", given, [ca.densify(ca.jacobian(residual, x))]), begin


def peer_readings(estimate, covariance):
    """The readings (trials, 13, 3) of the first trials, as our Monte Carlo draws them."""
    normal = streams(SEED, 0)[0].standard_normal((BLOCK, 13, 3))[:PEER]
    predicted = estimate.predicted["points"]
    return predicted + np.einsum("nij,tnj->tni", np.linalg.cholesky(covariance), normal)


def peer(model, readings, method, exact):
    """Angles (trials, 12) by least_squares, trial after trial."""
    residual, jacobian, begin = model
    found = []
    for points in readings:
        seen = points.T
        options = {"jac": lambda x, seen=seen: np.array(jacobian(x, seen))} if exact else {}
        best = least_squares(lambda x, seen=seen: np.array(residual(x, seen)).ravel(), begin, method=method,
                             x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12, **options)
        found.append(best.x[1:13] - best.x[0])
    return np.array(found)


def timed(call):
    wall, processor = time.perf_counter(), time.process_time()
    result = call()
    return result, time.process_time() - processor, time.perf_counter() - wall


def main(trials: int) -> None:
    problem = circle.example(SEED)
    _, covariance = circle.example_points(SEED)
    estimate = solve(problem)
    model, readings = peer_model(estimate, covariance), peer_readings(estimate, covariance)

    def ours(name, count):
        with row_back_end(name):
            return timed(lambda: montecarlo(estimate, count, SEED))

    lines = []
    with tempfile.TemporaryDirectory() as folder:
        os.environ["CALIB_CACHE"] = folder
        first, cold, _ = ours("compiled", BLOCK)
        _, warm, _ = ours("compiled", BLOCK)
    lines.append(f"Cold start of the compiled back end (writing out, compiling, {BLOCK} trials): {cold:.2f} s, "
                 f"again in the same process {warm:.2f} s.")
    difference = np.abs(peer(model, readings, "lm", True) - first.samples[:PEER]) / first.linear_u
    if difference.max() > 1e-4:
        raise SystemExit(f"scipy and calib differ by {difference.max():.1e} u")
    lines.append(f"Largest difference of an angle between scipy (lm) and calib in {PEER} trials: "
                 f"{difference.max():.1e} u.")

    ways = {
        "compiled": (20 * BLOCK, lambda: ours("compiled", 20 * BLOCK)[1]),
        "NumPy": (4 * BLOCK, lambda: ours("numpy", 4 * BLOCK)[1]),
        "scipy least_squares, lm, exact Jacobian": (PEER, lambda: timed(lambda: peer(model, readings, "lm", True))[1]),
        "scipy least_squares, trf, exact Jacobian":
            (PEER, lambda: timed(lambda: peer(model, readings, "trf", True))[1]),
        "scipy least_squares, lm, 2-point": (50, lambda: timed(lambda: peer(model, readings[:50], "lm", False))[1]),
    }
    rounds = [{name: call() / count * 1e6 for name, (count, call) in ways.items()} for _ in range(ROUNDS)]
    each = {name: statistics.median(r[name] for r in rounds) for name in ways}
    table = [f"| {name} | {us:.1f} | {us / each['compiled']:.0f} | {us / each['NumPy']:.1f} |"
             for name, us in each.items()]
    whole = {name: ours(name, trials) for name in ("compiled", "numpy")}
    for name, (found, processor, wall) in whole.items():
        lines.append(f"{trials} trials at once, {name}: {processor:.2f} s CPU, {wall:.2f} s on the clock, "
                     f"{found.failures} failures, standard deviations within "
                     f"{np.abs(found.u / found.linear_u - 1).max():.1e} of the linear ones.")
    _, sampling, _ = timed(lambda: [streams(SEED, k)[0].standard_normal((BLOCK, 39)) for k in range(20)])
    lines.append(f"Of the compiled time, drawing 39 normal numbers takes {sampling / 20 / BLOCK * 1e6:.2f} us a trial.")
    reached = whole["compiled"][1] / trials * 1e6
    lines += [f"{name}: {us / reached:.0f} times the CPU time a trial of the {trials} compiled ones."
              for name, us in each.items() if "scipy" in name]
    text = (f"# Monte Carlo of the space circle, us a trial\n\nThirteen points with 3x3 covariances, 19 unknowns, "
            f"sampling included; one thread, CPU time, medians of {ROUNDS} interleaved rounds in one run; "
            f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}, "
            f"SciPy {scipy.__version__}.\n\n"
            "| way | us a trial | times compiled | times NumPy |\n| --- | --- | --- | --- |\n" + "\n".join(table)
            + "\n\n" + "\n".join(f"- {line}" for line in lines) + "\n")
    print(text)
    RESULTS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
