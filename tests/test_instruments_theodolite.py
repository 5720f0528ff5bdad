"""The theodolite against exact geometry, the face rule and hand-derived numbers."""

from __future__ import annotations

import numpy as np
import pytest

from calib import Observations, Problem, Shared, predict
from calib.geometry import rotation_about
from calib.units import arcsec, degree
from instruments import theodolite

ELEVATIONS = np.array([-50.0, -10.0, 0.0, 25.0, 60.0]) * degree
AZIMUTHS = np.array([10.0, 80.0, 170.0, -100.0, -20.0]) * degree
SMALL = 20 * arcsec                       # first-order formulas are exact to SMALL^2 = 0.002"
SECOND_ORDER = 5 * SMALL**2


def lines(azimuth=AZIMUTHS, elevation=ELEVATIONS):
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)


def readings(face, effect=None, size=None, line=None, zero=(0.0, 0.0), sense=(1.0, 1.0)):
    """Raw circle readings (n, 2) on one face, without or with one effect."""
    line = lines() if line is None else line
    problem = Problem([Observations(theodolite.circles, line, np.full(len(line), float(face)), Shared(np.array(zero)),
                                    Shared(np.array(sense)), u=arcsec)],
                      effects=[e for e in theodolite.effects() if effect in (e.name, e.label)])
    return predict(problem, {e: np.atleast_1d(size) for e in problem.effects})["readings"]


