"""Monte Carlo in lanes against linear propagation, repeated solves, and distributions in closed form."""

import casadi as ca
import numpy as np
import pytest
from declared import line, network
from shipped import example

from calib import (
    Constraint,
    Gaussian,
    Ipopt,
    Observations,
    Problem,
    Quantity,
    Unknown,
    covariance,
    linearise,
    montecarlo,
    prior,
    simulate,
    solve,
)
from calib.compiled import available, row_back_end
from calib.linearisation import linearise_system
from calib.system import System
from calib.workflow.montecarlo import Adaptive
from calib.workflow.places import Threads
from calib.workflow.propagation import verdict
from calib.workflow.trials import BLOCK, FactoredTrials, LargeTrials, SmallTrials, trials_of


def agree(found, stated, trials):
    """Whether standard deviations agree within 4 times their sampling error."""
    return np.abs(found / stated - 1).max() < 4 / np.sqrt(2 * trials)


def test_the_spread_of_a_network_is_its_covariance():
    problem, _, point = network(3, 8, 1)
    quantity = Quantity("points", lambda p: p, point.each, unit="mm", keys=point.keys)
    result = montecarlo(solve(problem.with_quantities(quantity)), 2000, seed=1)
    assert result.failures == 0
    assert agree(result.u, result.linear_u, 2000)
    assert result.names[0] == "points[0].x"


@pytest.mark.parametrize(
    "u",
    [
        Gaussian.serial(0.1, 0.7, np.arange(5)),
        Gaussian.groups([1, 1, 1, 2, 2], {1: 0.01 * (np.eye(3) + 0.5), 2: 0.02 * np.eye(2)}),
    ],
)
def test_correlated_readings_are_drawn_and_weighted_as_stated(u):
    problem, offset, slope = line(readings=np.arange(5.0), u=u)
    result = montecarlo(
        solve(problem.with_quantities(Quantity("end", lambda a, b: a + 9 * b, offset, slope))), 5000, seed=2
    )
    assert agree(result.u, result.linear_u, 5000)


def test_priors_constraints_and_held_quantities_take_part():
    x = np.arange(5.0)
    a, b, c = Unknown("a"), Unknown("b"), Unknown("c")
    problem = Problem(
        [
            Observations(lambda a, b, c, x: a + b * x + c * x**2, a, b, c, x, readings=1 + x, u=0.1),
            prior(b, 1.0, 0.05),
            prior(c, 0.0, 0.02),
        ],
        [Constraint("tied", lambda a, b: a - b, a, b, tolerance=1e-9)],
        [Quantity("a", lambda a: a, a), Quantity("b", lambda b: b, b)],
        held=[c],
    )
    result = montecarlo(solve(problem), 5000, seed=3)
    assert agree(result.u, result.linear_u, 5000)
    assert np.abs(result.samples[:, 0] - result.samples[:, 1]).max() < 1e-9


def test_the_same_seed_gives_the_same_samples():
    problem, offset, _ = line(readings=np.arange(5.0))
    estimate = solve(problem.with_quantities(Quantity("offset", lambda a: a, offset)))
    assert np.array_equal(montecarlo(estimate, 50, seed=4).samples, montecarlo(estimate, 50, seed=4).samples)


def test_lanes_give_what_solving_one_by_one_gives():
    problem, _, point = network(3, 6, 2)
    problem = problem.with_quantities(
        Quantity("distance", lambda a, b: ca.norm_2(a - b), point[0], point[1], unit="mm")
    )
    estimate = solve(problem)
    result = montecarlo(estimate, 300, seed=5)
    single = [solve(simulate(problem, estimate, seed))["distance"] for seed in range(60)]
    assert np.std(single) == pytest.approx(result.u[0], rel=4 / np.sqrt(120))


def test_the_square_of_a_normal_quantity_has_a_skew_interval_and_the_shortest_is_shorter():
    # x = N(0, 1): x^2 is chi-squared with one degree of freedom; its shortest 95 % interval begins at zero and ends at
    # 3.841.
    a = Unknown("a", 1e-3)
    problem = Problem(
        [Observations(lambda a: a, a, readings=[0.0], u=1.0)], quantities=[Quantity("square", lambda a: a**2, a)]
    )
    result = montecarlo(solve(problem), 40000, seed=6)
    shortest, symmetric = result.interval_shortest()[0], result.interval_symmetric()[0]
    assert shortest == pytest.approx([0.0, 3.841], abs=0.1)
    assert symmetric == pytest.approx([0.000982, 5.024], abs=0.15)
    assert shortest[1] - shortest[0] < symmetric[1] - symmetric[0]


