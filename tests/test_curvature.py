"""The smallest curvature by directions against the eigenvalues of the whole Hessian."""

import numpy as np
import pytest
from casadi import cos
from declared import network

from calib import Constraint, Observations, Problem, Unknown, linearise, solve
from calib.linearisation import linearise_system
from calib.solve.certificate import certify
from calib.solve.curvature import smallest_curvature
from calib.system import System


def at(problem, values):
    """System, stored values and linearisation of a problem."""
    system = System(problem)
    stored = {u: u.store(values[u]) if u in values else u.ambient for u in system.layout.unknowns}
    return system, stored, linearise_system(system, stored)


def both(system, stored, fit):
    """The smallest curvature by directions, and from the whole Hessian within the conditions."""
    weighed = [g.weighting.weigh(g.residual) for g in fit.groups]
    nothing = np.zeros(len(system.conditions))
    found = smallest_curvature(system.bend(stored, weighed, nothing), fit)
    root = fit.factor.root
    second = system.second_order(stored, weighed, nothing)
    return found, 1.0 + float(np.linalg.eigvalsh(root.T @ second @ root)[0])


@pytest.mark.parametrize("spread", [1.0, 1e3, 1e5])
def test_it_is_the_smallest_eigenvalue_of_the_hessian_however_large_the_residuals(spread):
    problem, *_ = network(4, 12, 7)
    observed = problem.observations[0]
    errors = np.random.default_rng(3).normal(0, 5e-6 * spread, observed.readings.shape)
    system, stored, fit = at(problem.with_readings({"polar": observed.readings + errors}), {})
    found, exact = both(system, stored, fit)
    assert found == pytest.approx(exact, rel=1e-3) if exact > 0 else found < 0


def test_one_direction_that_curves_downwards_among_eighty_is_found():
    x = Unknown("x", np.full((80, 1), 0.4))
    readings = np.cos(np.full((80, 1), 0.4))
    readings[57] += 3.0  # cos is bent downwards: a reading above it adds to the curvature, one below takes from it
    system, stored, fit = at(Problem([Observations(lambda a: cos(a), x.each, readings=readings, u=0.1)]), {})
    found, exact = both(system, stored, fit)
    assert found == pytest.approx(1.0, abs=1e-9) and exact == pytest.approx(1.0, abs=1e-9)
    readings[57] -= 6.0
    system, stored, fit = at(Problem([Observations(lambda a: cos(a), x.each, readings=readings, u=0.1)]), {})
    found, exact = both(system, stored, fit)
    assert exact == pytest.approx(1.0 - 3.0 * np.cos(0.4) / np.sin(0.4) ** 2, rel=1e-12)
    assert found < 0
    assert "curves downwards" in certify(system, stored, fit).why


def test_within_conditions_only_directions_that_keep_them_count():
    a = Unknown("a", [[0.4], [0.4]])
    o = Observations(lambda v: cos(v), a.each, readings=[np.cos(0.4) + 3.0, np.cos(0.4) - 3.0], u=0.1)
    assert both(*at(Problem([o]), {}))[0] < 0
    tied = Problem([o], [Constraint("alike", lambda p, q: p - q, a[0], a[1], tolerance=1e-9)])
    found, exact = both(*at(tied, {}))
    assert found == pytest.approx(exact, abs=1e-12)
    assert found == pytest.approx(1.0, abs=1e-9)  # the two bends cancel where both must move together


def test_affine_problems_are_straight_without_a_search():
    a = Unknown("a", 1.0)
    estimate = solve(Problem([Observations(lambda v: 2 * v, a, readings=[2.0, 2.1], u=0.1)]))
    weighed = [g.weighting.weigh(g.residual) for g in linearise(estimate).groups]
    assert System(estimate.problem).bend(estimate.values, weighed, np.zeros(0)) is None
    assert estimate.certificate.curvature == 1.0
