import casadi as ca
import numpy as np
import pytest

from calib import (
    Constraint,
    Direction,
    Gaussian,
    GaussNewton,
    Observations,
    Pose,
    Problem,
    Rotation,
    Unknown,
    linearise,
    prior,
    simulate,
    solve,
)
from calib.errors import CalibrationError, MethodRefusal, RankDefect
from calib.geometry import distance_to_line, norm, rotation_about, unit
from calib.solve.ipopt import ExactHessian, GaussNewtonHessian, Ipopt

HESSIANS = (ExactHessian(), GaussNewtonHessian())


def units_apart(first, second):
    """Largest difference of two estimates in standard uncertainties of the first."""
    fit = linearise(first)
    step = np.concatenate([u.difference(second.values[u], first.values[u]).ravel() for u in fit.layout.unknowns])
    return float(np.max(np.abs(step[fit.layout.free_columns]) / np.sqrt(np.diag(fit.factor.matrix))))


def exponential(amplitude, rate, time):
    return amplitude * ca.exp(-rate * time)


def decay(seed, correlated=None, **bounds):
    time = np.linspace(0.0, 4.0, 25)
    amplitude, rate = Unknown("amplitude", 2.0, "m"), Unknown("rate", 0.7, "1/s", **bounds)
    u = Gaussian.serial(0.05, correlated, time) if correlated else 0.05
    problem = Problem([Observations(exponential, amplitude, rate, time, u=u, group="decay")], name="decay")
    return simulate(problem, {amplitude: 2.0, rate: 0.7}, seed), amplitude, rate


@pytest.mark.parametrize("hessian", HESSIANS)
@pytest.mark.parametrize("correlated", [None, 0.8])
def test_a_decay_is_fitted_as_by_gauss_newton_also_with_serial_correlation(hessian, correlated):
    problem, amplitude, rate = decay(3, correlated)
    far = {amplitude: 0.2, rate: 3.0}
    expected, found = solve(problem, GaussNewton()), solve(problem, Ipopt(hessian), start=far)
    assert found.converged and found.certificate.passed and found.method == "ipopt"
    assert units_apart(expected, found) <= 1e-8
    assert found.objective == pytest.approx(expected.objective, rel=1e-12)


def point_seen(pose, target):
    return pose.inverse() @ target


@pytest.mark.parametrize("hessian", HESSIANS)
@pytest.mark.parametrize("turned", [10.0, 170.0])
def test_a_pose_is_found_from_far_off_with_a_covariance_matrix_for_each_point(hessian, turned):
    generator = np.random.default_rng(5)
    targets = generator.normal(size=(8, 3))
    roots = 1e-4 * (np.eye(3) + 0.4 * generator.normal(size=(8, 3, 3)))
    truth = rotation_about(unit([1.0, -2.0, 0.5]), np.radians(turned))
    pose = Pose("pose", truth, (0.3, -0.2, 1.0))
    covariance = Gaussian.matrix(roots @ roots.transpose(0, 2, 1))
    problem = Problem([Observations(point_seen, pose, targets, u=covariance, group="points")], name="resection")
    problem = simulate(problem, {}, 11)
    expected = solve(problem, GaussNewton())
    away = solve(problem, Ipopt(hessian), start={pose: Pose("start").show(Pose("start").ambient)})
    assert away.converged and away.certificate.passed
    assert units_apart(expected, away) <= 1e-8


def circle_point(centre, radius, angle):
    return centre + radius * ca.vertcat(ca.cos(angle), ca.sin(angle))


def length_between(first, second):
    return norm(second - first)