@pytest.mark.slow
def test_trials_keep_to_inequalities_as_they_do_to_bounds():
    # The mean of four readings that cannot be negative: half of the trials lie at zero, as where it is a bound.
    a, bounded = Unknown("a"), Unknown("b", lower=0.0)

    def mean(unknown, constraints=()):
        readings = Observations(lambda a: a, unknown[np.zeros(4, int)], readings=np.zeros(4), u=1.0)
        return Problem([readings], constraints, [Quantity("mean", lambda a: a, unknown)])

    limited = mean(a, [Constraint("limit", lambda a: a, a, tolerance=1e-9, upper=np.inf)])
    found = montecarlo(solve(limited, Ipopt()), 200, seed=3)
    at_bound = montecarlo(solve(mean(bounded)), 20_000, seed=3)
    assert found.failures == 0
    assert found.samples.min() > -1e-7
    assert np.mean(found.samples < 1e-6) == pytest.approx(0.5, abs=0.11)      # 3 standard deviations
    # The mean of the positive half of N(0, 1/2) and of as many zeros, by its integral.
    assert at_bound.mean[0] == pytest.approx(0.5 / np.sqrt(2 * np.pi), abs=0.01)
    assert found.mean[0] == pytest.approx(0.5 / np.sqrt(2 * np.pi), abs=3 * 0.29 / np.sqrt(200))
    again = montecarlo(solve(limited, Ipopt()), 40, seed=3, place=Threads(2))
    assert np.array_equal(again.samples, found.samples[:40])


def test_linear_propagation_is_reported_beside_the_samples():
    problem, offset, slope = line(readings=np.arange(5.0))
    estimate = solve(problem.with_quantities(Quantity("end", lambda a, b: a + 9 * b, offset, slope)))
    assert montecarlo(estimate, 10, seed=1).linear_u == pytest.approx(covariance(linearise(estimate)).u)


# --- blocks, threads, back ends ----------------------------------------------------------------------------------


def circle_estimate(seed=1):
    return solve(example("problems.circle", seed))


@pytest.mark.parametrize("name", ["problems.circle", "problems.base_point", "problems.plumb"])
def test_a_trial_written_out_as_one_row_is_the_trial_solved_with_stored_derivatives(name):
    estimate = solve(example(name))
    system, truth = System(estimate.problem), dict(estimate.values)
    fit, chosen = linearise_system(system, truth), estimate.problem.quantities
    u = covariance(fit).u
    small, large = (kind.sample(7, 0, 100) for kind in (
        SmallTrials(system, fit, truth, chosen, 100), LargeTrials(system, fit, truth, chosen, 100)))
    assert small[1].all() and large[1].all()
    assert np.abs((small[0] - large[0]) / u).max() < 1e-6


def test_held_quantities_are_drawn_alike_by_both_kinds_of_trials():
    x = np.arange(5.0)
    a, b, c = Unknown("a", 1.0), Unknown("b", 1.0), Unknown("c", 0.5)
    problem = Problem(
        [Observations(lambda a, b, c, x: a * ca.exp(b * x / 10) + ca.sin(c * x), a, b, c, x, readings=1 + x, u=0.01),
         prior(c, 0.5, 0.05)], quantities=[Quantity("b", lambda b: b, b)], held=[c])
    estimate = solve(problem)
    system, truth = System(problem), dict(estimate.values)
    fit = linearise_system(system, truth)
    (small, _), (large, _) = (kind.sample(8, 3, 2000) for kind in (
        SmallTrials(system, fit, truth, problem.quantities, 2000),
        LargeTrials(system, fit, truth, problem.quantities, 2000)))
    u = covariance(fit).u
    # the two draw several groups in different orders, so that the spread alone is alike
    assert agree(small.std(axis=0, ddof=1), large.std(axis=0, ddof=1), 1000)
    assert agree(small.std(axis=0, ddof=1), u, 200)


