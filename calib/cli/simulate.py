"""`calib simulate`: readings of the declared model of a job, in the columns of its tables."""

from __future__ import annotations

from pathlib import Path

import click

from calib import catalogue, files, units
from calib.cli.output import DONE, Output, job_options, output_options, sources, typed
from calib.cli.solve import method_of, method_option
from calib.errors import InputError
from calib.job import Job
from calib.solve.estimate import solve
from calib.workflow.simulated import Simulated, simulated
from calib.workflow.solution import declared

LOOSE = ("group", "row", "component", "reading", "unit")


@click.command()
@job_options
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True)
@click.option("--with-effect", "effects", multiple=True, metavar="NAME=VALUE",
              help="Switch an effect on, as in --with-effect \"drift=0.4 arcsec/h\"; may be repeated.")
@method_option
@output_options
def simulate(
    job: Path, data_folder: Path | None, problem_file: Path | None, seed: int, effects: tuple[str, ...], method: str,
    output: Output,
) -> int:
    """Solve JOB and draw new readings around its estimate, with errors as stated and effects as asked.

    With --out: the job with its tables, ready to be solved, and truth.json.
    """
    from calib.report.provenance import provenance

    read = Job.read(job, data_folder)
    module = catalogue.module(read.problem, problem_file)
    problem = declared(read, module)
    estimate = solve(problem, method_of(method))
    found = simulated(read, problem, estimate, seed, _effects(effects), getattr(module, "in_columns", None))
    truth = [{"name": name, "value": value, "unit": unit} for name, (value, unit) in found.truth.items()]
    origin = provenance(sources(read, problem_file), typed(), seed)
    content = {"format": 1, "problem": read.problem, "seed": seed, "effects": dict(_effects(effects)), "truth": truth,
               "method": estimate.method, "provenance": origin.content()}
    if output.as_json:
        tables = {name: {"columns": [column.header for column in table.columns], "rows": table.cells}
                  for name, table in found.tables.items()}
        output.result({**content, "tables": tables})
    elif output.folder is None:
        raise InputError("calib simulate: say where the tables go, with --out DIR, or ask for --json")
    if output.folder is not None:
        if any(path.resolve().parent == output.folder.resolve() for path in read.files):
            raise InputError(f"--out {output.folder}: is the folder of the job itself, whose readings would be lost; "
                             "name another folder")
        output.wrote(*_write(output, read, found, content))
    return DONE


def _write(output: Output, job: Job, found: Simulated, content: dict[str, object]) -> list[Path]:
    written = [files.write_text(output.path(job.path.name), job.path.read_text(encoding="utf-8-sig"))]
    tables = list(found.tables.values())
    elsewhere = {path for name, path in job.named.items() if path != job.path.parent / name}    # they stay there
    for place, path in enumerate(path for path in job.everything_read[1:] if path not in elsewhere):
        if not path.is_relative_to(job.path.parent):
            raise InputError(f"{path}: does not lie below the job; move it there and name it so in the job")
        target = output.path(str(path.relative_to(job.path.parent)))
        is_table = place < len(tables)
        written.append(tables[place].write(target) if is_table else files.write_bytes(target, path.read_bytes()))
    if found.loose:
        written.append(files.write_csv(output.path("simulated_readings.csv"), LOOSE, _loose(found)))
    return [*written, files.write_json(output.path("truth.json"), content)]


def _loose(found: Simulated) -> list[tuple[object, ...]]:
    lines: list[tuple[object, ...]] = []
    for group, observations in found.loose.items():
        assert observations.readings is not None
        dim = observations.readings.shape[1]
        for row, reading in zip(observations.rows, observations.readings):
            for component, unit, value in zip(observations.components(dim), observations.units(dim), reading):
                lines.append((group, int(row), component, float(units.from_si(value, unit)), unit))
    return lines


def _effects(given: tuple[str, ...]) -> dict[str, str]:
    found = {}
    for text in given:
        name, sign, value = text.partition("=")
        if not sign or not value.strip():
            raise InputError(f"--with-effect {text}: write NAME=VALUE, as in \"drift=0.4 arcsec/h\"")
        found[name.strip()] = value.strip()
    return found
