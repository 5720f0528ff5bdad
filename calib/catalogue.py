"""The problem modules that are there: those beside calib, those of other distributions, and a person's own file."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import inspect
import pkgutil
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from calib import units
from calib.errors import InputError

BESIDE = Path(__file__).resolve().parent.parent
ENTRY_POINTS = "calib.problems"
COMPANIONS = ("problems", "instruments")


def check_companions() -> None:
    """Make sure that `problems` and `instruments` are those beside calib.

    raises InputError naming the two paths where a foreign package of that name is found first.
    """
    for name in COMPANIONS:
        found = importlib.util.find_spec(name)
        ours = BESIDE / name
        places = [Path(place).resolve() for place in (found.submodule_search_locations or [])] if found else []
        if found and found.origin and not places:
            places = [Path(found.origin).resolve()]
        if not places or places[0] != ours:
            theirs = places[0] if places else "nothing"
            raise InputError(f"two packages are called '{name}': {theirs} is found first, {ours} belongs to calib; "
                             f"rename or remove the first, or put {BESIDE} before it on the path")


def own_names() -> list[str]:
    """Names of the modules in the package `problems` beside calib, without importing them.

    return: names such as "problems.plumb", sorted.
    """
    return [f"problems.{found.name}" for found in pkgutil.iter_modules([str(BESIDE / "problems")])]


def foreign_names() -> list[str]:
    """Names of the problem modules that other distributions offer under the entry-point group `calib.problems`.

    return: module names, sorted.
    """
    return sorted(point.value for point in importlib.metadata.entry_points(group=ENTRY_POINTS))


def module(name: str, file: str | Path | None = None) -> ModuleType:
    """The problem module that a job names.

    name: "problems.plumb", "plumb", a name of an entry point, or a scenario or suffix that a problem module accepts.
    file: a person's own problem file, which then is the module whatever the name.
    return: the module.
    raises InputError where there is none, with near names.
    """
    if file is not None:
        return _from_file(Path(file))
    for known in own_names() + foreign_names():
        if name in (known, known.removeprefix("problems.")):
            return _offering(known)
    by_entry_point = {point.name: point.value for point in importlib.metadata.entry_points(group=ENTRY_POINTS)}
    if name in by_entry_point:
        return _offering(by_entry_point[name])
    for candidate in problem_modules():
        if name in getattr(candidate, "accepts", ()):
            return candidate
    names = [candidate.__name__.removeprefix("problems.") for candidate in problem_modules()]
    near = units.near_matches(name.removeprefix("problems."), names)
    hint = f"did you mean '{near[0]}'? " if near else ""
    raise InputError(f"there is no problem '{name}'; {hint}There are: {', '.join(names)}. A problem file of your "
                     "own is named on the command line: --problem-file mine.py")


def problem_modules() -> Iterator[ModuleType]:
    """The modules that declare a problem from a job, imported one after the other.

    return: those of `problems`, then those of other distributions.
    """
    for name in own_names() + foreign_names():
        found = importlib.import_module(name)
        if hasattr(found, "from_job"):
            yield found


def published() -> dict[str, ModuleType]:
    """The modules that recompute a published paper, by the name the command line knows.

    return: {"five-axis": module, ...}, sorted by name.
    """
    found = {}
    for name in own_names() + foreign_names():
        candidate = importlib.import_module(name)
        if isinstance(getattr(candidate, "published", None), str) and hasattr(candidate, "reproduce"):
            found[candidate.published] = candidate
    return dict(sorted(found.items()))


def summary(candidate: ModuleType) -> str:
    """The first sentence of a module's docstring."""
    return (inspect.getdoc(candidate) or "").split("\n\n")[0].replace("\n", " ")


def source(candidate: ModuleType) -> str:
    """Where the physics of a problem module is described: its `source`, or the lines of its docstring that say so."""
    stated = getattr(candidate, "source", None)
    if isinstance(stated, str):
        return stated
    for paragraph in (inspect.getdoc(candidate) or "").split("\n\n"):
        lines = paragraph.splitlines()
        begin = [number for number, line in enumerate(lines) if line.lower().startswith("source")]
        if begin:
            return " ".join(lines[begin[0] :]).split(":", 1)[-1].strip().rstrip(".")
    return ""


def _offering(name: str) -> ModuleType:
    found = importlib.import_module(name)
    if not hasattr(found, "from_job"):
        raise InputError(f"module '{name}' declares no problem from a job (it has no from_job); `calib problems` lists "
                         "those that do")
    return found


def _from_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise InputError(f"{path}: there is no such problem file; check the path")
    spec = importlib.util.spec_from_file_location(f"problem_file_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: is not a Python file; name a file that ends in .py")
    found = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = found
    try:
        spec.loader.exec_module(found)
    except Exception as error:
        message = f"{path}: stops while it is read: {type(error).__name__}: {error}; run it with python"
        raise InputError(message) from error
    if not hasattr(found, "from_job"):
        raise InputError(f"{path}: has no function from_job(job) -> Problem; write one that declares your problem")
    return found
