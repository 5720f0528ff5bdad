"""`calib discover`: the answer file, the page, and the public cases with their truth."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from command import runner

from calib.workflow.discrepancy.answer import in_case_units
from calib.workflow.discrepancy.conclusion import NamedEffect
from problems import plumb

BESIDE = Path(__file__).parents[2] / "shared" / "reference_data"
EXAMPLES = Path(os.environ.get("CALIB_REFERENCE_DATA", BESIDE)).parent / "discrepancy_examples"
CASES = sorted(path.name for path in EXAMPLES.glob("example_*")) if EXAMPLES.is_dir() else []
KEYS = {"format", "case", "verdict", "p_value", "effects", "outlier_rows", "noise_factor", "rms", "heldout_rms",
        "where", "structure", "hidden", "next_measurement"}


@pytest.mark.skipif(not CASES, reason="the public cases are not beside the reference data")
@pytest.mark.parametrize("name", CASES)
def test_every_public_case_is_answered_as_its_truth_says(calib, name):
    truth = json.loads((EXAMPLES / name / "truth.json").read_text(encoding="utf-8"))
    ran = calib("discover", EXAMPLES / name, "--json")
    assert ran.status == 0
    found = json.loads(ran.out)
    assert set(found) >= KEYS
    assert found["case"] == name
    assert found["verdict"] == truth["verdict"]
    assert found["outlier_rows"] == truth["outlier_rows"]
    assert [(e["name"], e["channel"]) for e in found["effects"]] == [
        (e["name"], e["channel"]) for e in truth["effects"]]
    for mine, theirs in zip(found["effects"], truth["effects"], strict=True):
        for parameter, oracle in theirs["oracle"].items():
            assert abs(mine["parameters"][parameter]["value"] - oracle["value"]) < 1e-3 * oracle["u"]
            assert mine["parameters"][parameter]["u"] == pytest.approx(oracle["u"], rel=1e-3)
            assert mine["parameters"][parameter]["unit"] == theirs["parameters"][parameter]["unit"]
    for key in ("rms", "heldout_rms"):
        assert found[key]["before"] == pytest.approx(truth[key]["before"], rel=1e-4)
        assert found[key]["after"] == pytest.approx(truth[key]["oracle_after"], rel=1e-4)


@pytest.fixture
def calib(capsys):
    return runner(capsys)


def job_with(folder: Path, change, seed: int = 3) -> Path:
    """The example job of the plumb fit with its readings changed: (angle [deg], minutes, reading) -> reading."""
    for name, text in plumb.example_job(seed).items():
        lines = text.splitlines()
        if name.endswith(".csv"):
            header = next(i for i, line in enumerate(lines) if line.startswith("table"))
            for i in range(header + 1, len(lines)):
                cells = lines[i].split(",")
                cells[-1] = f"{change(*map(float, cells[-3:])):.3f}"
                lines[i] = ",".join(cells)
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / "job.toml"


def test_a_drift_in_a_job_is_named_and_the_page_says_it_first(calib, tmp_path):
    job = job_with(tmp_path, lambda angle, minutes, reading: reading + 0.8 * minutes / 60)
    ran = calib("discover", job, "--out", tmp_path / "out")
    assert ran.status == 0
    found = json.loads((tmp_path / "out" / "answer.json").read_text(encoding="utf-8"))
    (effect,) = found["effects"]
    assert (effect["name"], effect["channel"]) == ("drift", "reading")
    rate = effect["parameters"]["rate"]
    assert abs(rate["value"] - 0.8) < 3 * rate["u"]
    assert found["heldout_rms"]["after"] < found["heldout_rms"]["before"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert page.index("Missing in the model: drift (reading)") < page.index("<h2>")
    assert page.count("<svg") >= 3
    assert "://" not in page.replace("http://www.w3.org", "")


def test_an_unchanged_job_is_consistent(calib, tmp_path):
    job = job_with(tmp_path, lambda angle, minutes, reading: reading)
    ran = calib("discover", job, "--json")
    found = json.loads(ran.out)
    assert found["verdict"] == "consistent"
    assert found["effects"] == []
    assert found["rms"]["before"] == found["rms"]["after"]


def test_structure_without_a_name_is_described_and_no_effect_is_given(calib, tmp_path):
    job = job_with(tmp_path, lambda angle, minutes, reading: reading + 1.2 * np.exp(-0.5 * ((angle - 40) / 8) ** 2))
    found = json.loads(calib("discover", job, "--json").out)
    assert found["verdict"] == "unknown-structure"
    assert found["effects"] == []
    assert found["structure"][0]["covariate"] == "angle"


def test_the_cosine_error_is_given_as_an_angle_in_milliradians():
    beta, u = 4e-3, 1e-4
    one = NamedEffect("cosine", "x", {"kappa": (1 / np.cos(beta) - 1, beta * u, "1")}, 0.0, (), "")
    value, its_u, unit = in_case_units(one)["beta"]
    assert unit == "mrad"
    assert value == pytest.approx(4.0, rel=1e-6)
    assert its_u == pytest.approx(0.1, rel=1e-4)


def test_a_column_of_one_value_is_said_in_words(calib, tmp_path):
    job = job_with(tmp_path, lambda angle, minutes, reading: reading)
    table = (tmp_path / "level.csv").read_text(encoding="utf-8").splitlines()
    head = next(i for i, line in enumerate(table) if line.startswith("table"))
    place = table[head].split(",").index("direction")
    for i in range(head + 1, len(table)):
        cells = table[i].split(",")
        cells[place] = "1"
        table[i] = ",".join(cells)
    (tmp_path / "level.csv").write_text("\n".join(table) + "\n", encoding="utf-8")
    found = json.loads(calib("discover", job, "--json").out)
    assert any("'direction' never varies" in remark for remark in found["remarks"])


def test_too_few_readings_to_hold_out_are_said_in_words(calib, tmp_path):
    job = job_with(tmp_path, lambda angle, minutes, reading: reading)
    table = (tmp_path / "level.csv").read_text(encoding="utf-8").splitlines()
    head = next(i for i, line in enumerate(table) if line.startswith("table"))
    one, other = (table[head + 1:head + 39], table[head + 39:])
    (tmp_path / "level.csv").write_text("\n".join([*table[:head + 1], *one[:16:3], *other[:16:3]]) + "\n",
                                        encoding="utf-8")
    found = json.loads(calib("discover", job, "--json").out)
    assert found["heldout_rms"] is None
    assert any("too few to hold any out" in remark for remark in found["remarks"])
