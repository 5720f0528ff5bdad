"""`calib discover`: where model and readings disagree, which effect is missing, and how far the gap shrinks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import click

from calib import catalogue, files
from calib.cli.output import DONE, Output, job_options, output_options, sources, typed
from calib.job import Job
from calib.problem import Problem
from calib.report import numbers
from calib.workflow.solution import declared

if TYPE_CHECKING:
    from calib.workflow.discrepancy.conclusion import Explanation
    from calib.workflow.discrepancy.empirical import Empirical


@click.command()
@job_options
@click.option("--level", type=click.FloatRange(1e-6, 0.2), default=0.01, show_default=True,
              help="Probability of a false alarm where nothing is missing.")
@click.option("--grow", "growing", is_flag=True,
              help="First add effects as long as blocks of rows left out are predicted better: for a real machine, "
                   "from its nominal state.")
@click.option("--keep-structure", is_flag=True,
              help="Fit structure that no effect explains as an empirical term, and say what is left.")
@output_options
def discover(
    job: Path, data_folder: Path | None, problem_file: Path | None, level: float, growing: bool, keep_structure: bool,
    output: Output,
) -> int:
    """Find the physical effect that JOB (a .toml file or a case folder) lacks, or say that none is missing.

    With --out: answer.json and report.html.
    """
    from calib.workflow.discrepancy.answer import answer
    from calib.workflow.discrepancy.empirical import kept
    from calib.workflow.discrepancy.explain import explain
    from calib.workflow.discrepancy.shown import Shown
    from calib.workflow.discrepancy.split import held_out_rows

    read = Job.read(job, data_folder)
    module = catalogue.module(read.problem, problem_file)
    problem = declared(read, module)
    grown, more = "", dict[str, Any]()
    if growing:
        problem, grown, more = _grown(read, module, problem, output)
    check, remarks = held_out_rows(read, problem)
    remarks = (*(module.remarks(read) if hasattr(module, "remarks") else ()), *remarks)
    with output.progress(f"explaining {job.name}", 1) as step:
        found = explain(problem, level, check, remarks=remarks)
        step()
    if grown:
        found = replace(found, sentence=f"{grown} Of what is left then: {found.sentence}")
    shown = Shown(found, level)
    empirical = kept(found, check) if keep_structure and found.structure else None
    if empirical is not None:
        more["empirical"] = empirical.content()
    content = {**answer(_name(read), found, shown), **more}
    output.result(content)
    say(output, found)
    for gap in more.get("heldout", ()):
        unit = "" if gap["unit"] == "1" else f" [{gap['unit']}]"
        before, after = (numbers.plain(gap[which]) for which in ("before", "after"))
        output.prose(f"Held out, {gap['quantity']}: {before} before, {after} after{unit}.")
    if empirical is not None:
        _say_kept(output, empirical)
    if output.folder is not None:
        from calib.report import discovery
        from calib.report.provenance import provenance

        origin = provenance(sources(read, problem_file), typed())
        output.wrote(
            files.write_json(output.path("answer.json"), content),
            discovery.write(_name(read), shown, origin, output.path("report.html"), more),
        )
    return DONE


def _say_kept(output: Output, empirical: Empirical) -> None:
    """What the structure as an empirical term leaves, with its size."""
    output.say(f"  kept as an empirical term: rms of residual/u {empirical.rms:.3g}")
    if empirical.heldout_rms is not None:
        output.say("  on held-out rows:  {:.3g} before, {:.3g} after".format(*empirical.heldout_rms))
    for one in empirical.content()["parameters"]:
        shown, expanded = numbers.with_uncertainty(one["value"], 2.0 * one["u"])
        output.say(f"  {one['name']} = {shown} ± {expanded} {one['unit']} (k = 2)")


def _grown(
    job: Job, module: ModuleType, problem: Problem, output: Output
) -> tuple[Problem, str, dict[str, Any]]:
    """The grown problem, what was added in a sentence, and what it brought as content of the answer."""
    from calib.analyse.covariance import covariance
    from calib.workflow.growth import blocks_of, grow

    with output.progress(f"adding effects to {job.path.name}", 60) as step:
        growth = grow(problem, blocks_of(problem, module), progress=step)
    gaps = [("rms of residual/u on blocks left out", growth.before, growth.after, "1")]
    if hasattr(module, "heldout"):
        gaps += module.heldout(job, growth.estimate)
    heldout = [{"quantity": name, "before": before, "after": after, "unit": unit} for name, before, after, unit in gaps]
    fit = growth.estimate.fit
    effects = [label for one in growth.steps for label in one.effects]
    found = covariance(fit, *map(problem.parameters, effects)).displayed if effects else ()
    values = [{"name": name, "value": value, "u": u, "unit": unit} for name, value, u, unit in found]
    added = {"steps": files.plain(growth.steps), "values": values}
    return growth.problem, growth.sentence, {"added": added, "heldout": heldout}


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
