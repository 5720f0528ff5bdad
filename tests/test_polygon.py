"""Polygon and rotary table: closure, and what several starting faces tell apart."""

import numpy as np
import pytest
from folders import put

import calib
from calib.errors import InputError, RankDefect
from calib.job import Job
from calib.units import arcsec
from problems import polygon


def readings_of(face, table, starts, zero=0.0):
    """Readings written out: zero + face j + k - 1 + stop k, the circle closed on its first face."""
    faces = len(face)
    stop = np.tile(np.arange(faces + 1), len(starts))
    first = np.repeat(starts, faces + 1)
    return stop, first, np.array([zero + face[(j - 1 + k) % faces] + table[k % faces] for j, k in zip(first, stop)])


def deviations(seed, faces=12):
    drawn = np.random.default_rng(seed).normal(0.0, 2.0 * arcsec, (2, faces))
    return drawn - drawn.mean(axis=1, keepdims=True)


def test_two_neighbouring_starts_give_both_circles_exactly():
    face, table = deviations(1)
    stop, first, readings = readings_of(face, table, (1, 2), zero=7 * arcsec)
    estimate = calib.solve(polygon.declare(stop, first, first, readings, 12, 0.1 * arcsec))
    assert np.allclose(estimate["face"].ravel(), face, atol=1e-9 * arcsec)
    assert np.allclose(estimate["table"].ravel(), table, atol=1e-9 * arcsec)
    assert np.allclose(estimate["zero"].ravel(), 7 * arcsec)


@pytest.mark.parametrize("starts, defect", [
    ((1,), 11), ((1, 2), 0), ((1, 3), 1), ((1, 5), 3), ((1, 7), 5), ((1, 4, 7), 2), ((1, 4, 5), 0), ((1, 12), 0)])
def test_the_words_about_starting_faces_are_what_estimability_finds(starts, defect):
    stop, first, _ = readings_of(*deviations(1), starts)
    known = calib.estimability(calib.linearise(polygon.declare(stop, first, first, None, 12, 0.1 * arcsec)))
    assert known.defect == defect
    words = polygon.separating_starts(starts, 12)
    assert ("are separated" in words) == (defect == 0) and (defect == 0 or f"{defect} directions" in words)


def test_one_starting_face_is_refused_by_the_solver_with_faces_and_stops_named():
    stop, first, readings = readings_of(*deviations(1), (1,))
    with pytest.raises(RankDefect, match=r"face\[.*table\["):
        calib.solve(polygon.declare(stop, first, first, readings, 12, 0.1 * arcsec))


def test_deviations_are_found_within_their_u():
    """30 simulated calibrations: standardised errors of faces and stops have unit mean square."""
    errors = []
    face, table = deviations(3)
    stop, first, _ = readings_of(face, table, (1, 2, 5))
    problem = polygon.declare(stop, first, first, None, 12, 0.2 * arcsec)
    truth = {"face": face[:, None], "table": table[:, None]}
    for seed in range(30):
        fit = calib.linearise(calib.solve(calib.simulate(problem, truth, seed)))
        known = calib.covariance(fit, "face", "table")
        errors.append((known.values - np.append(face, table)) / known.u)
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=0.2)


def test_a_drift_is_seen_by_the_closing_reading():
    problem = polygon.example(2)
    drift = problem.attached_effect("drift (autocollimator)").effect
    size = np.array([5.0 * arcsec / 3600])
    estimate = calib.solve(calib.simulate(problem, {problem.parameters(drift): size}, 6).free(drift))
    u = calib.covariance(calib.linearise(estimate), drift).u
    assert np.abs((estimate[drift] - size) / u).max() < 4.0 and size[0] > 5.0 * u[0]


@pytest.mark.parametrize("change, words", [
    ({"stop": [0, 1, 13]}, "row 3: stop 13"), ({"start_face": [0, 0, 0]}, "row 1: starting face 0"),
    ({"start_face": [1, 2, 1]}, "series 'a' starts on faces 1, 2"), ({"faces": 2}, "2 faces")])
def test_a_stop_or_face_that_cannot_be_is_refused_with_its_row(change, words):
    given = {"stop": [0, 1, 2], "series": ["a"] * 3, "start_face": [1, 1, 1], "readings": [0.0] * 3, "faces": 12,
             "u": arcsec}
    with pytest.raises(InputError, match=words):
        polygon.declare(**{**given, **change})


def test_the_example_job_is_read_and_solved(tmp_path):
    job = Job.read(put(tmp_path, polygon.example_job(3)))
    estimate = calib.solve(polygon.from_job(job))
    job.refuse_unknown_keys()
    assert estimate.certificate.passed and estimate.dof == 39 - (24 + 3 - 2)
