"""The rotary encoder: sense, heads that cancel an eccentricity, and the errors of a divided circle."""

from __future__ import annotations

import numpy as np
import pytest

from calib import Observations, Problem, Shared, predict
from calib.units import arcsec, degree
from instruments import encoder

ANGLES = np.array([0.0, 40.0, 90.0, 200.0, 725.0]) * degree
EVERY = {effect.name: effect for effect in encoder.effects(lines=1000)}


def readings(name=None, size=None, head=0.0, zero=0.0, sense=1.0, **covariates):
    problem = Problem([Observations(encoder.head_reading, ANGLES, Shared(head), Shared(zero), Shared(sense), u=arcsec,
                                    covariates=covariates)], effects=[EVERY[name]] if name else [])
    return predict(problem, {effect: np.atleast_1d(size) for effect in problem.effects})["readings"][:, 0]


def test_the_reading_counts_with_or_against_the_angle_from_its_zero():
    assert readings(zero=0.1) == pytest.approx(0.1 + ANGLES, abs=1e-14)
    assert readings(zero=0.1, sense=-1.0, head=2.0) == pytest.approx(0.1 - ANGLES, abs=1e-14)


def test_the_mean_of_two_opposite_heads_is_free_of_the_eccentricity_and_keeps_the_second_wave():
    size = np.array([20.0, -30.0]) * arcsec
    first, second = (readings("encoder_ecc", size, head) for head in (0.0, np.pi))
    assert first - ANGLES == pytest.approx(size[0] * np.cos(ANGLES) + size[1] * np.sin(ANGLES), abs=1e-14)
    assert (first + second) / 2 == pytest.approx(ANGLES, abs=1e-14)
    mean = (readings("encoder_2nd", size, 0.0) + readings("encoder_2nd", size, np.pi)) / 2 - ANGLES
    assert mean == pytest.approx(size[0] * np.cos(2 * ANGLES) + size[1] * np.sin(2 * ANGLES), abs=1e-14)


def test_scale_runs_on_over_the_turns_and_hysteresis_follows_the_approach():
    assert readings("angle_scale", 1e-6) - ANGLES == pytest.approx(1e-6 * ANGLES, abs=1e-14)
    direction = np.array([1.0, -1.0, 1.0, -1.0, 1.0])
    added = readings("hysteresis", 4 * arcsec, direction=direction) - ANGLES
    assert added == pytest.approx(2 * arcsec * direction, abs=1e-14)


def test_the_error_of_subdivision_repeats_with_every_line():
    size = np.array([1.0, 0.5]) * arcsec
    added = readings("subdivision", size) - ANGLES
    assert added == pytest.approx(size[0] * np.cos(1000 * ANGLES) + size[1] * np.sin(1000 * ANGLES), abs=1e-12)


def test_the_angle_effects_fit_the_slot_of_any_mechanism():
    effects = encoder.axis_angle_effects("axis_angle", channel="theta")
    assert [e.label for e in effects] == ["encoder_ecc (theta)", "encoder_2nd (theta)", "angle_scale (theta)",
                                          "hysteresis (theta)"]
    assert {e.slot for e in effects} == {"axis_angle"}


def test_an_accuracy_grade_and_a_measuring_step_are_two_lines():
    lines = encoder.stated_uncertainty(2 * arcsec, 0.1 * arcsec)
    assert float(lines.u) / arcsec == pytest.approx(np.sqrt(4 / 3 + 0.01 / 12), rel=1e-12)
