"""The reference: every public name of the modules people write with, from its docstring."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from pathlib import Path
from types import ModuleType
from typing import Any

import calib
import instruments
from pages.words import documented, escaped, prose

# What people write with; a module that is added to `calib.__all__` or to `instruments` comes by itself.
FURTHER = ("calib.units", "calib.geometry", "calib.scene", "calib.table", "calib.job", "calib.settings", "calib.errors",
           "calib.mechanism.axis", "calib.mechanism.chain", "calib.mechanism.errors", "calib.mechanism.drive",
           "calib.mechanism.observe", "calib.analyse.shapes", "calib.workflow.conformity", "calib.workflow.solution",
           "calib.report.certificate.write")


def write(folder: Path) -> None:
    """Write a page for each module and their index."""
    folder.mkdir()
    pages: dict[str, list[tuple[str, Any]]] = {}
    for name in calib.__all__:
        thing = getattr(calib, name)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            pages.setdefault(thing.__module__, []).append((name, thing))
    own = [f"instruments.{one.name}" for one in pkgutil.iter_modules(instruments.__path__)]
    for name in (*FURTHER, *own):
        module = importlib.import_module(name)
        known = {thing for _, thing in pages.get(name, [])}
        pages.setdefault(name, []).extend((n, t) for n, t in _public(module) if t not in known)
    for name, things in pages.items():
        (folder / f"{name}.md").write_text(_page(name, things), encoding="utf-8")
    entries = "\n".join(sorted(pages))
    (folder / "index.md").write_text(
        "# Reference\n\nLengths are in metres, angles in radians, times in seconds, temperatures in kelvin.\n\n"
        f"```{{toctree}}\n:maxdepth: 1\n\n{entries}\n```\n", encoding="utf-8")


def _public(module: ModuleType) -> list[tuple[str, Any]]:
    return [(name, thing) for name, thing in vars(module).items()
            if not name.startswith("_") and (inspect.isclass(thing) or inspect.isfunction(thing))
            and thing.__module__ == module.__name__]


def _page(name: str, things: list[tuple[str, Any]]) -> str:
    module = importlib.import_module(name)
    parts = [f"# {escaped(name)}\n", prose(module.__doc__ or "")]
    for title, thing in things:
        parts += [f"## {escaped(title)}\n", _signature(title, thing), documented(inspect.getdoc(thing) or "")]
        if inspect.isclass(thing):
            parts += [_method(title, label, one) for label, one in _methods(thing)]
    return "\n".join(parts)


def _methods(thing: type) -> list[tuple[str, Any]]:
    found = []
    for name, one in vars(thing).items():
        function = one.__func__ if isinstance(one, (staticmethod, classmethod)) else one
        if not name.startswith("_") and (inspect.isfunction(function) or isinstance(one, property)) and one.__doc__:
            found.append((name, one))
    return found


def _method(title: str, name: str, one: Any) -> str:
    head = f"**{escaped(f'{title}.{name}')}**\n"
    if isinstance(one, property):
        return f"{head}\n{documented(one.__doc__ or '')}"
    function = one.__func__ if isinstance(one, (staticmethod, classmethod)) else one
    return f"{head}\n{_signature(f'{title}.{name}', function)}\n{documented(inspect.getdoc(function) or '')}"


def _signature(title: str, thing: Any) -> str:
    own = thing.__init__ if inspect.isclass(thing) and "__init__" in vars(thing) else thing
    try:
        signature = str(inspect.signature(own)).replace("'", "")
        signature = signature.replace("(self, ", "(").replace("(self)", "()").removesuffix(" -> None")
    except (TypeError, ValueError):
        signature = ""
    if len(signature) > 600:
        signature = "(...)"
    return f"```text\n{title}{signature}\n```\n"
