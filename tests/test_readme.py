"""The README: its two commands, and every example on it, run and compared with what is printed there."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
LOCKED = ("requirements.txt", "requirements-test.txt")
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)


def blocks(language: str) -> list[str]:
    return [text for name, text in BLOCKS if name == language]


def test_there_are_exactly_two_commands():
    first, second = blocks("sh")
    for command in (first, second):
        *continued, last = command.strip().splitlines()
        assert all(line.endswith("\\") for line in continued)
        assert not last.endswith("\\")
    assert first.startswith("python3 -m venv .venv")
    assert "--require-hashes -r requirements.txt" in first
    assert "--no-deps --no-build-isolation" in first
    assert first.rstrip().endswith("calib reproduce --out results")
    assert "--require-hashes -r requirements-test.txt" in second
    assert second.rstrip().endswith("-m pytest -n auto")


def test_the_commands_name_nothing_but_what_is_in_the_repository():
    words = [word for text in blocks("sh") for word in shlex.split(text)]
    assert not [word for word in words if "://" in word or word.startswith("/")]
    assert all((ROOT / name).is_file() for name in LOCKED)


@pytest.mark.parametrize("name", LOCKED)
def test_every_requirement_has_an_exact_version_and_hashes_and_no_address(name):
    text = (ROOT / name).read_text()
    assert "://" not in text
    assert "--index" not in text
    wanted = [line for line in text.splitlines() if line and not line.startswith(("#", " "))]
    assert wanted
    for line in wanted:
        assert re.match(r"[A-Za-z0-9_.-]+==[^ ]+( ; .+)? \\$", line), line
    assert text.count("--hash=sha256:") >= len(wanted)


def names(requirements: Iterable[str]) -> set[str]:
    return {re.split(r"[<>=\[; ]", one)[0].lower() for one in requirements}


def locked(name: str) -> set[str]:
    return {line.rstrip(" \\") for line in (ROOT / name).read_text().splitlines() if re.match(r"\w[^ ]*==", line)}


def test_everything_the_project_needs_is_among_the_requirements():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"]
    to_run = [*project["project"]["dependencies"], *extras["fast"], *project["build-system"]["requires"]]
    to_test = [one for extra, wanted in extras.items() if extra != "bench" for one in wanted]
    assert names(to_run) <= names(locked("requirements.txt"))
    assert names(to_test) - {project["project"]["name"]} <= names(locked("requirements-test.txt"))


def test_the_tests_run_on_the_same_versions_as_the_program():
    assert {one.split(" ;")[0] for one in locked("requirements.txt")} <= {
        one.split(" ;")[0] for one in locked("requirements-test.txt")}


def test_the_ci_script_runs_the_commands_of_the_readme():
    script = (ROOT / ".ci" / "run").read_text()
    assert os.access(ROOT / ".ci" / "run", os.X_OK)
    assert "README.md" in script
    assert "pip install" not in script


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target


@pytest.mark.parametrize("session", blocks("console"))
def test_the_sessions_on_the_readme_come_out_as_printed(tmp_path, session):
    for entry in re.split(r"^\$ ", session, flags=re.MULTILINE)[1:]:
        command, _, printed = entry.partition("\n")
        program, *words = shlex.split(command)
        assert program == "calib"
        finished = subprocess.run([sys.executable, "-m", "calib", *words], cwd=tmp_path, capture_output=True, text=True,
                                  check=False, env={**os.environ, "COLUMNS": "100"})
        assert finished.returncode == 0, finished.stderr
        assert finished.stdout.strip() == printed.strip()


def test_the_python_example_prints_what_is_printed_below_it(capsys):
    (code,), (printed,) = blocks("python"), blocks("text")
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    assert capsys.readouterr().out.strip() == printed.strip()
