"""The space circle: geometric fit, algebraic starts, the paper's objectives and weights."""

import numpy as np
import pytest
from folders import put

import calib
from calib.errors import InputError, RankDefect
from calib.job import Job
from calib.units import arcsec, degree, um
from instruments import laser_tracker
from problems import circle
from problems.circle import algebraic, pairwise

COMMAND = np.arange(13) * 30.0 * degree
CENTRE, NORMAL = np.array([2.0, 1.0, 0.3]), np.array([0.1, 0.2, 1.0]) / np.linalg.norm([0.1, 0.2, 1.0])


def circle_points(command=COMMAND, radius=0.1, noise=0.0, seed=0):
    first, second = circle.in_plane(NORMAL, np.array([1.0, 0.0, 0.0]))
    exact = CENTRE + radius * (np.cos(command)[:, None] * first + np.sin(command)[:, None] * second)
    return exact + np.random.default_rng(seed).normal(0.0, noise, exact.shape) if noise else exact


@pytest.mark.parametrize("fit", [algebraic.kasa, algebraic.pratt, algebraic.taubin])
@pytest.mark.parametrize("arc", [360.0, 90.0, 20.0])
def test_every_algebraic_fit_gives_an_exact_circle(fit, arc):
    angle = np.radians(np.linspace(0.0, arc, 9))
    found = fit(np.column_stack([3.0 + 0.1 * np.cos(angle), -2.0 + 0.1 * np.sin(angle)]))
    assert np.allclose(found, [3.0, -2.0, 0.1], atol=1e-12)


def test_kasa_shrinks_a_short_arc_more_than_pratt_and_taubin():
    """Known of the method: over a short arc Kasa's radius is too small, Pratt's and Taubin's much less so."""
    angle, rng = np.radians(np.linspace(0.0, 20.0, 13)), np.random.default_rng(5)
    arcs = [np.column_stack([np.cos(angle), np.sin(angle)]) + rng.normal(0.0, 4e-3, (13, 2)) for _ in range(200)]
    radius = {fit: np.median([fit(arc)[2] for arc in arcs]) for fit in
              (algebraic.kasa, algebraic.pratt, algebraic.taubin)}
    assert radius[algebraic.kasa] < 0.8
    assert radius[algebraic.pratt] == pytest.approx(1.0, abs=0.2)
    assert radius[algebraic.taubin] == pytest.approx(1.0, abs=0.2)


def test_the_start_follows_the_sense_of_the_command_and_whole_turns():
    command = np.arange(0.0, 721.0, 40.0) * degree
    forwards = algebraic.space_circle(circle_points(command), command=command)
    backwards = algebraic.space_circle(circle_points(-command), command=command)
    assert np.allclose(forwards.foot, command, atol=1e-9) and np.allclose(forwards.normal, NORMAL)
    assert np.allclose(backwards.foot, command, atol=1e-9) and np.allclose(backwards.normal, -NORMAL)


@pytest.mark.parametrize("points, words", [
    (circle_points()[:2], "2 points"),
    (np.tile(CENTRE, (5, 1)), "one position"),
    (CENTRE + np.arange(5)[:, None] * NORMAL, "straight line"),
    (circle_points()[:, :2], r"shape \(13, 2\)")])
def test_points_that_make_no_circle_are_refused_in_words(points, words):
    with pytest.raises(InputError, match=words):
        circle.declare(points, 1.0 * um)


def test_an_exact_circle_is_found_exactly_with_the_angles_turned():
    estimate = calib.solve(circle.declare(circle_points(), 1.0 * um))
    assert estimate.certificate.passed
    assert np.allclose(estimate["centre"], CENTRE, atol=1e-12) and estimate["radius"] == pytest.approx(0.1, abs=1e-12)
    assert np.allclose(estimate["angle"], COMMAND[1:], atol=1e-10)


def test_with_equal_u_the_foot_of_a_point_is_its_projection_on_the_circle():
    points = circle_points(noise=20.0 * um)
    estimate = calib.solve(circle.declare(points, 20.0 * um))
    offset = points - estimate["centre"]
    planar = offset - np.outer(offset @ estimate["normal"], estimate["normal"])
    foot = estimate["centre"] + estimate["radius"] * planar / np.linalg.norm(planar, axis=1)[:, None]
    assert np.abs(estimate.predicted["points"] - foot).max() < 1e-8 * 20.0 * um


def test_the_answer_does_not_depend_on_the_frame():
    points = circle_points(noise=20.0 * um)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    here = calib.solve(circle.declare(points, 20.0 * um))
    there = calib.solve(circle.declare(points @ turn.T + [5.0, -7.0, 1.0], 20.0 * um))
    assert there.objective == pytest.approx(here.objective, rel=1e-6)
    assert np.abs(there["angle"] - here["angle"]).max() < 1e-6 * 20.0 * um / 0.1
    assert np.allclose(turn @ here["centre"] + [5.0, -7.0, 1.0], there["centre"], atol=1e-6 * um)


def test_gauss_newton_and_ipopt_agree_on_the_circle_with_a_covariance_for_each_point():
    problem = circle.example(4)
    one, two = calib.solve(problem), calib.solve(problem, calib.Ipopt())
    u = calib.covariance(calib.linearise(one), "centre", "radius").u
    difference = np.append(two["centre"] - one["centre"], two["radius"] - one["radius"])
    assert np.abs(difference / u).max() < 1e-8


