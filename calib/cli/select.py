"""`calib select`: which observations of a job to keep, with the gap to a bound that no choice can beat."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import numpy as np

from calib import catalogue, files
from calib.analyse.selection.method import BranchAndBound, Conic, Exchange, Exhaustive, Greedy, Method, Relaxation
from calib.analyse.selection.planning import Step, along, next_best, separates_most
from calib.analyse.selection.select import Choice, select
from calib.cli import choices
from calib.cli.output import DONE, Output, job_argument, output_options, problem_file_option, sources, typed
from calib.errors import InputError
from calib.job import Job
from calib.linearisation import Linearisation, linearise
from calib.problem import Problem
from calib.solve.estimate import solve
from calib.workflow.solution import declared, requested

METHODS: dict[str, Method] = {"exhaustive": Exhaustive(), "greedy": Greedy(), "exchange": Exchange(),
                              "relaxation": Relaxation(), "conic": Conic(), "branch-and-bound": BranchAndBound()}
LISTED = 30       # quantities in the text
TRIED = 12        # numbers kept that the report compares
PATIENCE = 20.0   # seconds for them
BEST = 15         # further measurements in the text


@click.command(name="select")
@job_argument
@click.option("--keep", type=click.IntRange(1), metavar="K", help="Number of candidates to keep.")
@click.option("--criterion", type=click.Choice(tuple(choices.CRITERIA), case_sensitive=False), default="D",
              show_default=True)
@click.option("--quantity", "quantities", multiple=True, metavar="NAME",
              help="What A, E, G, I, c, Ds are about; may be given again.")
@click.option("--by", multiple=True, metavar="COVARIATE",
              help="What makes a candidate: a covariate, 'row' or 'group'; a row of a group if none.")
@click.option("--always", multiple=True, metavar="GROUP[=ROWS]",
              help="Readings that are kept in any case: a group, or rows of it as in tracker=1-20,25.")
@click.option("--budget", type=click.FloatRange(0.0, min_open=True), metavar="B", help="Of all costs, with --cost.")
@click.option("--cost", metavar="COVARIATE", help="Column with the cost of each row; 1 a candidate if none.")
@click.option("--at-most", "at_most", multiple=True, metavar="COVARIATE=K", help="At most K of each value.")
@click.option("--exclusive", multiple=True, metavar="LABEL|LABEL|...", help="Candidates of which at most one is kept.")
@click.option("--redundancy", type=click.FloatRange(0.0, 1.0, max_open=True), default=0.0, metavar="R",
              help="Least redundancy number of every kept reading.")
@click.option("--mdb", multiple=True, metavar="GROUP=VALUE",
              help="Largest minimal detectable bias, as in \"tracker=5 um\".")
@click.option("--influence", multiple=True, metavar="NAME=VALUE",
              help="Largest change of a quantity by a bias that just stays hidden.")
@click.option("--worst-case", "others", multiple=True, metavar="JOB", type=click.Path(path_type=Path),
              help="A further configuration with the same candidates; the worst counts. May be given again.")
@click.option("--next", "further", is_flag=True,
              help="Instead of a choice: which single candidate helps most beside what --always names.")
@click.option("--separate", nargs=2, metavar="EFFECT EFFECT",
              help="With --next: which candidate tells these two effects apart best.")
@click.option("--method", type=click.Choice(tuple(METHODS)), help="Default: exhaustive where there are few subsets, "
              "else exchange.")
@problem_file_option
@output_options
def choose(job: Path, keep: int | None, criterion: str, quantities: tuple[str, ...], by: tuple[str, ...],
           always: tuple[str, ...], budget: float | None, cost: str | None, at_most: tuple[str, ...],
           exclusive: tuple[str, ...], redundancy: float, mdb: tuple[str, ...], influence: tuple[str, ...],
           others: tuple[Path, ...], further: bool, separate: tuple[str, str] | None, method: str | None,
           problem_file: Path | None, output: Output) -> int:
    """Choose the best K candidate observations of JOB, with readings or without.

    With --out: selection.json and report.html.
    """
    from calib.report import selection
    from calib.report.provenance import provenance

    read = Job.read(job)
    module = catalogue.module(read.problem, problem_file)
    problem = declared(read, module)
    fit = _fit(problem, separate or ())
    reported = requested(problem, read.quantities, read.report.where("quantities"))
    files_read = sources(read, problem_file)
    if further or separate:
        _only_with_next(keep, budget, at_most, exclusive, others, redundancy, mdb, influence)
        chosen = None if separate else choices.criterion_of(criterion, quantities, reported, ())
        return _next(fit, read, chosen, separate, always, by, selection, provenance(files_read, typed()), output)
    if keep is None and budget is None:
        raise InputError("--keep: say how many candidates to keep, or give --budget and --cost")
    fits = [_fit(_other(path, read, module), ()) for path in others]
    criterion_asked = choices.criterion_of(criterion, quantities, reported, fits)
    grouping, fixed = choices.grouping_of(fit, by), choices.rows_of(fit, always, "--always")
    with output.progress(f"choosing from {job.name}", 2) as step:
        choice = select(
            fit, keep, criterion_asked, by=grouping, always=fixed, costs=choices.costs_of(fit, cost, grouping),
            budget=budget, at_most=choices.at_most_of(at_most),
            exclusive=[[label.strip() for label in text.split("|")] for text in exclusive],
            floors=choices.floors_of(fit, redundancy, mdb, influence), method=METHODS[method] if method else None,
            report=quantities or reported)
        step()
        steps = _steps(fit, choice, criterion_asked, grouping, fixed) if output.folder is not None else ()
        step()
    origin = provenance(files_read, typed())
    content = selection.content(read.problem, read.path.name, choice, origin)
    output.result(content)
    say(output, choice, selection.sentence(choice))
    if output.folder is not None:
        output.say()
        output.wrote(files.write_json(output.path("selection.json"), content),
                     selection.write(problem.name, fit, choice, steps, origin, output.path("report.html"),
                                     choices.places_of(read, fit)))
    return DONE


def _fit(problem: Problem, effects: Sequence[str]) -> Linearisation:
    """At the estimate where everything was read, at the start values of a plan; with some effects free beside it."""
    planned = any(o.readings is None for o in problem.observations)
    free = problem.free(*effects) if effects else problem
    if planned:
        return linearise(free)
    estimate = solve(problem)
    return linearise(free, {u: estimate[u] for u in problem.unknowns}) if effects else linearise(estimate)


def _other(path: Path, read: Job, module: ModuleType) -> Problem:
    other = Job.read(path)
    if other.problem != read.problem:
        raise InputError(f"--worst-case: {path} is a job of {other.problem}, where this one is of {read.problem}; name "
                         "a job of the same problem")
    return declared(other, module)


def _only_with_next(*given: Any) -> None:
    names = ("--keep", "--budget", "--at-most", "--exclusive", "--worst-case", "--redundancy", "--mdb", "--influence")
    for name, value in zip(names, given, strict=True):
        if value:
            raise InputError(f"{name} is for a choice of several; with --next leave it out")


def _next(fit: Linearisation, read: Job, criterion: Any, separate: tuple[str, str] | None, always: Sequence[str],
          by: Sequence[str], selection: Any, origin: Any, output: Output) -> int:
    """The ranking of single further measurements."""
    made = choices.rows_of(fit, always, "--always")
    if not made:
        raise InputError("--next: say what is there already, with --always GROUP=ROWS; the other rows of the job are "
                         "the candidates")
    grouping = choices.grouping_of(fit, by)
    ranking = separates_most(fit, *separate, made=made, by=grouping) if separate else \
        next_best(fit, criterion, made=made, by=grouping)
    what = "tells " + " and ".join(f"'{e}'" for e in separate) + " apart" if separate else f"criterion {criterion.name}"
    content = selection.ranking(read.problem, read.path.name, what, ranking, origin)
    output.result(content)
    for line in selection.ranked(what, ranking, BEST):
        output.say(line)
    if output.folder is not None:
        output.wrote(files.write_json(output.path("selection.json"), content))
    return DONE


def _steps(fit: Linearisation, choice: Choice, criterion: Any, by: Any, always: Any) -> tuple[Step, ...]:
    n, k = choice.candidates, len(choice.chosen)
    numbers = np.unique(np.append(np.round(np.geomspace(max(1, k / 3), min(n, 3 * k), TRIED)).astype(int), n))
    # The number that was asked for and its neighbours first: where time is short, the far ends are left out.
    order = sorted((int(m) for m in numbers), key=lambda m: abs(np.log(m / k)))
    steps = along(fit, criterion, order, by=by, always=always, patience=PATIENCE)
    return tuple(sorted(steps, key=lambda s: s.keep))


def say(output: Output, choice: Choice, sentence: str) -> None:
    """The choice for people: what, how good, and the u that it promises."""
    from calib import units
    from calib.report import numbers, selection

    output.prose(sentence)
    output.prose(selection.listed(choice), "  ")
    output.say("\nstandard uncertainties with all candidates, and with the chosen ones")
    width = max((len(p.name) for p in choice.promises[:LISTED]), default=0)
    for p in choice.promises[:LISTED]:
        scale = units.factor(p.unit)
        u = numbers.plain(p.u_chosen / scale) if np.isfinite(p.u_chosen) else "not known"
        unit = "" if p.unit == "1" else p.unit
        output.say(f"  {p.name:<{width}}  {numbers.plain(p.u_all / scale):>10}  {u:>10}  {unit}".rstrip())
    if len(choice.promises) > LISTED:
        output.say(f"  and {len(choice.promises) - LISTED} more; all stand in selection.json, with --out")
    for remark in choice.remarks:
        output.prose(remark)


