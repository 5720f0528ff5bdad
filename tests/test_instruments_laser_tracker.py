"""The laser tracker against hand-derived numbers, its two sights, and Monte Carlo for Cartesian coordinates."""

from __future__ import annotations

import numpy as np
import pytest

from calib import Observations, Problem, predict
from calib.errors import InputError
from calib.units import arcsec, degree, um
from instruments import laser_tracker

POINTS = np.array([[3.0, 4.0, 12.0], [-2.0, 5.0, -1.0], [6.0, -1.0, 0.0], [-4.0, -3.0, 2.0]])


def readings(face, effect=None, size=None, **covariates):
    """Polar readings (n, 3) in one sight, without or with one effect."""
    problem = Problem([Observations(laser_tracker.polar_in_face, POINTS, np.full(len(POINTS), float(face)), u=1e-6,
                                    covariates=covariates)],
                      effects=[e for e in laser_tracker.effects() if effect in (e.name, e.label)])
    return predict(problem, {e: np.atleast_1d(size) for e in problem.effects})["readings"]


def added(effect, size, face=+1, **covariates):
    return readings(face, effect, size, **covariates) - readings(face)


def test_polar_readings_of_a_point_with_whole_numbers():
    # (3, 4, 12): 3-4-5 in the plane, 5-12-13 in space.
    assert readings(+1)[0] == pytest.approx([13.0, np.arctan2(4, 3), np.arctan2(5, 12)], abs=1e-15)
    assert laser_tracker.polar_readings(POINTS) == pytest.approx(readings(+1), abs=1e-15)


def test_cartesian_readings_are_turned_back_to_polar_and_again():
    assert laser_tracker.cartesian_readings(laser_tracker.polar_readings(POINTS)) == pytest.approx(POINTS, abs=1e-14)
    assert laser_tracker.polar_readings(POINTS[1]).shape == (3,)


def test_a_point_on_the_standing_axis_and_a_wrong_shape_are_refused_in_words():
    with pytest.raises(InputError, match="standing axis"):
        laser_tracker.polar_readings([[0.0, 0.0, 2.0]])
    with pytest.raises(InputError, match=r"must be \(n, 3\)"):
        laser_tracker.polar_readings([[1.0, 2.0]])


def test_the_covariance_of_cartesian_coordinates_agrees_with_monte_carlo():
    u, trials = np.array([5 * um, 1.5 * arcsec, 2.5 * arcsec]), 40_000
    generator = np.random.default_rng(11)
    polar = laser_tracker.polar_readings(POINTS)
    expected = laser_tracker.cartesian_covariance(polar, u)
    for reading, covariance in zip(polar, expected, strict=True):
        drawn = laser_tracker.cartesian_readings(reading + generator.normal(size=(trials, 3)) * u)
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        whitened = np.cov((drawn - drawn.mean(axis=0)) @ root.T, rowvar=False)
        # Entries of a sample covariance of unit variance scatter by sqrt(2/n) on and sqrt(1/n) off the diagonal.
        assert np.abs(whitened - np.eye(3)).max() < 5 * np.sqrt(2 / trials)


def test_the_covariance_at_the_horizon_is_range_and_two_lever_arms():
    covariance = laser_tracker.cartesian_covariance([[4.0, 0.0, np.pi / 2]], [2e-6, 3e-6, 5e-6])[0]
    assert covariance == pytest.approx(np.diag([2e-6, 12e-6, 20e-6]) ** 2, abs=1e-24)


def test_a_coordinate_statement_is_isotropic_at_every_point():
    # U = 15 um + 6 um/m at 10 m is 75 um, k = 2: 37.5 um each way; 3.75 urad of zenith angle, and at zenith angle 30
    # degrees 7.5 urad of azimuth.
    statement = laser_tracker.from_coordinate_statement(15 * um, 6e-6)
    polar = np.array([[10.0, 0.4, 30 * degree]])
    assert statement.at(polar)[0] == pytest.approx([37.5e-6, 7.5e-6, 3.75e-6], rel=1e-12)
    covariance = laser_tracker.cartesian_covariance(polar, statement.at(polar))[0]
    assert covariance == pytest.approx(37.5e-6**2 * np.eye(3), abs=1e-22)


def test_a_point_statement_shares_its_square_among_three_coordinates():
    polar = np.array([[10.0, 0.4, 80 * degree]])
    statement = laser_tracker.from_point_statement(15 * um, 6e-6)
    covariance = laser_tracker.cartesian_covariance(polar, statement.at(polar))[0]
    assert np.sqrt(np.trace(covariance)) == pytest.approx(37.5e-6, rel=1e-12)