@pytest.mark.parametrize("hessian", HESSIANS)
def test_equality_constraints_hold_and_agree_with_gauss_newton(hessian):
    generator = np.random.default_rng(2)
    points = Unknown("point", [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.1]], "m")
    readings = points.ambient + 1e-3 * generator.normal(size=(3, 3))
    bar = Constraint("bar", length_between, points[0], points[1], tolerance=1e-9, unit="m", lower=1.001, upper=1.001)
    problem = Problem([Observations(lambda p: p, points.each, readings=readings, u=1e-3, group="points")], [bar])
    expected, found = solve(problem, GaussNewton()), solve(problem, Ipopt(hessian))
    assert found.certificate.passed and found.certificate.feasibility <= 1e-3
    assert units_apart(expected, found) <= 1e-8
    assert np.linalg.norm(found[points][1] - found[points][0]) == pytest.approx(1.001, abs=1e-12)


def test_an_active_inequality_gives_the_answer_of_the_equation_and_an_inactive_one_changes_nothing():
    generator = np.random.default_rng(2)
    ends = Unknown("end", [[0.0, 0.0], [1.0, 0.0]], "m")
    readings = ends.ambient + 1e-3 * generator.normal(size=(2, 2))

    def fitted(method, **limits):
        bar = Constraint("bar", length_between, ends[0], ends[1], tolerance=1e-9, unit="m", **limits)
        return solve(Problem([Observations(lambda p: p, ends.each, readings=readings, u=1e-3)], [bar]), method)

    measured = np.linalg.norm(readings[1] - readings[0])
    as_equation = fitted(GaussNewton(), lower=measured - 0.004, upper=measured - 0.004)
    pushed = fitted(Ipopt(), lower=0.0, upper=measured - 0.004)
    idle = fitted(Ipopt(), lower=measured - 0.004, upper=np.inf)
    np.testing.assert_allclose(pushed[ends], as_equation[ends], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(idle[ends], readings, rtol=0.0, atol=1e-11)
    assert pushed.certificate.passed and idle.certificate.passed
    with pytest.raises(MethodRefusal, match="bar"):
        fitted(GaussNewton(), lower=0.0, upper=1.0)


@pytest.mark.parametrize("hessian", HESSIANS)
def test_a_bound_that_is_pushed_against_holds_exactly_and_the_rest_adjusts(hessian):
    problem, amplitude, rate = decay(3, upper=0.6)
    held, amplitude_held, rate_held = decay(3)
    expected = solve(held.hold(rate_held), GaussNewton(), start={rate_held: 0.6})
    found = solve(problem, Ipopt(hessian), start={rate: 0.1})
    assert found[rate] == 0.6
    u = np.sqrt(linearise(expected).factor.matrix[0, 0])
    assert abs(found[amplitude] - expected[amplitude_held]) <= 1e-8 * u
    assert found.certificate.passed
    assert solve(decay(3, upper=0.9)[0], Ipopt(hessian)).objective == pytest.approx(solve(held).objective, rel=1e-12)


def test_an_effect_at_its_bound_of_zero_stays_there():
    kappa, scale = Unknown("kappa", 0.0, "1", lower=0.0), Unknown("scale", 1.0, "1")
    length = np.linspace(0.1, 1.0, 10)
    model = lambda k, s, x: s * x + k * x * x   # noqa: E731
    readings = length - 0.01 * length**2
    problem = Problem([Observations(model, kappa, scale, length, readings=readings, u=1e-4)])
    found = solve(problem, Ipopt())
    assert found[kappa] == 0.0 and found.certificate.passed
    expected = float(readings @ length / (length @ length))       # least squares of scale alone
    assert found[scale] == pytest.approx(expected, rel=1e-13)


def turned_azimuth(rotation, toward):
    there = ca.mtimes(rotation.T, toward)
    return ca.atan2(there[1], there[0])


@pytest.mark.parametrize("hessian", HESSIANS)
def test_periodic_readings_are_met_across_the_turn_of_the_circle(hessian):
    azimuth = np.radians([10.0, 80.0, 179.0, 181.0, 250.0, 359.0])
    toward = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.full(6, 0.2)])
    station = Rotation("station", rotation_about(np.array([0.0, 0.0, 1.0]), 3.0))
    problem = Problem([Observations(turned_azimuth, station, toward, u=1e-5, period=2 * np.pi, group="circle"),
                       prior(station, np.eye(3), [1e-4, 1e-4, 4.0], name="levelled")])
    problem = simulate(problem, {}, 4)
    turns = {"circle": problem.observations[0].readings + 2 * np.pi * np.array([0, 1, -1, 2, 0, 0])[:, None]}
    expected, found = solve(problem, GaussNewton()), solve(problem.with_readings(turns), Ipopt(hessian))
    assert found.converged and units_apart(expected, found) <= 1e-8
    assert np.abs(found.residuals["circle"]).max() < 1e-4


