"""Covariance, budget and considered uncertainty against closed forms."""

import numpy as np
import pytest
from declared import line, straight

from calib import Observations, Problem, Quantity, Unknown, budget, covariance, linearise, prior, solve
from calib.errors import DeclarationError, RankDefect

X = np.array([0.0, 1.0, 2.0, 3.0, 4.0])


def test_a_straight_line_has_its_textbook_covariance():
    # u = s; var(slope) = s^2/Sxx, var(offset) = s^2 (1/n + xm^2/Sxx), cov = -s^2 xm/Sxx, with Sxx = 10, xm = 2, n = 5.
    problem, offset, slope = line(readings=X + 0.01, u=0.1)
    c = covariance(linearise(solve(problem)), offset, slope)
    assert np.allclose(c.matrix, 0.01 * np.array([[1 / 5 + 4 / 10, -2 / 10], [-2 / 10, 1 / 10]]), rtol=1e-13)
    assert c.correlation[0, 1] == pytest.approx(-0.2 / np.sqrt(0.6 * 0.1), rel=1e-12)


def test_derived_quantities_come_with_all_their_correlations():
    problem, offset, slope = line(readings=X, u=0.1)
    here = Quantity("here", lambda a, b: a + 2 * b, offset, slope, unit="mm")  # at the mean x: u = s/sqrt(n)
    there = Quantity("there", lambda a, b: [a, a + b, a + 4 * b], offset, slope, unit="mm", parts=("0", "1", "4"))
    c = covariance(linearise(solve(problem.with_quantities(here, there))))
    assert c.names == ("here", "there.0", "there.1", "there.4")
    assert c["here"][1] == pytest.approx(0.1 / np.sqrt(5), rel=1e-12)
    f = np.array([[1, 2], [1, 0], [1, 1], [1, 4]])
    assert np.allclose(
        c.matrix, f @ covariance(linearise(solve(problem)), offset, slope).matrix @ f.T, rtol=1e-12, atol=1e-18
    )


def test_a_held_quantity_with_a_prior_is_considered_and_not_estimated():
    # The offset is held at 0 with u = 0.3: the slope is fitted through the origin and moves by -Sx/Sxx per unit of
    # offset.
    problem, offset, slope = line(readings=X, u=0.1)
    known = problem.with_observations(prior(offset, 0.0, 0.3)).hold(offset)
    estimate = solve(known)
    own, lever = 0.1 / np.sqrt(30), 10 / 30
    fit = linearise(estimate)
    assert covariance(fit, slope).u[0] == pytest.approx(np.hypot(own, lever * 0.3), rel=1e-12)
    lines = {c.label: c.u for c in budget(fit, slope).contributions}
    assert lines == pytest.approx({"line": own, "held offset": lever * 0.3})
    assert estimate.dof == 4  # the prior of something held is no reading of the estimate


def test_the_budget_adds_up_to_the_variance():
    a, b = Unknown("a"), Unknown("b")
    groups = [
        Observations(straight, a, b, X, readings=X, u=0.1, group="first"),
        Observations(straight, a, b, X[:3] + 0.5, readings=X[:3], u=0.3, group="second"),
        prior(b, 1.0, 0.05),
    ]
    fit = linearise(solve(Problem(groups, quantities=[Quantity("end", lambda a, b: a + 9 * b, a, b)])))
    lines = budget(fit, "end")
    assert {c.label for c in lines.contributions} == {"first", "second", "prior b"}
    assert sum(c.u**2 for c in lines.contributions) == pytest.approx(lines.u**2, rel=1e-12)
    assert lines.u == pytest.approx(covariance(fit, "end").u[0], rel=1e-12)
    assert [c.u for c in lines.contributions] == sorted((c.u for c in lines.contributions), reverse=True)


def test_a_budget_is_of_one_scalar():
    p = Unknown("p", [0.0, 0.0])
    fit = linearise(solve(Problem([Observations(lambda p: p, p, readings=[[1.0, 2.0]], u=1.0)])))
    with pytest.raises(DeclarationError, match=r"one scalar; this is 2: p\.1, p\.2"):
        budget(fit, p)


def test_what_can_be_known_is_given_beside_a_rank_defect_and_the_rest_is_refused():
    a, b = Unknown("a"), Unknown("b")
    o = Observations(lambda a, b: a + b, a, b, readings=[3.0, 3.2], u=0.1)
    total = Quantity("total", lambda a, b: a + b, a, b)
    fit = linearise(Problem([o], quantities=[total]))
    assert covariance(fit, total).u[0] == pytest.approx(0.1 / np.sqrt(2), rel=1e-10)
    with pytest.raises(RankDefect, match="'a' cannot be known from these readings"):
        covariance(fit, a)


def test_nothing_is_scaled_by_the_fit():
    problem, *_ = line(readings=X + np.array([0, 5, 0, -5, 0]), u=0.1)
    good, *_ = line(readings=X, u=0.1)
    assert np.allclose(covariance(linearise(solve(problem))).matrix, covariance(linearise(solve(good))).matrix)
    assert solve(problem).variance_factor > 100
