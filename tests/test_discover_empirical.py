"""Structure without a name, kept as an empirical term where the caller asks."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command import runner

import calib
from calib import linearise, predict, solve
from calib.errors import CalibrationError
from calib.units import arcsec, degree
from calib.workflow.discrepancy.empirical import kept
from problems import plumb, turntable

U = 0.2 * arcsec
ANGLE = np.arange(0.0, 720.0, 10.0)


def readings(seed: int) -> np.ndarray:
    """A level over two turns with four waves in a turn, which no candidate has [arcsec]."""
    noise = np.random.default_rng(seed).standard_normal(len(ANGLE))
    return 5.0 * np.sin(np.radians(ANGLE)) + 0.2 * noise + 0.6 * np.cos(np.radians(4 * ANGLE) - 0.5)


def problem(seed: int):
    declared = plumb.declare(ANGLE * degree, readings(seed) * arcsec, U)
    return declared.with_effects(*declared.acting(plumb.effects()))


def test_a_harmonic_that_no_effect_has_is_kept_with_its_size_and_uncertainty():
    found = calib.explain(problem(2))
    assert found.verdict == "unknown-structure"
    check = {"level": np.arange(len(ANGLE)) % 5 == 2}
    more = kept(calib.explain(problem(2), check=check), check)
    (term,) = more.terms
    value, u = more.estimate[term] / arcsec, [p["u"] for p in more.content()["parameters"]]
    assert np.abs(value - 0.6 * np.array([np.cos(0.5), np.sin(0.5)])).max() < 4 * max(u)
    assert more.rms == pytest.approx(1.0, abs=0.25)
    assert more.heldout_rms[1] < 0.6 * more.heldout_rms[0]
    assert more.problem.observations[0].slots == problem(2).observations[0].slots
    assert linearise(more.estimate).dof == found.before.dof - 2


def test_without_size_an_empirical_term_changes_no_prediction():
    tracked = turntable.example(1)
    seen = tracked.observations[0]
    term = calib.Unknown("term", np.zeros((1, 2)), "m")
    columns = np.random.default_rng(1).normal(size=(seen.n, 3, 2))
    added = tracked.with_addition(seen.group, term, columns)
    estimate = solve(tracked)
    np.testing.assert_array_equal(predict(tracked, estimate)[seen.group], predict(added, estimate)[seen.group])
    values = {u: estimate[u] for u in tracked.unknowns} | {term: np.array([[1e-6, -2e-6]]).reshape(term.shape)}
    moved = predict(added, values)[seen.group] - predict(tracked, estimate)[seen.group]
    np.testing.assert_allclose(moved, columns @ [1e-6, -2e-6], atol=1e-14)


def test_where_nothing_was_described_nothing_can_be_kept():
    with pytest.raises(CalibrationError, match="no structure was described"):
        kept(calib.explain(plumb.example(1)))


def test_the_command_keeps_a_structure_only_when_asked(capsys, tmp_path):
    command = runner(capsys)
    lines = ["row,table,angle_deg,reading_arcsec"]
    lines += [f"{i + 1},T,{a:.1f},{r:.4f}" for i, (a, r) in enumerate(zip(ANGLE, readings(4), strict=True))]
    (tmp_path / "level.csv").write_text("# source: simulated\n" + "\n".join(lines) + "\n", encoding="utf-8")
    (tmp_path / "job.toml").write_text(
        'problem = "problems.plumb"\n[data.level]\nfile = "level.csv"\ninstrument = "level"\n[instruments.level]\n'
        'u = "0.2 arcsec"\n', encoding="utf-8")
    plain = json.loads(command("discover", tmp_path / "job.toml", "--json").out)
    asked = json.loads(command("discover", tmp_path / "job.toml", "--keep-structure", "--json").out)
    assert plain["verdict"] == asked["verdict"] == "unknown-structure"
    assert "empirical" not in plain
    assert asked["effects"] == []
    assert asked["empirical"]["rms"] < 0.5 * plain["rms"]["before"]
    assert {p["unit"] for p in asked["empirical"]["parameters"]} == {"arcsec"}