def wrapped(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def test_the_face_rule_turns_half_a_circle_and_mirrors_the_zenith_angle():
    first, second = readings(+1), readings(-1)
    assert first == pytest.approx(np.column_stack([AZIMUTHS, np.pi / 2 - ELEVATIONS]), abs=1e-15)
    assert second[:, 0] - first[:, 0] == pytest.approx(np.full(5, np.pi), abs=1e-15)
    assert second[:, 1] + first[:, 1] == pytest.approx(np.full(5, 2 * np.pi), abs=1e-15)


def test_collimation_is_c_over_cos_e_from_the_exact_geometry():
    # Alidade at azimuth 0: the line of sight (cos c cos e', sin c, cos c sin e') leaves the vertical plane by the angle
    # atan2(sin c, cos c cos e') where sin e = cos c sin e'. The effect says by how much the face 1 reading grows.
    c = SMALL
    inner = np.arcsin(np.sin(ELEVATIONS) / np.cos(c))
    exact = np.arctan2(np.sin(c), np.cos(c) * np.cos(inner))
    added = readings(+1, "collimation", c)[:, 0] - readings(+1)[:, 0]
    assert added == pytest.approx(exact, abs=SECOND_ORDER)
    assert added == pytest.approx(c / np.cos(ELEVATIONS), rel=1e-9)


def test_trunnion_axis_tilt_is_t_tan_e_from_the_exact_geometry():
    # With the trunnion axis tilted by t about the x axis of the alidade, the line of sight at circle elevation e' is
    # (cos e', sin t sin e', cos t sin e'): azimuth atan2(sin t sin e', cos e'), where sin e = cos t sin e'.
    t = SMALL
    inner = np.arcsin(np.sin(ELEVATIONS) / np.cos(t))
    exact = np.arctan2(np.sin(t) * np.sin(inner), np.cos(inner))
    added = readings(+1, "trunnion_tilt", t)[:, 0] - readings(+1)[:, 0]
    assert added == pytest.approx(exact, abs=SECOND_ORDER)


@pytest.mark.parametrize("name", ["collimation", "trunnion_tilt"])
def test_the_mean_of_both_faces_is_free_of_collimation_and_trunnion_tilt(name):
    mean = (readings(+1, name, SMALL)[:, 0] + readings(-1, name, SMALL)[:, 0] - np.pi) / 2
    assert mean == pytest.approx(AZIMUTHS, abs=1e-15)


def test_the_zenith_angle_of_both_faces_is_free_of_the_vertical_index_and_their_sum_shows_it():
    first, second = (readings(face, "vertical_index", SMALL)[:, 1] for face in (+1, -1))
    assert (first - second + 2 * np.pi) / 2 == pytest.approx(np.pi / 2 - ELEVATIONS, abs=1e-15)
    assert (first + second - 2 * np.pi) / 2 == pytest.approx(np.full(5, SMALL), abs=1e-15)


@pytest.mark.parametrize("face", [+1, -1])
def test_a_tilted_standing_axis_acts_as_the_exact_rotation_and_not_differently_on_the_other_face(face):
    # Standing axis along (tx, ty, 1): the rotation about (-ty, tx, 0) carries the plumb line into it, and the
    # theodolite sees every line turned back.
    tilt = np.array([0.6, -0.8]) * SMALL
    turned = lines() @ np.asarray(rotation_about(np.array([0.8, 0.6, 0.0]), SMALL), float)
    difference = readings(face, "standing_axis_tilt", tilt) - readings(face, line=turned)
    assert np.abs(wrapped(difference)).max() < SECOND_ORDER


def test_a_clockwise_circle_falls_with_the_azimuth_and_an_elevation_circle_reads_elevations():
    clockwise = readings(+1, zero=(0.3, np.pi / 2), sense=(-1.0, -1.0))
    assert clockwise == pytest.approx(np.column_stack([0.3 - AZIMUTHS, ELEVATIONS]), abs=1e-15)
    # On face 2 an elevation circle shows 180 degrees less the elevation.
    second = readings(-1, zero=(0.3, np.pi / 2), sense=(-1.0, -1.0))[:, 1]
    assert wrapped(second - (np.pi - ELEVATIONS)) == pytest.approx(np.zeros(5), abs=1e-14)


@pytest.mark.parametrize("channel, column", [("H", 0), ("V", 1)])
def test_eccentricity_is_one_wave_of_the_raw_reading_so_that_opposite_readings_cancel_it(channel, column):
    c, s = 3 * arcsec, -4 * arcsec
    label = f"circle_eccentricity ({channel})"
    raw = readings(+1)[:, column]
    added = readings(+1, label, np.array([c, s]))[:, column] - raw
    assert added == pytest.approx(c * np.cos(raw) + s * np.sin(raw), abs=1e-15)
    opposite = c * np.cos(raw + np.pi) + s * np.sin(raw + np.pi)
    assert added + opposite == pytest.approx(np.zeros(5), abs=1e-15)


def test_angles_and_vectors_give_the_same_readings():
    faces = np.array([1.0, -1.0, 1.0, -1.0, 1.0])
    by_angle = Observations(theodolite.face_readings, AZIMUTHS, np.pi / 2 - ELEVATIONS, ELEVATIONS, faces, u=arcsec)
    by_line = Observations(theodolite.circles, 7.0 * lines(), faces, Shared(np.zeros(2)), Shared(np.ones(2)), u=arcsec)
    for effect in theodolite.effects():
        if effect.inputs and not {"elevation", "face"} >= set(effect.inputs):
            continue
        size = np.full(len(effect.parameters), SMALL)
        first, second = (predict(Problem([o], effects=[effect]), {effect: size})["readings"]
                         for o in (by_angle, by_line))
        assert first == pytest.approx(second, abs=1e-14), effect.label


def test_pointing_grows_with_nearness_and_with_elevation():
    # 10 um at 2 m is 5e-6 rad = 1.0313"; with 1" of the circle sqrt(1 + 1.0636) = 1.4365". At 60 degrees the level
    # distance is 1 m, 2.0626", and sqrt(1 + 4.2545) = 2.2923" of the horizontal circle.
    u = theodolite.pointing((arcsec, arcsec), np.array([2.0, 2.0]), np.array([0.0, 60.0]) * degree, 10e-6) / arcsec
    assert u == pytest.approx(np.array([[1.4365, 1.4365], [2.2923, 1.4365]]), abs=1e-4)


def test_one_reading_on_one_face_scatters_more_than_the_stated_mean_of_two():
    # 0.5" of the mean of two faces is 0.7071" of one; 1" last digit is 0.2887"; together sqrt(0.5 + 0.0833) = 0.7638".
    lines_of_u = theodolite.stated_uncertainty(0.5 * arcsec, 1.0 * arcsec)
    assert float(lines_of_u.u) / arcsec == pytest.approx(0.76376, abs=1e-5)
