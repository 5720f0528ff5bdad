"""The serial arm: simulated errors are covered, postures that were not used are predicted, the real arm is
calibrated."""

import os
from pathlib import Path

import numpy as np
import pytest
from folders import put

import calib
from calib.errors import InputError
from calib.job import Job
from problems import serial_arm

REAL = Path(os.environ.get("CALIB_REFERENCE_DATA", Path(__file__).parents[2] / "shared" / "reference_data"))
needs_real_data = pytest.mark.skipif(not (REAL / "panda").is_dir(), reason="the recorded arm is not here")


@pytest.fixture(scope="module")
def job_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    put(folder, serial_arm.example_job(3))
    return folder


@pytest.mark.slow
def test_postures_that_were_not_used_are_predicted_far_better_than_by_the_urdf(job_folder):
    job = Job.read(job_folder / "job.toml")
    estimate = calib.solve(serial_arm.from_job(job))
    assert estimate.certificate.passed
    rows = {name: (before, after) for name, before, after, _ in serial_arm.heldout(job, estimate)}
    before, after = rows["mean distance error (shelf, not used)"]
    assert before > 1.0 and after < 0.1 * before
    prior, expected = rows["mean distance error to be expected by the stated uncertainties (shelf, not used)"]
    assert after == pytest.approx(expected, rel=0.4) and before == pytest.approx(prior, rel=0.6)
    before, after = rows["mean distance error (bench, used)"]
    assert after < 0.12        # seats of 0.05 mm in each component miss by 0.08 mm on average


def test_simulated_errors_of_every_family_lie_within_their_stated_uncertainty():
    problem, truth = serial_arm.simulated(1, 1)
    estimate = calib.solve(problem)
    found = calib.covariance(calib.linearise(estimate), *(problem.select(name) for name in truth))
    standardised = (found.values - np.concatenate([np.ravel(v) for v in truth.values()])) / found.u
    assert np.abs(standardised).max() < 4.5
    assert np.sqrt(np.mean(standardised ** 2)) < 1.6


@pytest.mark.slow
def test_the_stated_intervals_cover_the_truth_in_fifty_repetitions():
    problem, truth = serial_arm.simulated(0, 1)
    names = [problem.select(name) for name in truth]
    true = np.concatenate([np.ravel(v) for v in truth.values()])
    start, inside, squares = calib.solve(problem), [], []
    for seed in range(50):
        found = calib.covariance(calib.linearise(calib.solve(calib.simulate(problem, truth, seed), start=start)),
                                 *names)
        standardised = (found.values - true) / found.u
        inside.append(np.abs(standardised) < 1.96)
        squares.append(standardised ** 2)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.12)


def test_degrees_in_a_file_of_radians_are_recognised(job_folder, tmp_path):
    for path in job_folder.iterdir():
        (tmp_path / path.name).write_text(path.read_text())
    rows = np.loadtxt(tmp_path / "bench_1.csv", delimiter=",")
    np.savetxt(tmp_path / "bench_1.csv", np.rad2deg(rows), delimiter=",")
    with pytest.raises(InputError, match="degrees given as radians"):
        serial_arm.from_job(Job.read(tmp_path / "job.toml"))


def test_a_file_of_another_arm_is_named_with_its_line(job_folder, tmp_path):
    for path in job_folder.iterdir():
        (tmp_path / path.name).write_text(path.read_text())
    (tmp_path / "bench_2.csv").write_text("0.1,0.2,0.3\n")
    with pytest.raises(InputError, match=r"bench_2.csv, line 1: 3 numbers where 6 joints are expected"):
        serial_arm.from_job(Job.read(tmp_path / "job.toml"))


def test_an_arm_whose_errors_are_held_is_the_urdf_and_its_clusters_are_of_like_postures(job_folder, tmp_path):
    for path in job_folder.iterdir():
        (tmp_path / path.name).write_text(path.read_text().replace("[options]", '[options]\nerrors = "held"'))
    problem = serial_arm.from_job(Job.read(tmp_path / "job.toml"))
    assert all(problem.is_held(a.unknown).all() for a in problem.attached)
    block = serial_arm.blocks(problem)["seat"]
    assert len(block) == problem.observations[0].n and 2 <= len(set(block)) <= serial_arm.BLOCKS


@needs_real_data
@pytest.mark.slow
def test_the_real_arm_calibrated_in_front_is_better_everywhere(monkeypatch):
    monkeypatch.setenv("CALIB_REFERENCE_DATA", str(REAL))
    job = Job.read(Path(__file__).parents[1] / "problems" / "data" / "serial_arm" / "panda.toml")
    estimate = calib.solve(serial_arm.from_job(job))
    assert estimate.certificate.passed and estimate.residuals["seat"].shape == (62, 3)
    rows = {name: (before, after) for name, before, after, _ in serial_arm.heldout(job, estimate)}
    before, after = rows["mean distance error (front, used)"]
    assert before == pytest.approx(10.34, abs=0.01) and after < 0.25
    before, after = rows["mean distance error (right, not used)"]
    assert before == pytest.approx(7.99, abs=0.01) and after < 0.45
    before, after = rows["mean distance error (back-high, not used)"]
    assert before == pytest.approx(7.46, abs=0.01) and after < 1.0
