"""The plumb fit: printed numbers, coverage, bad geometry and the case format."""

import os
from pathlib import Path

import numpy as np
import pytest

from calib import covariance, linearise, solve
from calib.errors import RankDefect
from calib.job import Job
from calib.table import shipped
from calib.units import arcsec, degree
from problems import plumb

CASES = Path(os.environ.get("CALIB_REFERENCE_DATA", "absent")).parent / "discrepancy_examples"


@pytest.mark.parametrize("column, printed", [("three_axis", (-1.7, 2.4)), ("two_axis", (-1.4, -0.8))])
def test_the_plumb_errors_are_those_that_the_paper_prints(column, printed):
    table = shipped("five_axis/table1_level.csv")
    problem = plumb.declare(table.number("position", "angle"), table.number(column, "angle"), 0.2 * arcsec)
    estimate = solve(problem)
    found = estimate["plumb"][0] / arcsec
    assert np.round(found, 1) == pytest.approx(printed)
    assert np.round(covariance(linearise(estimate), "plumb").u / arcsec, 1) == pytest.approx([0.3, 0.3])


def test_two_tables_give_their_parallelism_with_its_uncertainty():
    problem = plumb.example(3)
    estimate = solve(problem)
    c = covariance(linearise(estimate), "parallelism")
    first, second = estimate["plumb"]
    assert c.values[:2] == pytest.approx(second - first)
    assert c.values[2] == pytest.approx(np.hypot(*(second - first)))


def test_ninety_five_per_cent_intervals_cover_the_truth():
    truth = np.array([[-1.7, 2.4], [-1.4, -0.8]]) * arcsec
    inside = []
    for seed in range(50):
        estimate = solve(plumb.example(seed))
        u = covariance(linearise(estimate), "plumb").u
        inside.append(np.abs(estimate["plumb"].ravel() - truth.ravel()) < 1.96 * u)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.05)  # 200 intervals, 3.2 standard errors


def test_readings_at_one_position_say_what_cannot_be_known():
    angle = np.full(6, 30.0) * degree
    with pytest.raises(RankDefect, match=r"2 direction.* cannot be known.*plumb.*zero"):
        solve(plumb.declare(angle, np.full(6, 60.0) * arcsec, 0.2 * arcsec))


def test_a_short_arc_is_solved_and_its_uncertainty_says_so():
    angle = np.linspace(0, 2, 9) * degree
    estimate = solve(plumb.declare(angle, np.full(9, 60.0) * arcsec, 0.2 * arcsec))
    assert estimate.certificate.passed
    assert covariance(linearise(estimate), "plumb").u.max() > 100 * arcsec


@pytest.mark.skipif(not CASES.is_dir(), reason="the example cases are not at hand")
@pytest.mark.parametrize("case, rms, effect", [("clean", 1.04734, None), ("effect", 1.06765, -1.6880621870092347)])
def test_a_case_folder_is_a_job_of_this_problem(case, rms, effect):
    problem = plumb.from_job(Job.read(CASES / f"example_level_plumb_{case}"))
    if effect is not None:
        problem = problem.free("drift (reading)")
    estimate = solve(problem)
    assert np.sqrt(estimate.variance_factor) == pytest.approx(rms, abs=5e-6)
    if effect is not None:
        assert estimate["drift (reading)"] / (arcsec / 3600) == pytest.approx(effect, rel=1e-6)
