"""`calib solve`: the estimate of a job with uncertainty, reliability, budget and certificate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from calib import catalogue, files
from calib.cli.output import DONE, FAILED, Output, job_argument, output_options, problem_file_option, typed
from calib.job import Job
from calib.report import numbers
from calib.solve.gauss_newton import GaussNewton
from calib.solve.method import Method
from calib.workflow.solution import Solution, solved

METHODS = ("gauss-newton", "ipopt", "convex")


def method_of(name: str) -> Method:
    """The method of a name of the command line, imported only when it is wanted."""
    if name == "ipopt":
        from calib.solve.ipopt import Ipopt

        return Ipopt()
    if name == "convex":
        from calib.solve.convex import Convex

        return Convex()
    return GaussNewton()


method_option = click.option("--method", type=click.Choice(METHODS), default=METHODS[0], show_default=True)


@click.command()
@job_argument
@method_option
@problem_file_option
@output_options
def solve(job: Path, method: str, problem_file: Path | None, output: Output) -> int:
    """Solve JOB (a .toml file, a case folder, or a file that a problem accepts).

    With --out: result.json, observations.csv and report.html.
    """
    from calib.report import observations, page, result
    from calib.report.provenance import provenance

    read = Job.read(job)
    module = catalogue.module(read.problem, problem_file)
    with output.progress(f"solving {job.name}", 1) as step:
        solution = solved(read, module, method_of(method))
        step()
    origin = provenance([*read.files, *([problem_file] if problem_file else [])], typed())
    content = result.content(solution, origin)
    output.result(content)
    say(output, solution)
    if output.folder is not None:
        output.wrote(
            files.write_json(output.path("result.json"), content),
            observations.write(solution, output.path("observations.csv")),
            page.write(solution, origin, output.path("report.html")),
        )
    estimate = solution.estimate
    return DONE if estimate.certificate.passed and estimate.converged else FAILED


def say(output: Output, solution: Solution) -> None:
    """The results for people: values with U (k = 2), agreement, advice, what cannot be known."""
    from calib.report.page import agreement

    estimate = solution.estimate
    if not (estimate.certificate.passed and estimate.converged):
        why = estimate.certificate.why if estimate.converged else estimate.message
        output.prose(f"NOT CERTIFIED: {why}. These numbers show where it stopped; they are no result.")
        output.say()
    output.say(f"{solution.problem.name}: expanded uncertainty U with k = 2\n")
    rows = [_row(*displayed) for displayed in solution.results.displayed]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    for row, name in zip(rows, solution.results.names):
        judged = [one.verdict for one in solution.conformities if one.quantity == name]
        line = (f"  {row[0]:<{widths[0]}}  {row[1]:>{widths[1]}} ± {row[2]:<{widths[2]}}  {row[3]}"
                f"{''.join(f'  {verdict}' for verdict in judged)}")
        output.say(line.rstrip())
    output.say()
    output.prose(agreement(solution))
    for exclusion in solution.job.exclude:
        rows = ", ".join(map(str, exclusion.rows))
        output.prose(f"Left out, table {exclusion.table}, row {rows}: {exclusion.reason}")
    limits = (*solution.remarks, *solution.weak)
    for heading, lines in (("To adjust:", solution.advice), ("Cannot be known, or hardly:", limits)):
        if lines:
            output.say(f"\n{heading}")
            for sentence in lines:
                output.prose(sentence, "  - ")


def _row(name: str, value: float, u: float, unit: str) -> tuple[str, str, str, str]:
    shown, expanded = numbers.with_uncertainty(value, 2.0 * u)
    return name, shown, expanded or "0 (fixed)", "" if unit == "1" else unit


def content_of(solution: Solution, **more: Any) -> dict[str, Any]:
    """A small content for commands that solve on the way: method and certificate."""
    estimate = solution.estimate
    return {"method": estimate.method, "converged": estimate.converged,
            "certificate": files.plain(estimate.certificate), **more}