def test_threads_and_the_split_into_blocks_change_no_sample(monkeypatch):
    estimate, trials = circle_estimate(), 2 * BLOCK + 300
    monkeypatch.setenv("CALIB_THREADS", "1")
    alone = montecarlo(estimate, trials, seed=9).samples
    monkeypatch.setenv("CALIB_THREADS", "3")
    np.testing.assert_array_equal(montecarlo(estimate, trials, seed=9).samples, alone)
    system, truth = System(estimate.problem), dict(estimate.values)
    ready = trials_of(system, linearise_system(system, truth), truth, estimate.problem.quantities, trials)
    backwards = [ready.sample(9, number, count)[0] for number, count in ((2, 300), (1, BLOCK), (0, BLOCK))]
    np.testing.assert_array_equal(np.concatenate(backwards[::-1]), alone)


def test_a_longer_run_begins_with_the_shorter_one():
    estimate = circle_estimate()
    shorter, longer = (montecarlo(estimate, trials, seed=10).samples for trials in (BLOCK, BLOCK + 700))
    np.testing.assert_array_equal(longer[:BLOCK], shorter)
    assert len(np.unique(longer[:, 0])) == len(longer)


@pytest.mark.skipif(not available(), reason="llvmlite is not installed")
def test_compiled_trials_of_a_network_are_those_of_numpy(monkeypatch, tmp_path):
    monkeypatch.setenv("CALIB_CACHE", str(tmp_path))
    problem, _, point = network(3, 30, 1)
    distance = Quantity("distance", lambda a, b: ca.norm_2(a - b), point[0], point[1], unit="mm")
    estimate = solve(problem.with_quantities(distance))
    with row_back_end("numpy"):
        first = montecarlo(estimate, 60, seed=15)
    with row_back_end("compiled"):
        second = montecarlo(estimate, 60, seed=15)
    assert first.failures == second.failures == 0
    assert np.abs((first.samples - second.samples) / first.linear_u).max() < 1e-6


@pytest.mark.skipif(not available(), reason="llvmlite is not installed")
def test_compiled_trials_are_those_of_numpy(monkeypatch, tmp_path):
    monkeypatch.setenv("CALIB_CACHE", str(tmp_path))
    estimate = circle_estimate()
    with row_back_end("numpy"):
        first = montecarlo(estimate, 3000, seed=11)
    with row_back_end("compiled"):
        second = montecarlo(estimate, 3000, seed=11)
    assert first.failures == second.failures == 0
    assert np.abs((first.samples - second.samples) / first.linear_u).max() < 1e-6


def test_a_trial_that_finds_no_solution_is_counted_and_left_out():
    # the readings 0.05 +- 0.1 of exp(a) are negative in a third of the trials: a then runs away to minus infinity
    a = Unknown("a", np.log(0.05))
    observed = Observations(lambda a: ca.exp(a), a, readings=[0.05], u=0.1)
    problem = Problem([observed], quantities=[Quantity("a", lambda a: a, a)])
    result = montecarlo(solve(problem), 3000, seed=12)
    assert len(result.samples) + result.failures == 3000
    assert result.failures > 500
    # They are named: a run that stops at the second of them has these two, one trial less has one.
    assert len(result.failed) == 20
    assert montecarlo(solve(problem), result.failed[1], seed=12).failed == result.failed[:2]
    assert montecarlo(solve(problem), result.failed[1] - 1, seed=12).failures == 1
    assert np.all(np.isfinite(result.samples))


# --- adaptive number of trials ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("digits", "u", "tolerance"), [(2, 0.35e-3, 0.005e-3), (1, 0.4e-3, 0.05e-3), (1, 2.0, 0.5),
                                                        (2, 0.0996, 0.005), (2, 0.0, 0.0)])
def test_the_numerical_tolerance_is_that_of_the_examples_of_the_guide(digits, u, tolerance):
    assert Adaptive(digits=digits).tolerance(np.array([u])) == pytest.approx([tolerance])


