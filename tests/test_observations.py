"""Binding of models to unknowns and data, priors, and every refusal with its words."""

import numpy as np
import pytest
from declared import straight

from calib import (
    Direction,
    Gaussian,
    Observations,
    Problem,
    Rotation,
    Shared,
    Unknown,
    covariance,
    linearise,
    prior,
    solve,
)
from calib.errors import CalibrationError, DeclarationError
from calib.geometry import rotation_about


def test_an_array_of_another_length_is_refused_with_both_lengths():
    with pytest.raises(DeclarationError, match="argument 'x' has 4 rows where 5 are expected"):
        Observations(straight, Unknown("a"), Unknown("b"), np.zeros(4), readings=np.zeros(5), u=1.0)


def test_a_bare_number_is_refused_with_the_word_that_makes_it_a_constant():
    with pytest.raises(DeclarationError, match=r"write Shared\(2.0\)"):
        Observations(straight, Unknown("a"), Unknown("b"), 2.0, readings=np.zeros(5), u=1.0)


def test_a_repeating_unknown_needs_an_index():
    with pytest.raises(DeclarationError, match=r"bind it as a\[index\] or a.each"):
        Observations(straight, Unknown("a", np.zeros((2, 1))), Unknown("b"), np.zeros(5), readings=np.zeros(5), u=1.0)


@pytest.mark.parametrize(
    "u, words",
    [
        (None, "no uncertainty"),
        (0.0, "must be a positive number"),
        (-1.0, "must be a positive number"),
        (np.nan, "must be a positive number"),
        (np.ones(4), "uncertainties have shape"),
    ],
)
def test_every_reading_needs_a_positive_uncertainty(u, words):
    with pytest.raises(DeclarationError, match=words):
        solve(Problem([Observations(straight, Unknown("a"), Unknown("b"), np.arange(5.0), readings=np.zeros(5), u=u)]))


def test_a_reading_that_is_not_a_number_is_named_by_its_row():
    readings = np.array([0.0, 1.0, np.nan])
    with pytest.raises(DeclarationError, match="reading 3 is not a finite number"):
        Observations(straight, Unknown("a"), Unknown("b"), np.arange(3.0), readings=readings, u=1.0)


def test_readings_of_the_wrong_width_are_named_when_the_model_is_known():
    o = Observations(lambda a: [a, a], Unknown("a"), readings=np.zeros((4, 3)), u=1.0, group="pairs")
    with pytest.raises(CalibrationError, match=r"'pairs'.*predicts 2 components.*shape \(4, 3\)"):
        solve(Problem([o]))


def test_a_shared_constant_equals_the_same_value_in_every_row():
    x = np.arange(4.0)
    a, b = Unknown("a"), Unknown("b")

    def scaled(a, b, x, k):
        return a + k * b * x

    readings = np.array([0.0, 1.1, 1.9, 3.2])
    one = solve(Problem([Observations(scaled, a, b, x, Shared(2.0), readings=readings, u=0.1)]))
    many = solve(Problem([Observations(scaled, a, b, x, np.full(4, 2.0), readings=readings, u=0.1)]))
    assert one[b] == pytest.approx(many[b], abs=1e-15)


def test_a_period_makes_readings_near_the_turn_agree():
    angle = Unknown("angle", 0.01, "arcsec")
    readings = np.array([2 * np.pi - 0.01, 0.01, 0.0])
    estimate = solve(Problem([Observations(lambda a: a, angle, readings=readings, u=1e-3, period=2 * np.pi)]))
    assert estimate[angle] == pytest.approx(0.0, abs=1e-12)


def test_a_prior_is_an_observation_of_an_unknown():
    # One reading 1.0 with u = 1 and a prior 0.0 with u = 1: the mean is 0.5, u = 1/sqrt(2).
    a = Unknown("a")
    estimate = solve(Problem([Observations(lambda a: a, a, readings=[1.0], u=1.0), prior(a, 0.0, 1.0)]))
    assert estimate[a] == pytest.approx(0.5, abs=1e-15)
    assert covariance(linearise(estimate), a).u[0] == pytest.approx(1 / np.sqrt(2), abs=1e-15)


def test_a_prior_of_one_part_leaves_the_other_parts_alone():
    p = Unknown("p", [0.0, 0.0], parts=("x", "y"))
    estimate = solve(
        Problem([Observations(lambda p: p, p, readings=[[1.0, 1.0]], u=1.0), prior(p.part("y"), 0.0, 1.0)])
    )
    assert np.allclose(estimate[p], [1.0, 0.5])


@pytest.mark.parametrize("angle", [0.01, 1.0, 2.5])
def test_a_prior_of_a_rotation_pulls_to_it_from_any_distance(angle):
    nominal = np.asarray(rotation_about(np.array([0.6, 0.0, 0.8]), angle), float)
    turn = Rotation("R")
    estimate = solve(Problem([prior(turn, nominal, 1e-3)]))
    assert np.allclose(estimate[turn], nominal, atol=1e-12)
    assert np.allclose(covariance(linearise(estimate), turn).u, 1e-3)


def test_a_prior_of_a_direction_has_the_stated_u_about_both_local_axes():
    direction = Direction("n", [0.1, 0.0, 1.0])
    estimate = solve(Problem([prior(direction, [0.0, 0.6, 0.8], 2e-3)]))
    assert np.allclose(estimate[direction], [0.0, 0.6, 0.8], atol=1e-9)
    assert np.allclose(covariance(linearise(estimate), direction).u, 2e-3, rtol=1e-6)


def test_an_uncertainty_of_the_form_a_plus_b_l_stands_still_at_the_estimate():
    # Two lengths read once each, u = 1 + L: the estimates are the readings, their u is 1 + L whatever the start.
    length = Unknown("L", np.array([[1.0], [1.0]]), "mm")
    readings = np.array([3.0, 7.0])
    o = Observations(
        lambda length: length, length.each, readings=readings, u=Gaussian.depending(lambda length: 1 + length)
    )
    fit = linearise(solve(Problem([o])))
    assert np.allclose(covariance(fit, length).u, 1 + readings, rtol=1e-8)


def test_an_uncertainty_may_depend_on_the_reading_itself():
    length = Unknown("L", np.array([[1.0], [1.0]]), "mm")
    o = Observations(
        lambda length: length, length.each, readings=[3.0, 7.0], u=Gaussian.depending(lambda reading: 2 * reading)
    )
    assert np.allclose(covariance(linearise(solve(Problem([o]))), length).u, [6.0, 14.0])
