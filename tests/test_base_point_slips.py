"""The slips of the base-point paper, each with its number (docs/slips/base_point.md)."""

import numpy as np
import pytest

import calib
from calib.table import shipped
from calib.units import mm, um
from problems import base_point
from problems.base_point import (
    SHORTENING,
    FreeStart,
    TiedStart,
    paper,
)

EXPERIMENT = paper.experiment("d")
TIED = calib.solve(base_point.declare(EXPERIMENT, TiedStart(), sense=SHORTENING))
FREE = calib.solve(base_point.declare(EXPERIMENT, FreeStart((0.0, 0.0, 0.0)), sense=SHORTENING))
PUBLISHED = paper.reproduce()
BASE = np.array([-0.21, 1.38, -0.3])


C = np.array([-203.8742, 1400.9193, -228.9421]) * mm


def test_the_printed_signs_of_equation_6_have_no_root():
    square = (EXPERIMENT.points - C) ** 2
    radicand = square[:, 0] - square[:, 1] - square[:, 2]
    assert radicand[0] / mm**2 == pytest.approx(-1948969, abs=1) and np.sum(radicand < 0) == 23
    assert np.sqrt(radicand[31]) / mm == pytest.approx(759.5, abs=0.05)
    assert np.sqrt(square[31].sum()) / mm == pytest.approx(1087.0, abs=0.05)


def test_the_reading_of_table_2_grows_when_the_path_shortens():
    path, length, d = np.linalg.norm(EXPERIMENT.points[13] - C), np.linalg.norm(C), EXPERIMENT.readings[13]
    assert (path - (length + d)) / mm == pytest.approx(534.35, abs=0.01)
    assert (path - (length - d)) / mm == pytest.approx(0.0012, abs=0.0001)


def test_the_cosine_of_equation_1_has_plus_for_the_beam_and_minus_for_the_triangle():
    table = shipped("base_point/table1_symmetric_simulation.csv")
    a, b = table.number("a", "length")[0] / mm, table.number("b", "length")[0] / mm
    length, cosine = np.hypot(700.0, 500.0), 700.0 / np.hypot(700.0, 500.0)
    assert np.degrees(np.arccos(cosine)) == pytest.approx(35.54, abs=0.005)
    assert np.sqrt(length**2 + b**2 - 2 * length * b * cosine) - length == pytest.approx(a, abs=1e-4)
    assert np.sqrt(length**2 + b**2 + 2 * length * b * cosine) - length == pytest.approx(109.8915, abs=1e-4)


def test_equation_3_has_the_wrong_sign_of_the_correction():
    target, begin, correction = np.array([131.3487, 0.0]), np.array([700.0, 500.0]), np.array([1.0, 1.0])
    path = np.linalg.norm(begin - target)
    grown = np.linalg.norm(begin + correction - target) - path
    slope = (begin - target) @ correction / path
    assert grown == pytest.approx(1.41131, abs=1e-5) and abs(slope - grown) < 6e-6
    assert abs(-slope - grown) == pytest.approx(2.82, abs=0.01)


def test_the_noise_of_table_1_is_a_micrometre_and_is_not_in_its_readings():
    table = shipped("base_point/table1_symmetric_simulation.csv")
    a, b, e = (table.number(name, "length") for name in ("a", "b", "e"))
    exact = np.hypot(0.7 - b, 0.5) - np.hypot(0.7, 0.5)
    assert np.sum((e / (0.1 * um)) ** 2) == pytest.approx(684, abs=1)
    assert np.sum((e / um) ** 2) == pytest.approx(6.84, abs=0.01)
    assert np.abs(a - exact).max() < 0.12 * um and np.abs(a - exact - e).max() > 2.0 * um
    for name, printed, needed in (("sym", 0.040, 0.40), ("half", 0.26, 2.58)):
        foot = paper.FEET[name]
        assert paper.sigma_x(foot, 0.1 * um) == pytest.approx(printed, abs=0.005)
        assert paper.sigma_x(foot, 1.0 * um) == pytest.approx(needed, abs=0.005)


def test_two_or_three_unknowns_print_the_same_s():
    assert PUBLISHED["s"].value == pytest.approx(1.279, abs=0.001)
    assert PUBLISHED["s"].more["value_with_three_unknowns"] == pytest.approx(1.301, abs=0.001)


def test_the_digit_repairs_move_the_base_point_by_tens_of_micrometres():
    assert PUBLISHED["base_x"].more["value_as_printed"] == pytest.approx(-203.8702, abs=0.0001)
    assert PUBLISHED["base_z"].more["value_as_printed"] == pytest.approx(-228.9151, abs=0.0001)
    assert FREE["base_point"] - TIED["base_point"] == pytest.approx(np.array([-32, 50, -91]) * um, abs=0.6 * um)


def test_the_printed_decimals_are_beyond_what_the_readings_carry():
    u = calib.covariance(calib.linearise(TIED), "base_point").u
    assert u / um == pytest.approx([5.4, 11.3, 33.2], abs=0.05)
    assert PUBLISHED.studies["lag_one_correlation_of_joint_residuals"] == pytest.approx(0.44, abs=0.005)


def test_the_digit_repairs_are_where_the_printed_residuals_do_not_fit():
    table = shipped("base_point/table2_experiment.csv")
    residuals, row = TIED.residuals["tracker"][:, 0], table.whole("i")
    repaired, shift = table.text("repaired"), table.number("d_printed", "length") - table.number("d", "length")
    misfit = residuals + shift - table.number("delta_printed", "length")      # a longer d is a larger residual
    found = {int(row[k]): abs(misfit[k]) / um for k in np.flatnonzero(np.abs(misfit) > 0.06 * um)}
    assert sorted(found) == row[repaired != "no"].tolist() == [5, 14, 19, 25]
    assert [found[k] for k in (14, 25, 5, 19)] == pytest.approx([0.8, 2.7, 0.32, 0.85], abs=0.05)


def test_the_coordinate_across_the_line_gains_little_from_symmetry():
    rows = {(r["layout"], r["start"]): r["u_y_um"] for r in PUBLISHED.studies["layouts"]}
    tied = [rows[name, "tied to the zero point"] for name in ("sym", "half")]
    assert tied == pytest.approx([1.57, 2.72], abs=0.005) and tied[1] / tied[0] == pytest.approx(1.73, abs=0.005)
