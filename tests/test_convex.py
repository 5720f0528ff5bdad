from itertools import combinations

import casadi as ca
import numpy as np
import pytest

from calib import (
    Constraint,
    Direction,
    Gaussian,
    GaussNewton,
    Observations,
    Problem,
    Rotation,
    Unknown,
    linearise,
    prior,
    simulate,
    solve,
)
from calib.effect import Effect, Parameter, direct
from calib.errors import CalibrationError, MethodRefusal, RankDefect
from calib.solve.convex import L1, Convex, Huber, LeastSquares, MinimumZone
from calib.solve.ipopt import GaussNewtonHessian, Ipopt

LOSSES = (LeastSquares(), Huber(1.345), L1(), MinimumZone())


def straight(offset, slope, place, *, reading=direct):
    return reading(offset + slope * place)


def straightness(readings, place, u=1e-6, **kept):
    """Heights along a straightedge: unknown offset and slope, and the problem of both."""
    offset, slope = Unknown("offset", 0.0, "um", **kept), Unknown("slope", 0.0, "urad")
    return Problem([Observations(straight, offset, slope, place, readings=readings, u=u, group="heights", unit="um")],
                   name="straightness"), offset, slope


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_least_squares_is_the_answer_of_gauss_newton_to_rounding(seed):
    generator = np.random.default_rng(seed)
    place = np.sort(generator.uniform(0.0, 1.0, 20))
    u = Gaussian.serial(generator.uniform(1e-6, 3e-6, 20), 0.6, place)
    problem, offset, slope = straightness(5e-6 + 3e-5 * place + 2e-6 * generator.normal(size=20), place, u)
    expected, found = solve(problem, GaussNewton()), solve(problem, Convex(), start={offset: 7.0, slope: -40.0})
    size = np.sqrt(np.diag(linearise(expected).factor.matrix))
    assert abs(found[offset] - expected[offset]) <= 1e-8 * size[0]
    assert abs(found[slope] - expected[slope]) <= 1e-8 * size[1]
    assert found.converged and found.certificate.passed and found.certificate.gap <= 1e-9
    assert found.method == "convex" and found.objective == pytest.approx(expected.objective, rel=1e-9)


def test_the_l1_line_passes_through_the_five_exact_points_and_ignores_two_wild_ones():
    place = np.arange(7.0)
    readings = 1e-6 * (2.0 + 3.0 * place)
    readings[[2, 5]] += [4e-4, -9e-5]
    problem, offset, slope = straightness(readings, place)
    found = solve(problem, Convex(L1()))
    assert found[offset] == pytest.approx(2e-6, abs=1e-18) and found[slope] == pytest.approx(3e-6, abs=1e-18)
    assert found.certificate.passed and found.certificate.gap <= 1e-12


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_l1_line_is_the_best_of_all_lines_through_two_points(seed):
    generator = np.random.default_rng(seed)
    place, u = generator.uniform(0.0, 1.0, 9), generator.uniform(1e-6, 2e-6, 9)
    readings = 1e-5 * place + 3e-6 * generator.standard_t(2, size=9)
    problem, offset, slope = straightness(readings, place, u)
    found = solve(problem, Convex(L1()))
    # a linear program has its answer at a corner: a line through two points
    lines = [(s := (readings[j] - readings[i]) / (place[j] - place[i]), readings[i] - s * place[i])
             for i, j in combinations(range(9), 2)]
    best_slope, best_offset = min(lines, key=lambda line: np.sum(np.abs(readings - line[1] - line[0] * place) / u))
    assert found[slope] == pytest.approx(best_slope, abs=1e-16)
    assert found[offset] == pytest.approx(best_offset, abs=1e-16)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_weighted_median_is_the_l1_value_of_repeated_readings(seed):
    readings = np.sort(np.random.default_rng(seed).normal(size=7))
    value = Unknown("value", 100.0)
    found = solve(Problem([Observations(lambda v: v, value, readings=readings, u=0.1)]), Convex(L1()))
    assert found[value] == pytest.approx(readings[3], abs=1e-15)


