"""`calib montecarlo`: propagation of distributions through the whole estimation (JCGM 101)."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np

from calib import catalogue, files, units
from calib.cli.output import DONE, FAILED, Output, job_options, output_options, sources, typed
from calib.cli.place import place_options
from calib.cli.solve import content_of, method_of, method_option
from calib.errors import CalibrationError
from calib.job import Job
from calib.report import numbers
from calib.workflow.montecarlo import Adaptive, MonteCarlo
from calib.workflow.places import Place, Threads
from calib.workflow.propagation import STEPS, departures, propagated, sampled, tolerance, verdict
from calib.workflow.solution import requested, solved

USUAL_DIGITS = 2
LARGEST = 10_000_000
CORRELATED = 100     # results up to which montecarlo.json holds their correlations; samples.npz has all


@click.command()
@job_options
@click.option("--trials", type=click.IntRange(100, 100_000_000), default=None,
              help=f"How many; 20000 if not given. With --digits: at most ({LARGEST} if not given).")
@click.option("--digits", type=click.IntRange(1, 4), default=None,
              help="Go on until every result stands still to so many digits of u (JCGM 101, 7.9).")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True)
@method_option
@place_options
@output_options
def montecarlo(
    job: Path, data_folder: Path | None, problem_file: Path | None, trials: int | None, digits: int | None, seed: int,
    method: str, workers: int | None, scheduler: str | None, output: Output,
) -> int:
    """Solve JOB, then solve it again with readings drawn anew around the estimate, trial after trial.

    With --out: montecarlo.json, samples.npz and report.html.
    """
    from calib.report import montecarlo as report
    from calib.report.provenance import provenance

    read = Job.read(job, data_folder)
    number = Adaptive(digits, largest=trials or LARGEST) if digits else trials or 20_000
    what = f"at most {trials or LARGEST} trials" if digits else f"{number} trials"
    with _place(read, problem_file, workers, scheduler) as place:
        solution = solved(read, catalogue.module(read.problem, problem_file), method_of(method))
        results = requested(solution.problem, read.quantities, read.report.where("quantities"))
        with output.progress(what, STEPS) as step:
            found = propagated(solution.estimate, number, seed, sampled(solution.problem, results), step, place)
    if not len(found.samples):
        raise CalibrationError(f"{solution.problem.name}: no trial converged; the readings hardly hold the unknowns, "
                               "or the estimate is no minimum")
    rows = quantities(found, digits or USUAL_DIGITS)
    origin = provenance(sources(read, problem_file), typed(), seed)
    content = {
        "format": 1, "problem": read.problem, "job": read.path.name, "trials": len(found.samples) + found.failures,
        "failures": found.failures, "failed_trials": list(found.failed), "seed": seed, **content_of(solution),
        "quantities": rows,
        "correlation": {"names": found.names, "matrix": found.correlation} if len(rows) <= CORRELATED else None,
        "stability": None if found.stability is None else {"digits": digits, "reached": found.stability.reached},
        "provenance": origin.content(),
    }
    written: tuple[Path, ...] = ()
    if output.folder is not None:     # before any text: a reader of a pipe may have gone
        packed = io.BytesIO()
        scale = [units.factor(unit) for unit in found.units]
        names, its_units = np.array(found.names), np.array(found.units)
        np.savez_compressed(packed, samples=found.samples / scale, names=names, units=its_units)
        written = (
            files.write_json(output.path("montecarlo.json"), content),
            files.write_bytes(output.path("samples.npz"), packed.getvalue()),
            report.write(solution, found, rows, origin, output.path("report.html")),
        )
    output.result(content)
    output.say(f"{solution.problem.name}: {content['trials']} trials, seed {seed}, {found.failures} did not converge; "
               "shortest 95% intervals\n")
    width = max(len(str(row["name"])) for row in rows)
    for row in rows:
        mean, u = numbers.with_uncertainty(row["mean"], row["u"])
        low, high = (numbers.with_uncertainty(end, row["u"])[0] for end in row["interval_shortest"])
        spread = f"u = {u}, [{low}, {high}] {row['unit']}; linear result: {row['verdict']}" if u else \
            f"{row['unit']}, the same in all trials"
        output.say(f"  {row['name']:<{width}}  {mean}{',' if u else ''} {spread}")
    if found.failed:
        output.say()
        named = ", ".join(map(str, found.failed)) + (" ..." if found.failures > len(found.failed) else "")
        output.prose(f"Trials that did not converge and are not among the samples: {named}.")
    if found.stability is not None and not found.stability.reached:
        output.say()
        output.prose(f"{content['trials']} trials are not enough for {digits} digit(s) of every u; allow more with "
                     "--trials, or ask for fewer.")
    if written:
        output.say()
        output.wrote(*written)
    passed = solution.estimate.certificate.passed and solution.estimate.converged and found.failures == 0
    return DONE if passed else FAILED


@contextmanager
def _place(job: Job, problem_file: Path | None, workers: int | None, scheduler: str | None) -> Iterator[Place]:
    """Who makes the trials: the threads of this program, or the workers of a scheduler."""
    if scheduler is None:
        yield Threads(workers)
        return
    from calib.workflow.distributed import Distributed, connected
    from calib.workflow.parcel import packed

    parcel, contents = packed(job, problem_file)
    with connected(scheduler) as there:
        yield Distributed(there, parcel, contents)


def quantities(found: MonteCarlo, digits: int = USUAL_DIGITS) -> list[dict[str, Any]]:
    """The entries of montecarlo.json, in display units.

    found: the samples; digits: of u to which the linear result is judged.
    return: one entry a result: d_low, d_high and tolerance as in JCGM 101, 8.1; after an adaptive run also how far
    mean, u and both ends of the interval still move.
    """
    shortest, symmetric = found.interval_shortest(), found.interval_symmetric()
    entries = []
    for i, (name, unit) in enumerate(zip(found.names, found.units)):
        scale = units.factor(unit)
        low, high = departures(found.linear[i], found.linear_u[i], symmetric[i])
        entries.append({
            "name": name, "unit": unit, "mean": found.mean[i] / scale, "u": found.u[i] / scale,
            "interval_shortest": list(shortest[i] / scale), "interval_symmetric": list(symmetric[i] / scale),
            "trials": len(found.samples), "linear": found.linear[i] / scale, "linear_u": found.linear_u[i] / scale,
            "d_low": low / scale, "d_high": high / scale,
            "tolerance": tolerance(found.linear_u[i], digits) / scale, "digits": digits,
            "verdict": verdict(found.linear[i], found.linear_u[i], symmetric[i], len(found.samples), digits),
            **({} if found.stability is None else {"moves": list(found.stability.spread[i] / scale)}),
        })
    return entries
