"""`calib select`: which observations of a job to keep, with the gap to a bound that no choice can beat."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from calib import catalogue, files
from calib.analyse.selection import criterion as criteria
from calib.analyse.selection.floors import Floors
from calib.analyse.selection.method import BranchAndBound, Exchange, Exhaustive, Greedy, Method, Relaxation
from calib.analyse.selection.planning import Step, along
from calib.analyse.selection.select import Choice, select
from calib.cli.output import DONE, Output, job_argument, output_options, problem_file_option, typed
from calib.job import Job
from calib.linearisation import Linearisation, linearise
from calib.problem import Problem
from calib.solve.estimate import solve
from calib.workflow.knowledge import named
from calib.workflow.solution import declared, requested

CRITERIA = {"D": criteria.D, "A": criteria.A, "E": criteria.E, "G": criteria.G, "I": criteria.I, "c": criteria.C,
            "Ds": criteria.Ds}
METHODS: dict[str, Method] = {"exhaustive": Exhaustive(), "greedy": Greedy(), "exchange": Exchange(),
                              "relaxation": Relaxation(), "branch-and-bound": BranchAndBound()}
LISTED = 30       # labels and quantities in the text
TRIED = 12        # numbers kept that the report compares


@click.command(name="select")
@job_argument
@click.option("--keep", type=click.IntRange(1), required=True, metavar="K", help="Number of candidates to keep.")
@click.option("--criterion", type=click.Choice(tuple(CRITERIA), case_sensitive=False), default="D", show_default=True)
@click.option("--quantity", "quantities", multiple=True, metavar="NAME",
              help="What A, E, G, I, c, Ds are about; may be given again.")
@click.option("--by", multiple=True, metavar="COVARIATE",
              help="What makes a candidate: a covariate, 'row' or 'group'; a row of a group if none.")
@click.option("--always", multiple=True, metavar="GROUP", help="Group that is kept in any case.")
@click.option("--at-most", "at_most", multiple=True, metavar="COVARIATE=K", help="At most K of each value.")
@click.option("--redundancy", type=click.FloatRange(0.0, 1.0, max_open=True), default=0.0, metavar="R",
              help="Least redundancy number of every kept reading.")
@click.option("--method", type=click.Choice(tuple(METHODS)), help="Default: exhaustive where there are few subsets, "
              "else exchange.")
@problem_file_option
@output_options
def choose(job: Path, keep: int, criterion: str, quantities: tuple[str, ...], by: tuple[str, ...],
           always: tuple[str, ...], at_most: tuple[str, ...], redundancy: float, method: str | None,
           problem_file: Path | None, output: Output) -> int:
    """Choose the best K candidate observations of JOB, with readings or without.

    With --out: selection.json and report.html.
    """
    from calib.report import selection
    from calib.report.provenance import provenance

    read = Job.read(job)
    problem = declared(read, catalogue.module(read.problem, problem_file))
    fit = _fit(problem)
    wanted = [named(problem, name, "--quantity") for name in quantities]
    reported = wanted or requested(problem, read.quantities, read.report.where("quantities"))
    chosen_criterion = _criterion(criterion, wanted, reported)
    grouping: Any = None if not by else by[0] if len(by) == 1 else by
    with output.progress(f"choosing from {job.name}", 2) as step:
        choice = select(fit, keep, chosen_criterion, by=grouping, always=always, at_most=_at_most(at_most),
                        floors=Floors(redundancy) if redundancy else None, method=METHODS[method] if method else None,
                        report=reported)
        step()
        steps = _steps(fit, choice, chosen_criterion, grouping, always) if output.folder is not None else ()
        step()
    origin = provenance([*read.files, *([problem_file] if problem_file else [])], typed())
    content = selection.content(read.problem, read.path.name, choice, origin)
    output.result(content)
    say(output, choice, selection.sentence(choice))
    if output.folder is not None:
        output.say()
        output.wrote(files.write_json(output.path("selection.json"), content),
                     selection.write(problem.name, fit, choice, steps, origin, output.path("report.html")))
    return DONE


def _fit(problem: Problem) -> Linearisation:
    """At the estimate where everything was read, at the start values of a plan."""
    planned = any(o.readings is None for o in problem.observations)
    return linearise(problem) if planned else linearise(solve(problem))


def _criterion(name: str, wanted: list[Any], reported: list[Any]) -> Any:
    if name == "D":
        return criteria.D()
    if name in ("G", "I"):
        return CRITERIA[name](*wanted)
    return CRITERIA[name](*(wanted or reported))


def _at_most(texts: tuple[str, ...]) -> dict[str, int]:
    limits = {}
    for text in texts:
        name, _, count = text.partition("=")
        if not name or not count.isdigit():
            raise click.BadParameter(f"'{text}': write COVARIATE=K, such as target=2", param_hint="--at-most")
        limits[name] = int(count)
    return limits


def _steps(fit: Linearisation, choice: Choice, criterion: Any, by: Any, always: tuple[str, ...]) -> tuple[Step, ...]:
    n, k = choice.candidates, len(choice.chosen)
    numbers = np.unique(np.append(np.round(np.geomspace(max(1, k / 3), min(n, 3 * k), TRIED)).astype(int), n))
    least = int(np.ceil(np.linalg.matrix_rank(fit.factor.matrix) / max(1, fit.factor.size)))
    return along(fit, criterion, [int(m) for m in numbers if m >= least], by=by, always=always)


def say(output: Output, choice: Choice, sentence: str) -> None:
    """The choice for people: what, how good, and the u that it promises."""
    from calib import units
    from calib.report import numbers

    output.prose(sentence)
    more = f" and {len(choice.labels) - LISTED} more" if len(choice.labels) > LISTED else ""
    output.prose("; ".join(choice.labels[:LISTED]) + more, "  ")
    output.say("\nstandard uncertainties with all candidates, and with the chosen ones")
    width = max((len(p.name) for p in choice.promises[:LISTED]), default=0)
    for p in choice.promises[:LISTED]:
        scale = units.factor(p.unit)
        u = numbers.plain(p.u_chosen / scale) if np.isfinite(p.u_chosen) else "not known"
        unit = "" if p.unit == "1" else p.unit
        output.say(f"  {p.name:<{width}}  {numbers.plain(p.u_all / scale):>10}  {u:>10}  {unit}".rstrip())
    for remark in choice.remarks:
        output.prose(remark)
