"""Redundancy, w-tests, minimal detectable biases and external reliability against brute force."""

import numpy as np
import pytest
from declared import line, network

from calib import Observations, Problem, Quantity, Unknown, linearise, reliability, solve
from calib.analyse.influence import influence
from calib.analyse.multiplicity import holm
from problems.network import example


def test_a_mean_of_n_readings_has_redundancy_one_less_one_nth():
    a = Unknown("a")
    r = reliability(linearise(solve(Problem([Observations(lambda a: a, a, readings=[1.0, 2.0, 4.0, 5.0], u=0.5)]))))
    assert np.allclose(r.redundancy, 0.75)
    assert np.allclose(r.w, (np.array([1, 2, 4, 5]) - 3) / (0.5 * np.sqrt(0.75)))
    assert np.allclose(r.mdb, 4.1321470 * 0.5 / np.sqrt(0.75), rtol=1e-6)  # 3.2905 + 0.8416 for 0.1 % and 80 %


def test_a_reading_that_nothing_controls_has_no_finite_minimal_detectable_bias():
    a, b = Unknown("a"), Unknown("b")
    problem = Problem(
        [
            Observations(lambda a: a, a, readings=[1.0, 1.1], u=0.1, group="twice"),
            Observations(lambda b: b, b, readings=[5.0], u=0.1, group="once"),
        ],
        quantities=[Quantity("b", lambda b: b, b)],
    )
    r = reliability(linearise(solve(problem)))
    alone = r.of("once")
    assert r.redundancy[alone] == pytest.approx([0.0], abs=1e-12)
    assert np.isinf(r.mdb[alone]).all()
    assert (r.w[alone], r.influence["b"][alone]) == (0.0, 0.0)


@pytest.mark.parametrize("row, component", [(0, 0), (7, 1), (20, 2)])
def test_the_influence_is_what_a_bias_of_that_size_really_does(row, component):
    problem, _, point = network(3, 8, 5)
    height = Quantity("height", lambda p: p[2], point[4], unit="mm")
    problem = problem.with_quantities(height)
    estimate = solve(problem)
    r = reliability(linearise(estimate))
    place = row * 3 + component
    readings = problem.observations[0].readings.copy()
    readings[row, component] += r.mdb[place]
    moved = solve(problem.with_readings({"polar": readings}), start=estimate)
    assert moved[height] - estimate[height] == pytest.approx(r.influence["height"][place], rel=1e-3, abs=1e-10)
    again = reliability(linearise(moved))
    assert again.w[place] - r.w[place] == pytest.approx(4.1321470, rel=1e-3)


def test_the_w_test_rejects_at_its_level_when_nothing_is_wrong():
    problem, *_ = line(readings=np.zeros(5), u=0.1)
    generator, rejected = np.random.default_rng(11), 0
    for _ in range(400):
        estimate = solve(problem.with_readings({"line": generator.normal(0, 0.1, 5)}))
        rejected += int(np.sum(reliability(linearise(estimate)).p_value < 0.05))
    assert rejected / 2000 == pytest.approx(0.05, abs=0.02)


def test_the_influence_on_points_is_what_a_bias_of_that_size_really_does():
    problem = example(seed=3)
    estimate = solve(problem)
    tests = reliability(estimate.fit)
    found = influence(estimate.fit, tests)
    point = next(u for u in problem.unknowns if u.name == "point")
    controlled = np.flatnonzero(tests.redundancy > 0.05)
    for i in controlled[[0, len(controlled) // 2, -1]]:
        group, row = str(tests.group[i]), int(tests.row[i])
        readings = {o.group: np.array(o.readings) for o in problem.observations}
        readings[group][row - 1] += 1e-3 * tests.mdb[i]      # small: the influence is linear
        moved = np.asarray(solve(problem.with_readings(readings), start=estimate)[point]) - np.asarray(estimate[point])
        lengths = 1e3 * np.linalg.norm(moved, axis=1)
        assert found.point[i] == point.keys[int(np.argmax(lengths))]
        assert found.shift[i] == pytest.approx(lengths.max(), rel=1e-4)


def test_probabilities_of_many_tests_are_those_of_holm():
    assert holm(np.array([0.04, 0.01, 0.03])) == pytest.approx([0.06, 0.03, 0.06])
    assert holm(np.array([0.9, 0.8])) == pytest.approx([1.0, 1.0])