def test_standardised_errors_of_the_angles_have_unit_spread():
    """40 simulated circles with the full covariances of a tracker: mean square of (estimate - truth)/u is 1."""
    exact = circle_points(radius=0.5)
    polar = laser_tracker.polar_readings(exact)
    covariance = laser_tracker.cartesian_covariance(polar, [2.0 * um, 1.0 * arcsec, 1.0 * arcsec])
    problem = circle.declare(exact, calib.Gaussian.matrix(covariance), COMMAND)
    u = calib.covariance(calib.linearise(problem), "angle").u
    errors = [(calib.solve(calib.simulate(problem, None, seed))["angle"] - COMMAND[1:]) / u for seed in range(40)]
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=0.25)     # 40 x 12 correlated values


def test_an_arc_of_two_degrees_says_that_the_radius_is_hardly_known():
    problem = circle.declare(circle_points(np.linspace(0.0, 2.0, 13) * degree, radius=0.5), 5.0 * um)
    u = calib.covariance(calib.linearise(problem), "radius").u[0]
    assert u > 0.05 * 0.5


# --- the paper's objectives --------------------------------------------------------------------------------------


def printed_objective(points, centre, plane):
    """Equation 8 as printed: the double sum over i and j, the plane distance inside it."""
    d = np.linalg.norm(points - centre, axis=1)
    height = (points @ plane[:3] + plane[3]) / np.linalg.norm(plane[:3])
    return sum((d[i] - d[j]) ** 2 + height[i] ** 2 for i in range(len(d)) for j in range(len(d)))


def test_the_declared_pairwise_problem_is_equation_8():
    points = circle_points(noise=20.0 * um)
    estimate = calib.solve(pairwise.pairwise(points))
    printed = printed_objective(points, estimate["centre"], estimate["plane"])
    assert estimate.objective == pytest.approx(printed, rel=1e-9)
    assert len(estimate.residuals["pairs"]) + len(estimate.residuals["plane"]) == 13 * 12 // 2 + 13


def test_equation_8_counts_the_radial_error_twice_and_the_axial_once():
    """Sum over i, j of (d_i - d_j)^2 is 2 n times the sum of (d_i - mean d)^2; a plane distance enters n times."""
    points, n = circle_points(noise=20.0 * um), 13
    estimate = calib.solve(pairwise.pairwise(points))
    d = np.linalg.norm(points - estimate["centre"], axis=1)
    radial = np.sum((d - d.mean()) ** 2)
    axial = np.sum(estimate.residuals["plane"] ** 2)
    assert estimate.objective == pytest.approx(2 * n * radial + n * axial, rel=1e-9)


def test_equation_8_without_conditions_leaves_the_axis_and_the_scale_of_the_plane_open():
    problem = pairwise.pairwise(circle_points())
    with pytest.raises(RankDefect) as refused:
        calib.solve(calib.Problem(problem.observations))
    assert len(refused.value.directions) == 2
    assert any("centre" in words for words in refused.value.directions)
    assert any("plane" in words for words in refused.value.directions)


def test_equation_14_is_not_zero_on_an_exact_circle_unless_the_weights_are_equal():
    points = circle_points(radius=4.0)
    unequal = pairwise.weights(np.linspace(10.0, 40.0, 13) * um)
    truth = calib.predict(pairwise.weighted_pairwise(points, unequal))["pairs"]
    assert np.abs(truth).max() == pytest.approx((unequal.max() - unequal.min()) * 4.0**2, rel=1e-9)
    assert np.abs(calib.predict(pairwise.weighted_pairwise(points, np.full(13, 1 / 13)))["pairs"]).max() < 1e-12
    assert np.abs(calib.predict(pairwise.repaired_pairwise(points, unequal))["pairs"]).max() < 1e-12


def test_equation_14_displaces_the_centre_of_an_exact_circle_and_its_repair_does_not():
    points = circle_points(radius=4.0)
    unequal = pairwise.weights(np.linspace(10.0, 40.0, 13) * um)
    printed = calib.solve(pairwise.weighted_pairwise(points, unequal))
    repaired = calib.solve(pairwise.repaired_pairwise(points, unequal))
    assert np.linalg.norm(printed["centre"] - CENTRE) > 0.5
    assert np.linalg.norm(repaired["centre"] - CENTRE) < 1e-10


def test_equal_weights_make_the_repaired_objective_the_orthogonal_fit():
    """With radial and axial equally weighed the two differ by the axial part of the distance only: axial^2/(2 R)."""
    points = circle_points(noise=5.0 * um)
    orthogonal = calib.solve(circle.declare(points, 5.0 * um))
    repaired = calib.solve(pairwise.repaired_pairwise(points, np.full(13, 1 / 13)))
    assert np.linalg.norm(orthogonal["centre"] - repaired["centre"]) < 5.0 * (5.0 * um) ** 2 / (2 * 0.1)


def test_the_weights_of_equations_10_to_13_have_one_solution_and_it_is_the_inverse_square():
    u = np.array([10.0, 20.0, 40.0]) * um
    estimate = calib.solve(pairwise.weight_problem(u))
    assert np.allclose(estimate["weight"], pairwise.weights(u), atol=1e-12)
    assert np.allclose(pairwise.weights(u), np.array([16.0, 4.0, 1.0]) / 21.0)
    assert np.argmin(pairwise.weights(u) * u) == 2      # u_c of equation 10 is smallest at the worst point


def test_the_example_job_is_read_and_solved(tmp_path):
    job = Job.read(put(tmp_path, circle.example_job(3)))
    estimate = calib.solve(circle.from_job(job))
    job.refuse_unknown_keys()
    assert estimate.certificate.passed and estimate.dof == 39 - 6 - 13
    assert estimate["radius"] == pytest.approx(0.2, abs=5.0 * um)
