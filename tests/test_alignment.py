"""Alignment of two frames: closed form where it is the estimate, proof where it is not, errors of the part shared."""

from __future__ import annotations

import json

import numpy as np
import pytest
from folders import put

import calib
from calib.errors import InputError
from calib.geometry import small_rotation_vector
from calib.job import Job
from calib.units import um
from problems import alignment
from tests.command import runner

ISOTROPIC = np.tile((10 * um) ** 2 * np.eye(3), (12, 1, 1))


@pytest.fixture
def job(tmp_path):
    return Job.read(put(tmp_path, alignment.example_job(1)))


def seen_points(seed, covariance=ISOTROPIC):
    exact = np.array([alignment.PLACE @ point for point in alignment.PART])
    problem = alignment.declare(alignment.PART, exact, covariance)
    return np.asarray(calib.simulate(problem, None, seed).observations[0].readings)


@pytest.mark.parametrize("seed", range(3))
def test_with_one_u_for_everything_the_estimate_is_the_closed_form(seed):
    seen = seen_points(seed)
    estimate = calib.solve(alignment.declare(alignment.PART, seen, ISOTROPIC))
    closed = alignment.start(alignment.PART, seen)
    fit = calib.covariance(calib.linearise(estimate), estimate.problem.select("seen_from_part"))
    turned = small_rotation_vector(np.asarray(estimate["seen_from_part"].rotation).T @ closed.rotation)
    moved = closed.translation - estimate["seen_from_part"].translation
    assert np.abs(np.concatenate([moved, turned]) / fit.u).max() < 1e-6


def test_the_relaxation_proves_the_pose_and_refuses_what_it_does_not_know():
    problem = alignment.example(3)
    order = [alignment.PART[int(name[1:]) - 1] for name in problem.observations[0].covariates["point"]]
    found = alignment.bound(calib.solve(problem), order)
    assert found.proven and found.lower <= found.objective
    with pytest.raises(InputError, match="an effect is estimated"):
        alignment.bound(calib.solve(problem.free("scale (part)")), order)


def test_adjusting_the_points_gives_the_same_pose_and_u_as_adding_their_covariance(job):
    common = alignment.Common.read(job)
    twice = [np.concatenate([part, part]) for part in (common.points, common.seen, common.covariance)]
    twice[1] = twice[1] + np.random.default_rng(4).normal(size=twice[1].shape) * 3 * um
    names = common.names * 2
    poses = []
    for problem in (alignment.declare(*twice, 8 * um, names), alignment.declare_adjusted(*twice, 8 * um, names)):
        estimate = calib.solve(problem)
        cov = calib.covariance(calib.linearise(estimate), problem.select("seen_from_part"))
        poses.append((estimate, cov))
    (one, u_one), (other, u_other) = poses
    assert u_other.u == pytest.approx(u_one.u, rel=1e-4)  # the other linearises at adjusted points
    assert one.objective == pytest.approx(other.objective, rel=1e-6) and one.dof == other.dof
    moved = one["seen_from_part"].translation - other["seen_from_part"].translation
    assert np.abs(moved / u_one.u[:3]).max() < 1e-3


def test_points_that_are_not_seen_are_carried_over_with_their_uncertainty(job):
    estimate = calib.solve(alignment.from_job(job))
    tool = calib.covariance(calib.linearise(estimate), "target")
    place = estimate["seen_from_part"] @ np.array([0.6, 0.4, 0.9])
    assert tool.names == ("target[tool].x", "target[tool].y", "target[tool].z")
    assert tool.values == pytest.approx(np.asarray(place).ravel(), abs=1e-12)
    exact = alignment.PLACE @ np.array([0.6, 0.4, 0.9])
    assert np.all(np.abs(tool.values - exact) < 4 * tool.u)


def test_a_job_is_compared_and_proven_on_the_command_line(job, capsys, tmp_path):
    finished = runner(capsys)("compare", str(job.path), "--starts", "0", "--draws", "5", "--json")
    lines = {line["formulation"]: line for line in json.loads(finished.out)}
    assert lines["semidefinite relaxation"]["bound"]["proven"]
    adjusted = lines["points adjusted too"]["difference_in_u"].values()
    assert max(abs(value) for value in adjusted) < 1e-5
    assert lines["closed form, equal weights"]["objective"] > lines["semidefinite relaxation"]["objective"]


@pytest.mark.parametrize("points, said", [
    (alignment.PART[:2], "three points"), (np.outer([0.0, 1.0, 2.0], [1.0, 0.2, 0.1]), "on a line")])
def test_points_that_fix_no_pose_are_refused(points, said):
    with pytest.raises(InputError, match=said):
        alignment.start(points, points)


def test_a_seen_point_that_the_part_does_not_have_is_named(job):
    table = job.path.parent / "seen.csv"
    table.write_text(table.read_text(encoding="utf-8").replace("P3,", "Q3,"), encoding="utf-8")
    with pytest.raises(InputError, match="'Q3' is seen but is not in"):
        alignment.from_job(Job.read(job.path))