def test_a_direction_and_a_foot_point_for_each_row_agree_on_an_orthogonal_line_fit():
    generator = np.random.default_rng(8)
    along = np.linspace(-1.0, 1.0, 12)
    points = np.outer(along, unit([1.0, 2.0, 2.0])) + 0.5 + 1e-3 * generator.normal(size=(12, 3))
    axis, origin = Direction("axis", (0.0, 0.6, 0.8)), Unknown("origin", (0.5, 0.5, 0.5), "m")
    place = Unknown("place", along[:, None], "m")
    problem = Problem([Observations(lambda o, d, s: o + s * d, origin, axis, place.each, readings=points, u=1e-3),
                       prior(origin.part("x"), 0.5, 1e-9)])
    expected, found = solve(problem, GaussNewton()), solve(problem, Ipopt())
    assert units_apart(expected, found) <= 1e-8
    _, _, principal = np.linalg.svd(points - points.mean(axis=0))        # the line is the first principal axis
    distances = [float(distance_to_line(p, found[origin], found[axis])) for p in points]
    best = [float(distance_to_line(p, points.mean(axis=0), principal[0])) for p in points]
    np.testing.assert_allclose(distances, best, rtol=0.0, atol=1e-10)


def test_what_a_method_must_refuse_is_refused():
    problem, amplitude, rate = decay(1)
    with pytest.raises(MethodRefusal, match="no readings"):
        solve(problem.with_readings({"decay": None}), Ipopt())
    both = Unknown("both", 1.0)
    undetermined = Problem([Observations(lambda a, b: a + b, amplitude, both, readings=[1.0, 2.0], u=0.1)])
    with pytest.raises(RankDefect, match="both"):
        solve(undetermined, Ipopt())
    with pytest.raises(CalibrationError, match="everything is held"):
        solve(problem.hold(amplitude, rate), Ipopt())


def test_uncertainties_that_depend_on_the_prediction_stand_still_at_the_same_answer():
    scale = Unknown("scale", 1.0)
    length = np.linspace(1.0, 9.0, 9)
    u = Gaussian.depending(lambda s, x: 1e-3 + 1e-3 * s * x)
    problem = Problem([Observations(lambda s, x: s * x, scale, length, u=u, group="lengths",
                                    readings=1.01 * length + 1e-3 * np.cos(7 * length))])
    assert units_apart(solve(problem, GaussNewton()), solve(problem, Ipopt())) <= 1e-8


def test_contradictory_constraints_end_in_a_failed_certificate_or_an_error():
    x = Unknown("x", 0.0, "m")
    apart = [Constraint(f"at {v}", lambda x: x, x, tolerance=1e-9, lower=v, upper=v) for v in (0.0, 1.0)]
    problem = Problem([Observations(lambda x: x, x, readings=[0.5], u=0.1)], apart)
    found = solve(problem, Ipopt())
    assert not found.converged and not found.certificate.passed and "condition" in found.certificate.why


@pytest.mark.parametrize("seed", [1, 2])
def test_large_residuals_do_not_stop_the_exact_hessian(seed):
    # ranges of 1 m from six known points that no point satisfies: residuals of decimetres where u is 1 mm
    stations = np.random.default_rng(seed).normal(size=(6, 2))
    point = Unknown("point", (0.1, 0.2), "m")
    problem = Problem([Observations(lambda p, s: norm(p - s), point, stations, readings=np.full(6, 1.0), u=1e-3)])
    found = solve(problem, Ipopt())
    assert found.converged and found.certificate.passed and found.certificate.curvature < 1.0
