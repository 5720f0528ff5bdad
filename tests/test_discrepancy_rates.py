"""Rates of the discrepancy workflow on seeded cases; the larger tables are made by benchmarks/discrepancy_rates.py.

Each bound is what a procedure that holds the stated rate exceeds in one run of a thousand (binomial).
"""

from __future__ import annotations

import numpy as np
import pytest
from discrepancy_cases import NOISES, hide_blunders, hide_effects, hide_noise, hide_structure
from discrepancy_designs import DESIGNS
from discrepancy_outcomes import outcome
from scipy.stats import binom

QUICK = ("level_plumb", "theodolite_target")
SEED = 9_000


def at_most(rate: float, count: int) -> int:
    """Failures that a failure rate does not exceed but once in a thousand runs."""
    return int(binom.ppf(0.999, count, rate))


@pytest.mark.parametrize("scenario", QUICK)
@pytest.mark.slow
def test_a_clear_effect_is_named_or_its_aliases_are(scenario):
    found = [outcome(hide_effects(scenario, SEED + seed, 1, 5.0), gap=False) for seed in range(4)]
    assert sum(not one.or_alias for one in found) <= at_most(0.05, 4)
    assert all(one.right for one in found if one.or_alias)


@pytest.mark.parametrize("scenario", QUICK)
def test_nothing_is_found_in_clean_readings(scenario):
    found = [outcome(hide_effects(scenario, SEED + seed, 0, 0.0)) for seed in range(8)]
    assert sum(one.alarmed for one in found) <= at_most(0.01, 8)


@pytest.mark.parametrize("scenario", QUICK)
@pytest.mark.slow
def test_a_structure_without_a_name_is_not_given_one(scenario):
    found = [outcome(hide_structure(scenario, SEED + seed, 3.0)) for seed in range(3)]
    assert sum(not one.right for one in found) <= at_most(0.05, 3)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", DESIGNS)
def test_false_alarms_keep_to_the_level(scenario):
    count = 100
    found = [outcome(hide_effects(scenario, SEED + seed, 0, 0.0)) for seed in range(count)]
    assert sum(one.alarmed for one in found) <= at_most(0.01, count)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", DESIGNS)
def test_one_effect_of_three_times_the_noise_is_named_with_honest_uncertainty(scenario):
    count = 12
    found = [outcome(hide_effects(scenario, SEED + seed, 1, 3.0)) for seed in range(count)]
    assert sum(not one.or_alias for one in found) <= at_most(0.05, count)
    within = np.array([one.within for one in found if np.isfinite(one.within)])
    assert np.sum(within < 1) <= at_most(0.15, len(within))
    ratios = np.array([one.u_ratio for one in found if np.isfinite(one.u_ratio)])
    assert np.all((ratios > 0.9) & (ratios < 1.2))
    shrinks = np.array([one.shrink for one in found if np.isfinite(one.shrink)])
    assert np.sum(shrinks < 0.95) <= at_most(0.05, len(shrinks))


@pytest.mark.slow
@pytest.mark.parametrize("scenario", DESIGNS)
def test_no_physical_effect_is_named_for_noise_or_blunders(scenario):
    cases = [hide_noise(scenario, SEED + seed, kind) for kind in NOISES for seed in range(2)]
    cases += [hide_blunders(scenario, SEED + seed, 6.0) for seed in range(5)]
    found = [outcome(case) for case in cases]
    assert sum(one.named for one in found) <= at_most(1 / 35, len(found))


@pytest.mark.slow
@pytest.mark.parametrize("scenario", DESIGNS)
def test_structure_is_recognised_as_unknown(scenario):
    found = []
    for seed in range(12):
        try:
            found.append(outcome(hide_structure(scenario, SEED + seed, 3.0)))
        except ValueError:
            continue  # this design shows no structure of the drawn shapes
    assert len(found) >= 6
    assert sum(not one.right for one in found) <= at_most(0.05, len(found))
