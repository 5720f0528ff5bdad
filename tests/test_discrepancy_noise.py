"""What is not a physical effect: noise with a memory against structure that runs on, uneven noise, pulses."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import binom, kstest

from calib.analyse.score import Field
from calib.workflow.discrepancy.noise import noise_tests
from calib.workflow.discrepancy.readings import Channel, sequences
from calib.workflow.discrepancy.rivals import SERIAL, accounts, running
from calib.workflow.discrepancy.structure import Pattern, Screen

N = 90
TIME = np.linspace(-1, 1, N)
TARGETS = np.tile(["A", "B", "C"], N // 3)
CHANNEL = Channel("dial", "", np.arange(N), np.arange(N), {"time": TIME, "target": TARGETS}, {"time": "s"},
                  np.arange(N))


def left(residual):
    """The field of one channel outside a level and a trend."""
    basis = np.linalg.qr(np.stack([np.ones(N), TIME], axis=1))[0]
    return Field(residual - basis @ (basis.T @ residual), 1 - np.sum(basis**2, axis=1), basis, (), ())


def remembering(noise, memory, places):
    for order in places:
        for before, after in pairwise(order):
            noise[after] = memory * noise[before] + np.sqrt(1 - memory**2) * noise[after]
    return noise


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_noise_with_a_memory_is_no_structure_whatever_its_size(seed, factor):
    noise = remembering(np.random.default_rng([seed, 1]).standard_normal(N), 0.8, [np.arange(N)])
    here = left(factor * noise)
    best = accounts(here, [CHANNEL])[0]
    assert best.kind == SERIAL
    assert running(here, [CHANNEL])[0] > best.score


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("shape", [np.sin(8 * TIME), 4 * (np.abs(TIME - 0.3) < 0.2), np.cumsum(np.cos(TIME**3 * 30))])
def test_what_runs_on_beside_the_stated_noise_is_no_noise_with_a_memory(seed, shape):
    signal = 2.5 * shape / np.std(shape)
    here = left(signal + np.random.default_rng([seed, 2]).standard_normal(N))
    score, size = running(here, [CHANNEL])
    assert score < accounts(here, [CHANNEL])[0].score
    assert size > 1.0


def test_readings_of_each_target_may_remember_each_other():
    ways = sequences([CHANNEL])
    assert [len(order) for order in ways["readings of each target"]] == [N // 3] * 3
    noise = remembering(np.random.default_rng(3).standard_normal(N), 0.8, ways["readings of each target"])
    tests = {test.where: p for test, p in noise_tests(left(noise), [CHANNEL], 1.0, 1)}
    assert tests["all readings of each target"] < 1e-4
    assert tests["dial"] > 0.01


def test_the_size_of_a_part_fails_as_often_as_stated():
    level, cases = 0.05, 20
    noise = np.random.default_rng(4).standard_normal((cases, N))
    found = [noise_tests(left(one), [CHANNEL], 1.0, 1) for one in noise]
    p_values = [test.p_value for tests in found for test, _ in tests if test.where == "dial, target B"]
    assert kstest(p_values, "uniform").pvalue > 1e-3
    failed = sum(min(p for _, p in tests) <= level for tests in found)
    assert failed <= binom.ppf(0.999, cases, level)


def test_what_effects_of_one_kind_describe_is_no_structure_without_a_name():
    step = (TIME > 0).astype(float)[:, None]
    shapes = [Pattern("dial", "block", "level", CHANNEL.places, np.hstack([step, 1 - step]), True),
              Pattern("dial", "time", "curve", CHANNEL.places, TIME[:, None] ** 2, True)]
    here = left(4 * step[:, 0] + np.random.default_rng(5).standard_normal(N))
    signal = here.outside(step)
    screen = Screen(here, shapes, 1, None, [signal / np.linalg.norm(signal)])
    assert screen.named.tolist() == [True, False]
    assert screen.best(0.01) is None
    assert screen.places()[0].covariate == "block"
