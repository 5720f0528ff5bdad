"""Score tests: what a held effect would explain, against the refit that frees it."""

from __future__ import annotations

import numpy as np
import pytest

from calib import linearise, solve
from calib.analyse.score import candidates, field_of, scores
from problems import axis_points, plumb


@pytest.fixture(scope="module")
def fit():
    return linearise(solve(plumb.example(4)))


@pytest.mark.parametrize("label", ["drift (reading)", "hysteresis (reading)", "tilt_motion_2x (three-axis)"])
def test_the_statistic_is_the_drop_of_a_refit(fit, label):
    problem = plumb.example(4)
    before = solve(problem)
    one = next(s for s in scores(linearise(before)) if s.candidate.label == label)
    after = solve(problem.free(one.candidate.selection))
    assert before.objective - after.objective == pytest.approx(one.statistic, rel=1e-6)
    assert before.dof - after.dof == one.dof
    found = after.values[one.candidate.unknown][one.candidate.instance]
    assert np.all(np.abs(found - one.step) < 1e-6 * one.u)


def test_an_effect_that_the_unknowns_absorb_has_no_separability(fit):
    step = next(s for s in scores(fit) if s.candidate.label == "step (reading@2)")
    assert step.dof == 0
    assert step.separability == pytest.approx(0.0, abs=1e-9)
    assert step.p_value == 1.0


def test_separability_is_between_zero_and_one_and_smaller_where_unknowns_imitate(fit):
    found = {s.candidate.label: s.separability for s in scores(fit)}
    assert all(-1e-12 <= value <= 1 + 1e-12 for value in found.values())
    assert found["tilt_motion_2x (three-axis)"] < found["gain (reading)"]


def test_redundancy_adds_up_to_the_degrees_of_freedom(fit):
    field = field_of(fit, candidates(fit))
    assert float(np.sum(field.redundancy)) == pytest.approx(fit.dof, abs=1e-9)
    assert field.dof == fit.dof
    assert field.squares == pytest.approx(fit.objective, rel=1e-9)


@pytest.mark.slow
def test_p_values_of_clean_readings_are_uniform():
    values = []
    for seed in range(30):
        p = {s.candidate.label: s.p_value for s in scores(linearise(solve(axis_points.example(seed))))}
        values += [p["collimation (H)"], p["vertical_index (V)"]]
    # Kolmogorov-Smirnov at 0.1%: 1.95/sqrt(n)
    ordered = np.sort(values)
    steps = np.arange(1, len(ordered) + 1) / len(ordered)
    assert np.max(np.abs(ordered - steps + 0.5 / len(ordered))) < 1.95 / np.sqrt(len(ordered))
