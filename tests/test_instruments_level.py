"""The level against its sign convention and hand-derived numbers."""

from __future__ import annotations

import numpy as np
import pytest

from calib import Observations, Problem, Shared, predict
from calib.units import arcsec, degree
from instruments import level

ANGLES = np.array([0.0, 90.0, 180.0, 30.0]) * degree
TILT = np.array([6.0, -4.0]) * arcsec


def readings(name=None, size=None, **covariates):
    problem = Problem([Observations(level.on_turning_axis, Shared(TILT), ANGLES, Shared(10 * arcsec), u=arcsec,
                                    covariates=covariates)],
                      effects=[e for e in level.effects(blocks=(2,), settling_time=100.0) if e.name == name])
    return predict(problem, {e: np.atleast_1d(size) for e in problem.effects})["readings"][:, 0] / arcsec


def test_the_level_reads_zero_less_theta_y_cosine_plus_theta_x_sine():
    # z = 10, theta_x = 6, theta_y = -4: at 0, 90, 180, 30 degrees 10 + 4, 10 + 6, 10 - 4 and 10 + 4 cos 30 + 6 sin 30.
    assert readings() == pytest.approx([14.0, 16.0, 6.0, 13 + 2 * np.sqrt(3)], abs=1e-12)


def test_a_wrong_sensitivity_scales_the_tilt_and_not_the_zero():
    assert readings("gain", 0.01) - readings() == pytest.approx(0.01 * (readings() - 10), abs=1e-12)


def test_settling_has_fallen_to_one_in_e_after_its_time_constant():
    since = np.array([0.0, 100.0, 200.0, 0.0])
    added = readings("settling", 2 * arcsec, time_since_seating=since) - readings()
    assert added == pytest.approx(2 * np.array([1, np.exp(-1), np.exp(-2), 1]), abs=1e-12)


def test_hysteresis_is_half_its_width_from_either_side_and_a_step_stays_from_its_block_on():
    width = readings("hysteresis", 1 * arcsec, direction=np.array([1.0, -1.0, 1.0, -1.0])) - readings()
    assert width == pytest.approx([0.5, -0.5, 0.5, -0.5], abs=1e-12)
    step = readings("step", 3 * arcsec, block=np.array([1, 2, 3, 1])) - readings()
    assert step == pytest.approx([0, 3, 3, 0], abs=1e-12)


def test_drift_and_temperature_act_in_proportion():
    late = readings("drift", 2 * arcsec / 3600, time=np.array([0, 1800, 3600, 7200.0])) - readings()
    assert late == pytest.approx([0, 1, 2, 4], abs=1e-12)
    warm = readings("thermal", 0.5 * arcsec, temperature_difference=np.array([0, 1, -1, 2.0])) - readings()
    assert warm == pytest.approx([0, 0.5, -0.5, 1.0], abs=1e-12)


def test_a_limit_of_error_and_the_last_digit_are_two_lines():
    # (0.1" + 1% of 20") = 0.3", rectangular 0.1732"; last digit 0.1": 0.02887".
    lines = level.stated_uncertainty(0.1 * arcsec, 0.01, np.array([-20.0]) * arcsec, 0.1 * arcsec)
    assert lines.u / arcsec == pytest.approx([np.hypot(0.3 / np.sqrt(3), 0.1 / np.sqrt(12))], rel=1e-12)
