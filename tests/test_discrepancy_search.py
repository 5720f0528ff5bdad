"""The search over sets of effects: signs that cannot be, simpler names first, sparse sets, levels that are kept."""

from __future__ import annotations

import numpy as np
import pytest
from discrepancy_designs import locators
from scipy.stats import binom

from calib import linearise
from calib.analyse.score import Field, field_of
from calib.workflow.discrepancy.alias import aliases
from calib.workflow.discrepancy.looks import corrected, effective_looks
from calib.workflow.discrepancy.noise import spread_test
from calib.workflow.discrepancy.search import search
from calib.workflow.discrepancy.sparse import sparse_sets
from calib.workflow.discrepancy.subsets import Subsets

N = 80


def field(residual, signals=()):
    """A field of rows outside two directions of unknowns."""
    n = len(residual)
    basis = np.linalg.qr(np.stack([np.ones(n), np.linspace(-1, 1, n)], axis=1))[0]
    outside = residual - basis @ (basis.T @ residual)
    bare = Field(outside, np.maximum(1 - np.sum(basis**2, axis=1), 0), basis, (), ())
    return bare.with_signals([np.asarray(s, float).reshape(n, -1) for s in signals])


def shapes(count):
    return [np.sin((k + 2) * np.linspace(0, np.pi, N) + k) for k in range(count)]


def found(residual, signals, positive=()):
    here = field(residual, signals)
    return search(here, np.arange(N), 0.01, 3, None, None, frozenset(positive))


@pytest.mark.parametrize(("size", "expected"), [(1.5, (0,)), (-1.5, ())])
def test_an_effect_of_one_sign_is_named_for_that_sign_only(size, expected):
    signal = shapes(1)[0]
    noise = np.random.default_rng(4).standard_normal(N)
    assert found(size * signal + noise, [signal], positive={0}).effects == expected


def test_an_effect_of_one_sign_is_no_alias_where_the_other_sign_is_needed():
    signal = shapes(1)[0]
    residual = -1.5 * signal + np.random.default_rng(4).standard_normal(N)
    columns = [signal.reshape(N, 1), 3.0 * signal.reshape(N, 1)]
    here = field(residual, columns)
    assert aliases(here, [0], {0: np.array([-1.5])}, columns)[0] == [1]
    assert aliases(here, [0], {0: np.array([-1.5])}, columns, frozenset({1}))[0] == []


@pytest.mark.parametrize("seed", range(5))
def test_of_two_effects_that_explain_alike_the_one_with_fewer_parameters_is_named(seed):
    first, second, third = shapes(3)
    wide = np.stack([second, first, third], axis=1)
    residual = 1.2 * first + np.random.default_rng([seed, 1]).standard_normal(N)
    assert found(residual, [wide, first]).effects == (1,)


def test_a_convex_program_gives_the_set_that_is_there():
    signals = shapes(20)
    residual = 2 * signals[4] - 1.5 * signals[11] + np.random.default_rng(8).standard_normal(N)
    model = Subsets(field(residual, signals), 15.0, np.arange(N))
    sets = sparse_sets(model.products(()), 6)
    assert [4, 11] in sets
    costs = model.costs(sets, (), 1.0)
    assert sets[int(np.argmin(costs))] == [4, 11]


def test_two_effects_are_found_that_forward_steps_begin_with_a_third_for():
    first, second = shapes(2)
    between = first + second + 0.05 * np.cos(9 * np.linspace(0, np.pi, N))
    residual = 4 * first + 4 * second + np.random.default_rng(2).standard_normal(N)
    # The sum is nearer to the residuals than either part; the parts are what is there.
    assert set(found(residual + 2 * first, [between, first, second]).effects) == {1, 2}


@pytest.mark.parametrize("count", [12, 60, 300])
def test_the_spread_of_normal_residuals_fails_no_more_often_than_stated(count):
    level, cases = 0.02, 300
    frame = np.linalg.qr(np.random.default_rng(count).standard_normal((count, count // 4)))[0]
    failed = 0
    for seed in range(cases):
        noise = np.random.default_rng([seed, 5]).standard_normal(count)
        here = Field(noise - frame @ (frame.T @ noise), 1 - np.sum(frame**2, axis=1), frame, (), ())
        failed += spread_test(here).p_value <= level
    assert failed <= binom.ppf(0.999, cases, level)


@pytest.mark.parametrize(("what", "factor", "df"),
                         [("heavy tails", 1 / np.sqrt(3), 3), ("size", 1.4, 1e9), ("size", 0.7, 1e9)])
def test_residuals_of_another_size_or_with_heavy_tails_are_seen_for_what_they_are(what, factor, df):
    looks = [spread_test(field(factor * np.random.default_rng([seed, 6]).standard_t(df, 200))) for seed in range(20)]
    assert np.mean([one.p_value < 1e-3 and one.what == what for one in looks]) >= 0.8


def test_looks_that_are_the_same_count_once_and_others_each():
    p = np.random.default_rng(1).uniform(size=(30, 4000))
    assert effective_looks(p.min(axis=0), 30) == pytest.approx(30, rel=0.15)
    assert effective_looks(p[0], 30) == pytest.approx(1.0, abs=0.3)
    assert corrected(0.01, 3) == pytest.approx(1 - 0.99**3)


def test_many_unknowns_take_away_what_an_orthogonal_factor_of_their_derivatives_does():
    design = locators(np.random.default_rng(3), 45)
    fit = linearise(design.build(None), design.truth)
    derivatives, _ = fit.rows
    assert derivatives.shape[1] > 250  # where the normal matrix is eliminated block by block
    basis = field_of(fit, ()).basis
    dense = derivatives.toarray()
    other = np.linalg.qr(dense / np.linalg.norm(dense, axis=0))[0]
    noise = np.random.default_rng(1).standard_normal((len(dense), 3))
    assert basis @ (basis.T @ noise) == pytest.approx(other @ (other.T @ noise), abs=1e-9)
