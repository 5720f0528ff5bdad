"""`calib discover`: where model and readings disagree, which effect is missing, and how far the gap shrinks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from calib import catalogue, files
from calib.cli.output import DONE, Output, job_argument, output_options, problem_file_option, typed
from calib.job import Job
from calib.report import numbers
from calib.workflow.solution import declared

if TYPE_CHECKING:
    from calib.workflow.discrepancy.conclusion import Explanation


@click.command()
@job_argument
@click.option("--level", type=click.FloatRange(1e-6, 0.2), default=0.01, show_default=True,
              help="Probability of a false alarm where nothing is missing.")
@problem_file_option
@output_options
def discover(job: Path, level: float, problem_file: Path | None, output: Output) -> int:
    """Find the physical effect that JOB (a .toml file or a case folder) lacks, or say that none is missing.

    With --out: answer.json and report.html.
    """
    from calib.workflow.discrepancy.answer import answer
    from calib.workflow.discrepancy.explain import explain
    from calib.workflow.discrepancy.shown import Shown
    from calib.workflow.discrepancy.split import held_out_rows

    read = Job.read(job)
    problem = declared(read, catalogue.module(read.problem, problem_file))
    check, remark = held_out_rows(read, problem)
    with output.progress(f"explaining {job.name}", 1) as step:
        found = explain(problem, level, check, remarks=(remark,) if remark else ())
        step()
    shown = Shown(found, level)
    content = answer(_name(read), found, shown)
    output.result(content)
    say(output, found)
    if output.folder is not None:
        from calib.report import discovery
        from calib.report.provenance import provenance

        origin = provenance([*read.files, *([problem_file] if problem_file else [])], typed())
        output.wrote(
            files.write_json(output.path("answer.json"), content),
            discovery.write(_name(read), shown, origin, output.path("report.html")),
        )
    return DONE


def _name(job: Job) -> str:
    return job.settings.text("case") if job.path.name == "case.toml" else job.path.stem


def say(output: Output, found: Explanation) -> None:
    """The finding for people: the sentence, the effects with U (k = 2), what cannot be told apart, what to measure."""
    from calib.workflow.discrepancy.answer import in_case_units

    output.prose(found.sentence)
    for one in found.effects:
        for name, (value, u, unit) in in_case_units(one).items():
            shown, expanded = numbers.with_uncertainty(value, 2.0 * u)
            output.say(f"  {one.name} ({one.channel}): {name} = {shown} ± {expanded} {unit} (k = 2)")
        if one.plausibility:
            output.prose(one.plausibility, "    ")
        if one.aliases:
            listed = ", ".join(f"{name} ({channel})" for name, channel in one.aliases)
            output.prose(f"these readings cannot tell it from {listed}", "    ")
    output.say(f"  rms of residual/u: {found.rms[0]:.3g} before, {found.rms[1]:.3g} after")
    if found.heldout_rms is not None:
        output.say(f"  on held-out rows:  {found.heldout_rms[0]:.3g} before, {found.heldout_rms[1]:.3g} after")
    if found.next_measurement:
        output.prose(f"To measure next: {found.next_measurement}.")
    for remark in found.remarks:
        output.prose(remark)
