"""Slips in the turntable paper's equations 3 to 15: every number of docs/slips/turntable.md that concerns them."""

import casadi as ca
import numpy as np
import pytest

import calib
from calib.units import arcsec, degree, mm, um
from instruments import laser_tracker
from problems import circle
from problems.circle import pairwise

COMMAND = np.arange(12) * 30.0 * degree
TRACKER = laser_tracker.from_coordinate_statement(15.0 * um, 6e-6)      # the U of section 2.2, k = 2


def level_circle(radius, distance, count=12):
    command = np.arange(count) * 2.0 * np.pi / count
    return np.column_stack([distance + radius * np.cos(command), radius * np.sin(command), np.full(count, -0.4)])


def weights_by_distance(points):
    return pairwise.weights(TRACKER.at(laser_tracker.polar_readings(points))[:, 0])


def angle_errors(points, centre):
    angle = np.arctan2(points[:, 1] - centre[1], points[:, 0] - centre[0])
    return np.angle(np.exp(1j * (angle - angle[0] - COMMAND)))


def test_equation_3_is_a_plane_in_the_centre_not_a_sphere():
    centre, one, two = ca.SX.sym("centre", 3), ca.DM([0.1, 0.0, 0.2]), ca.DM([0.0, 0.3, -0.1])
    printed = ca.dot(one - centre, one - centre) - ca.dot(two - centre, two - centre)
    assert np.abs(np.array(ca.DM(ca.hessian(printed, centre)[0]))).max() == 0.0


def test_a_centre_50_mm_up_the_axis_satisfies_equations_5_and_7_as_well():
    points = level_circle(0.1, 3.0)
    problem = pairwise.pairwise(points)
    seen = calib.predict(problem, {"centre": [3.0, 0.0, -0.35]})
    assert np.abs(seen["pairs"]).max() < 1e-15 and np.abs(seen["plane"]).max() < 1e-15


def test_equation_8_counts_10_um_radially_22_times_and_axially_12_times():
    centre, plane = [3.0, 0.0, -0.4], [0.0, 0.0, 1.0, 0.4]
    found = []
    for direction in ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]):
        points = level_circle(0.1, 3.0)
        points[0] += 10.0 * um * np.array(direction)
        problem = pairwise.pairwise(points)
        seen = calib.predict(problem, {"centre": centre, "plane": plane})
        found.append(2.0 * np.sum(seen["pairs"] ** 2) + 12.0 * np.sum(seen["plane"] ** 2))
    assert found == pytest.approx([22.0 * (10 * um) ** 2, 12.0 * (10 * um) ** 2], rel=1e-6)


@pytest.mark.parametrize("count, printed, independent", [(13, 91, 25), (3, 6, 5)])
def test_of_the_counted_equations_only_2_n_minus_1_are_independent(count, printed, independent):
    i, j = np.triu_indices(count, 1)
    differences = np.zeros((len(i), 2 * count))
    differences[np.arange(len(i)), i], differences[np.arange(len(i)), j] = 1.0, -1.0
    distances = np.hstack([np.zeros((count, count)), np.eye(count)])
    equations = np.vstack([differences, distances])
    assert len(equations) == printed and np.linalg.matrix_rank(equations) == independent


def test_weights_from_ten_repeats_differ_2_4_times_by_chance_alone():
    """Equation 9 with ten repeats: twelve points of one true u, three coordinates, 27 degrees of freedom each."""
    variance = np.random.default_rng(1).chisquare(27, (4000, 12)) / 27
    ratio = variance.max(axis=1) / variance.min(axis=1)
    assert np.median(ratio) == pytest.approx(2.4, abs=0.1) and np.quantile(ratio, 0.95) == pytest.approx(3.7, abs=0.2)


def test_the_weights_do_not_minimise_the_sum_that_the_text_names():
    u = np.array([10.0, 20.0, 40.0])
    weights = pairwise.weights(u)
    assert np.allclose(weights * u, np.array([160.0, 80.0, 40.0]) / 21.0)       # 7.6, 3.8, 1.9: worst point, least u
    assert np.sum(weights * u) == pytest.approx(40.0 / 3.0)
    assert np.sum(np.array([1.0, 0.0, 0.0]) * u) == 10.0


