"""Robust estimation by reweighting: the answers of the convex method, blunders found, a covariance that holds."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command import runner

from calib import L1, Convex, Gaussian, Huber, Observations, Problem, Unknown, covariance, linearise, simulate, solve
from calib.errors import CalibrationError
from calib.solve.robust import Truncated, robust
from calib.units import arcsec, mm
from problems import network
from problems.network.example import survey


def line(x, intercept_and_slope):
    return intercept_and_slope[0] + intercept_and_slope[1] * x


def lines(
    seed: int, count: int, wild: float, each: int = 25, rho: float = 0.0
) -> tuple[Problem, Unknown]:
    """Straight lines of `each` readings, through the origin without slope; a part of the readings is wild; rho:
    correlation of each five readings."""
    generator = np.random.default_rng(seed)
    x = np.tile(np.linspace(-1, 1, each), count)
    matrix = (1 - rho) * np.eye(5) + rho
    y = generator.normal(size=len(x)) if not rho else \
        (np.linalg.cholesky(matrix) @ generator.normal(size=(5, len(x) // 5))).T.ravel()
    y[generator.uniform(size=len(x)) < wild] += 30.0
    of = Unknown("line", np.zeros((count, 2)), parts=("at", "slope"))
    block = np.repeat(np.arange(len(x) // 5), 5)
    u = Gaussian.groups(block, dict.fromkeys(range(len(x) // 5), matrix)) if rho else Gaussian.standard(1.0)
    return Problem([Observations(line, x, of[np.repeat(np.arange(count), each)], readings=y, u=u)]), of


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


@pytest.mark.slow
def test_the_covariance_holds_where_few_readings_check_each_other():
    # Residuals of six readings and two unknowns show too few of the bounded errors; the covariance must not.
    for loss in (Huber(), Truncated(4.0)):
        problem, of = lines(seed=5, count=300, wild=0.0, each=6)
        found = robust(problem, loss, iterations=60)
        errors = found.estimate[of].ravel() / covariance(found.robust_fit, of).u
        assert np.mean(errors**2) == pytest.approx(1.0, abs=0.2)     # 600 errors: standard deviation 0.06


def test_a_wild_reading_among_correlated_ones_is_left_out_exactly():
    problem, of = lines(seed=6, count=1, wild=0.0, rho=0.8)
    readings = np.array(problem.observations[0].readings)
    readings[7] += 40.0
    found = robust(problem.with_readings({"readings": readings}), Truncated(6.0))
    assert [(row, weight < 1e-6) for _, row, weight in found.left_out()] == [(8, True)]
    without = solve(problem.keep({"readings": np.arange(25) != 7}))
    np.testing.assert_allclose(found.estimate[of], without[of], atol=1e-6)
    # The bound of 6 u keeps all but nothing of the square of a good reading back.
    np.testing.assert_allclose(covariance(found.robust_fit, of).matrix, covariance(without.fit, of).matrix, rtol=1e-5)


def test_huber_with_correlated_readings_is_the_optimum_over_estimate_and_errors_besides():
    import cvxpy

    problem, of = lines(seed=7, count=1, wild=0.1, rho=0.6)
    found = robust(problem, Huber(1.0))
    x, y = np.linspace(-1, 1, 25), np.ravel(problem.observations[0].readings)
    weight = np.kron(np.eye(5), np.linalg.inv(0.4 * np.eye(5) + 0.6))
    unknown, besides = cvxpy.Variable(2), cvxpy.Variable(25)
    residual = y - np.column_stack([np.ones(25), x]) @ unknown - besides
    root = np.linalg.cholesky(weight).T
    cost = 0.5 * cvxpy.sum_squares(root @ residual) + cvxpy.norm1(cvxpy.multiply(np.sqrt(np.diag(weight)), besides))
    best = cvxpy.Problem(cvxpy.Minimize(cost)).solve(solver="CLARABEL")
    assert found.converged
    assert found.value == pytest.approx(best, rel=1e-7)
    np.testing.assert_allclose(np.ravel(found.estimate[of]), unknown.value, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("loss", [Huber(), L1(), Truncated()])
def test_the_covariance_holds_with_correlated_readings(loss):
    for wild in (0.0, 0.04):
        problem, of = lines(seed=8, count=60, wild=wild, rho=0.7)
        found = robust(problem, loss, iterations=30)
        errors = found.estimate[of].ravel() / covariance(found.robust_fit, of).u
        assert 0.65 < np.mean(errors**2) < 1.4      # 120 errors: standard deviation 0.13


def test_a_chain_too_long_to_weigh_is_refused_by_name():
    x = Unknown("x", 0.0)
    chain = Observations(lambda x: x, x, readings=np.zeros(1001), u=Gaussian.serial(1.0, 0.5, np.arange(1001)),
                         group="gauge")
    with pytest.raises(CalibrationError, match="gauge: 1001 readings are correlated"):
        robust(Problem([chain]))


@pytest.mark.slow
def test_blunders_in_a_network_of_real_size_are_left_out_and_the_rest_is_as_without_them():
    places = np.random.default_rng(1).uniform(0.0, 800.0, (120, 2))
    away = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    station = np.repeat(np.arange(120), 10)
    target = np.argsort(away, axis=1)[:, 1:11].ravel()
    ends = [[f"P{i}" for i in side] for side in (station, target)]
    role = network.survey.CONSTRAINED
    points = {f"P{i}": network.Point((*place, np.nan), role) for i, place in enumerate(places)}
    problem = simulate(network.declare(network.Survey(points, [
        network.Batch("distance", *ends, None, np.full(1200, 2 * mm)),
        network.Batch("direction", *ends, None, np.full(1200, 5 * arcsec), orientation=ends[0])])), None, 1)
    readings = {o.group: np.array(o.readings) for o in problem.observations}
    bad = {("distance", 17, 1.0), ("distance", 800, -0.05), ("direction", 399, 0.02), ("direction", 555, -1e-3)}
    for name, row, error in bad:
        readings[name][row] += error
    found = robust(problem.with_readings(readings), Truncated(4.5))
    # Of 2,400 good readings 0.02 lie beyond 4.5 u.
    assert {(name, row - 1) for name, row, _ in found.left_out()} == {(name, row) for name, row, _ in bad}
    point = next(u for u in problem.unknowns if u.name == "point")
    clean = solve(problem)
    moved = np.abs(np.asarray(found.estimate[point]) - np.asarray(clean[point])) / \
        covariance(clean.fit, point).u.reshape(-1, 2)
    assert moved.max() < 2.0
    assert np.median(moved) < 1e-2


@pytest.mark.slow
def test_the_command_takes_a_robust_loss_and_says_what_it_did(tmp_path, capsys):
    calib = runner(capsys)
    assert calib("example", "problems.network", "--out", tmp_path, "--quiet").status == 0
    path = tmp_path / "slope_distances.csv"
    lines_of = path.read_text().splitlines()
    cells = lines_of[6].split(",")
    cells[2] = str(float(cells[2]) + 1.0)
    path.write_text("\n".join([*lines_of[:6], ",".join(cells), *lines_of[7:]]) + "\n")
    for loss in ("huber", "truncated"):
        answer = calib("solve", tmp_path / "job.toml", "--robust", loss, "--out", tmp_path / loss)
        assert answer.status == 0, answer.error
        assert "Check row 5 of slope_distances (off by" in " ".join(answer.out.split())
        entry = json.loads((tmp_path / loss / "result.json").read_text())["robust"]
        assert entry["loss"] == loss
        assert [one["row"] for one in entry["wild"]] == [5]
        assert (tmp_path / loss / "observations.csv").read_text().splitlines()[0].endswith(",weight")
        assert "Wild readings" in (tmp_path / loss / "report.html").read_text()
    assert "belongs to --robust" in calib("solve", tmp_path / "job.toml", "--limit", 2).error
