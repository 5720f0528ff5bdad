"""Variance components: closed forms, simulation, and refusals."""

import numpy as np
import pytest
from declared import line

from calib import Observations, Problem, Unknown, covariance, linearise, prior, solve, variance_components
from calib.analyse.scatter import ByMatrices, ByPasses
from calib.errors import CalibrationError
from problems.network import example


def two_groups(seed, factors=(1.0, 3.0), n=(40, 25)):
    generator = np.random.default_rng(seed)
    a = Unknown("a")
    return Problem(
        [
            Observations(lambda a: a, a, readings=generator.normal(5.0, 0.1 * f, k), u=0.1, group=name)
            for name, f, k in zip(("fine", "coarse"), factors, n, strict=True)
        ]
    )


def test_one_group_has_the_root_of_the_variance_factor():
    problem, *_ = line(readings=[0.0, 1.2, 1.7, 3.3, 3.9], u=0.1)
    estimate = solve(problem)
    components = variance_components(linearise(estimate))
    assert components.factor[0] == pytest.approx(np.sqrt(estimate.variance_factor), rel=1e-9)
    assert components.dof[0] == pytest.approx(3.0, rel=1e-9)
    assert components.u_factor[0] == pytest.approx(components.factor[0] / np.sqrt(6), rel=1e-9)  # 1/sqrt(2 dof)


def test_rescaled_uncertainties_are_the_callers_act_and_change_no_other_number():
    problem, offset, _ = line(readings=[0.0, 1.2, 1.7, 3.3, 3.9], u=0.1)
    fit = linearise(solve(problem))
    scaled = variance_components(fit).rescaled(fit)
    assert covariance(scaled, offset).u[0] == pytest.approx(
        covariance(fit, offset).u[0] * np.sqrt(fit.objective / fit.dof)
    )
    assert scaled.objective == pytest.approx(fit.dof, rel=1e-9)


def test_factors_of_two_groups_are_recovered_with_their_own_uncertainty():
    found, stated = [], []
    for seed in range(150):
        components = variance_components(linearise(solve(two_groups(seed))))
        found.append(components.factor)
        stated.append(components.u_factor)
    assert np.mean(found, axis=0) == pytest.approx([1.0, 3.0], rel=0.03)
    assert np.std(found, axis=0) == pytest.approx(np.mean(stated, axis=0), rel=0.25)


def test_groups_may_share_one_component():
    components = variance_components(linearise(solve(two_groups(1, factors=(2.0, 2.0)))), {"both": ["fine", "coarse"]})
    assert components.factors.keys() == {"fine", "coarse"}
    assert len(components.factor) == 1


def test_a_prior_keeps_its_stated_uncertainty():
    problem = two_groups(2)
    with_prior = problem.with_observations(prior(problem.unknowns[0], 5.0, 0.01))
    assert "prior a" not in variance_components(linearise(solve(with_prior))).names


def test_a_group_without_redundancy_is_named():
    a, b = Unknown("a"), Unknown("b")
    problem = Problem(
        [
            Observations(lambda a: a, a, readings=[1.0, 1.1], u=0.1, group="twice"),
            Observations(lambda b: b, b, readings=[5.0], u=0.1, group="once"),
        ]
    )
    with pytest.raises(CalibrationError, match="'once' cannot be estimated: its readings have no redundancy"):
        variance_components(linearise(solve(problem)))


def test_matrices_and_passes_over_the_rows_give_the_same_scatter():
    fit = linearise(solve(example(4)))
    sets = [[g.name] for g in fit.groups if not g.is_prior]
    variance = np.linspace(0.5, 2.0, len(sets))
    whole, passing = ByMatrices(fit, sets), ByPasses(fit, sets)
    for by_matrices, by_passes in zip(whole.at(variance), passing.at(variance), strict=True):
        assert by_passes == pytest.approx(by_matrices, rel=1e-9)
    assert passing.taken(variance) == pytest.approx(whole.taken(variance), rel=1e-8)    # few readings: no probes


def test_probes_give_the_traces_of_many_readings():
    fit = linearise(solve(two_groups(3, n=(400, 250))))
    variance = np.array([0.5, 2.0])
    whole, passing = ByMatrices(fit, [["fine"], ["coarse"]]), ByPasses(fit, [["fine"], ["coarse"]])
    assert passing.taken(variance) == pytest.approx(whole.taken(variance), rel=0.5)     # rank one: 64 probes, 18 %
