"""`calib discover` where several instruments meet: joint networks, survey networks, mechanisms; the truth is sealed."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import runner
from discover_cases import KINDS, gkf, hide, joint_network, judged, survey, write

import calib
from calib import predict, simulate, solve
from calib.units import mm, ppm, um
from problems import network

BENCHMARK = Path(__file__).parent.parent / "benchmarks" / "discrepancy_hidden.py"


@pytest.fixture(name="command")
def _command(capsys):
    return runner(capsys)


def with_effect(problem, label, key, value, seed):
    """The network with readings drawn anew, one station's instrument with an error."""
    attached = problem.attached_effect(label)
    parameters = np.zeros((attached.unknown.count, attached.unknown.freedom))
    parameters[attached.keys.index(key)] = value
    return simulate(problem, {attached.unknown: parameters.reshape(attached.unknown.shape)}, seed)


@pytest.mark.slow
def test_the_zero_of_a_tracker_shows_through_the_other_instruments_only():
    problem = with_effect(joint_network(1), "range_offset (each station range)", "B", 150 * um, 5)
    found = calib.explain(problem)
    (one,) = found.effects
    assert ("range_offset", "B range") in {(one.name, one.channel), *one.aliases}
    tracker = next(o for o in problem.observations if o.group == "tracker")
    alone = problem.without("bar", "ranges").keep({"tracker": tracker.covariates["station"] == "B"})
    blind = calib.explain(alone.hold("station"))
    assert blind.verdict == "consistent"
    assert {r.label: r.dof for r in blind.ranking}["range_offset (B range)"] == 0
    assert any("hardly anything could be found" in remark for remark in blind.remarks)


@pytest.mark.slow
def test_an_instrument_that_moved_between_settings_is_found_as_a_step_of_its_station():
    problem = with_effect(joint_network(2), "step (each station tracker_x@2)", "C", 400 * um, 6)
    found = calib.explain(problem)
    assert found.verdict == "effects"
    assert {e.name for e in found.effects} == {"step"}
    assert all(e.channel.startswith("C tracker_") for e in found.effects)


def test_a_blunder_is_left_out_of_its_own_table_where_several_number_their_rows_alike():
    plan = survey(3)
    problem = network.declare(plan)
    far = next(o for o in problem.observations if o.group == "slope distance")
    readings = np.array(far.readings)
    readings[4] += 20 * mm
    found = calib.explain(problem.with_readings({far.group: readings}))
    assert found.verdict == "outliers"
    assert [(one.group, one.row) for one in found.outliers] == [("slope distance", far.rows[4])]
    assert f"row {far.rows[4]} of slope distance is a blunder" in found.sentence
    assert sum(o.n for o in found.after.problem.observations) == sum(o.n for o in problem.observations) - 1


def test_the_scale_of_distances_in_a_survey_file_is_named(command, tmp_path):
    plan = survey(3)
    problem = network.with_candidates(network.declare(plan))
    drawn = simulate(problem, {problem.parameters("scale (distance)"): np.array(40 * ppm).reshape(
        problem.parameters("scale (distance)").shape)}, 4)
    readings = {o.group: np.asarray(o.readings) for o in drawn.observations}
    path = tmp_path / "network.gkf"
    path.write_text(gkf(replace(plan, batches=[replace(b, readings=readings[b.group]) for b in plan.batches])),
                    encoding="utf-8")
    ran = command("discover", path, "--json")
    assert ran.status == 0
    answer = json.loads(ran.out)
    assert [(e["name"], e["channel"]) for e in answer["effects"]] == [("scale", "distance")]
    size = answer["effects"][0]["parameters"]["s"]
    assert size["unit"] == "ppm"
    assert abs(size["value"] - 40) < 3 * size["u"]


def test_a_survey_file_without_errors_is_consistent(command, tmp_path):
    path = tmp_path / "network.gkf"
    path.write_text(gkf(survey(5)), encoding="utf-8")
    found = json.loads(command("discover", path, "--json").out)
    assert found["verdict"] == "consistent"


@pytest.mark.slow
def test_the_analysis_cannot_open_the_truth(tmp_path):
    (tmp_path / "truths").mkdir()
    (tmp_path / "truths" / "case.json").write_text("{}")
    code = (f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); from pathlib import Path; "
            f"from discover_cases import seal; folder = Path({str(tmp_path / 'truths')!r}); seal(folder); "
            "open(folder / 'case.json')")
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ran.returncode != 0
    assert "which the analysis does not see" in ran.stderr


def test_what_is_hidden_is_drawn_from_the_candidates_of_the_problem_and_changes_its_readings():
    problem = KINDS["table on a slide, declared by hand"](4)
    hidden = hide(problem, 4, 2, 3.0)
    offered = {(a.effect.name, a.effect.channel) for a in problem.attached}
    assert len(hidden.effects) == 2
    assert {(name, channel) for name, channel, _ in hidden.effects} <= offered
    nominal = predict(problem, solve(problem))["points"]
    assert np.sqrt(np.mean((hidden.readings["points"] - nominal) ** 2)) > 4 * um


@pytest.mark.slow
def test_hidden_effects_are_named_behind_a_sealed_truth(tmp_path):
    for name in ("cases", "truths"):
        (tmp_path / name).mkdir()
    written = sum(write(kind, seed, count, 3.0, tmp_path / "cases", tmp_path / "truths")
                  for kind in KINDS for seed, count in ((7101, 0), (7101, 1), (7102, 1)))
    assert written > 2 * len(KINDS)
    subprocess.run([sys.executable, str(BENCHMARK), "--analyse", str(tmp_path)], check=True)
    outcomes = []
    for path in sorted((tmp_path / "truths").glob("*.json")):
        truth, answer = (json.loads(one.read_text()) for one in
                         (path, tmp_path / "cases" / f"{path.stem}.answer.json"))
        outcomes.append((truth, judged(truth, answer)))
    clean = [one for truth, one in outcomes if not truth["effects"]]
    hidden = [one for truth, one in outcomes if truth["effects"]]
    assert sum(one.alarmed for one in clean) <= 1
    assert sum(one.all_or_alias for one in hidden) >= 0.9 * len(hidden)
    assert all(one.rms[1] < one.rms[0] for one in hidden if one.verdict == "effects")

