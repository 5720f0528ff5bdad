"""Interferometers against hand-derived numbers: counting sense, start, and every error of the beam."""

from __future__ import annotations

import numpy as np
import pytest

from calib import Observations, Problem, Shared, predict
from calib.units import mm, nm, um
from instruments import interferometer

POSITIONS = np.array([0.0, 0.1, 0.25, 0.5])
POINTS = np.array([[3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 9.0], [-3.0, 0.0, 0.0]])
BASE = np.array([0.0, 0.0, 4.0])
EVERY = {e.label: e for e in (*interferometer.effects(), *interferometer.displacement_effects(),
                              *interferometer.tracking_effects())}


def on_guide(label=None, size=None, sense=1.0, start=0.0, **covariates):
    observations = Observations(interferometer.displacement, POSITIONS, Shared(start), Shared(sense), u=nm,
                                covariates=covariates)
    return predict(Problem([observations], effects=[EVERY[label]] if label else []),
                   {EVERY[label]: np.atleast_1d(size)} if label else None)["readings"][:, 0]


def tracked(label=None, size=None, sense=1.0, velocity=None, **covariates):
    velocity = np.zeros((4, 3)) if velocity is None else velocity
    observations = Observations(interferometer.tracking_in_motion, POINTS, velocity, Shared(BASE), Shared(4.0),
                                Shared(sense), u=nm, covariates=covariates)
    return predict(Problem([observations], effects=[EVERY[label]] if label else []),
                   {EVERY[label]: np.atleast_1d(size)} if label else None)["readings"][:, 0]


def test_the_reading_grows_or_falls_with_the_path_by_the_counting_sense():
    # 3-4-5 triangles: three paths of 5 m and one of 5 m along the axis, zeroed at 4 m.
    assert tracked() == pytest.approx(np.ones(4), abs=1e-15)
    assert tracked(sense=-1.0) == pytest.approx(-np.ones(4), abs=1e-15)
    assert on_guide(sense=-1.0, start=0.2) == pytest.approx(0.2 - POSITIONS, abs=1e-15)


def test_the_cosine_error_is_the_projection_of_the_motion_on_the_beam():
    beta = 2e-3                                       # kappa = beta^2/2 = 2e-6: half a metre is read 1 um short
    added = on_guide("cosine (d)", beta**2 / 2) - on_guide()
    assert added[-1] == pytest.approx(-1e-6, rel=1e-9)
    assert added == pytest.approx(POSITIONS * (np.cos(beta) - 1), abs=0.5 * beta**4 / 24 + 1e-16)
    assert interferometer.cosine_angle(beta**2 / 2) == pytest.approx(beta, rel=1e-12)


def test_the_cosine_error_can_only_shorten_the_reading():
    assert EVERY["cosine (d)"].parameters[0].lower == 0.0


def test_the_abbe_error_is_pitch_times_offset():
    # 10 urad/m times 0.5 m is a pitch of 5 urad; at an offset of 0.1 m that is 0.5 um.
    added = on_guide("pitch_abbe (d)", 10e-6, abbe_offset=np.full(4, 0.1)) - on_guide()
    assert added[-1] == pytest.approx(0.5e-6, rel=1e-9)


def test_the_dead_path_turns_a_change_of_temperature_into_a_change_of_reading():
    # 0.1 m of dead path, 2 K warmer: 0.1 m times -0.955e-6 /K times 2 K = -0.191 um, whatever the displacement.
    added = on_guide("dead_path (d)", 0.1, temperature_difference=np.full(4, 2.0)) - on_guide()
    assert added == pytest.approx(np.full(4, -0.191e-6), abs=1e-15)


def test_an_air_thermometer_that_reads_high_makes_the_displayed_length_long():
    added = on_guide("air_temperature (d)", 1.0) - on_guide()
    assert added == pytest.approx(0.955e-6 * POSITIONS, rel=1e-9)


def test_the_cyclic_error_has_two_waves_for_each_wavelength_of_displacement():
    # psi = 4 pi d/lambda: the cosine part at d = 0, the sine part at lambda/8 (psi = pi/2), the cosine part again at
    # lambda/2.
    wave = interferometer.HELIUM_NEON
    d = np.array([0.0, wave / 8, wave / 4, wave / 2])
    observations = Observations(interferometer.displacement, d, Shared(0.0), Shared(1.0), u=nm)
    cyclic = EVERY["cyclic (d)"]
    reading = predict(Problem([observations], effects=[cyclic]), {cyclic: np.array([5 * nm, 3 * nm])})["readings"][:, 0]
    assert reading - d == pytest.approx(np.array([5, 3, -5, 5]) * nm, abs=1e-9 * nm)


def test_the_fringes_follow_the_path_with_all_that_changes_it():
    wave, d = interferometer.HELIUM_NEON, np.linspace(0.0, 1.0, 5) * um
    time = np.arange(5) * 60.0
    observations = Observations(interferometer.displacement, d, Shared(0.0), Shared(1.0), u=nm,
                                covariates={"time": (time, "s")})
    cyclic, drift = EVERY["cyclic (d)"], EVERY["drift (d)"]
    values = {cyclic: np.array([5 * nm, 3 * nm]), drift: np.array([50 * nm / 60])}
    reading = predict(Problem([observations], effects=[cyclic, drift]), values)["readings"][:, 0]
    moved = d + 50 * nm / 60 * time
    psi = 4 * np.pi * moved / wave
    assert reading == pytest.approx(moved + (5 * np.cos(psi) + 3 * np.sin(psi)) * nm, abs=1e-9 * nm)


def test_the_base_wanders_twice_in_a_turn_of_azimuth():
    added = tracked("base_wander (d)", np.array([1 * um, 0.0])) - tracked()
    # azimuths 0, 90, (above) and 180 degrees
    assert added[[0, 1, 3]] == pytest.approx(np.array([1, -1, 1]) * um, abs=1e-15)


def test_a_drifting_base_shortens_the_path_it_drifts_along():
    added = tracked("drift (base_z)", 1e-9, time=np.full(4, 1000.0)) - tracked()
    # The base moves up by 1 um: the points 3 m aside lie 4 m below it, cosine 0.8, the last but one straight above.
    assert added == pytest.approx(np.array([0.8, 0.8, -1.0, 0.8]) * um, abs=1e-12)


def test_late_triggering_reads_the_path_of_a_little_later():
    velocity = np.tile([10 * mm, 0.0, 0.0], (4, 1))
    added = tracked("time_sync (d)", 5e-3, velocity=velocity) - tracked(velocity=velocity)
    # 10 mm/s for 5 ms is 50 um along x; the line from base to point has the x components 0.6, 0, 0, -0.6.
    assert added == pytest.approx(np.array([30, 0, 0, -30]) * um, abs=1e-12)


def test_scale_multiplies_the_predicted_reading():
    assert tracked("scale (d)", 3e-6) == pytest.approx(tracked() * (1 + 3e-6), rel=1e-14)


def test_a_statement_with_a_share_becomes_two_lines():
    # (0.2 um + 0.5e-6 * 2 m)/2 = 0.6 um and 10 nm/sqrt(12) = 2.89 nm.
    lines = interferometer.stated_uncertainty(0.2 * um, 0.5e-6, np.array([2.0]), 10 * nm)
    assert lines.u == pytest.approx([np.hypot(0.6e-6, 10e-9 / np.sqrt(12))], rel=1e-12)
    assert set(lines.lines) == {"stated U", "resolution"}
