"""What discoveries say of the published tables, with the care that small tables need."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parent.parent / "benchmarks" / "discrepancy_papers.py"
SAME = {("angle_scale", "theta"), ("drift", "reading"), ("slip", "reading")}


@pytest.fixture(scope="module", name="papers")
def _papers():
    spec = importlib.util.spec_from_file_location("discrepancy_papers", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module", name="said")
def _said(papers):
    return {case.name: papers.said(case) for case in papers.every_case()}


@pytest.mark.slow
def test_every_table_of_readings_is_judged(said):
    assert len(said) == 18
    assert all(one["verdict"] and one["sentence"] for one in said.values())


@pytest.mark.slow
@pytest.mark.parametrize("column", ["table 1, B1", "table 1, B2", "table 2, horizontal", "table 2, pitch",
                                    "table 2, spin"])
def test_growth_with_the_turn_is_one_set_of_causes_that_nothing_tells_apart(said, column):
    (effect,) = said[column]["effects"]
    assert {(effect["name"], effect["channel"]), *map(tuple, effect["alias"])} >= SAME
    assert said[column]["rms"][1] < 0.35


@pytest.mark.slow
def test_the_rod_agrees_with_the_polygon_and_only_the_stated_u_is_too_large(said):
    assert said["table 1, A1-B2"]["verdict"] == "noise-misstated"
    assert said["table 1, A1-B2"]["rms"][0] < 0.3


@pytest.mark.slow
def test_no_effect_is_named_where_the_scatter_is_larger_than_assumed(said):
    for name in ("table 2, filaments", "table 3, targets of the pitch axes", "tables 1 to 4 jointly"):
        assert said[name]["effects"] == []
        assert 1.5 < said[name]["rms"][0] < 1.9


@pytest.mark.slow
def test_what_a_small_table_could_have_shown_stands_beside_its_verdict(said):
    level = said["table 1, level on two yaw axes"]
    assert level["verdict"] == "consistent"
    could = {(effect, parameter): size for effect, parameter, size, _, _ in level["could_be_seen"]}
    assert could["tilt_motion_3x (three-axis)", "c"] < 1.5          # arcsec
    assert level["too_small_to_be_seen"] == ["gain (reading)"]


@pytest.mark.slow
def test_the_tied_start_of_the_base_point_is_the_strongest_candidate_and_goes_with_a_free_start(said):
    tied, free = (said[f"table 2, start {start}, digits repaired"] for start in ("tied", "free"))
    assert tied["best"][0][0] == "start_offset (d)"
    assert tied["best"][0][1] == pytest.approx(34.9, abs=0.1)
    assert tied["verdict"] != "consistent"
    assert free["verdict"] == "consistent"
    assert free["rms"][0] == pytest.approx(0.7115, abs=1e-3)


@pytest.mark.slow
def test_the_residuals_of_the_base_point_hang_together_along_the_guides(papers, monkeypatch):
    monkeypatch.setattr(papers, "DRAWS", 4000)
    study = papers.correlation_of_table_2(seed=2)
    assert study["lag_one"] == pytest.approx(0.437, abs=1e-3)
    assert study["p_lag_one"] < 0.003
    assert "travel on both lines" in study["best"]
    assert study["p_best_corrected"] < 0.02
    wider = [b / a for a, b in zip(*(study["base_point"][k]["u_um"] for k in ("independent", "with memory")),
                                   strict=True)]
    assert all(1.2 < ratio < 1.5 for ratio in wider)
