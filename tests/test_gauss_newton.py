"""Gauss-Newton: far starts, constraints, bounds, rank defects and refusals."""

import casadi as ca
import numpy as np
import pytest
from declared import line, network, straight

from calib import Constraint, Observations, Pose, Problem, Unknown, covariance, linearise, solve
from calib.errors import CalibrationError, MethodRefusal, RankDefect
from calib.geometry import rotation_about


@pytest.mark.parametrize("degrees", [5, 90, 150, 175])
def test_a_pose_is_found_from_far_away(degrees):
    axis = np.array([0.36, 0.48, 0.8])
    turn = np.asarray(rotation_about(axis, np.radians(degrees)), float)
    points = np.random.default_rng(3).normal(size=(10, 3))
    pose = Pose("pose")
    estimate = solve(
        Problem([Observations(lambda t, p: t @ p, pose, points, readings=points @ turn.T + [1, 2, 3], u=1e-3)])
    )
    assert estimate.converged
    assert estimate.certificate.passed
    assert np.allclose(estimate[pose].rotation, turn, atol=1e-10)
    assert np.allclose(estimate[pose].translation, [1, 2, 3], atol=1e-10)


def test_an_equality_constraint_holds_exactly_and_lowers_the_uncertainty():
    # y = a + b x with a = b: least squares with one unknown a (1 + x).
    x, y = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.2, 1.1, 1.3, 2.6])
    a, b = Unknown("a"), Unknown("b")
    o = Observations(straight, a, b, x, readings=y, u=0.1)
    estimate = solve(Problem([o], [Constraint("equal", lambda a, b: a - b, a, b, tolerance=1e-12)]))
    assert estimate[a] == pytest.approx((1 + x) @ y / ((1 + x) @ (1 + x)), abs=1e-14)
    assert estimate[a] - estimate[b] == pytest.approx(0.0, abs=1e-14)
    fit = linearise(estimate)
    assert covariance(fit, a).u[0] == pytest.approx(0.1 / np.linalg.norm(1 + x), rel=1e-12)
    assert fit.dof == 3


def test_a_nonlinear_constraint_is_met_from_a_start_that_breaks_it():
    point = Unknown("point", [3.0, 0.5])
    o = Observations(lambda p: p, point, readings=[[2.0, 1.0]], u=0.1)
    estimate = solve(
        Problem([o], [Constraint("unit circle", lambda p: ca.dot(p, p), point, tolerance=1e-10, lower=1.0, upper=1.0)])
    )
    assert np.allclose(
        estimate[point], np.array([2.0, 1.0]) / np.sqrt(5), atol=1e-10
    )  # the nearest point of the circle
    assert estimate.certificate.passed


def test_contradictory_constraints_are_never_called_converged():
    a = Unknown("a")
    conditions = [
        Constraint("one", lambda a: a - 1, a, tolerance=1e-9),
        Constraint("two", lambda a: a - 2, a, tolerance=1e-9),
    ]
    estimate = solve(Problem([Observations(lambda a: a, a, readings=[1.0], u=1.0)], conditions))
    assert not estimate.converged
    assert "constraints contradict" in estimate.message
    assert not estimate.certificate.passed


def test_a_bound_that_holds_the_estimate_leaves_it_no_uncertainty_of_its_own():
    x, y = np.array([0.0, 1.0, 2.0]), np.array([1.0, 0.5, 0.2])
    a, b = Unknown("a"), Unknown("b", 0.5, lower=0.0)
    estimate = solve(Problem([Observations(straight, a, b, x, readings=y, u=0.1)]))
    assert estimate[b] == 0.0
    assert estimate[a] == pytest.approx(y.mean(), abs=1e-14)
    assert estimate.certificate.passed
    assert covariance(linearise(estimate), b).u[0] == 0.0


def test_a_bound_that_does_not_matter_changes_nothing():
    x, y = np.array([0.0, 1.0, 2.0]), np.array([1.0, 0.5, 0.2])
    a, b, free = Unknown("a"), Unknown("b", 5.0, lower=-1.0), Unknown("b", 5.0)
    one = solve(Problem([Observations(straight, a, b, x, readings=y, u=0.1)]))
    two = solve(Problem([Observations(straight, a, free, x, readings=y, u=0.1)]))
    assert one[b] == pytest.approx(two[free], abs=1e-14)


def test_an_inequality_is_refused_with_the_method_that_takes_it():
    a = Unknown("a")
    problem = Problem(
        [Observations(lambda a: a, a, readings=[1.0], u=1.0)],
        [Constraint("limit", lambda a: a, a, tolerance=1e-9, lower=-np.inf, upper=0.5)],
    )
    with pytest.raises(MethodRefusal, match="'limit' is an inequality; use Ipopt"):
        solve(problem)


def test_a_rank_defect_is_named_in_the_users_words_with_its_cure():
    a, b = Unknown("squareness", unit="urad"), Unknown("line_frame", unit="urad")
    o = Observations(lambda a, b, x: (a + b) * x, a, b, np.arange(4.0), readings=np.arange(4.0), u=1.0)
    with pytest.raises(RankDefect, match=r"1 urad .* - 1 urad .* changes no reading; hold one of them, add a prior"):
        solve(Problem([o]))


def test_an_unknown_that_no_reading_sees_is_named_alone():
    a, b = Unknown("seen"), Unknown("unseen")
    o = Observations(lambda a, b: a + 0 * b, a, b, readings=[1.0, 2.0], u=1.0)
    with pytest.raises(RankDefect, match="unseen changes no reading; hold it, add a prior"):
        solve(Problem([o]))


def test_fewer_readings_than_unknowns_are_counted_in_the_message():
    problem, *_ = line(readings=[1.0], x=[2.0])
    with pytest.raises(RankDefect, match=r"\(1 readings for 2 unknowns\)"):
        solve(problem)


def test_everything_held_is_refused():
    problem, offset, slope = line()
    with pytest.raises(CalibrationError, match="everything is held"):
        solve(problem.hold(offset, slope))


def test_observations_without_readings_can_be_planned_but_not_solved():
    problem, offset, slope = line()
    planned = problem.with_readings({"line": None})
    with pytest.raises(MethodRefusal, match="'line' have no readings"):
        solve(planned)
    assert np.allclose(
        covariance(linearise(planned), offset, slope).matrix, covariance(linearise(problem), offset, slope).matrix
    )


def test_a_model_that_breaks_down_is_named_with_row_and_unknown():
    a = Unknown("a", -1.0)
    problem = Problem(
        [Observations(lambda a, x: ca.sqrt(a) * x, a, np.ones(3), readings=np.ones(3), u=1.0, rows=[7, 8, 9])]
    )
    with pytest.raises(CalibrationError, match=r"row 7: the model .* gives nan at the present values of a"):
        solve(problem)


def test_the_order_of_rows_and_the_unit_of_an_unknown_do_not_matter():
    problem, station, point = network(4, 12, 1)
    seen = problem.observations[0]
    order = np.random.default_rng(0).permutation(seen.n)
    i, j = seen.covariates["station"][order], seen.covariates["point"][order]
    again = Observations(
        seen.model,
        station[i],
        point[j],
        readings=seen.readings[order],
        u=[5e-6, 5e-6, 5e-6],
        group="polar",
        period=seen.period,
    )
    first, second = solve(problem), solve(Problem([again]).hold(station[0]))
    assert np.abs(first[point] - second[point]).max() < 1e-12
    assert first.objective == pytest.approx(second.objective, rel=1e-9)
