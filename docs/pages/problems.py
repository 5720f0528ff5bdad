"""One page a problem: the physics from its docstring, what it reads, its effects, and a figure of its own example."""

from __future__ import annotations

import tempfile
from pathlib import Path
from types import ModuleType

from jinja2 import Environment, FileSystemLoader

from calib import Estimate, catalogue, covariance, reliability, solve
from calib.analyse.shapes import scene
from calib.effect import Effect
from calib.job import Job
from calib.report import numbers, plots, space
from calib.scene import Scene
from calib.workflow.solution import declared, requested
from pages.words import escaped, prose, raw, table

TEMPLATES = Path(space.__file__).parent / "templates"
SEED = 1
ANSWERS = 12


def write(folder: Path) -> None:
    """Write a page for every problem that a job may name, and their index."""
    folder.mkdir()
    names = []
    for module in catalogue.problem_modules():
        short = module.__name__.split(".")[-1]
        names.append(short)
        (folder / f"{short}.md").write_text(_page(short, module), encoding="utf-8")
    entries = "\n".join(names)
    (folder / "index.md").write_text(
        "# Problems\n\nEach is declared in one module: the physics, what is unknown, how it is read from files.\n\n"
        f"```{{toctree}}\n:maxdepth: 1\n\n{entries}\n```\n", encoding="utf-8")


def _page(short: str, module: ModuleType) -> str:
    title, _, rest = (module.__doc__ or short).partition("\n\n")
    first = " ".join(title.split())
    parts = [f"# {escaped(first.split(':')[0].rstrip('.'))}\n", prose(first), prose(rest)]
    found = _example(short, module)
    if found is not None:
        job, estimate, files, shapes = found
        parts += ["## Its example\n", _commands(short, files), _answer(job, estimate), _figure(estimate, shapes)]
    parts += [_read(module), _effects(module)]
    return "\n".join(part for part in parts if part)


def _example(short: str, module: ModuleType) -> tuple[Job, Estimate, list[str], Scene] | None:
    """The solved example of a problem: job, estimate, names of its files, shapes; None where it has none."""
    if not hasattr(module, "example_job"):
        return None
    files = module.example_job(SEED)
    with tempfile.TemporaryDirectory() as folder:
        for name, text in files.items():
            path = Path(folder, short, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        job = Job.read(Path(folder, short, _job_of(list(files))))
        estimate = solve(declared(job, module))
        # A scene may read the tables of the job again, so it is asked while they are there.
        shapes = module.scene(job, estimate) if hasattr(module, "scene") else scene(estimate.fit)
    return job, estimate, list(files), shapes


def _job_of(files: list[str]) -> str:
    return next(name for name in files if name.endswith((".toml", ".gkf")))


def _commands(short: str, files: list[str]) -> str:
    return (f"```console\n$ calib example {short} --out {short}-job\n\n"
            f"$ calib solve {short}-job/{_job_of(files)} --out {short}-results\n```\n")


def _answer(job: Job, estimate: Estimate) -> str:
    wanted = requested(estimate.problem, job.quantities, "the example")
    found = covariance(estimate.fit, *wanted)
    # Of poses and directions the engine has small angles, which mean nothing to a reader.
    turned = {label for one in estimate.problem.unknowns if one.kind != "vector" for label in one.labels}
    rows: list[list[str]] = []
    for name, value, u, unit in found.displayed:
        if u > 0 and name not in turned and len(rows) < ANSWERS:
            shown, expanded = numbers.with_uncertainty(value, 2.0 * u)
            rows.append([name, f"{shown} ± {expanded}", "" if unit == "1" else unit])
    return table(["result", "value ± U (k = 2)", "unit"], rows)


def _figure(estimate: Estimate, shapes: Scene) -> str:
    drawn = space.space(shapes)
    if drawn is not None:
        environment = Environment(loader=FileSystemLoader(TEMPLATES), autoescape=True, trim_blocks=True,
                                  lstrip_blocks=True)
        macro = environment.get_template("space.html.j2").module.drawing
        return raw("\n".join(line for line in str(macro(drawn)).splitlines() if line.strip()))
    checked = reliability(estimate.fit)
    name = next(group.name for group in estimate.fit.groups if not group.is_prior)
    chosen = checked.of(name)
    component = [str(one) for one in checked.component[chosen]]
    figure = plots.residuals(checked.row[chosen], checked.w[chosen], component, "row of the data file")
    return raw(f"<figure>{plots.svg(figure, estimate.problem.name)}</figure>".replace("\n\n", "\n"))


def _read(module: ModuleType) -> str:
    parts = []
    for name, columns in getattr(module, "columns", {}).items():
        parts += [f"## Table `{name}`\n", table(["column", "meaning"], [[k, v] for k, v in columns.items()])]
    if getattr(module, "options", {}):
        parts += ["## Options\n", table(["option", "meaning"], [[k, v] for k, v in module.options.items()])]
    return "\n".join(parts)


def _effects(module: ModuleType) -> str:
    offered = getattr(module, "effects", None)
    try:
        found = [one for one in offered() if isinstance(one, Effect)] if callable(offered) else []
    except TypeError:       # some ask for what only a job knows
        found = []
    if not found:
        return ""
    rows = [[one.name, one.channel or one.slot, ", ".join(f"{p.name} [{p.unit}]" for p in one.parameters), one.source]
            for one in found]
    return "## Effects that may be missing\n\n" + table(["effect", "acts on", "parameters", "source"], rows)
