"""Positioning of a rotary table: effects and what tells them apart, methods side by side, figures of ISO 230-2."""

import numpy as np
import pytest
from folders import put

import calib
from calib.errors import InputError
from calib.job import Job
from calib.units import arcsec, degree, minute, ppm
from problems import positioning, two_way

TURN = np.arange(13) * 30.0 * degree
STRAIGHT = ("angle_scale (theta)", "drift (reading)", "slip (reading)")


def test_a_scale_is_the_straight_line_through_the_deviations():
    errors = 63e-6 * TURN + np.random.default_rng(1).normal(0.0, 2.0 * arcsec, 13)
    problem = positioning.declare(TURN, TURN + errors, 2.0 * arcsec)
    scale = problem.attached_effect("angle_scale (theta)").effect
    estimate = calib.solve(problem.free(scale))
    assert estimate[scale][0] == pytest.approx(np.polyfit(TURN, errors, 1)[0], rel=1e-7)
    assert estimate["zero"] == pytest.approx(np.polyfit(TURN, errors, 1)[1], rel=1e-6)


@pytest.mark.parametrize("label", [e.label for e in positioning.example(1).effects])
def test_an_effect_that_is_there_is_found_with_its_size(label):
    problem = positioning.example(1)
    effect = problem.attached_effect(label).effect
    sizes = {"arcsec": 9 * arcsec, "ppm": 40 * ppm, "arcsec/h": 15 * arcsec / 3600}
    size = np.array([sizes[parameter.unit] for parameter in effect.parameters])
    measured = calib.simulate(problem, {problem.parameters(effect): size}, 3).free(effect)
    estimate = calib.solve(measured)
    assert np.abs((estimate[effect] - size) / calib.covariance(calib.linearise(estimate), effect).u).max() < 4.0


def test_one_way_at_an_even_pace_hides_scale_drift_and_slip_behind_one_another():
    found, directions = positioning.told_apart(positioning.declare(TURN, TURN, arcsec), *STRAIGHT)
    assert len(directions) == 2
    assert all(candidate.separability == 0.0 and candidate.u_alone > 0.0 for candidate in found)


def test_the_way_back_frees_the_scale_and_a_pause_frees_drift_from_slip():
    both = np.concatenate([TURN, TURN[::-1]])
    pause = np.arange(26) * minute + (np.arange(26) >= 13) * 60 * minute
    even, _ = positioning.told_apart(positioning.declare(both, both, arcsec), *STRAIGHT)
    paused, _ = positioning.told_apart(positioning.declare(both, both, arcsec, {"time": (pause, "min")}), *STRAIGHT)
    assert even[0].separability == pytest.approx(1.0, abs=1e-6) and even[1].separability < 0.01
    assert paused[1].separability > 0.1 and paused[2].separability > 0.1


def test_travel_counts_the_way_back_too():
    assert np.allclose(positioning.travelled([0.0, 1.0, 3.0, 1.0]), [0.0, 1.0, 3.0, 5.0])


def test_growth_of_a_method_against_another_is_found_and_their_common_growth_is_the_tables():
    rng = np.random.default_rng(4)
    true = TURN * (1.0 + 63e-6) + np.append(0.0, rng.normal(0.0, 5.0 * arcsec, 12))
    readings = {"A": true + rng.normal(0.0, 0.3 * arcsec, 13),
                "B": true * (1 + 60e-6) + rng.normal(0.0, 1.0 * arcsec, 13)}
    problem = positioning.declare_methods(TURN, readings, {"A": 0.3 * np.sqrt(2) * arcsec, "B": np.sqrt(2) * arcsec})
    estimate = calib.solve(problem)
    value, u = calib.covariance(calib.linearise(estimate), "growth")["growth[B]"]
    assert abs(value - 60e-6) < 4.0 * u and u < 2e-6
    deviation = estimate["deviation"].ravel()
    assert np.polyfit(TURN, deviation, 1)[0] == pytest.approx(63e-6, abs=8e-6)
    assert np.all(estimate.problem.is_held(problem.select("growth").unknown)[0])


# --- ISO 230-2 ---------------------------------------------------------------------------------------------------


