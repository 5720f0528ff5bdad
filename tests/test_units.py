import math

import numpy as np
import pytest

from calib import units
from calib.errors import CalibrationError, InputError


@pytest.mark.parametrize(("text", "factor", "dimension"), [
    ("mm", 1e-3, "length"), ("µm", 1e-6, "length"), ("um^2", 1e-12, "length^2"), ("mm2", 1e-6, "length^2"),
    ("m²", 1.0, "length^2"), ("arcsec", math.pi / 648000.0, "angle"), ("gon", math.pi / 200.0, "angle"),
    ("arcsec/h", math.pi / 648000.0 / 3600.0, "angle/time"), ("um/m", 1e-6, "number"), ("ppm/K", 1e-6, "1/temperature"),
    ("urad/m", 1e-6, "angle/length"), ("mm/s", 1e-3, "length/time"), ("um/(m*K)", 1e-6, "1/temperature"),
    ("um/m/K", 1e-6, "1/temperature"), ("m*K/s", 1.0, "length*temperature/time"), ("1", 1.0, "number"),
    ("1/K", 1.0, "1/temperature"), ("%", 0.01, "number"), ("hPa", 100.0, "pressure"), ("K^-1", 1.0, "1/temperature"),
    ("m^-2", 1.0, "1/length^2"), ("Hz*s", 1.0, "number"), ("km/(h/min)", 1000.0 / 60.0, "length"),
])
def test_a_unit_text_has_its_factor_and_dimension(text, factor, dimension):
    assert math.isclose(units.factor(text), factor, rel_tol=4e-16)
    assert units.dimension(text) == dimension


def test_values_and_arrays_go_to_si_and_back():
    readings = np.array([1.5, -2.25])
    np.testing.assert_allclose(units.to_si(readings, "um"), readings * 1e-6, rtol=2e-16)
    np.testing.assert_allclose(units.from_si(units.to_si(readings, "arcsec/h"), "arcsec/h"), readings, rtol=4e-16)
    assert units.to_si(180.0, "deg") == pytest.approx(math.pi, rel=1e-15)
    assert 0.15 * units.arcsec == units.to_si(0.15, "arcsec")


def test_full_turns_of_every_angle_unit_are_the_same_angle():
    turns = [360 * units.degree, 400 * units.gon, 1296000 * units.arcsec, 21600 * units.arcmin, units.to_si(1, "rev")]
    np.testing.assert_allclose(turns, 2 * math.pi, rtol=4e-16)


@pytest.mark.parametrize(("text", "hint"), [
    ("arcsek", "arcsec"), ("mrd", "mrad"), ("Mm", "mm"), ("grad", "rad"), ("um/M", "'m'")])
def test_an_unknown_unit_is_refused_with_near_matches(text, hint):
    with pytest.raises(InputError, match="unknown unit") as refusal:
        units.factor(text)
    assert hint in refusal.value.sentence and text in str(refusal.value)
    assert isinstance(refusal.value, CalibrationError)


@pytest.mark.parametrize("text", ["", " ", "mm/", "/mm", "(mm", "mm)", "mm//s", "10 um", "mm;", "mm^", "m^2.5", "()"])
def test_a_text_that_is_no_unit_is_refused(text):
    with pytest.raises(InputError):
        units.factor(text)


def test_degrees_celsius_are_refused_as_a_factor_and_have_their_own_function():
    with pytest.raises(InputError, match="kelvin_from_celsius"):
        units.to_si(20.0, "°C")
    assert units.kelvin_from_celsius(20.0) == 293.15


@pytest.mark.parametrize(("text", "expected", "constant", "proportional"), [
    ("0.5 um + 0.2 um/m", None, 0.5e-6, 0.2e-6), ("10 urad", None, 10e-6, 0.0), ("2 mm + 1 ppm", None, 2e-3, 1e-6),
    ("1 arcsec + 0.5 arcsec/m", None, units.arcsec, 0.5 * units.arcsec), ("5 ppm", "length", 0.0, 5e-6),
    ("0.2um/m+0.5um", "length", 0.5e-6, 0.2e-6), ("1.5e-1 um", "length", 0.15e-6, 0.0), ("5 ppm", "number", 5e-6, 0.0),
])
def test_a_stated_uncertainty_is_a_constant_and_a_proportional_part(text, expected, constant, proportional):
    np.testing.assert_allclose(units.uncertainty(text, expected), (constant, proportional), rtol=4e-16)


@pytest.mark.parametrize(("text", "expected"), [
    ("", None), ("um", None), ("0.5", None), ("0.5 um 3 um", None), ("-1 um", None), ("1 um - 2 um/m", None),
    ("1 um + 2 um", None), ("1 um + 2 urad", None), ("10 urad", "length"), ("nan um", None), ("1 um +", None),
    ("+ 1 um", None)])
def test_a_text_that_is_no_uncertainty_is_refused(text, expected):
    with pytest.raises(InputError):
        units.uncertainty(text, expected)


def test_a_quantity_text_is_one_number_of_the_wanted_dimension():
    assert units.quantity("0.1 mm", "length") == 0.1 * 1e-3
    assert units.quantity("-3 arcsec") == -3 * units.arcsec
    with pytest.raises(InputError, match=r"angle.*length"):
        units.quantity("3 arcsec", "length")
    with pytest.raises(InputError, match="sum"):
        units.quantity("1 mm + 1 um")


@pytest.mark.parametrize("dimension", sorted({kind for _, kind in units.SYMBOLS.values()}))
def test_the_example_unit_of_a_message_is_of_the_dimension_that_is_wanted(dimension):
    assert units.dimension(units.customary(dimension)) == dimension
