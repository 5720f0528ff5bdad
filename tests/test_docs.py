"""The documentation: every block of code is run, every example draws its picture, the site builds without a warning."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest
from command import runner

from calib.report.certificate.stated import stated

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
# The tutorials are run by test_mechanism_tutorials.py, the README by test_readme.py.
PAGES = sorted(page for page in DOCS.rglob("*.md") if not {"made", "tutorials", "_build"} & set(page.parts))
EXAMPLES = sorted((DOCS / "examples").glob("*.py"))
FENCE = re.compile(r"^(?:<!-- not run: ([^\n]+) -->\n)?(`{3,})([^\n]*)\n(.*?)^\2$", re.DOTALL | re.MULTILINE)
LANGUAGES = {"python", "console", "toml", "text", "sh", "{toctree}"}


@dataclass(frozen=True)
class Block:
    """A fenced block: why it is not run (None: it is), its language, its text."""

    spared: str | None
    language: str
    text: str


def blocks(page: Path) -> list[Block]:
    found = FENCE.findall(page.read_text(encoding="utf-8"))
    return [Block(why or None, language.strip(), text) for why, _, language, text in found]


@pytest.mark.parametrize("page", sorted({*PAGES, *DOCS.glob("tutorials/*.md")}), ids=lambda page: page.stem)
def test_every_block_says_its_language_and_what_is_not_run_says_why(page):
    for block in blocks(page):
        assert block.language in LANGUAGES, block.text
        assert block.spared or block.language != "sh", f"a block of sh is not run and must say why: {block.text}"
        assert block.spared is None or len(block.spared) > 10


def told(page: Path) -> list[Block]:
    return [block for block in blocks(page) if block.spared is None]


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if any(b.language == "python" for b in told(page))],
                         ids=lambda page: page.stem)
def test_python_on_a_page_prints_what_is_printed_below_it(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": page.stem}
    heard = ""
    for block in told(page):
        if block.language == "python":
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile(block.text, page.name, "exec"), names)
            heard += out.getvalue()
        elif block.language == "text" and heard:
            assert heard.strip() == block.text.strip()
            heard = ""
    assert heard == "", "what is printed stands on the page"


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if any(b.language == "console" for b in told(page))],
                         ids=lambda page: page.stem)
def test_commands_on_a_page_run_and_say_what_is_printed_below_them(page, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    calib = runner(capsys)
    made: set[str] = set()
    for block in told(page):
        for entry in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:] if block.language == "console" else ():
            command, _, printed = entry.partition("\n")
            program, *words = shlex.split(command)
            assert program == "calib"
            if words[0] == "example" and command in made:
                continue        # a page may begin anew with the same job
            made.add(command)
            answer = calib(*words)
            assert answer.status == 0, f"{command}: {answer.error}"
            if printed.strip():
                assert answer.out.strip() == printed.strip()


@pytest.mark.parametrize("page", [page for page in PAGES if any(b.language == "toml" for b in told(page))],
                         ids=lambda page: page.stem)
def test_job_files_on_a_page_are_jobs(page, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    calib = runner(capsys)
    for number, block in enumerate(told(page)):
        if block.language != "toml":
            continue
        job = tomllib.loads(block.text)
        if "certificate" in job:
            stated(job["certificate"], page)
        if "problem" in job:
            folder = tmp_path / str(number)
            name = job["problem"].removeprefix("problems.")
            assert calib("example", name, "--out", folder, "--quiet").status == 0
            (folder / "job.toml").write_text(block.text, encoding="utf-8")
            answer = calib("solve", folder / "job.toml", "--quiet")
            assert answer.status in (0, 1), answer.error


@pytest.mark.slow
@pytest.mark.parametrize("script", EXAMPLES, ids=lambda script: script.stem)
def test_an_example_finishes_in_seconds_and_draws_a_picture(script, tmp_path):
    picture = tmp_path / "picture.png"
    environment = {**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT)}
    finished = subprocess.run([sys.executable, "-W", "error", str(script), str(picture)], cwd=tmp_path, text=True,
                              capture_output=True, check=False, env=environment, timeout=120)
    assert finished.returncode == 0, finished.stderr
    content = picture.read_bytes()
    assert content.startswith(b"\x89PNG")
    width, height = (int.from_bytes(content[at : at + 4], "big") for at in (16, 20))
    assert min(width, height) > 300
    assert len(content) > 10_000, "there is something on it"


def test_there_are_examples():
    assert 6 <= len(EXAMPLES) <= 12


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    for needed in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(needed)
    copy = tmp_path / "checkout" / "docs"
    copy.parent.mkdir()
    shutil.copytree(DOCS, copy)
    (copy.parent / "benchmarks").symlink_to(ROOT / "benchmarks")      # pages show its pictures
    environment = {**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT), "CALIB_DOCS_PAPERS": "turntable"}
    words = ["-W", "--keep-going", "-q", "-b", "html", str(copy), str(tmp_path / "site")]
    finished = subprocess.run([sys.executable, "-m", "sphinx", *words], text=True, capture_output=True, check=False,
                              env=environment, timeout=600)
    assert finished.returncode == 0, finished.stdout + finished.stderr
    for name in ("index", "start", "made/gallery", "made/problems/network", "made/reference/calib.problem",
                 "made/published"):
        assert (tmp_path / "site" / f"{name}.html").is_file(), name