def small_two_way():
    """Three positions, two runs each way, deviations [arcsec] chosen so that every figure is seen by eye."""
    position = np.array([0.0, 90.0, 180.0]) * degree
    up = np.array([[0.0, 0.0], [4.0, 6.0], [1.0, 1.0]])
    down = np.array([[-2.0, -2.0], [1.0, 1.0], [0.0, 2.0]])
    command = np.concatenate([np.repeat(position, 2)] * 2)
    direction = np.repeat([1, -1], 6)
    return command, command + np.concatenate([up.ravel(), down.ravel()]) * arcsec, direction


def test_the_figures_of_iso_230_2_are_those_of_the_definitions():
    """By hand: means up 0 5 1, down -2 1 1; s = sqrt 2 at 90 up and 180 down, else 0; B = 4 at 90; E = 5 - (-2) = 7;
    M = 3 - (-1) = 4; A = 5 + 2 sqrt 2 - (-2); R_90 = max(2 sqrt 2 + 4, 4 sqrt 2) = 2 sqrt 2 + 4."""
    estimate = calib.solve(two_way.declare(*small_two_way(), 1.0 * arcsec))
    root = np.sqrt(2.0)
    found = {name: estimate[name] / arcsec for name in "AEMRB"}
    assert found == pytest.approx({"A": 7.0 + 2 * root, "E": 7.0, "M": 4.0, "R": 4.0 + 2 * root, "B": 4.0}, rel=1e-9)


def test_u_of_the_figures_is_that_of_the_means_and_spreads_that_decide_them():
    """Two runs of u = 1: a mean has u^2 = 1/2, a spread 1/2. E, B: two means; M: two half sums of two; A: two means and
    two spreads, doubled; R: both means and both spreads, doubled, at 90 degrees."""
    fit = calib.linearise(calib.solve(two_way.declare(*small_two_way(), 1.0 * arcsec)))
    known = calib.covariance(fit, "A", "E", "M", "R", "B")
    assert np.allclose((known.u / arcsec) ** 2, [1.0 + 4.0, 1.0, 0.5, 1.0 + 4.0, 1.0])


def test_u_of_the_figures_covers_their_scatter_where_the_extremes_stand_clear():
    command, _, direction = small_two_way()
    command, direction = np.tile(command, 5), np.tile(direction, 5)      # ten runs
    truth = np.where(direction > 0, 1.0, -1.0) * np.where(command > 1.0, 20.0, 5.0) * arcsec + 3.0 * command * arcsec
    rng, found = np.random.default_rng(8), []
    for _ in range(60):
        noise = rng.normal(0.0, 1.0 * arcsec, len(command))
        estimate = calib.solve(two_way.declare(command, command + truth + noise, direction, 1.0 * arcsec))
        found.append([estimate[name] for name in "AEB"])
    u = calib.covariance(calib.linearise(estimate), "A", "E", "B").u
    assert np.allclose(np.std(found, axis=0), u, rtol=0.3)               # 60 draws know a spread to 9 %


@pytest.mark.parametrize("leave_out, words", [(0, "1 runs upwards"), (11, "1 runs downwards")])
def test_a_missing_run_is_refused_with_its_position(leave_out, words):
    keep = np.arange(12) != leave_out
    with pytest.raises(InputError, match=words):
        two_way.start(*(column[keep] for column in small_two_way()))


def test_one_reading_says_nothing_about_positioning():
    with pytest.raises(InputError, match="1 readings"):
        positioning.declare([0.0], [0.0], arcsec)


def test_the_example_job_gives_the_figures(tmp_path):
    job = Job.read(put(tmp_path, positioning.example_job(3)))
    estimate = calib.solve(positioning.from_job(job))
    job.refuse_unknown_keys()
    assert estimate.certificate.passed and 0.0 < estimate["M"] <= estimate["E"] <= estimate["A"]


def test_a_job_without_figures_offers_the_effects_of_its_columns(tmp_path):
    files = positioning.example_job(3)
    (tmp_path / "job.toml").write_text(files["job.toml"].replace("figures = true", "harmonics = [3, 12]").replace(
        '[report]\nquantities = ["A", "E", "M", "R", "B"]\n', ""))
    (tmp_path / "readings.csv").write_text(files["readings.csv"])
    labels = {e.label for e in positioning.from_job(Job.read(tmp_path / "job.toml")).effects}
    assert {"harmonic_3 (theta)", "harmonic_12 (theta)", "step (reading@2)", "hysteresis (theta)"} <= labels