def test_an_l1_answer_that_is_not_unique_says_so():
    value = Unknown("value", 0.0)
    found = solve(Problem([Observations(lambda v: v, value, readings=[1.0, 2.0], u=0.1)]), Convex(L1()))
    assert 1.0 <= found[value] <= 2.0 and "other answers" in found.message and found.certificate.passed


def test_the_minimum_zone_of_a_zigzag_is_known():
    # heights 0, 2, 0, 2 at 0, 1, 2, 3 um: the zone through (1, 2), (3, 2) above and (0, 0), (2, 0) below is horizontal
    place, readings = np.arange(4.0), 1e-6 * np.array([0.0, 2.0, 0.0, 2.0])
    problem, offset, slope = straightness(readings, place)
    found = solve(problem, Convex(MinimumZone()))
    assert found[slope] == pytest.approx(0.0, abs=1e-18) and found[offset] == pytest.approx(1e-6, abs=1e-18)
    np.testing.assert_allclose(np.abs(found.residuals["heights"]), 1e-6, rtol=0.0, atol=1e-17)
    assert found.certificate.passed and found.certificate.gap <= 1e-12


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_minimum_zone_line_is_the_best_of_all_lines_parallel_to_a_chord(seed):
    generator = np.random.default_rng(seed)
    place = generator.uniform(0.0, 1.0, 12)
    readings = 1e-5 * place + 2e-6 * generator.normal(size=12)
    problem, _, slope = straightness(readings, place)
    found = solve(problem, Convex(MinimumZone()))
    # the narrowest strip leans on one side on two points: ISO 12780, minimum zone reference line
    slopes = [(readings[j] - readings[i]) / (place[j] - place[i]) for i, j in combinations(range(12), 2)]
    strips = [(np.ptp(readings - s * place), s) for s in slopes]
    width, best = min(strips)
    assert found[slope] == pytest.approx(best, abs=1e-16)
    assert 2.0 * np.abs(found.residuals["heights"]).max() == pytest.approx(width, rel=1e-12)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_huber_is_where_a_smooth_solver_and_the_equation_of_its_pulls_put_it(seed):
    generator = np.random.default_rng(seed)
    place = np.linspace(0.0, 1.0, 30)
    readings = 1e-5 * place + 1e-6 * generator.standard_t(1.5, size=30)
    problem, offset, slope = straightness(readings, place)
    found = solve(problem, Convex(Huber(1.345)))
    pull = np.clip(found.residuals["heights"][:, 0] / 1e-6, -1.345, 1.345)
    np.testing.assert_allclose([pull.sum(), pull @ place], 0.0, atol=1e-10)
    assert np.any(np.abs(pull) == 1.345) and found.certificate.passed
    opti = ca.Opti()
    x = opti.variable(2)
    r = (readings - x[0] * 1e-6 - x[1] * 1e-6 * place) / 1e-6
    inside = ca.fmin(ca.fabs(r), 1.345)
    opti.minimize(ca.sum1(inside * (ca.fabs(r) - 0.5 * inside)))
    opti.solver("ipopt", {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-11}})
    np.testing.assert_allclose(np.array([found[offset], found[slope]]) / 1e-6, opti.solve().value(x), atol=1e-7)


def test_a_huber_threshold_beyond_all_residuals_is_least_squares():
    place = np.linspace(0.0, 1.0, 10)
    problem, offset, slope = straightness(1e-5 * place + 1e-6 * np.cos(9 * place), place)
    plain, wide = solve(problem, Convex()), solve(problem, Convex(Huber(50.0)))
    assert wide[offset] == pytest.approx(plain[offset], abs=1e-17)
    assert wide[slope] == pytest.approx(plain[slope], abs=1e-17)


@pytest.mark.parametrize("loss", LOSSES)
def test_bounds_and_affine_constraints_hold_under_every_loss(loss):
    generator = np.random.default_rng(4)
    place = np.linspace(0.0, 1.0, 15)
    problem, offset, slope = straightness(5e-6 + 3e-5 * place + 1e-6 * generator.normal(size=15), place, upper=2e-6)
    middle, end = np.array([0.5]), np.array([1.0])
    through = Constraint("end", straight, offset, slope, end, tolerance=1e-12, lower=3.4e-5, upper=3.4e-5)
    below = Constraint("middle", straight, offset, slope, middle, tolerance=1e-12, lower=-1.0, upper=1e-3)
    found = solve(Problem(problem.observations, [through, below]), Convex(loss))
    assert found[offset] == 2e-6                       # the readings pull upwards, the bound holds exactly
    assert found[slope] == pytest.approx(3.2e-5, abs=1e-16)
    assert found.certificate.passed and found.certificate.gap <= 1e-9


