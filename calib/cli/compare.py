"""`calib compare`: one job under every method and formulation that accepts it."""

from __future__ import annotations

from pathlib import Path

import click

from calib import catalogue, files
from calib.cli.output import DONE, FAILED, Output, job_argument, output_options, problem_file_option, sources, typed
from calib.job import Job
from calib.report import numbers


@click.command()
@job_argument
@click.option("--starts", type=click.IntRange(0, 100_000), default=200, show_default=True,
              help="Random starts of each iterative method; 0: none.")
@click.option("--draws", type=click.IntRange(2, 100_000), default=100, show_default=True,
              help="Draws for the uncertainty of what has no formula for it.")
@click.option("--seconds", type=click.FloatRange(0.1), default=10.0, show_default=True,
              help="Processor time for the random starts of each line; what was not tried then is said.")
@click.option("--study", "trials", type=click.IntRange(0, 100_000), default=0, show_default=True,
              help="Trials of a simulation under each of five kinds of noise: bias, spread, efficiency; 0: none.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True)
@problem_file_option
@output_options
def compare(job: Path, starts: int, draws: int, seconds: float, trials: int, seed: int, problem_file: Path | None,
            output: Output) -> int:
    """Solve JOB under every method and formulation that accepts it, and say why the others refuse.

    With --out: comparison.json and report.html.
    """
    from calib.report import comparison as report
    from calib.report.provenance import provenance
    from calib.workflow.compare.side_by_side import Comparison, Effort, methods
    from calib.workflow.compare.side_by_side import compare as compared
    from calib.workflow.compare.study import NOISES
    from calib.workflow.solution import declared, requested

    read = Job.read(job)
    module = catalogue.module(read.problem, problem_file)
    problem = declared(read, module)
    what = requested(problem, read.quantities, read.report.where("quantities"))
    others = module.formulations(read) if hasattr(module, "formulations") else {}
    where = module.start_region(read) if hasattr(module, "start_region") else None
    with output.progress(f"comparing {job.name}",
                         len(methods()) + len(others) + (len(NOISES) if trials else 0)) as step:
        found: Comparison = compared(problem, what, others, Effort(starts, draws, seed, seconds, trials), where, step)
    origin = provenance(sources(read, problem_file), typed(), seed)
    content = report.content(found)
    output.result(content)
    output.say(f"{problem.name}: formulations side by side\n")
    accepted = [line for line in found.lines if line.accepted]
    width = max((len(f"{line.formulation}: {line.method}") for line in accepted), default=0)
    output.say(f"  {'':<{width}}  {'v′Pv':>10}  {'max diff/u':>10}  {'iter':>5}  {'ms':>8}  {'starts':>10}")
    for line in accepted:
        far = max((abs(value) for value in line.difference.values()), default=None)
        tried = "–" if line.starts is None else f"{line.starts.successes}/{len(line.starts.found)}"
        away = "–" if far is None else f"{far:.1e}" if 0.0 < far < 1e-3 else numbers.plain(far, 3)
        steps = "–" if line.iterations is None else str(line.iterations)
        output.say(f"  {f'{line.formulation}: {line.method}':<{width}}  {numbers.plain(line.objective, 6):>10}  "
                   f"{away:>10}  {steps:>5}  {1e3 * (line.seconds or 0.0):>8.1f}  {tried:>10}")
    output.say()
    for sentence in report.sentences(found):
        output.prose(sentence)
    if found.refused:
        output.say("\nRefused:")
        together: dict[str, list[str]] = {}
        for line in found.refused:
            together.setdefault(line.why, []).append(f"{line.formulation}, {line.method}".rstrip(", "))
        for why, names in together.items():
            output.prose(f"{'; '.join(names)}: {why}", "  - ")
    if output.folder is not None:
        output.say()
        output.wrote(files.write_json(output.path("comparison.json"), content),
                     report.write(found, origin, output.path("report.html")))
    reference = found.reference
    good = reference is not None and reference.certificate is not None and reference.certificate.passed
    return DONE if good else FAILED
