"""Do the 95 % intervals of the twelve five-axis results hold the truth? Simulated repetitions of the paper's readings.

Three procedures: step by step; jointly with every target's circle shared; jointly with sharing only where the test at
1 % accepts it. Two kinds of readings: scattering as stated, and scattering as much as the paper's tables really do;
each with intervals by the stated u and by the scatter found (u_vc, Student's t with effective degrees of freedom).

Run: python benchmarks/five_axis_coverage.py [repetitions]; writes benchmarks/results/five_axis_coverage.md.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from scipy.special import stdtrit

from calib import Problem, budget, simulate, solve
from calib.uncertainty import Gaussian
from problems.circle_sharing import sharing
from problems.five_axis import joint, results, step_by_step
from problems.five_axis.joint import Sharing
from problems.five_axis.readings import published

RESULTS = Path(__file__).parent / "results" / "five_axis_coverage.md"
# Stated u of tables 1 to 4 in arcseconds, and their scatter over it, as `calib reproduce five-axis` finds it.
ARCSEC = np.pi / 648000
STATED = {"table 1": 0.2 * ARCSEC, "table 2": ARCSEC, "table 3": ARCSEC, "table 4": ARCSEC}
SCATTER = {"as stated": dict.fromkeys(STATED, 1.0),
           "as found": {"table 1": 1.15, "table 2": 1.75, "table 3": 1.71, "table 4": 1.83}}
PLACES = {"step by step": results.STEP, "jointly, all shared": results.JOINT, "jointly, tested": results.JOINT}


def scattering(problem: Problem, factors: dict[str, float]) -> Problem:
    """The problem whose readings scatter by factors of the stated u."""
    return problem.with_uncertainty({g: Gaussian.standard(u * factors[g]) for g, u in STATED.items()})


def names(procedure: str) -> list[str]:
    """Names of the twelve results in a procedure."""
    return [name for key in results.ITEMS for name in PLACES[procedure][key]]


def at(fit: results.Fit, wanted: list[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, u and u_vc of named results."""
    rows = [fit.stated.names.index(name) for name in wanted]
    return fit.stated.values[rows], fit.stated.u[rows], fit.found.u[rows]


def coverage_factors(fit: results.Fit, wanted: list[str]) -> np.ndarray:
    """Student's t for 95 % with effective degrees of freedom (Welch-Satterthwaite, JCGM 100:2008, G.4)."""
    rescaled = fit.scatter.rescaled(fit.linear)
    functions = rescaled.functions(*rescaled.results)
    dof = dict(zip(fit.scatter.names, fit.scatter.dof))
    factors = []
    for name in wanted:
        i = functions.labels.index(name)
        one = type(functions)(functions.labels[i:i + 1], functions.units[i:i + 1], functions.values[i:i + 1],
                              functions.derivatives[i:i + 1])
        found = budget(rescaled, one)
        spread = sum(line.u ** 4 / dof[line.label] for line in found.contributions if line.label in dof)
        factors.append(stdtrit(found.u ** 4 / spread, 0.975) if spread > 0 else 1.96)
    return np.array(factors)


def fitted(procedure: str, problem: Problem) -> tuple[results.Fit, int]:
    """The fit of drawn readings by a procedure, and how many of four targets refused to share."""
    if procedure != "jointly, tested":
        return results.Fit.of(problem), 0
    readings = {o.group: o.readings for o in problem.observations}
    apart = step_by_step.declare(published())
    drawn = results.Fit.of(apart.with_readings({group: readings[group] for group in STATED}))
    accepted = [one.target for one in sharing(drawn.linear, drawn.scatter) if one.accepted]
    return results.Fit.of(joint.declare(published(), Sharing(accepted)).with_readings(readings)), 4 - len(accepted)


def main(repetitions: int) -> None:
    begin = time.perf_counter()
    lines = ["# Coverage of the twelve five-axis results", "",
             f"{repetitions} simulated repetitions of the paper's readings at its own result: share of the 95 % "
             "intervals that hold the truth, and root mean",
             "square of error/u. u: as stated; u_vc: by the scatter found, Student's t. "
             "`python benchmarks/five_axis_coverage.py`", "",
             f"One share of {repetitions} has a standard error of {np.sqrt(0.95 * 0.05 / repetitions):.3f}.", "",
             "| procedure | readings scatter | interval by | " + " | ".join(results.ITEMS)
             + " | all | rms error/u | refused |",
             "| --- | --- | --- | " + "--- | " * (len(results.ITEMS) + 3)]
    declared = {"step by step": step_by_step.declare(published())}
    together = joint.declare(published(), Sharing("ABCD"))
    declared |= dict.fromkeys(("jointly, all shared", "jointly, tested"), together)
    for scatter, factors in SCATTER.items():
        for procedure, problem in declared.items():
            truth, wanted = solve(problem), names(procedure)
            true = at(results.Fit.of(problem), wanted)[0]
            source, refused, errors, errors_vc, inside_vc = scattering(problem, factors), 0, [], [], []
            for seed in range(1, repetitions + 1):
                drawn = simulate(source, truth, seed)
                fit, not_shared = fitted(procedure, scattering(drawn, SCATTER["as stated"]))
                values, u, u_vc = at(fit, wanted)
                refused += not_shared
                errors.append((values - true) / u)
                errors_vc.append((values - true) / u_vc)
                inside_vc.append(np.abs(errors_vc[-1]) <= coverage_factors(fit, wanted))
            for kind, found, inside in (("u", np.array(errors), np.abs(np.array(errors)) <= 1.959964),
                                        ("u_vc", np.array(errors_vc), np.array(inside_vc))):
                covered = inside.mean(axis=0)
                tested = f"{refused} of {4 * repetitions}" if procedure == "jointly, tested" else ""
                lines.append(f"| {procedure} | {scatter} | {kind} | " + " | ".join(f"{c:.3f}" for c in covered)
                             + f" | {covered.mean():.4f} | {np.sqrt(np.mean(found ** 2)):.3f} | {tested} |")
                print(lines[-1], flush=True)
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"{time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500)
