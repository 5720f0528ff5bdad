"""Monte Carlo in lanes against linear propagation, repeated solves, and distributions in closed form."""

import casadi as ca
import numpy as np
import pytest
from declared import line, network

from calib import (
    Constraint,
    Gaussian,
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
from calib.errors import CalibrationError


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


def test_inequalities_are_refused():
    a = Unknown("a")
    problem = Problem([Observations(lambda a: a, a, readings=[0.0], u=1.0)], quantities=[Quantity("a", lambda a: a, a)])
    estimate = solve(problem)
    limited = Problem(
        problem.observations, [Constraint("limit", lambda a: a, a, tolerance=1e-9, upper=np.inf)], problem.quantities
    )
    from dataclasses import replace

    with pytest.raises(CalibrationError, match="inequality constraints"):
        montecarlo(replace(estimate, problem=limited), 10, seed=1)


def test_linear_propagation_is_reported_beside_the_samples():
    problem, offset, slope = line(readings=np.arange(5.0))
    estimate = solve(problem.with_quantities(Quantity("end", lambda a, b: a + 9 * b, offset, slope)))
    assert montecarlo(estimate, 10, seed=1).linear_u == pytest.approx(covariance(linearise(estimate)).u)
