"""The two-axis positioner: simulated errors come back within their stated uncertainty; the real one is predicted
better."""

import os
from pathlib import Path

import numpy as np
import pytest
from folders import put

import calib
from calib.errors import InputError
from calib.job import Job
from calib.mechanism.smooth import Smooth
from calib.units import degree, mm, mrad
from problems import positioner

REAL = Path(os.environ.get("CALIB_REFERENCE_DATA", Path(__file__).parents[2] / "shared" / "reference_data"))
TRUTH = {"EY0C (C)": 0.63 * mm, "EB0C (C)": 0.43 * mrad, "scale_A (A)": 1.1e-3}
needs_real_data = pytest.mark.skipif(not (REAL / "positioner").is_dir(), reason="the recorded positioner is not here")


@pytest.fixture(scope="module")
def simulated():
    problem = positioner.example(1)
    return problem, calib.solve(problem)


def test_the_simulated_errors_come_back_within_four_standard_uncertainties(simulated):
    problem, estimate = simulated
    assert estimate.certificate.passed
    found = calib.covariance(calib.linearise(estimate), *(problem.parameters(name) for name in TRUTH))
    assert np.all(np.abs(found.values - list(TRUTH.values())) < 4 * found.u)


@pytest.mark.slow
def test_the_stated_intervals_cover_the_truth_in_fifty_repetitions(simulated):
    problem, estimate = simulated
    parameters = [problem.parameters(name) for name in TRUTH]
    truth = {parameter: estimate.values[parameter] for parameter in parameters}
    true = np.array([float(v[0, 0]) for v in truth.values()])
    standardised = []
    for seed in range(50):
        again = calib.solve(calib.simulate(problem, estimate, seed), start=estimate)
        found = calib.covariance(calib.linearise(again), *parameters)
        standardised.append((found.values - true) / found.u)
    inside = np.mean(np.abs(standardised) < 1.96, axis=0)
    assert np.all(inside >= 0.84), inside          # 50 trials at 0.95: below 0.84 once in a thousand
    assert np.mean(np.square(standardised)) == pytest.approx(1.0, abs=0.4)


def test_structure_in_what_remains_is_said_and_its_absence_too(simulated):
    problem, estimate = simulated
    clean = positioner.advice(calib.linearise(estimate))
    assert "misses the identified axes by" in clean[0] and clean[1].startswith("None of the")
    without_scale = calib.solve(problem.hold(problem.parameters("scale_A")))
    assert "What remains has structure: freeing" in positioner.advice(calib.linearise(without_scale))[1]


def test_an_example_job_gives_the_angle_between_the_axes(tmp_path):
    put(tmp_path, positioner.example_job(3))
    estimate = calib.solve(positioner.from_job(Job.read(tmp_path / "job.toml")))
    axes = calib.covariance(calib.linearise(estimate), "axes")
    angle, u = axes["axes.angle"]
    assert abs(angle - (np.pi / 2 - TRUTH["EB0C (C)"])) < 4 * u
    offset, u = axes["axes.offset"]
    assert abs(offset + TRUTH["EY0C (C)"]) < 4 * u


def test_uncertainty_by_blocks_agrees_with_the_stated_one_where_poses_are_independent(tmp_path):
    job = Job.read(put(tmp_path, positioner.example_job(3)))
    for _, stated, by_blocks in positioner.uncertainty_by_blocks(calib.solve(positioner.from_job(job))).values():
        assert 0.25 < by_blocks / stated < 3.0        # five blocks: the ratio spreads by a factor of two


@pytest.mark.slow
def test_poses_that_err_alike_where_they_are_near_give_intervals_that_cover():
    a, c = np.meshgrid(np.linspace(-30, 30, 6) * degree, np.linspace(0, 315, 8) * degree, indexing="ij")
    positions = np.stack([a.ravel(), c.ravel()], axis=1)
    smooth = (Smooth(0.05 * mm, 0.3 * mm, 0.4), Smooth(0.1 * mrad, 0.6 * mrad, 0.4))
    true = [np.pi / 2 - TRUTH["EB0C (C)"], -TRUTH["EY0C (C)"]]
    alone, standardised, naive = positioner.simulated(positions, 0), [], []
    for seed in range(8):
        drawn = positioner.simulated(positions, seed, smooth)
        same = alone.with_readings({"pose": drawn.observations[0].recorded})
        for kept, one in ((standardised, drawn), (naive, same)):
            found = calib.covariance(calib.solve(one).fit, "axes")
            kept.append((found.values - true) / found.u)
    assert 0.5 < np.sqrt(np.mean(np.square(standardised))) < 1.6
    assert np.sqrt(np.mean(np.square(naive))) > 2.0


def test_quaternions_in_the_other_order_are_named(tmp_path):
    files = positioner.example_job(3)
    for name, text in files.items():
        (tmp_path / name).write_text(text.replace("qw,qx,qy,qz", "qx,qy,qz,qw") if name == "poses.csv" else text)
    with pytest.raises(InputError, match="other order"):
        positioner.from_job(Job.read(tmp_path / "job.toml"))


def test_quaternions_of_another_length_are_named_with_their_row(tmp_path):
    files = positioner.example_job(3)
    lines = files["poses.csv"].splitlines()
    cells = lines[4].split(",")
    lines[4] = ",".join([*cells[:5], "2.0", *cells[6:]])
    (tmp_path / "job.toml").write_text(files["job.toml"])
    (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"pose 3: the quaternion .* has length"):
        positioner.from_job(Job.read(tmp_path / "job.toml"))


def test_poses_that_move_one_axis_only_are_refused():
    problem = positioner.example(1)
    positions = np.stack([np.linspace(0, 1, 5), np.zeros(5)], axis=1)
    with pytest.raises(InputError, match="only 'A' moves"):
        positioner.declare(positions, np.zeros((5, 3)), np.tile(np.eye(3), (5, 1, 1)), 1e-3, 1e-3)
    assert problem.name == "two-axis positioner"


@needs_real_data
@pytest.mark.slow
def test_the_real_positioner_is_identified_and_predicts_poses_that_were_not_used(monkeypatch):
    monkeypatch.setenv("CALIB_REFERENCE_DATA", str(REAL))
    job = Job.read(Path(__file__).parents[1] / "problems" / "data" / "positioner" / "measured.toml")
    estimate = calib.solve(positioner.from_job(job))
    assert estimate.certificate.passed and estimate.residuals["pose"].shape == (205, 6)
    angle, u = calib.covariance(calib.linearise(estimate), "axes")["axes.angle"]
    assert 0.1 * mrad < u < 0.3 * mrad and abs(angle - np.pi / 2) < 5 * u
    for _, stated, by_blocks in positioner.uncertainty_by_blocks(estimate).values():
        assert stated > 0.8 * by_blocks         # neighbouring poses are stated to err alike
    for _, before, after, _ in positioner.heldout(job, estimate):
        assert after < before