def test_least_squares_at_a_bound_and_an_inequality_agrees_with_ipopt():
    generator = np.random.default_rng(6)
    place = np.linspace(0.0, 1.0, 15)
    problem, offset, slope = straightness(5e-6 + 3e-5 * place + 1e-6 * generator.normal(size=15), place)
    high = Constraint("middle", straight, offset, slope, np.array([0.5]), tolerance=1e-12, lower=2.2e-5, upper=1.0)
    limited = Problem(problem.observations, [high])
    one, other = solve(limited, Convex()), solve(limited, Ipopt())
    u = np.sqrt(np.diag(linearise(one).factor.matrix))
    assert np.all(np.abs([one[offset] - other[offset], one[slope] - other[slope]]) <= 1e-8 * u)
    assert one[offset] + 0.5 * one[slope] == pytest.approx(2.2e-5, abs=1e-17)
    assert one.certificate.passed and other.certificate.passed


@pytest.mark.parametrize("beyond", [0.0, 1e-9, -1e-9, 1e-7, -1e-7, 1e-5, -1e-5])
def test_a_bound_that_only_just_touches_is_decided_alike_by_all_methods(beyond):
    x, y = Unknown("x", 1.0, lower=0.0), Unknown("y", 0.0)
    both = Observations(lambda a, b: a + b, x, y, readings=[1.0 + beyond, 1.0 + beyond], u=1.0, group="sum")
    one = Observations(lambda b: b, y, readings=[1.0], u=1.0, group="one")
    # where x is at its bound, two of three equal readings ask y for 1 + beyond
    expected = (max(beyond, 0.0), 1.0 + min(beyond, 0.0) * 2 / 3)
    for method in (GaussNewton(), Ipopt(), Ipopt(GaussNewtonHessian()), Convex()):
        found = solve(Problem([both, one]), method)
        assert found.certificate.passed, (method, found.certificate.why)
        assert (found[x], found[y]) == pytest.approx(expected, rel=0.0, abs=1e-14)
        assert (found[x] == 0.0) == (beyond <= 0.0)


def test_contradictory_limits_are_named():
    problem, offset, _ = straightness(np.zeros(5), np.arange(5.0), lower=-1.0, upper=0.0)
    aloft = Constraint("aloft", lambda o: o, offset, tolerance=1e-9, lower=2.0, upper=3.0)
    with pytest.raises(CalibrationError, match=r"contradict.*'aloft'"):
        solve(Problem(problem.observations, [aloft]), Convex())


def product(gain, value):
    return gain * value


def seen(direction, point):
    return ca.dot(direction, point)


def bent(value):
    return value * value


BENT = Effect("bent", "reading", lambda value, p: p.c * value**2, (Parameter("c", "1/m", (1e-6, 1e-3)),))


@pytest.mark.parametrize("loss", LOSSES)
def test_what_is_not_affine_is_refused_with_group_and_argument(loss):
    gain, value, toward = Unknown("gain", 1.0), Unknown("value", 2.0), Direction("toward", (0.0, 0.0, 1.0))
    bilinear = Observations(product, gain, value, readings=[2.0], u=0.1, group="products")
    known = prior(value, 2.0, 0.1)
    with pytest.raises(MethodRefusal, match=r"'products'.*product is not affine.*'gain'.*'value'"):
        solve(Problem([bilinear, known]), Convex(loss))
    assert solve(Problem([bilinear, known]).hold(gain), Convex(loss)).certificate.passed
    plane = Observations(seen, toward, np.eye(3), readings=[0.0, 0.0, 1.0], u=0.1, group="plane")
    with pytest.raises(MethodRefusal, match=r"'plane'.*'direction' \(unknown 'toward', a direction\)"):
        solve(Problem([plane]), Convex(loss))
    curved = Constraint("curve", bent, value, tolerance=1e-6, lower=1.0, upper=4.0)
    with pytest.raises(MethodRefusal, match=r"constraint 'curve'.*'value'"):
        solve(Problem([known], [curved]), Convex(loss))


