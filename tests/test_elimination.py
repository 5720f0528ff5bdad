"""The factor with eliminated blocks against the dense one, on the same readings."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from declared import network

from calib import (
    Constraint,
    Gaussian,
    Observations,
    Problem,
    Quantity,
    Unknown,
    compiled,
    coupling,
    covariance,
    elimination,
    estimability,
    linearisation,
    linearise,
    predict,
    prior,
    reliability,
    solve,
)
from calib.compiled import available, row_back_end
from calib.elimination import EliminatedFactor
from calib.errors import ModelBreakdown, RankDefect
from calib.factor import DenseFactor
from calib.linearisation import linearise as linearise_problem


def both(problem, monkeypatch):
    """The same problem linearised with the dense and with the eliminated factor."""
    dense, eliminated = linearise(problem), linearise_problem(problem)
    monkeypatch.setattr(elimination, "DENSE_SIZE", 10_000)
    assert isinstance(dense.factor, DenseFactor)
    monkeypatch.setattr(elimination, "DENSE_SIZE", 1)
    assert isinstance(eliminated.factor, EliminatedFactor)
    return dense, eliminated


def lengths(point, first, second, u=1e-5):
    """Distances between points, of which at most one of a pair can be eliminated."""
    a, b = point.ambient[first], point.ambient[second]
    return Observations(lambda a, b: ca.norm_2(a - b), point[first], point[second],
                        readings=np.linalg.norm(a - b, axis=1) + 1e-3, u=u, group="bars")


CASES = {
    "bars between points": lambda p, s, q: p.with_observations(lengths(q, np.array([1, 4, 4, 9]),
                                                                       np.array([4, 7, 9, 2]))),
    "points as stations": lambda p, s, q: p.with_observations(lengths(
        q, np.repeat([3, 8], 12), np.array([*range(3), *range(4, 8), *range(9, 14)] * 2))).hold(q[8]),
    "correlated readings of two points": lambda p, s, q: p.with_observations(lengths(
        q, np.array([0, 5, 6, 11]), np.array([1, 2, 3, 4]),
        Gaussian.groups(["A", "A", "B", "B"], {k: 1e-10 * np.array([[1, 0.6], [0.6, 1]]) for k in "AB"}))),
    "points and stations": lambda p, s, q: p,
    "a point held": lambda p, s, q: p.hold(q[3]),
    "priors on points": lambda p, s, q: p.with_observations(prior(q[2], q.ambient[2], 1e-5)),
    "a condition between stations": lambda p, s, q: type(p)(
        p.observations,
        [
            Constraint(
                "same height",
                lambda a, b: a.translation[2] - b.translation[2],
                s[1],
                s[2],
                tolerance=1e-9,
                lower=0.3,
                upper=0.3,
            )
        ],
        held=[s[0]],
    ),
    "a condition on a point": lambda p, s, q: type(p)(
        p.observations, [Constraint("height", lambda a: a[2], q[1], tolerance=1e-9)], held=[s[0]]
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_elimination_changes_no_result(case, monkeypatch):
    dense, eliminated = both(CASES[case](*network(4, 15, 1)), monkeypatch)
    size = dense.factor.size
    scale = np.sqrt(np.diag(dense.factor.matrix))
    scale = np.where(scale > 1e-12, scale, 1.0)  # a column that a condition pins has none
    assert np.abs((eliminated.factor.step - dense.factor.step) / scale).max() < 1e-8
    assert np.abs((eliminated.factor.matrix - dense.factor.matrix) / np.outer(scale, scale)).max() < 1e-9
    right = np.random.default_rng(0).normal(size=(size, 3)) / scale[:, None]
    assert np.abs((eliminated.factor.solve(right) - dense.factor.solve(right)) / scale[:, None]).max() < 1e-8
    assert eliminated.dof == dense.dof
    assert eliminated.factor.decrement == pytest.approx(dense.factor.decrement, rel=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_redundancy_numbers_add_up_to_the_degrees_of_freedom_and_agree(case, monkeypatch):
    dense, eliminated = both(CASES[case](*network(4, 15, 2)), monkeypatch)
    one, other = reliability(dense), reliability(eliminated)
    assert one.redundancy.sum() == pytest.approx(dense.dof, abs=1e-7)
    assert np.abs(one.redundancy - other.redundancy).max() < 1e-9
    assert np.abs(one.w - other.w).max() < 1e-6


def test_a_free_datum_has_its_six_directions_in_both(monkeypatch):
    problem, station, _ = network(4, 15, 3)
    dense, eliminated = both(problem.free(station[0]), monkeypatch)
    assert (estimability(dense).defect, estimability(eliminated).defect) == (6, 6)
    overlap = np.linalg.svd(np.linalg.qr(dense.factor.null)[0].T @ np.linalg.qr(eliminated.factor.null)[0])[1]
    assert overlap == pytest.approx(np.ones(6), abs=1e-6)


def test_points_seen_by_nobody_are_found_when_eliminated(monkeypatch):
    problem, _, point = network(4, 15, 4)
    seen = problem.observations[0]
    kept = seen.covariates["point"] != 5
    smaller = type(seen)(
        seen.model,
        seen.arguments[0].unknown[seen.arguments[0].index[kept]],
        point[seen.arguments[1].index[kept]],
        readings=seen.readings[kept],
        u=[5e-6] * 3,
        period=seen.period,
    )
    dense, eliminated = both(
        type(problem)([smaller, prior(point[14], point.ambient[14], 1.0)]).hold(seen.arguments[0].unknown[0]),
        monkeypatch,
    )
    assert dense.factor.defect == eliminated.factor.defect == 0 or "point[5]" in " ".join(
        estimability(eliminated).directions
    )


@pytest.mark.parametrize("name", ["numpy", "compiled"])
def test_unknowns_that_are_all_eliminated_leave_nothing_and_are_estimated(name):
    if name == "compiled" and not available():
        pytest.skip("llvmlite is not installed")
    truth = np.random.default_rng(2).normal(size=(60, 5))
    posture = Unknown("posture", np.zeros((60, 5)))
    seen = Observations(lambda p: p + 0.1 * p**2, posture.each, readings=truth + 0.1 * truth**2, u=1e-3)
    with row_back_end(name):
        estimate = solve(Problem([seen, prior(posture, truth, 1e-3)]))
        fit = linearise(estimate)
        assert fit.factor.rank == 300
        assert reliability(fit).redundancy.sum() == pytest.approx(300, rel=1e-12)
    assert np.abs(estimate[posture] - truth).max() < 1e-9
    assert covariance(fit, posture.part("1")).u == pytest.approx(1e-3 / np.hypot(1 + 0.2 * truth[:, 0], 1), rel=1e-9)


def test_a_message_lists_the_first_of_many_directions():
    posture = Unknown("posture", np.zeros((60, 5)))
    seen = Observations(lambda p: p[:3], posture.each, readings=np.zeros((60, 3)), u=1e-3)
    with pytest.raises(RankDefect, match="and 112 more of this kind") as error:
        solve(Problem([seen]))
    assert len(error.value.directions) == 120


@pytest.mark.skipif(not available(), reason="llvmlite is not installed")
@pytest.mark.parametrize(("case", "thin"), [*((case, True) for case in CASES), ("points and stations", False)])
def test_compiled_loops_give_the_factor_of_numpy(case, thin, monkeypatch, tmp_path):
    monkeypatch.setenv("CALIB_CACHE", str(tmp_path))
    monkeypatch.setattr(elimination, "DENSE_SIZE", 1)
    monkeypatch.setattr(linearisation, "STORED", 0)
    monkeypatch.setattr(coupling, "THIN", 2.0 if thin else 0.0)
    problem, station, point = network(4, 15, 1)
    far = Quantity("far", lambda a, b: ca.norm_2(a - b), point[2], point[11])
    problem = CASES[case](problem, station, point).with_quantities(far)
    found = {}
    for name in ("numpy", "compiled"):
        with row_back_end(name):
            fit = linearise(problem)
            tests = reliability(fit)
            plain = reliability(replace(fit, results={}))  # no derivative is needed beside those of the loop
            found[name] = [fit.factor.matrix, fit.factor.step, fit.pull, tests.redundancy, plain.redundancy, plain.w,
                           tests.influence["far"], solve(problem)]
            assert (fit.leverages(0) is not None) == (name == "compiled")
    for one, other in zip(found["numpy"][:-1], found["compiled"][:-1], strict=True):
        assert np.abs(one - other).max() <= 1e-9 * np.abs(one).max()
    one, other = found["numpy"][-1], found["compiled"][-1]
    assert other.certificate.passed
    assert other.objective == pytest.approx(one.objective, rel=1e-9)


@pytest.mark.skipif(not available(), reason="llvmlite is not installed")
def test_one_instance_for_all_rows_and_every_other_number_of_a_list_are_read_by_compiled_loops(monkeypatch):
    monkeypatch.setattr(elimination, "DENSE_SIZE", 1)
    problem, _, point = network(4, 15, 6)
    others = np.repeat([0, 1, 2, 3, 8, 9], 2)[::2]
    place = point.ambient
    spokes = Observations(lambda a, b: ca.norm_2(a - b), point[4], point[others], group="spokes", u=1e-5,
                          readings=np.linalg.norm(place[others] - place[4], axis=1))
    found = {}
    for name in ("numpy", "compiled"):
        with row_back_end(name):
            estimate = solve(problem.with_observations(spokes))
            found[name] = [estimate[point], predict(problem.with_observations(spokes))["spokes"]]
    assert np.abs(found["numpy"][0] - found["compiled"][0]).max() < 1e-9
    np.testing.assert_allclose(found["compiled"][1], found["numpy"][1], rtol=1e-14)


@pytest.mark.skipif(not available(), reason="llvmlite is not installed")
def test_threads_change_nothing_but_the_order_of_sums(monkeypatch, tmp_path):
    monkeypatch.setenv("CALIB_CACHE", str(tmp_path))
    monkeypatch.setattr(elimination, "DENSE_SIZE", 1)
    monkeypatch.setattr(compiled, "THREAD_WORK", 1e3)
    problem = CASES["bars between points"](*network(4, 40, 5))
    steps = []
    for count in ("1", "3"):
        monkeypatch.setenv("CALIB_THREADS", count)
        with row_back_end("compiled"):
            steps.append(linearise(problem).factor.step)
    assert np.abs(steps[0] - steps[1]).max() <= 1e-10 * np.abs(steps[0]).max()


@pytest.mark.skipif(not available(), reason="llvmlite is not installed")
def test_a_row_that_breaks_down_is_named_by_compiled_loops_too(monkeypatch):
    monkeypatch.setattr(elimination, "DENSE_SIZE", 1)
    problem, _, point = network(4, 15, 6)
    place = point.ambient[3]
    broken = Observations(lambda p: ca.sqrt(p[0] - (place[0] + 1.0)), point[np.array([3, 4])], readings=[1.0, 1.0],
                          u=0.1, group="roots", rows=[17, 18])
    with row_back_end("compiled"), pytest.raises(ModelBreakdown, match="'roots', row 17"):
        solve(problem.with_observations(broken))
