"""The built wheel, installed elsewhere, recomputes a paper: data files ship with it, and the checkout is not needed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
pytestmark = pytest.mark.slow


def run(*words: object, **options):
    finished = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False, **options)
    assert finished.returncode == 0, finished.stdout + finished.stderr
    return finished


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    options = ("--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", folder)
    run(sys.executable, "-m", "pip", "wheel", *options, ROOT)
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def environment(wheel, tmp_path_factory):
    """A new environment with the wheel; what it depends on is lent by this one."""
    folder = tmp_path_factory.mktemp("environment")
    run(sys.executable, "-m", "venv", folder)
    python = folder / "bin" / "python"
    run(python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", wheel)
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").stdout.strip())
    lent = site / "lent"
    lent.mkdir()
    for entry in Path(sysconfig.get_path("purelib")).iterdir():
        # An editable install of the checkout must not be lent, or the checkout would stand in for the wheel.
        if "calibration_framework" not in entry.name.replace("-", "_") and entry.suffix != ".pth":
            (lent / entry.name).symlink_to(entry)
    (site / "lent.pth").write_text(f"{lent}\n")
    return folder


def test_the_wheel_holds_the_packages_and_their_data_and_nothing_else(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {"calib", "problems", "instruments"}
    shipped = {str(path.relative_to(ROOT)) for path in (ROOT / "problems" / "data").rglob("*") if path.is_file()}
    assert shipped <= set(names)
    assert "calib/report/templates/page.html.j2" in names
    assert not [name for name in names if "__pycache__" in name]


def test_the_installed_wheel_recomputes_a_paper_far_from_the_checkout(environment, tmp_path):
    home = {**os.environ, "HOME": str(tmp_path), "PYTHONPATH": ""}
    where = run(environment / "bin" / "python", "-c", "import calib; print(calib.__file__)", cwd=tmp_path, env=home)
    assert str(environment) in where.stdout
    run(environment / "bin" / "calib", "reproduce", "base-point", "--out", "results", cwd=tmp_path, env=home)
    content = json.loads((tmp_path / "results" / "base-point.json").read_text())
    assert {one["key"] for one in content["quantities"]} >= {"base_x", "base_y", "base_z", "ssq"}
    assert next(one for one in content["quantities"] if one["key"] == "base_x")["verdict"] == "agrees"


def test_the_installed_wheel_makes_and_solves_its_examples(environment, tmp_path):
    calib = environment / "bin" / "calib"
    run(calib, "example", "plumb", "--out", "job", cwd=tmp_path)
    run(calib, "solve", "job/job.toml", "--out", "results", cwd=tmp_path)
    assert "plumb" in (tmp_path / "results" / "report.html").read_text()
