"""`calib example`, `calib problems` and `calib effects`: what is there, with its source, and a job to start from."""

from __future__ import annotations

import inspect
from pathlib import Path
from types import ModuleType
from typing import Any

import click

from calib import catalogue, files
from calib.cli.output import DONE, Output, output_options, problem_file_option
from calib.effect import Effect
from calib.errors import InputError
from calib.job import Job


@click.command()
@click.argument("name", metavar="PROBLEM")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True)
@output_options
def example(name: str, seed: int, output: Output) -> int:
    """Write a runnable job with simulated data of PROBLEM."""
    module = catalogue.module(name)
    if not hasattr(module, "example_job"):
        there = [_short(one) for one in catalogue.problem_modules() if hasattr(one, "example_job")]
        raise InputError(f"problem '{name}' has no example; those with one: {', '.join(there)}")
    texts = module.example_job(seed)
    output.result({"format": 1, "problem": module.__name__, "seed": seed, "files": texts})
    if output.folder is None:
        if not output.as_json:
            raise InputError("calib example: say where the job goes, with --out DIR, or ask for --json")
        return DONE
    present = [file for file in texts if output.path(file).exists()]
    if present:
        raise InputError(f"{output.path(present[0])}: is there already; name another folder")
    output.wrote(*(files.write_text(output.path(file), text) for file, text in texts.items()))
    job = next((file for file in texts if file.endswith(".toml")), "")
    output.say(f"next: calib solve {output.folder if job == 'case.toml' else output.path(job)} --out results")
    return DONE


@click.command()
@click.argument("name", required=False)
@output_options
def problems(name: str | None, output: Output) -> int:
    """List the problems, one line each with its source; for NAME its columns and options."""
    if name is None:
        found = [_line(module) for module in catalogue.problem_modules()]
        output.result(found)
        width = max(len(one["name"]) for one in found)
        for one in found:
            output.say(f"{one['name']:<{width}}  {one['summary']}{_source(one['source'])}")
        return DONE
    module = catalogue.module(name)
    described = {
        **_line(module), "accepts": list(getattr(module, "accepts", ())), "columns": getattr(module, "columns", {}),
        "options": getattr(module, "options", {}), "job": inspect.getdoc(module.from_job) or "",
    }
    output.result(described)
    output.say(f"{described['name']}: {described['summary']}{_source(described['source'])}\n")
    output.say(described["job"])
    for table, columns in described["columns"].items():
        output.say(f"\n[data.{table}]")
        for column, meaning in columns.items():
            output.say(f"  {column}: {meaning}".removesuffix(": "))
    if described["options"]:
        output.say("\n[options]")
    for key, meaning in described["options"].items():
        output.say(f"  {key}: {meaning}")
    return DONE


@click.command()
@click.argument("job", required=False, type=click.Path(path_type=Path))
@problem_file_option
@output_options
def effects(job: Path | None, problem_file: Path | None, output: Output) -> int:
    """List the named effects, one line each with its source: all, or those that JOB can have."""
    if job is None:
        found = [entry for module in catalogue.problem_modules() for entry in _effects_of(module)]
    else:
        read = Job.read(job)
        problem = catalogue.module(read.problem, problem_file).from_job(read)
        found = [_effect(attached.effect, _short_name(read.problem)) for attached in problem.attached]
    output.result(found)
    width = max((len(one["effect"]) for one in found), default=0)
    for one in found:
        sizes = "; ".join(f"{parameter['name']} [{parameter['unit']}]" for parameter in one["parameters"])
        output.say(f"{one['problem']}: {one['effect']:<{width}}  {sizes}{_source(one['source'])}")
    return DONE


def _effects_of(module: ModuleType) -> list[dict[str, Any]]:
    """The effects of a problem's example: what a job has depends on its covariates, the example has them all."""
    if not hasattr(module, "example"):
        return []
    return [_effect(attached.effect, _short(module)) for attached in module.example(1).attached]


def _effect(effect: Effect, problem: str) -> dict[str, Any]:
    sizes = [{"name": one.name, "unit": one.unit, "plausible_si": list(one.plausible)} for one in effect.parameters]
    return {
        "problem": problem, "effect": effect.label, "name": effect.name, "channel": effect.channel, "slot": effect.slot,
        "per": effect.per, "source": effect.source,
        "parameters": sizes,
    }


def _line(module: ModuleType) -> dict[str, Any]:
    return {"name": _short(module), "summary": catalogue.summary(module), "source": catalogue.source(module)}


def _short(module: ModuleType) -> str:
    return _short_name(module.__name__)


def _short_name(name: str) -> str:
    return name.removeprefix("problems.")


def _source(text: str) -> str:
    return f" [{text}]" if text else ""
