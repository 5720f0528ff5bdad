"""`calib discover` where the input cannot be used or shows little: what is wrong, in words, and what to measure."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command import runner

import calib
from calib import Observations, Problem, Unknown, simulate
from calib.errors import CalibrationError
from calib.units import arcsec, degree
from problems import plumb

CASE = """format = 1
case = "level"
scenario = "level_plumb"

[instruments.level]
sigma_arcsec = 0.2

[known]
tables = ["T1"]
reference_temperature_C = 20.0

[[known.applied_tilt]]
setup = 1
dtheta_x_arcsec = 0.0
dtheta_y_arcsec = 0.0

[[columns]]
name = "angle_deg"
meaning = "angle of the table"
unit = "deg"
"""
HEADER = "row,split,table,setup,block,sweep,direction,angle_deg,time_min,temp_C,reading_arcsec"
VERDICTS = {"consistent", "effects", "unknown-structure", "noise-misstated", "outliers"}


@pytest.fixture(name="discover")
def _discover(capsys):
    command = runner(capsys)
    return lambda folder, *words: command("discover", folder, *words)


@pytest.fixture(name="case")
def _case(tmp_path):
    """A case folder without anything hidden: a level on one table, up and down, 38 readings."""
    sweep = np.arange(0.0, 91.0, 5.0)
    angle = np.concatenate([sweep, sweep[::-1]])
    drawn = simulate(plumb.declare(angle * degree, np.zeros(len(angle)), 0.2 * arcsec),
                     {"zero": np.array([30 * arcsec]), "plumb": np.array([[4.0, -3.0]]) * arcsec}, seed=4)
    readings = np.asarray(drawn.observations[0].readings)[:, 0] / arcsec
    rows = []
    for i, (a, r) in enumerate(zip(angle, readings, strict=True)):
        split, sweep, way = "check" if i % 6 == 3 else "fit", 1 + (i >= 19), 1 if i < 19 else -1
        warm = 20 + 0.3 * np.sin(i / 5)
        rows.append(f"{i + 1},{split},T1,1,{sweep},{sweep},{way},{a:.1f},{2 * i},{warm:.2f},{r:.3f}")
    (tmp_path / "case").mkdir()
    (tmp_path / "case" / "case.toml").write_text(CASE, encoding="utf-8")
    (tmp_path / "case" / "measurements.csv").write_text("\n".join([HEADER, *rows, ""]), encoding="utf-8")
    return tmp_path / "case"


def changed(case: Path, name: str, change) -> Path:
    path = case / name
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    return case


def rows_changed(case: Path, change) -> Path:
    """The case with its rows (lists of cells) put through a function of (number from 0, cells)."""
    lines = (case / "measurements.csv").read_text(encoding="utf-8").splitlines()
    rows = [change(i, line.split(",")) for i, line in enumerate(lines[1:])]
    text = "\n".join([lines[0], *(",".join(cells) for cells in rows if cells), ""])
    (case / "measurements.csv").write_text(text, encoding="utf-8")
    return case


def with_cell(column: str, value: str, only: int | None = None):
    place = HEADER.split(",").index(column)

    def change(i, cells):
        return [*cells[:place], value, *cells[place + 1:]] if only in (None, i) else cells
    return change


def test_the_untouched_case_is_consistent(discover, case):
    ran = discover(case, "--json")
    assert ran.status == 0
    assert json.loads(ran.out)["verdict"] == "consistent"


@pytest.mark.parametrize(("name", "change", "words"), [
    ("case.toml", lambda text: text.replace("level_plumb", "level_plum"), ["level_plum", "there is no problem"]),
    ("case.toml", lambda text: "", ["case.toml", "format"]),
    ("case.toml", lambda text: text.replace("format = 1", "format = 7"), ["line 1", "'format': is 7",
                                                                                   "reads format 1"]),
    ("case.toml", lambda text: text.replace("sigma_arcsec = 0.2", ""), ["instruments.level", "is missing"]),
    ("case.toml", lambda text: text.replace("arcsec = 0.2", "arcsec = 0.0"), ["standard uncertainty", "is 0"]),
    ("measurements.csv", lambda text: "", ["is empty", "header"]),
    ("measurements.csv", lambda text: HEADER + "\n", ["no rows"]),
    ("measurements.csv", lambda text: text.replace("angle_deg", "bearing_deg"), ["'angle' is missing", "bearing_deg"]),
    ("measurements.csv", lambda text: text.replace(".", ";"), ["line 2", "angle_deg"]),
], ids=["unknown scenario", "empty case file", "later format", "no sigma", "sigma of zero", "empty table",
        "header alone", "column missing", "decimal sign"])
def test_what_cannot_be_used_is_said_with_its_place_and_nothing_is_written(
    discover, case, tmp_path, name, change, words
):
    ran = discover(changed(case, name, change), "--out", tmp_path / "out")
    assert ran.status == 2
    assert ran.error.startswith("calib: ")
    for word in words:
        assert word in ran.error
    assert not (tmp_path / "out" / "answer.json").exists()


@pytest.mark.parametrize("value", ["nan", "inf", "1e300", "", "12,5", "broken"])
def test_a_reading_that_is_no_number_is_named_by_line_and_column(discover, case, value):
    ran = discover(rows_changed(case, with_cell("reading_arcsec", value, only=4)))
    assert ran.status == 2
    assert "line 6" in ran.error
    assert "reading_arcsec" in ran.error or "columns" in ran.error or "cells" in ran.error


def test_a_case_that_describes_no_columns_is_read_all_the_same(discover, case):
    ran = discover(changed(case, "case.toml", lambda text: text[:text.index("[[columns]]")]), "--json")
    assert ran.status == 0
    assert json.loads(ran.out)["verdict"] == "consistent"


def test_too_few_readings_to_fit_are_said_with_what_is_missing(discover, case):
    ran = discover(rows_changed(case, lambda i, cells: cells if i < 2 else None))
    assert ran.status == 2
    assert "2 readings for 3 unknowns" in ran.error
    assert "add readings" in ran.error


def test_few_readings_get_a_verdict_that_says_how_little_it_means(discover, case):
    ran = discover(rows_changed(case, lambda i, cells: cells if i < 6 else None), "--json")
    found = json.loads(ran.out)
    assert ran.status == 0
    assert found["verdict"] in VERDICTS
    assert any("hardly anything could be found" in remark for remark in found["remarks"])


@pytest.mark.parametrize(("mark", "words"),
                         [("fit", "No row is marked `check`"), ("check", "Every row is marked `check`"),
                          ("later", "'later', which is neither `fit` nor `check`")])
def test_where_nothing_can_be_held_out_the_gap_is_judged_on_the_fit_and_that_is_said(discover, case, mark, words):
    found = json.loads(discover(rows_changed(case, with_cell("split", mark)), "--json").out)
    assert found["heldout_rms"] is None
    assert any(words in remark for remark in found["remarks"])


def test_a_covariate_that_never_varies_is_named_with_what_it_would_show(discover, case):
    found = json.loads(discover(rows_changed(case, with_cell("direction", "1")), "--json").out)
    assert any("'direction' never varies" in remark for remark in found["remarks"])
    assert found["next_measurement"] == "let direction vary to show hysteresis (reading)"
    sizes = {d["effect"]: d["size"] for d in found["detectable"]}
    assert sizes["hysteresis (reading)"] is None
    assert sizes["drift (reading)"] > 0


def test_candidates_that_all_hide_in_the_unknowns_are_said_in_words():
    angle = np.repeat([0.0, 90.0], 6) * degree
    problem = plumb.declare(angle, 0.2 * arcsec * np.random.default_rng(1).standard_normal(12), 0.2 * arcsec)
    only = [e for e in plumb.effects() if e.name.startswith("tilt_motion")]
    found = calib.explain(problem.with_effects(*only).hold("zero"))
    assert found.verdict == "consistent"
    assert any("Not one of the known effects" in remark for remark in found.remarks)


def test_a_problem_without_candidates_is_still_judged():
    angle = np.arange(0, 360, 10) * degree
    errors = 0.2 * arcsec * (np.random.default_rng(2).standard_normal(36) + 6 * np.cos(3 * angle))
    found = calib.explain(plumb.declare(angle, errors, 0.2 * arcsec))
    assert found.verdict == "unknown-structure"
    assert found.structure[0].shape == "harmonic 3"
    assert "finer steps of angle" in found.next_measurement


def test_a_fit_that_stops_half_way_is_said_and_names_what_to_do():
    from casadi import atan

    steep, middle = Unknown("steepness", 40.0, "1"), Unknown("middle", 3.0, "1")
    problem = Problem([Observations(lambda k, m, t: atan(1e3 * k * (t - m)), steep, middle, np.linspace(0, 1, 20),
                                    readings=np.linspace(3, 9, 20), u=1e-9)])
    with pytest.raises(CalibrationError, match="does not converge"):
        calib.explain(problem)


def test_readings_in_another_unit_are_answered_with_the_advice_to_look_at_the_columns(discover, case):
    place = HEADER.split(",").index("reading_arcsec")
    ran = discover(rows_changed(case, lambda i, cells: [*cells[:place], str(3600 * float(cells[place]) + i % 7 * 900)]),
                   "--json")
    assert ran.status == 0
    assert any("check units, signs and order of the columns" in remark for remark in json.loads(ran.out)["remarks"])
