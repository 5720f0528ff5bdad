"""`calib discover` on a job of every shipped problem, and what an answer holds beside the verdict."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from casadi import vertcat
from command import runner
from shipped import modules

import calib
from calib import Effect, Observations, Parameter, Problem, Rotation, direct, linearise, simulate
from calib.units import arcsec, hour
from calib.workflow.discrepancy.answer import answer
from calib.workflow.discrepancy.conclusion import Explanation
from calib.workflow.discrepancy.picture import pictures, separation
from calib.workflow.discrepancy.shown import Shown
from problems import axis_points, plumb

JOBS = {m.__name__.removeprefix("problems."): m for m in modules()
        if m.__name__.count(".") == 1 and callable(getattr(m, "example_job", None))}
VERDICTS = {"consistent", "effects", "unknown-structure", "noise-misstated", "outliers"}


@pytest.fixture(name="command")
def _command(capsys):
    return runner(capsys)


def job_of(name: str, seed: int, folder: Path) -> Path:
    for file, text in JOBS[name].example_job(seed).items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text(text, encoding="utf-8")
    return next(path for path in (folder / "job.toml", folder / "case.toml", *folder.glob("*.gkf")) if path.is_file())


@pytest.mark.slow
@pytest.mark.parametrize("name", JOBS)
def test_a_job_of_every_shipped_problem_gets_a_reasoned_verdict(command, tmp_path, name):
    ran = command("discover", job_of(name, 1, tmp_path), "--json")
    assert ran.status == 0, ran.error
    found = json.loads(ran.out)
    assert found["verdict"] in VERDICTS
    assert found["sentence"].endswith(".")
    assert {"where", "structure", "hidden", "next_measurement", "groups", "results", "detectable"} <= set(found)
    assert bool(found["effects"]) == (found["verdict"] == "effects")


def drifting(rate: float, seed: int, axis: str = "V") -> Explanation:
    """Axis points with a drift of one circle."""
    problem = axis_points.example(1)
    drift = problem.parameters(f"drift ({axis})")
    return calib.explain(simulate(problem, {drift: np.full(drift.shape, rate)}, seed))


@pytest.fixture(scope="module", name="found")
def _found() -> Explanation:
    return drifting(4 * arcsec / hour, 3)


def test_the_gaps_of_the_components_make_up_the_whole(found):
    shown = Shown(found)
    assert [g.group for g in shown.gaps] == ["circles H", "circles V"]
    for k, estimate in enumerate((found.before, found.after)):
        squares = sum(g.readings * g.rms[k] ** 2 for g in shown.gaps)
        assert squares == pytest.approx(estimate.objective, rel=1e-9)
        spare = sum(g.readings * g.rms[k] ** 2 / g.variance_factor[k] for g in shown.gaps)
        assert spare == pytest.approx(estimate.dof, rel=1e-9)
    still, drifts = shown.gaps
    assert drifts.rms[0] > 1.2 * drifts.rms[1]
    assert still.rms[0] == pytest.approx(still.rms[1], rel=0.02)


def test_results_are_shown_before_and_after_with_what_moved(found):
    shown = Shown(found)
    moved = {r.name: r for r in shown.results}
    fits = [linearise(e) for e in (found.before, found.after)]
    labels = fits[0].functions().labels
    assert set(labels) <= set(moved)
    assert any(abs(r.in_u) > 0.5 for name, r in moved.items() if name.endswith(".V"))
    assert all(abs(r.in_u) < 0.5 for name, r in moved.items() if name.startswith("centre") and name.endswith(".H"))
    assert Shown(drifting(0.0, 5)).results == ()


def test_the_first_picture_is_drawn_against_what_drives_the_effect(found):
    first = pictures(Shown(found), 3)[0]
    assert first.label == "time / min"
    assert "circles V" in first.caption
    assert first.key_label == "face"         # the zenith angle is read the other way round on the second face
    on = first.keys == first.keys[0]
    slope = [abs(np.polyfit(first.x[on], y[on], 1)[0]) for y in (first.before, first.after)]
    assert slope[0] > 5 * slope[1]


def test_structure_that_the_second_face_turns_round_is_drawn_the_right_way_round():
    problem = axis_points.example(1)
    seen = problem.observations[0]
    known = {a.name: a.data for a in seen.arguments}
    wave = 3 * arcsec * np.cos(4 * known["angle"]) * known["face"]
    whole = np.asarray(seen.readings) + np.stack([np.zeros(len(wave)), wave.ravel()], axis=1)
    found = calib.explain(problem.with_readings({seen.group: whole}))
    assert found.verdict == "unknown-structure"
    first = pictures(Shown(found), 1)[0]
    assert "turned with the face" in first.caption
    assert np.corrcoef(first.before, np.cos(4 * np.radians(first.x)))[0, 1] > 0.8


def test_a_rotation_that_an_effect_turns_is_said_to_move():
    turn = Rotation("turn")
    points = np.random.default_rng(6).normal(size=(40, 3))

    def seen(frame, point, *, spindle=direct):
        return frame @ spindle(point)

    late = (np.arange(40) >= 20).astype(float)
    slip = Effect("slip", "spindle", lambda value, p, late: p.angle * late * vertcat(-value[1], value[0], 0),
                  (Parameter("angle", "rad", (1e-4, 1e-1)),))
    plan = Problem([Observations(seen, turn, points, readings=points, u=1e-3, group="points",
                                 covariates={"late": late})], effects=[slip])
    found = calib.explain(simulate(plan, {plan.parameters("slip (spindle)"): np.array([[0.02]])}, 1))
    assert [e.name for e in found.effects] == ["slip"]
    moved = {r.name: r for r in Shown(found).results}
    assert abs(moved["turn.z"].after[0] - moved["turn.z"].before[0] + 0.01) < 4 * moved["turn.z"].after[1] + 0.002


def test_the_alias_map_has_ones_on_its_diagonal_and_the_named_effect_first(found):
    mapped = separation(Shown(found))
    assert mapped.labels[0] == "drift (V)"
    assert np.allclose(np.diag(mapped.matrix), 1.0)
    assert mapped.matrix.max() <= 1.0 + 1e-9


def test_what_hides_in_the_unknowns_is_never_said_to_be_detectable():
    found = calib.explain(plumb.example(1))
    content = answer("plumb", found)
    unseen = {r.label for r in found.ranking if not r.dof}
    assert unseen
    assert {d["effect"] for d in content["detectable"] if d["size"] is None} == unseen


@pytest.mark.slow
def test_an_effect_of_the_size_called_detectable_is_found_four_times_in_five():
    size = next(d for d in Shown(drifting(0.0, 4)).detectable if d.effect == "drift (V)")
    seen = [bool(drifting(size.size * arcsec / hour, seed).effects) for seed in range(100, 130)]
    assert size.unit == "arcsec/h"
    assert 0.65 <= np.mean(seen) <= 0.97