def test_separate_statements_keep_the_range_apart():
    statement = laser_tracker.from_separate_statements((1 * um, 0.5e-6), (15 * um, 6e-6))
    # At 4 m and the horizon: (1 + 2)/2 = 1.5 um of range; (15 + 24)/2 = 19.5 um across, 4.875 urad.
    assert statement.at([[4.0, 0.0, np.pi / 2]])[0] == pytest.approx([1.5e-6, 4.875e-6, 4.875e-6], rel=1e-12)


def test_transit_tilt_is_the_cotangent_of_the_zenith_angle():
    t = 5 * arcsec
    # cot(zenith) of (3, 4, 12) is 12/5.
    assert added("transit_tilt", t)[0] == pytest.approx([0.0, 2.4 * t, 0.0], abs=1e-15)


def test_beam_offsets_act_by_the_lever_arm():
    # 26 um at 13 m are 2 urad of zenith angle; the level distance is 5 m, so 5.2 urad of azimuth.
    assert added("beam_offset (zenith)", 26 * um)[0] == pytest.approx([0, 0, 2e-6], abs=1e-15)
    assert added("beam_offset (azimuth)", 26 * um)[0] == pytest.approx([0, 5.2e-6, 0], abs=1e-15)


def test_a_transit_offset_lengthens_the_range_by_sine_and_turns_the_zenith_angle_by_cosine_over_range():
    # zenith angle of (3, 4, 12): sine 5/13, cosine 12/13.
    o = 13 * um
    assert added("transit_offset", o)[0] == pytest.approx([5e-6, 0.0, 12e-6 / 13], abs=2e-11)


@pytest.mark.parametrize("name", ["transit_tilt", "beam_tilt", "vertical_index", "beam_offset (azimuth)",
                                  "beam_offset (zenith)", "transit_offset"])
def test_the_mean_of_both_sights_is_free_of_what_changes_sign_with_the_face(name):
    mean = (added(name, 1e-5, +1) + added(name, 1e-5, -1)) / 2
    assert np.abs(added(name, 1e-5)).max() > 1e-6
    assert np.abs(mean).max() < 1e-9        # the second order of the transit offset is left


def test_range_effects_add_an_offset_a_share_and_the_air():
    distance = readings(+1)[:, 0]
    assert added("range_offset", 7 * um)[:, 0] == pytest.approx(np.full(4, 7e-6), abs=1e-14)
    assert added("scale", 2e-6)[:, 0] == pytest.approx(2e-6 * distance, abs=1e-14)
    # The thermometer shows 1 K too much, the index used is 0.955 ppm too small, so 13 m are shown 12.4 um too long.
    assert added("air_temperature", 1.0)[0, 0] == pytest.approx(13 * 0.955e-6, rel=1e-3)


def test_warm_air_above_bends_the_line_so_that_the_target_seems_higher():
    # 1 K/m changes the index by -0.955e-6 per metre of height: at the horizon (6, -1, 0) the line over sqrt(37) m is an
    # arc of curvature 0.955e-6 /m, whose tangent at the tracker rises by half the turn of the arc.
    assert added("air_gradient", 1.0)[2, 2] == pytest.approx(-0.5 * 0.955e-6 * np.sqrt(37), rel=1e-3)


def test_a_drifting_base_moves_all_points_with_time():
    rate, time = 3e-9, np.array([0.0, 100.0, 200.0, 300.0])
    moved = laser_tracker.cartesian_readings(readings(+1, "drift (tracker_y)", rate, time=time))
    assert moved - POINTS == pytest.approx(np.outer(rate * time, [0, 1, 0]), abs=1e-14)


def test_the_vocabulary_of_the_tracker_is_complete():
    labels = {effect.label for effect in laser_tracker.effects(blocks=(2,))}
    wanted = {f"{name} ({channel})" for name in ("drift", "thermal") for channel in ("azimuth", "zenith", "range")}
    wanted |= {f"step ({channel}@2)" for channel in ("azimuth", "zenith", "range")}
    wanted |= {f"step (tracker_{axis}@2)" for axis in "xyz"} | {f"drift (tracker_{axis})" for axis in "xyz"}
    wanted |= {"range_offset (range)", "transit_tilt (azimuth)", "scale (range)"}
    assert wanted <= labels
