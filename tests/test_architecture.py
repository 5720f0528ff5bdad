"""The layout of the design, kept by static imports: who may know whom, who may speak, how long a file may be."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
OURS = ("calib", "instruments", "problems")
SOURCES = sorted(path for package in OURS for path in (ROOT / package).rglob("*.py"))
ENGINE = [path for path in SOURCES if path.relative_to(ROOT).parts[0] == "calib"]

# Each layer may import itself and what stands before it; the innermost stands first.
LAYERS = (
    ("calib.errors", "calib.units", "calib.frozen", "calib.blocks"),
    ("calib.geometry", "calib.uncertainty", "calib.scene"),
    ("calib.unknown",),
    ("calib.effect",),
    ("calib.observations",),
    ("calib.rows", "calib.compiled", "calib.trace"),
    ("calib.problem",),
    ("calib.layout", "calib.factor", "calib.pattern", "calib.coupling", "calib.accumulation",
     "calib.normal", "calib.elimination"),
    ("calib.system", "calib.defect"),
    ("calib.linearisation",),
    ("calib.analyse", "calib.solve"),
    ("calib.mechanism",),
    ("calib.files", "calib.columns", "calib.table", "calib.settings", "calib.job", "calib.catalogue"),
    ("calib.workflow",),
    ("calib.report",),
    ("calib.cli", "calib.__main__"),
)
CASADI_ALLOWED = ("calib.geometry", "calib.mechanism", "calib.trace", "calib.rows", "calib.compiled", "calib.solve",
                  "calib.unknown", "calib.observations", "instruments", "problems")
LAZY = ("cvxpy", "matplotlib", "clarabel", "rich", "jinja2")


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def imports(path: Path, top_level_only: bool = False) -> set[str]:
    """Modules that a file imports; imports for type checking alone do not count."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    typing_only = {
        id(inner) for node in ast.walk(tree) if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for inner in ast.walk(node)
    }
    nodes = tree.body if top_level_only else ast.walk(tree)
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    found = set()
    for node in nodes:
        if id(node) in typing_only:
            continue
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            source = ".".join(filter(None, (base, node.module)))
            known = {alias.name for alias in node.names if is_module(f"{source}.{alias.name}")}
            found.update(f"{source}.{name}" for name in known)
            if len(known) < len(node.names):
                found.add(source)
    return found


def is_module(name: str) -> bool:
    path = ROOT.joinpath(*name.split("."))
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def layer(name: str) -> int | None:
    for number, names in enumerate(LAYERS):
        if any(name == one or name.startswith(f"{one}.") for one in names):
            return number
    return None


def test_every_module_of_the_engine_has_its_layer():
    without = [module_name(path) for path in ENGINE if layer(module_name(path)) is None]
    assert without == ["calib"]


def test_the_engine_imports_outward_never():
    wrong = []
    for path in ENGINE:
        mine = layer(module_name(path))
        for name in imports(path):
            theirs = layer(name)
            if mine is not None and theirs is not None and theirs > mine:
                wrong.append(f"{module_name(path)} imports {name}")
    assert wrong == []


def test_analyses_know_neither_models_nor_solvers():
    wrong = [f"{module_name(path)} imports {name}" for path in ENGINE if module_name(path).startswith("calib.analyse")
             for name in imports(path)
             if name.startswith(("calib.solve", "calib.system", "calib.trace", "calib.rows", "casadi"))]
    assert wrong == []


def test_the_engine_imports_no_instrument_problem_test_or_benchmark():
    foreign = ("instruments", "problems", "tests", "benchmarks")
    wrong = [f"{module_name(path)} imports {name}" for path in ENGINE for name in imports(path)
             if name.split(".")[0] in foreign]
    assert wrong == []


def test_instruments_import_no_problem():
    own = [path for path in SOURCES if path.relative_to(ROOT).parts[0] == "instruments"]
    wrong = [f"{module_name(path)} imports {name}" for path in own for name in imports(path)
             if name.split(".")[0] in ("problems", "tests", "benchmarks")]
    assert wrong == []


def test_casadi_stays_in_models_geometry_and_the_trace():
    wrong = [module_name(path) for path in SOURCES if "casadi" in {name.split(".")[0] for name in imports(path)}
             and not module_name(path).startswith(CASADI_ALLOWED)]
    assert wrong == []


def test_cvxpy_stays_with_the_convex_method_and_what_asks_for_it_by_name():
    allowed = ("calib.solve", "calib.analyse.selection", "calib.workflow", "problems")
    users = [module_name(path) for path in SOURCES if "cvxpy" in imports(path)]
    wrong = [name for name in users if not name.startswith(allowed)]
    assert wrong == []


def test_heavy_libraries_are_imported_where_they_are_used():
    wrong = [f"{module_name(path)} imports {name}" for path in SOURCES for name in imports(path, top_level_only=True)
             if name.split(".")[0] in LAZY]
    assert wrong == []


def test_nothing_in_the_engine_prints():
    wrong = []
    for path in ENGINE:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print":
                wrong.append(f"{module_name(path)}, line {node.lineno}")
    assert wrong == []


def test_no_file_is_longer_than_400_lines():
    everything = [*SOURCES, *(ROOT / "tests").glob("*.py"), *(ROOT / "benchmarks").glob("*.py")]
    long = {str(path.relative_to(ROOT)): lines for path in everything
            if (lines := len(path.read_text(encoding="utf-8").splitlines())) > 400}
    assert long == {}


@pytest.mark.parametrize("library", ["cvxpy", "matplotlib", "scipy.optimize", "rich", "jinja2"])
def test_importing_the_engine_does_not_import(library):
    code = f"import sys, calib; sys.exit({library!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
