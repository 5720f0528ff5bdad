"""Formulations under simulation: as good as promised where noise is as stated, worse by a known amount where not."""

from __future__ import annotations

import numpy as np
import pytest

import calib
from calib import Huber, LeastSquares
from calib.errors import CalibrationError
from calib.solve.convex import Convex
from calib.workflow.compare.again import with_readings_of
from calib.workflow.compare.formulation import ClosedForm
from calib.workflow.compare.side_by_side import DECLARED, Effort, compare
from calib.workflow.compare.study import AS_STATED, NOISES, blunders, correlated, drawn, uneven
from tests.declared import line

TRIALS = 100
METHODS = {"Gauss-Newton": calib.GaussNewton(), "convex, least squares": Convex(LeastSquares()),
           "convex, Huber": Convex(Huber())}


@pytest.fixture(scope="module")
def compared():
    problem, offset, slope = line(list(3.0 + 0.5 * np.arange(20.0)), x=np.arange(20.0))

    def by_ends(declared):
        readings = declared.observations[0].readings.ravel()
        rate = (readings[-1] - readings[0]) / 19.0
        return {"slope": rate, "offset": readings[0]}
    return compare(problem, [offset, slope], {"by its ends": ClosedForm(by_ends)},
                   Effort(starts=0, draws=2, trials=TRIALS), under=METHODS)


def under(compared, formulation, method, noise):
    of = next(one for one in compared.lines if (one.formulation, one.method) == (formulation, method))
    return next(one for one in of.study if one.noise == noise.name)


@pytest.mark.slow
def test_least_squares_reaches_the_bound_under_the_stated_noise(compared):
    found = under(compared, DECLARED, "Gauss-Newton", AS_STATED)
    assert found.errors.shape == (TRIALS, 2) and found.failures == 0
    assert np.all(np.abs(found.bias) < 4.0 * found.u_of_bias)
    assert found.spread == pytest.approx(1.0, abs=4.0 / np.sqrt(2 * TRIALS))


@pytest.mark.slow
def test_what_uses_two_readings_of_twenty_is_less_efficient_by_what_paper_and_pencil_say(compared):
    found = under(compared, "by its ends", "closed form", AS_STATED)
    slope = found.names.index("slope")
    # variance of the slope: 2/19^2 from the ends, 12/(n (n^2 - 1)) from all n = 20
    expected = (12.0 / (20 * 399)) / (2.0 / 19**2)
    assert found.efficiency[slope] == pytest.approx(expected, rel=4.0 * np.sqrt(2.0 / TRIALS))


@pytest.mark.slow
def test_outliers_hurt_least_squares_more_than_huber(compared):
    least = under(compared, DECLARED, "Gauss-Newton", blunders())
    robust = under(compared, DECLARED, "convex, Huber", blunders())
    # one reading in ten eight times worse: the variance grows by 1 + 0.1 (64 - 1)
    assert np.mean(least.spread**2) == pytest.approx(7.3, rel=0.5)
    assert np.all(robust.efficiency > 1.5 * least.efficiency)


@pytest.mark.slow
def test_methods_that_minimise_squares_are_studied_once(compared):
    studied = [line.method for line in compared.lines if line.study]
    assert studied == ["Gauss-Newton", "convex, Huber", "closed form"]


@pytest.mark.parametrize("noise", NOISES, ids=lambda noise: noise.name)
def test_every_noise_draws_what_its_name_says(noise):
    errors = noise.draw(np.random.default_rng(5), (40000, 1)).ravel()
    variance = {blunders().name: 1 + 0.1 * 63, uneven().name: (1 + 9) / 2}.get(noise.name, 1.0)
    assert errors.var() == pytest.approx(variance, rel=0.1) and abs(errors.mean()) < 0.08
    neighbour = np.corrcoef(errors[1:], errors[:-1])[0, 1]
    assert neighbour == pytest.approx(0.8 if noise.name == correlated().name else 0.0, abs=0.03)


def test_the_same_seed_draws_the_same_readings_and_another_draws_others():
    problem, _, _ = line([0.05, 1.1, 1.9, 3.2, 3.9])
    truth = calib.solve(problem)
    one, same, other = (next(drawn(truth, AS_STATED, 1, seed)).observations[0].readings for seed in (3, 3, 4))
    assert np.array_equal(one, same) and not np.array_equal(one, other)


def test_another_declaration_with_other_rows_cannot_be_run_on_drawn_readings():
    five, _, _ = line([0.05, 1.1, 1.9, 3.2, 3.9])
    six, _, _ = line([0.05, 1.1, 1.9, 3.2, 3.9, 5.0], x=np.arange(6.0))
    with pytest.raises(CalibrationError, match="row for row"):
        with_readings_of(six, five)
    assert with_readings_of(five, five).observations[0].readings.shape == (5, 1)
