"""Layouts of target points: the smallest sqrt(Q11 + Q22), the printed layout, symmetric against half-symmetric."""

import numpy as np
import pytest
from folders import put

import calib
from calib.errors import InputError, RankDefect
from calib.job import Job
from calib.units import degree, um
from problems import base_point, base_point_layout
from problems.base_point import paper
from problems.base_point_layout import FREE, KNOWN, TIED

PRINTED = np.radians([0.0, 60.0, -60.0])                  # the three directions of the printed matrix A


def targets_in(angles, distance=1.0):
    """Targets (n, 2) seen from the origin against the directions of A."""
    return -distance * np.column_stack([np.cos(angles), np.sin(angles)])


def root(angles, zero):
    return base_point_layout.root_of_trace(targets_in(np.asarray(angles, float)), (0.0, 0.0), zero)


def test_the_printed_layout_has_two_by_root_three_and_not_1_169():
    assert root(PRINTED, KNOWN) == pytest.approx(2.0 / np.sqrt(3.0), rel=1e-12)
    assert abs(root(PRINTED, KNOWN) - 1.169) > 0.01


@pytest.mark.parametrize("zero", [KNOWN, FREE], ids=["known", "free"])
def test_the_best_layout_reaches_its_bound_and_its_angles_have_that_quality(zero):
    best = base_point_layout.best_layout(zero, starts=3, seed=1)
    assert best.gap == pytest.approx(0.0, abs=1e-9) and best.bound == np.sqrt(4.0 / 3.0)
    assert root(best.angles, zero) == pytest.approx(best.value, rel=1e-7)


@pytest.mark.parametrize("targets", [3, 4, 5, 8])
@pytest.mark.parametrize("zero", [KNOWN, FREE], ids=["known", "free"])
def test_evenly_spread_targets_reach_the_bound(targets, zero):
    spread = 2 * np.pi * np.arange(targets) / targets + 0.3
    assert root(spread, zero) == pytest.approx(base_point_layout.bound(targets), rel=1e-12)


def test_no_random_layout_is_better_than_the_bound():
    generator = np.random.default_rng(3)
    for zero in (KNOWN, FREE):
        quality = [root(generator.uniform(0.0, 2 * np.pi, 3), zero) for _ in range(40)]
        assert min(quality) > np.sqrt(4.0 / 3.0) - 1e-12


def test_with_an_unknown_start_the_printed_layout_is_more_than_twice_as_bad_as_three_targets_all_around():
    assert root(PRINTED, FREE) == pytest.approx(2.582, abs=0.001)
    assert root(np.radians([0.0, 120.0, 240.0]), FREE) == pytest.approx(2.0 / np.sqrt(3.0), rel=1e-12)


def test_targets_point_symmetric_about_the_base_point_are_not_the_optimum():
    assert root(np.radians([0.0, 180.0, 90.0]), KNOWN) == pytest.approx(np.sqrt(1.5), rel=1e-12)
    moved = PRINTED + np.array([0.0, np.pi, 0.0])
    assert root(moved, KNOWN) == pytest.approx(root(PRINTED, KNOWN), rel=1e-12)


def test_equation_5_as_printed_with_two_equal_rows_is_worse():
    assert root(np.radians([0.0, 60.0, 60.0]), KNOWN) == pytest.approx(np.sqrt(2.0), rel=1e-12)


def test_the_distance_of_the_targets_does_not_matter():
    near, far = (base_point_layout.root_of_trace(targets_in(PRINTED, d), (0.0, 0.0), FREE) for d in (0.3, 30.0))
    assert near == pytest.approx(far, rel=1e-9)


def test_targets_in_one_direction_do_not_determine_the_base_point():
    with pytest.raises(RankDefect, match="base_point"):
        root([0.3, 0.3, 0.3], KNOWN)


def test_symmetric_is_better_along_the_line_and_hardly_across():
    for zero, ratio_x, ratio_y in ((TIED, 6.47, 1.73), (FREE, 5.38, 1.77)):
        u = [base_point_layout.uncertainties(paper.layout_targets(), (foot, 0.5), zero, 1.0 * um)
             for foot in (0.7, 1.4)]
        assert u[1] / u[0] == pytest.approx([ratio_x, ratio_y], abs=0.01)


def test_with_the_start_tied_the_best_foot_is_not_in_the_middle_and_with_a_free_start_it_is_at_the_mean_target():
    feet = np.arange(0.3, 1.2, 0.01)
    best = {}
    for name, zero in (("tied", TIED), ("free", FREE)):
        u = [base_point_layout.uncertainties(paper.layout_targets(), (foot, 0.5), zero, 1.0 * um)[0]
             for foot in feet]
        best[name] = feet[int(np.argmin(u))]
        if name == "tied":
            assert min(u) == pytest.approx(0.278 * um, abs=0.001 * um)
    assert best["tied"] == pytest.approx(0.48, abs=0.011) and best["free"] == pytest.approx(0.77, abs=0.011)


def test_equation_1_and_the_planar_calibration_tied_to_its_zero_are_one_model():
    for foot in (0.7, 1.4):
        plan = base_point.declare_one_line(paper.travel(), None, 1.0 * um, begin=(foot, 0.5))
        by_equation_1 = calib.covariance(calib.linearise(plan), "beside").u
        planar = base_point_layout.uncertainties(paper.layout_targets(), (foot, 0.5), TIED, 1.0 * um)
        assert planar == pytest.approx(by_equation_1, rel=1e-9)


def test_the_mirror_turns_by_half_of_what_the_beam_turns():
    travel = paper.travel()
    assert base_point_layout.mirror_rotation(travel, 0.7, 0.5) / degree == pytest.approx(54.46, abs=0.01)
    assert base_point_layout.mirror_rotation(travel, 1.4, 0.5) / degree == pytest.approx(35.17, abs=0.01)


def test_gauss_newton_says_so_where_it_does_not_reach_the_minimum():
    estimate = calib.solve(base_point_layout.declare(KNOWN))
    assert estimate.certificate.passed == estimate.converged
    assert estimate["sqrt_q"] == pytest.approx(np.sqrt(4.0 / 3.0), abs=1e-6)


def test_what_cannot_be_planned_is_refused():
    with pytest.raises(InputError, match="2 start angles"):
        base_point_layout.declare(KNOWN, begin=[0.0, 1.0])
    with pytest.raises(InputError, match="tied"):
        base_point_layout.declare(TIED)


def test_the_example_job_is_a_layout(tmp_path):
    job = Job.read(put(tmp_path, base_point_layout.example_job(1)))
    estimate = calib.solve(base_point_layout.from_job(job), calib.Ipopt())
    job.refuse_unknown_keys()
    assert estimate.certificate.passed and estimate["sqrt_q"] == pytest.approx(np.sqrt(4.0 / 3.0), abs=1e-9)