def test_trials_go_on_until_the_digits_stand_still():
    problem, offset, slope = line(readings=np.arange(5.0))
    estimate = solve(problem.with_quantities(Quantity("end", lambda a, b: a + 9 * b, offset, slope)))
    result = montecarlo(estimate, Adaptive(digits=1), seed=13)
    assert result.stability.reached and np.all(result.stability.spread <= result.stability.tolerance[:, None])
    assert len(result.samples) >= 20_000 and len(result.samples) % 10_000 == 0
    more = montecarlo(estimate, Adaptive(digits=2), seed=13)
    assert more.stability.reached and len(more.samples) > len(result.samples)
    np.testing.assert_array_equal(more.samples[: len(result.samples)], result.samples)
    assert np.abs(more.u - more.linear_u) <= 2 * more.stability.tolerance


def test_a_limit_of_trials_is_kept_and_said():
    problem, offset, _ = line(readings=np.arange(5.0))
    estimate = solve(problem.with_quantities(Quantity("offset", lambda a: a, offset)))
    result = montecarlo(estimate, Adaptive(digits=4, largest=30_000), seed=14)
    assert len(result.samples) == 30_000 and not result.stability.reached


def test_trials_with_the_factor_of_the_truth_are_those_with_their_own():
    problem, _, point = network(3, 12, 1)
    problem = problem.with_quantities(Quantity("points", lambda p: p, point.each, unit="mm", keys=point.keys))
    estimate = solve(problem)
    system, truth = System(problem), dict(estimate.values)
    fit = linearise_system(system, truth)
    (own, first), (factored, second) = (
        kind(system, fit, truth, problem.quantities, 20).sample(16, 2, 20) for kind in (LargeTrials, FactoredTrials))
    assert first.all() and second.all()
    assert np.abs((own - factored) / covariance(fit, "points").u).max() < 1e-6


def test_the_derivatives_of_a_large_problem_are_not_stored():
    problem, _, point = network(4, 60, 1)
    problem = problem.with_quantities(Quantity("point", lambda p: p, point[0], unit="mm"))
    estimate = solve(problem)
    system, truth = System(problem), dict(estimate.values)
    assert isinstance(trials_of(system, linearise_system(system, truth), truth, problem.quantities, 20), FactoredTrials)


# --- bounds -------------------------------------------------------------------------------------------------------


def test_trials_keep_to_the_bounds_of_the_unknowns():
    # a is read as 0.5 +- 1 and cannot be negative: its estimate is the larger of the reading and zero, which is zero
    # with the probability of a normal variable below -0.5, and b = reading - a follows a where a leaves the bound.
    a, b = Unknown("a", 0.5, lower=0.0), Unknown("b", 1.0)
    problem = Problem(
        [Observations(lambda a: a, a, readings=[0.5], u=1.0, group="a"),
         Observations(lambda a, b: a + b, a, b, readings=[2.0], u=1e-3, group="sum")],
        quantities=[Quantity("a", lambda a: a, a), Quantity("b", lambda b: b, b)])
    result = montecarlo(solve(problem), 20_000, seed=20)
    a, b = result.samples.T
    assert result.failures == 0
    assert a.min() == 0.0
    assert np.mean(a == 0.0) == pytest.approx(0.3085, abs=4 * np.sqrt(0.31 * 0.69 / 20_000))
    assert a.mean() == pytest.approx(0.69780, abs=4 * a.std() / np.sqrt(20_000))  # 0.5 Phi(0.5) + phi(0.5)
    assert np.abs(a + b - 2.0).max() < 5e-3
    system = System(problem)
    single = [solve(simulate(problem, dict(zip(system.layout.unknowns, (0.5, 1.5))), seed))["a"]
              for seed in range(40)]
    assert min(single) == 0.0
    assert np.mean(np.array(single) == 0.0) == pytest.approx(0.31, abs=0.3)


def test_an_estimate_at_its_bound_is_not_called_valid_where_samples_leave_it():
    a = Unknown("a", 0.5, lower=0.0)
    problem = Problem([Observations(lambda a: a, a, readings=[-0.2], u=1.0)],
                      quantities=[Quantity("a", lambda a: a, a)])
    estimate = solve(problem)
    assert estimate["a"] == 0.0
    result = montecarlo(estimate, 2_000, seed=21)
    assert 0.4 < np.mean(result.samples == 0.0) < 0.6
    interval = result.interval_symmetric()[0]
    assert verdict(result.linear[0], result.linear_u[0], interval, 2_000) == "not valid"
