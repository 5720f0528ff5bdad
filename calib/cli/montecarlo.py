"""`calib montecarlo`: propagation of distributions through the whole estimation (JCGM 101)."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import click
import numpy as np

from calib import catalogue, files, units
from calib.cli.output import DONE, FAILED, Output, job_options, output_options, typed
from calib.cli.solve import content_of, method_of, method_option
from calib.job import Job
from calib.report import numbers
from calib.workflow.montecarlo import MonteCarlo
from calib.workflow.propagation import CHUNK, propagated, sampled, verdict
from calib.workflow.solution import requested, solved


@click.command()
@job_options
@click.option("--trials", type=click.IntRange(100, 100_000_000), default=20_000, show_default=True)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True)
@method_option
@output_options
def montecarlo(
    job: Path, data_folder: Path | None, problem_file: Path | None, trials: int, seed: int, method: str, output: Output
) -> int:
    """Solve JOB, then solve it again with readings drawn anew around the estimate, trial after trial.

    With --out: montecarlo.json, samples.npz and report.html.
    """
    from calib.report import montecarlo as report
    from calib.report.provenance import provenance

    read = Job.read(job, data_folder)
    solution = solved(read, catalogue.module(read.problem, problem_file), method_of(method))
    wanted = sampled(solution.problem, requested(solution.problem, read.quantities, read.report.where("quantities")))
    with output.progress(f"{trials} trials", -(-trials // CHUNK)) as step:
        found = propagated(solution.estimate, trials, seed, wanted, step)
    rows = quantities(found)
    origin = provenance([*read.files, *([problem_file] if problem_file else [])], typed(), seed)
    content = {
        "format": 1, "problem": read.problem, "job": read.path.name, "trials": trials, "failures": found.failures,
        "seed": seed, **content_of(solution), "quantities": rows, "provenance": origin.content(),
    }
    output.result(content)
    output.say(f"{solution.problem.name}: {trials} trials, seed {seed}, {found.failures} did not converge; shortest "
               "95% intervals\n")
    width = max(len(str(row["name"])) for row in rows)
    for row in rows:
        mean, u = numbers.with_uncertainty(row["mean"], row["u"])
        low, high = (numbers.with_uncertainty(end, row["u"])[0] for end in row["interval_shortest"])
        output.say(f"  {row['name']:<{width}}  {mean}, u = {u}, [{low}, {high}] {row['unit']}; linear result: "
                   f"{row['verdict']}")
    if output.folder is not None:
        packed = io.BytesIO()
        scale = [units.factor(unit) for unit in found.units]
        names, its_units = np.array(found.names), np.array(found.units)
        np.savez_compressed(packed, samples=found.samples / scale, names=names, units=its_units)
        output.say()
        output.wrote(
            files.write_json(output.path("montecarlo.json"), content),
            files.write_bytes(output.path("samples.npz"), packed.getvalue()),
            report.write(solution, found, rows, origin, output.path("report.html")),
        )
    passed = solution.estimate.certificate.passed and solution.estimate.converged and found.failures == 0
    return DONE if passed else FAILED


def quantities(found: MonteCarlo) -> list[dict[str, Any]]:
    """The entries of montecarlo.json, in display units.

    found: the samples.
    return: one entry a result.
    """
    shortest, symmetric = found.interval_shortest(), found.interval_symmetric()
    entries = []
    for i, (name, unit) in enumerate(zip(found.names, found.units)):
        scale = units.factor(unit)
        entries.append({
            "name": name, "unit": unit, "mean": found.mean[i] / scale, "u": found.u[i] / scale,
            "interval_shortest": list(shortest[i] / scale), "interval_symmetric": list(symmetric[i] / scale),
            "trials": len(found.samples), "linear": found.linear[i] / scale, "linear_u": found.linear_u[i] / scale,
            "verdict": verdict(found.linear[i], found.linear_u[i], symmetric[i], len(found.samples)),
        })
    return entries