def test_equation_13_with_11_is_one_regular_linear_system():
    u = np.array([10.0, 20.0, 40.0])
    system = np.block([[np.diag(2.0 * u**2), -np.ones((3, 1))], [np.ones((1, 3)), np.zeros((1, 1))]])
    solution = np.linalg.solve(system, [0.0, 0.0, 0.0, 1.0])
    assert np.linalg.matrix_rank(system) == 4 and np.allclose(solution[:3], [16 / 21, 4 / 21, 1 / 21])


def test_equation_14_is_429_square_metres_squared_at_the_truth_of_a_large_table():
    points = level_circle(4.0, 5.0)
    weights = weights_by_distance(points)
    assert weights.max() / weights.min() == pytest.approx(10.35, abs=0.01)
    at_truth = calib.predict(pairwise.weighted_pairwise(points, weights), {"centre": [5.0, 0.0, -0.4]})
    assert 2.0 * np.sum(at_truth["pairs"] ** 2) == pytest.approx(429.0, abs=0.1)
    estimate = calib.solve(pairwise.weighted_pairwise(points, weights))
    assert np.allclose(estimate["centre"], [5.0 - 2.0596, 0.0, -0.4], atol=1e-4)
    assert np.abs(angle_errors(points, estimate["centre"])).max() / degree == pytest.approx(30.99, abs=0.01)


def test_equation_14_ruins_a_small_table_too_so_table_1_was_not_made_with_it():
    """200 mm radius, 3 m away: weights differ by 15 %, the centre by 7.2 mm, an angle by 2 degrees; table 1: 0.05."""
    points = level_circle(0.2, 3.0)
    weights = weights_by_distance(points)
    estimate = calib.solve(pairwise.weighted_pairwise(points, weights))
    assert weights.max() / weights.min() == pytest.approx(1.154, abs=0.001)
    assert estimate["centre"][0] - 3.0 == pytest.approx(-7.17 * mm, abs=0.01 * mm)
    assert np.abs(angle_errors(points, estimate["centre"])).max() / arcsec == pytest.approx(7394.0, abs=1.0)
    repaired = calib.solve(pairwise.repaired_pairwise(points, weights))
    assert np.abs(angle_errors(points, repaired["centre"])).max() < 1e-9


def test_the_answer_of_equation_14_depends_on_the_unit_of_length():
    normal = np.array([0.3, 0.0, 1.0]) / np.linalg.norm([0.3, 0.0, 1.0])
    first, second = circle.in_plane(normal, np.array([1.0, 0.0, 0.0]))
    outward = np.cos(COMMAND)[:, None] * first + np.sin(COMMAND)[:, None] * second
    points = np.array([2.0, 0.0, 0.0]) + 0.2 * outward
    points = points + np.random.default_rng(1).normal(0.0, 20.0 * um, points.shape)
    weights = pairwise.weights(np.linspace(10.0, 12.0, 12))
    in_metres, in_millimetres = (calib.solve(pairwise.weighted_pairwise(points * k, weights))["centre"] / k
                                 for k in (1.0, 1000.0))
    assert np.linalg.norm(in_metres - in_millimetres) > 30.0 * um
    repaired = [calib.solve(pairwise.repaired_pairwise(points * k, weights))["centre"] / k
                for k in (1.0, 1000.0)]
    assert np.linalg.norm(repaired[0] - repaired[1]) < 1e-9


def test_a_first_point_10_um_off_the_plane_cannot_lie_on_the_x_axis_of_the_frame():
    """Equation 15 with figure 3: normal to z, first point to x: a right angle that misses by 20.6 arcsec."""
    first, normal = np.array([0.1, 0.0, 10.0 * um]), np.array([0.0, 0.0, 1.0])
    assert np.pi / 2 - np.arccos(first @ normal / np.linalg.norm(first)) == pytest.approx(20.6 * arcsec, rel=5e-3)


def test_more_points_make_the_circle_surer_but_hardly_the_angle():
    """Section 2.1, 10 um on each coordinate, 100 mm radius: u of the radius 5.0 to 1.0 um, of an angle 35.7 to 29.5."""
    u = {}
    for count in (4, 96):
        fit = calib.linearise(circle.declare(level_circle(0.1, 3.0, count), 10.0 * um))
        u[count] = calib.covariance(fit, "radius").u[0] / um, np.median(calib.covariance(fit, "angle").u) / arcsec
    assert u[4] == pytest.approx((5.0, 35.73), rel=1e-3) and u[96] == pytest.approx((1.0206, 29.47), rel=1e-3)
