"""Polygon against indexing table: closure, the uncertainty of the complete design, roll and wobble."""

from __future__ import annotations

import numpy as np
import pytest

from calib import Observations, Problem, Shared, Unknown, covariance, linearise, predict, simulate, solve
from calib.units import arcsec, mrad
from instruments import autocollimator

COUNT, U = 6, 0.1 * arcsec


def complete_design():
    """Every face on every position of the table, one zero for each mounting."""
    face, table = (Unknown(name, np.zeros((COUNT, 1)), "arcsec") for name in ("face", "table"))
    zero = Unknown("zero", np.zeros((COUNT, 1)), "arcsec")
    mounting, position = np.repeat(np.arange(COUNT), COUNT), np.tile(np.arange(COUNT), COUNT)
    readings = Observations(autocollimator.polygon_face, face[(mounting + position) % COUNT], table[position],
                            zero[mounting], u=U, unit="arcsec")
    closures = [autocollimator.closure("faces", face), autocollimator.closure("table", table)]
    return Problem([readings], constraints=closures), face, table, zero


def test_polygon_and_table_are_separated_and_both_circles_close():
    problem, face, table, zero = complete_design()
    waves = np.arange(COUNT)[:, None]
    truth = {face: np.cos(2.0 * waves) * arcsec, table: np.sin(1.7 * waves) * arcsec, zero: 3 * arcsec * waves}
    estimate = solve(simulate(problem, truth, 1, noise=False))
    # Only deviations from the mean of the circle exist; the mean goes to the zeros of the mountings.
    assert estimate[face] == pytest.approx(truth[face] - truth[face].mean(), abs=1e-6 * U)
    assert estimate[table] == pytest.approx(truth[table] - truth[table].mean(), abs=1e-6 * U)
    assert abs(estimate[face].sum()) < 1e-12 and abs(estimate[table].sum()) < 1e-12


def test_a_face_of_the_complete_design_is_known_to_the_latin_square_formula():
    # The rows, columns and faces form a Latin square: a face is the mean of its N readings less the mean of all N^2,
    # variance u^2/N - u^2/N^2 = u^2 (N - 1)/N^2.
    problem, face, *_ = complete_design()
    u = covariance(linearise(solve(simulate(problem, None, 2))), face).u
    assert u == pytest.approx(np.full(COUNT, U * np.sqrt(COUNT - 1) / COUNT), rel=1e-9)


def two_axes(effects, values):
    positions = np.arange(4)
    tilt = np.array([10.0, -5.0, 0.0, 20.0]) * arcsec
    observations = Observations(
        autocollimator.polygon_face_in_two_axes, np.array([1.0, 0, -1, 0]) * arcsec, tilt, np.zeros(4),
        Shared(np.zeros(2)), u=U, covariates={"table_angle": positions * np.pi / 2})
    problem = Problem([observations], effects=effects)
    return predict(problem, dict(zip(problem.effects, values, strict=True)))["readings"] / arcsec


def effect(name):
    return next(e for e in autocollimator.effects() if e.name == name)


def test_a_rolled_autocollimator_reads_the_pyramidal_error_as_an_angle():
    added = two_axes([effect("roll")], [np.array([100 * mrad])]) - two_axes([], [])
    assert added == pytest.approx(np.array([[1.0, 0], [-0.5, 0], [0, 0], [2.0, 0]]), abs=1e-12)


def test_a_wobbling_table_adds_one_wave_of_tilt_which_roll_turns_into_angle_too():
    wobble = two_axes([effect("wobble")], [np.array([2.0, 1.0]) * arcsec]) - two_axes([], [])
    assert wobble == pytest.approx(np.array([[0, 2.0], [0, 1.0], [0, -2.0], [0, -1.0]]), abs=1e-12)
    both = two_axes([effect("wobble"), effect("roll")], [np.array([2.0, 1.0]) * arcsec, np.array([100 * mrad])])
    roll = two_axes([effect("roll")], [np.array([100 * mrad])])
    assert both[:, 0] - roll[:, 0] == pytest.approx(0.1 * wobble[:, 1], abs=1e-12)


def test_the_turn_of_an_indexing_table_is_a_difference_of_two_positions():
    # +-0.1" rectangular is 0.0577", twice 0.0816"; engaging again 0.02", twice 0.0283".
    lines = autocollimator.table_uncertainty(0.1 * arcsec, 0.02 * arcsec)
    assert float(lines.u) / arcsec == pytest.approx(np.sqrt(2 * 0.01 / 3 + 2 * 0.0004), rel=1e-12)