def test_an_effect_that_is_held_at_zero_leaves_a_problem_affine_until_it_is_freed():
    place = np.linspace(0.0, 1.0, 12)
    problem, *_ = straightness(1e-5 * place + 1e-6 * np.cos(9 * place), place)
    problem = problem.with_effects(BENT)
    assert solve(problem, Convex()).certificate.passed
    with pytest.raises(MethodRefusal, match="heights"):
        solve(problem.free(BENT), Convex())


def test_correlated_readings_are_refused_by_losses_that_depend_on_the_whitening():
    place = np.linspace(0.0, 1.0, 6)
    problem, *_ = straightness(np.cos(place), place, Gaussian.serial(0.1, 0.5, place))
    for loss in LOSSES[1:]:
        with pytest.raises(MethodRefusal, match=r"'heights' have correlated errors"):
            solve(problem, Convex(loss))
    assert solve(problem, Convex()).certificate.passed


def test_a_covariance_matrix_without_correlations_is_no_hindrance():
    point = Unknown("point", (0.0, 0.0), "m")
    readings = [[0.0, 0.0], [1.0, 0.1], [0.0, 5.0]]
    problem = Problem([Observations(lambda p: p, point, readings=readings, u=Gaussian.matrix(np.diag([1.0, 4.0])))])
    np.testing.assert_allclose(solve(problem, Convex(L1()))[point], [0.0, 0.1], atol=1e-15)


def test_a_held_part_makes_a_product_affine_in_the_other():
    pair = Unknown("pair", (2.0, 3.0), parts=("gain", "value"))
    problem = Problem([Observations(lambda p: p[0] * p[1], pair, readings=[7.0], u=0.1, group="product")])
    assert solve(problem.hold(pair.part("gain")), Convex())[pair][1] == pytest.approx(3.5, rel=1e-15)
    with pytest.raises(MethodRefusal, match=r"'product'.*'pair'"):
        solve(problem, Convex())


def test_missing_readings_and_unseen_directions_are_refused():
    problem, *_ = straightness(np.zeros(5), np.arange(5.0))
    with pytest.raises(MethodRefusal, match="no readings"):
        solve(problem.with_readings({"heights": None}), Convex())
    for loss in LOSSES:
        with pytest.raises(RankDefect, match="slope"):
            solve(straightness(np.zeros(5), np.zeros(5))[0], Convex(loss))


def test_a_held_rotation_is_no_hindrance():
    frame, point = Rotation("frame", np.eye(3)), Unknown("point", (0.0, 0.0, 0.0), "m")
    problem = Problem([Observations(lambda r, p: r @ p, frame, point, u=1e-3, readings=[[0.1, 0.2, 0.3]])])
    found = solve(problem.hold(frame), Convex())
    np.testing.assert_allclose(found[point], [0.1, 0.2, 0.3], atol=1e-16)
    with pytest.raises(MethodRefusal, match="a rotation"):
        solve(problem, Convex())


@pytest.mark.parametrize("loss", LOSSES)
def test_periodic_readings_are_taken_in_the_period_of_the_start(loss):
    problem, zero = circle_readings()
    assert solve(problem, Convex(loss), start={zero: 3.0})[zero] == pytest.approx(3.1, abs=5e-5)


def test_a_start_half_a_turn_off_tears_periodic_readings_apart_and_is_refused():
    problem, zero = circle_readings()
    for loss in LOSSES[:3]:
        with pytest.raises(MethodRefusal, match="period"):
            solve(problem, Convex(loss), start={zero: 3.1 - np.pi})


def circle_readings():
    zero, turn = Unknown("zero", 3.1, "rad"), np.linspace(0.0, 6.0, 13)
    circle = Observations(lambda z, t: z + t, zero, turn, u=1e-5, period=2 * np.pi, group="circle")
    problem = simulate(Problem([circle]), {zero: 3.1}, 3)
    return problem.with_readings({"circle": problem.observations[0].readings % (2 * np.pi)}), zero
