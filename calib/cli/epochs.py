"""`calib epochs`: which points of a network moved from one epoch to another (congruence test)."""

from __future__ import annotations

from pathlib import Path

import click

from calib import catalogue, files
from calib.cli.output import DONE, FAILED, Output, data_option, output_options, problem_file_option, sources, typed
from calib.errors import InputError
from calib.job import Job


@click.command()
@click.argument("jobs", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="JOB...")
@data_option
@problem_file_option
@click.option("--level", type=click.FloatRange(0.0, 0.5, min_open=True, max_open=True), default=0.01, show_default=True,
              help="Chance that a point is said to have moved where none did; shared among the comparisons.")
@click.option("--previous", is_flag=True, help="Compare each epoch with the one before it, not with the first.")
@click.option("--release", is_flag=True, help="Test the fixed points too.")
@click.option("--a-posteriori", is_flag=True,
              help="Multiply the stated uncertainties by the scatter that both epochs show (tests with Fisher's F).")
@output_options
def epochs(
    jobs: tuple[Path, ...], data_folder: Path | None, problem_file: Path | None, level: float, previous: bool,
    release: bool, a_posteriori: bool, output: Output,
) -> int:
    """Say which points moved between the epochs JOB, JOB ..., or between those in the column `epoch` of one JOB.

    With --out: epochs.json, shifts.csv and report.html.
    """
    from calib.report import epochs as report
    from calib.report.provenance import provenance
    from calib.workflow.epochs import Rules, compared, epochs_of

    read = [Job.read(job, data_folder) for job in jobs]
    modules = [catalogue.module(job.problem, problem_file) for job in read]
    module = modules[0]
    if any(one is not module for one in modules) or not hasattr(module, "compare_epochs"):
        raise InputError("epochs are compared of networks; give jobs of one problem that compares epochs "
                         "(problems.network)")
    found = epochs_of(read, module)
    with output.progress("comparing epochs", 1) as step:
        comparisons = compared(found, module, Rules(level, release, a_posteriori), previous)
        step()
    for job in read:
        for section in ("options", "instruments"):
            job.settings.table(section)
        job.refuse_unknown_keys()
    origin = provenance([path for job in read for path in sources(job, problem_file)], typed())
    content = report.content(comparisons, level, origin)
    written: tuple[Path, ...] = ()
    if output.folder is not None:     # before any text: a reader of a pipe may have gone
        written = (
            files.write_json(output.path("epochs.json"), content),
            files.write_csv(output.path("shifts.csv"), report.COLUMNS, list(report.lines(comparisons))),
            report.write(comparisons, level, origin, output.path("report.html")),
        )
    output.result(content)
    for one in comparisons:
        output.say(f"{one.names[0]} to {one.names[1]}: {len(one.found.points)} points compared")
        for sentence in report.sentences(one):
            output.prose(sentence, "  ")
        output.say()
    output.wrote(*written)
    certified = all(e.certificate.passed and e.converged for one in comparisons for e in one.estimates)
    return DONE if certified else FAILED
