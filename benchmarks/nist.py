"""NIST StRD nonlinear regression, all 27 problems from both starts: log relative errors beside scipy's least_squares.

The log relative error is the number of digits that agree with the certified ones, at most their eleven, and the mean of
it over the parameters and over their standard errors. Usage: CALIB_REFERENCE_DATA=FOLDER python benchmarks/nist.py
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from test_nist import LIMITED, MODELS, declared, digits, in_order, read

from calib import Estimate, covariance, linearise, solve
from calib.errors import CalibrationError
from calib.solve.estimate import start_values
from calib.system import System


def ours(name: str, start: int) -> tuple[float, float, float, Estimate]:
    """Mean digits of the parameters and of their standard errors; CPU time [s]; the estimate."""
    b, problem = declared(name, start)
    certified, errors = read(name)[2:4]
    begin = time.process_time()
    estimate = solve(problem)
    spent = time.process_time() - begin
    order = in_order(name, estimate[b])
    u = covariance(linearise(estimate), b).u * np.sqrt(estimate.variance_factor)
    return float(digits(estimate[b][order], certified).mean()), float(digits(u[order], errors).mean()), spent, estimate


def carried(estimate: Estimate, u: np.ndarray, found: np.ndarray) -> float:
    """Mean digits of the parameters that rounding of readings, predictions and parameters leaves."""
    system = System(estimate.problem)
    rounding = system.rounding(estimate.values, [g.weighting for g in estimate.fit.groups])
    return float(np.clip(-np.log10(rounding * u / np.abs(found)), 0.0, 11.0).mean())


def scipys(name: str, start: int) -> float:
    """Mean digits of the parameters by scipy's Levenberg-Marquardt with our Jacobian, tolerances at their least."""
    from scipy.optimize import least_squares

    b, problem = declared(name, start)
    system = System(problem)
    values = start_values(system, None)
    weightings, begin = system.weightings(values), values[b].ravel()

    def at(x: np.ndarray) -> dict:
        return {b: x[None]}

    try:
        with np.errstate(all="ignore"):
            found = least_squares(
                lambda x: system.whitened(at(x), weightings), begin, method="lm", x_scale="jac",
                jac=lambda x: -np.concatenate([k.dense(system.layout.position, len(x))
                                               for k in system.blocks(at(x), weightings)]),
                xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=5000)
    except (ValueError, ArithmeticError, CalibrationError):  # where the model breaks down
        return 0.0
    return float(np.maximum(digits(found.x[in_order(name, found.x)], read(name)[2]), 0.0).mean())


def main() -> None:
    """Write the table to standard output."""
    print("| problem | start | digits of parameters | of standard errors | doubles carry | certificate | iterations | "
          "CPU [s] | scipy lm |\n| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    rows = []
    for name in MODELS:
        for start in (1, 2):
            parameters, errors, spent, estimate = ours(name, start)
            peer = scipys(name, start)
            rows.append((parameters, errors, peer))
            b = estimate.problem.unknowns[0]
            doubles = carried(estimate, covariance(linearise(estimate), b).u, estimate[b])
            limited = " (limited by double arithmetic)" if name in LIMITED or doubles < 10.0 else ""
            print(f"| {name}{limited} | {start} | {parameters:.2f} | {errors:.2f} | {doubles:.1f} | "
                  f"{'passed' if estimate.certificate.passed else estimate.certificate.why} | {estimate.iterations} | "
                  f"{spent:.3f} | {peer:.2f} |", flush=True)
    mean = np.mean(rows, axis=0)
    print(f"\nmean of {len(rows)}: parameters {mean[0]:.2f}, standard errors {mean[1]:.2f}; scipy lm {mean[2]:.2f}")


if __name__ == "__main__":
    main()
