"""`calib solve`: the estimate of a job with uncertainty, reliability, budget and certificate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from calib import catalogue, files
from calib.cli.output import DONE, FAILED, Output, job_options, output_options, sources, typed
from calib.errors import InputError
from calib.job import Job
from calib.report import numbers
from calib.solve.downweight import RobustLoss, Truncated
from calib.solve.gauss_newton import GaussNewton
from calib.solve.loss import L1, Huber
from calib.solve.method import Method
from calib.workflow.solution import Solution, solved

LISTED = 40       # results in the text; the files hold all
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


def loss_of(name: str | None, limit: float | None, method: str) -> RobustLoss | None:
    """The robust loss of a name of the command line; None for least squares.

    raises InputError where the options do not go together.
    """
    if name is None:
        if limit is not None:
            raise InputError("--limit belongs to --robust huber or truncated; name one of them")
        return None
    if method != METHODS[0]:
        raise InputError(f"--robust reweights steps of {METHODS[0]}; leave --method out")
    if name == "l1":
        if limit is not None:
            raise InputError("--limit: L1 has none; leave it out")
        return L1()
    kind = Huber if name == "huber" else Truncated
    return kind() if limit is None else kind(limit)


method_option = click.option("--method", type=click.Choice(METHODS), default=METHODS[0], show_default=True)


@click.command()
@job_options
@method_option
@click.option("--robust", "robust_loss", type=click.Choice(("huber", "l1", "truncated")), default=None,
              help="A loss that wild readings cannot dominate; truncated leaves them out (graduated non-convexity).")
@click.option("--limit", type=click.FloatRange(0.1), default=None,
              help="Of --robust huber or truncated, in units of u (1.345 and 3.29 if not given).")
@click.option("--against", type=click.Path(path_type=Path), metavar="FILE",
              help="A result.json or certificate of a second method or an earlier calibration: E_n of every result.")
@click.option("--certificate", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
              help="Write a digital calibration certificate (DCC, XML) with what the job's [certificate] says.")
@output_options
def solve(
    job: Path, data_folder: Path | None, problem_file: Path | None, method: str, robust_loss: str | None,
    limit: float | None, against: Path | None, certificate: Path | None, output: Output
) -> int:
    """Solve JOB (a .toml file, a case folder, or a file that a problem accepts).

    With --out: result.json, observations.csv, budget.csv and report.html.
    """
    from calib.report import budget, comparisons, observations, page, result
    from calib.report.provenance import provenance

    read = Job.read(job, data_folder)
    module = catalogue.module(read.problem, problem_file)
    origin = provenance(sources(read, problem_file), typed())
    with output.progress(f"solving {job.name}", 1) as step:
        solution = solved(read, module, method_of(method), loss_of(robust_loss, limit, method))
        step()
    content = result.content(solution, origin)
    compared, remark = comparisons.beside(solution, origin, against) if against is not None else ((), "")
    if compared:
        content["compatibility"] = {"with": against, "remark": remark, "results": comparisons.content(compared)}
    if certificate is not None:
        from calib.report.certificate.write import write as certify

        certify(solution, origin, certificate)
    written: tuple[Path, ...] = ()
    if output.folder is not None:     # before any text: a reader of a pipe may have gone
        identified = module.identified_files(read, solution.estimate) if hasattr(module, "identified_files") else {}
        written = (
            files.write_json(output.path("result.json"), content),
            observations.write(solution, output.path("observations.csv")),
            budget.write(solution, output.path("budget.csv")),
            page.write(solution, origin, output.path("report.html"), comparisons.grid(compared), remark),
            *(files.write_csv(output.path(f"{name}.csv"), list(lines[0]), [list(line.values()) for line in lines])
              for name, lines in solution.tables.items() if lines),
            *(files.write_text(output.path(name), text) for name, text in identified.items()),
        )
    output.result(content)
    say(output, solution)
    for line in compared:
        output.say(f"E_n of {line.quantity} = {numbers.plain(line.normalised, 3)}: "
                   f"{'compatible' if line.compatible else 'NOT compatible'} with {against}")
    if remark:
        output.prose(remark)
    if written:
        output.say()
        output.wrote(*written)
    if certificate is not None:
        output.say(f"certificate written: {certificate}")
    estimate = solution.estimate
    return DONE if estimate.certificate.passed and estimate.converged else FAILED


def say(output: Output, solution: Solution) -> None:
    """The results for people: values with U (k = 2), agreement, advice, what cannot be known."""
    from calib.report.page import agreement, told, unstated

    estimate = solution.estimate
    if not (estimate.certificate.passed and estimate.converged):
        why = estimate.certificate.why if estimate.converged else estimate.message
        output.prose(f"NOT CERTIFIED: {why}. These numbers show where it stopped; they are no result.")
        output.say()
    output.say(f"{solution.problem.name}: expanded uncertainty U with k = 2\n")
    verdicts = {one.quantity: f"  {one.verdict}" for one in solution.conformities}
    listed = told(solution)
    table = [_row(*displayed) for displayed in listed[:LISTED]]
    widths = [max((len(row[column]) for row in table), default=0) for column in range(4)]
    for name, value, expanded, unit in table:
        line = f"  {name:<{widths[0]}}  {value:>{widths[1]}} ± {expanded:<{widths[2]}}  {unit}"
        output.say(f"{line}{verdicts.get(name, '')}".rstrip())
    if len(listed) > LISTED:
        output.say(f"  and {len(listed) - LISTED} more, in result.json and report.html (--out DIR)")
    output.say()
    if unstated(solution):
        output.prose(unstated(solution))
    output.prose(agreement(solution))
    for exclusion in solution.job.exclude:
        left_out = ", ".join(map(str, exclusion.rows))
        output.prose(f"Left out, table {exclusion.table}, row {left_out}: {exclusion.reason}")
    for gap in solution.heldout:
        before, after = numbers.plain(gap.before), numbers.plain(gap.after)
        output.say(f"Held out, {gap.quantity}: {before} {gap.unit} before, {after} {gap.unit} after")
    limits = (*solution.remarks, *solution.weak)
    for heading, lines in (("To adjust:", solution.advice), ("Cannot be known, or hardly:", limits)):
        if lines:
            output.say(f"\n{heading}")
            for sentence in lines:
                output.prose(sentence, "  - ")


def _row(name: str, value: float, u: float, unit: str) -> tuple[str, str, str, str]:
    return name, *numbers.with_uncertainty(value, 2.0 * u), "" if unit == "1" else unit


def content_of(solution: Solution, **more: Any) -> dict[str, Any]:
    """A small content for commands that solve on the way: method and certificate."""
    estimate = solution.estimate
    return {"method": estimate.method, "converged": estimate.converged,
            "certificate": files.plain(estimate.certificate), **more}
