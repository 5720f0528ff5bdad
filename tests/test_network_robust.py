"""Robust estimation by reweighting: the answers of the convex method, blunders found, a covariance that holds."""

from __future__ import annotations

import numpy as np
import pytest

from calib import L1, Convex, Huber, Observations, Problem, Unknown, covariance, linearise, simulate, solve
from calib.solve.robust import Truncated, robust
from calib.units import mm
from problems import network
from problems.network.example import survey


def line(x, intercept_and_slope):
    return intercept_and_slope[0] + intercept_and_slope[1] * x


def lines(seed: int, count: int, wild: float, each: int = 25) -> tuple[Problem, Unknown]:
    """Straight lines of `each` readings, through the origin without slope; a part of the readings is wild."""
    generator = np.random.default_rng(seed)
    x = np.tile(np.linspace(-1, 1, each), count)
    y = generator.normal(size=len(x))
    y[generator.uniform(size=len(x)) < wild] += 30.0
    of = Unknown("line", np.zeros((count, 2)), parts=("at", "slope"))
    return Problem([Observations(line, x, of[np.repeat(np.arange(count), each)], readings=y, u=1.0)]), of


@pytest.mark.parametrize("loss", [Huber(), Huber(2.5)])
def test_huber_by_reweighting_is_the_convex_optimum(loss):
    problem, of = lines(seed=1, count=2, wild=0.08)
    found = robust(problem, loss)
    best = solve(problem, Convex(loss))
    assert found.converged
    assert np.abs(found.estimate[of] - best[of]).max() < 1e-5
    assert found.value == pytest.approx(loss.value(np.concatenate([r.ravel() for r in best.residuals.values()])))


def test_l1_by_reweighting_reaches_the_convex_optimum():
    problem, _ = lines(seed=2, count=1, wild=0.08)
    best = solve(problem, Convex(L1()))
    assert robust(problem, L1()).value == pytest.approx(float(np.abs(best.residuals["readings"]).sum()), rel=1e-4)


@pytest.mark.parametrize("loss", [Huber(), pytest.param(L1(), marks=pytest.mark.slow), Truncated()])
def test_the_covariance_holds_with_wild_readings_and_without(loss):
    for wild in (0.0, 0.04):
        problem, of = lines(seed=3, count=60, wild=wild)
        found = robust(problem, loss, iterations=40)
        _, matrix = found.covariance(of)
        errors = found.estimate[of].ravel() / np.sqrt(np.diag(matrix))
        # 120 standardised errors: their mean square has a standard deviation of 0.13, and somewhat more for L1.
        assert 0.7 < np.mean(errors**2) < 1.35


def test_without_wild_readings_robust_costs_what_the_textbook_says():
    problem, of = lines(seed=4, count=8, wild=0.0, each=500)
    plain = np.diag(covariance(linearise(solve(problem)), of).matrix)
    huber = np.diag(robust(problem, Huber()).covariance(of)[1])
    # Huber (1981): 95 % efficient at 1.345; the median line: pi / 2.
    assert np.mean(huber / plain) == pytest.approx(1 / 0.95, rel=0.03)
    absolute = np.diag(robust(problem, L1(), iterations=40).covariance(of)[1])
    assert np.mean(absolute / plain) == pytest.approx(np.pi / 2, rel=0.005)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_blunders_of_a_network_are_left_out_and_nothing_else_and_the_rest_is_least_squares(seed):
    problem = simulate(network.declare(survey()), None, seed)
    readings = {o.group: np.array(o.readings) for o in problem.observations}
    readings["slope_distances"][3] += 1.0
    readings["height_differences"][2] -= 40 * mm
    spoiled = problem.with_readings(readings)
    found = robust(spoiled, Truncated(4.0))
    assert found.converged
    assert {(group, row) for group, row, _ in found.left_out()} == {("slope_distances", 4), ("height_differences", 3)}
    without = solve(problem.keep({"slope_distances": np.arange(10) != 3, "height_differences": np.arange(6) != 2}))
    point = next(u for u in problem.unknowns if u.name == "point")
    assert np.abs(found.estimate[point] - without[point]).max() < 1e-6
