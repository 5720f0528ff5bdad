"""Thermometers against the tables of IEC 60751 and hand-derived numbers."""

from __future__ import annotations

import numpy as np
import pytest

from calib import Observations, Problem, Shared, predict
from calib.errors import InputError
from instruments import thermometer


def resistance(celsius):
    kelvin = np.asarray(celsius, float) + 273.15
    return predict(Problem([Observations(thermometer.resistance, kelvin, Shared(100.0), u=1e-3)]))["readings"][:, 0]


# IEC 60751, table of resistances of a Pt100 in ohm.
@pytest.mark.parametrize("celsius, ohm", [
    (-200, 18.52), (-100, 60.26), (-50, 80.31), (0, 100.00), (50, 119.40), (100, 138.51), (200, 175.86), (400, 247.09),
    (850, 390.48)])
def test_a_platinum_sensor_has_the_resistances_of_the_standard(celsius, ohm):
    assert resistance([celsius])[0] == pytest.approx(ohm, abs=0.005 + 1e-9)


def test_the_tolerance_classes_are_rectangular():
    # Class A at 100 degC: 0.15 + 0.002 * 100 = 0.35 K; class B at -50 degC: 0.3 + 0.005 * 50 = 0.55 K.
    assert thermometer.tolerance_uncertainty("A", 373.15) == pytest.approx(0.35 / np.sqrt(3), rel=1e-12)
    assert thermometer.tolerance_uncertainty("B", 223.15) == pytest.approx(0.55 / np.sqrt(3), rel=1e-12)


def test_an_unknown_tolerance_class_is_refused_in_words():
    with pytest.raises(InputError, match="no tolerance class 'D'"):
        thermometer.tolerance_uncertainty("D", 300.0)


def shown(name=None, size=None, **covariates):
    temperature = np.array([280.0, 293.15, 300.0])
    problem = Problem([Observations(thermometer.indication, temperature, u=1e-3, covariates=covariates)],
                      effects=[e for e in thermometer.effects() if e.name == name])
    return predict(problem, {e: np.atleast_1d(size) for e in problem.effects})["readings"][:, 0] - temperature


def test_a_lagging_sensor_reads_low_while_the_temperature_rises():
    late = shown("lag", 60.0, temperature_rate=np.array([1e-3, 0.0, -1e-3]))
    assert late == pytest.approx([-0.06, 0, 0.06], abs=1e-12)


def test_the_gain_has_no_effect_at_its_reference_and_conduction_draws_toward_the_room():
    assert shown("gain", 1e-3) == pytest.approx([-0.01315, 0, 0.00685], abs=1e-12)
    assert shown("conduction", 1e-2, ambient=np.full(3, 293.15)) == pytest.approx([0.1315, 0, -0.0685], abs=1e-12)


def test_self_heating_grows_with_the_square_of_the_current():
    warmer = shown("self_heating", 5e-3, current_squared=np.array([0.0, 1.0, 2.0]))
    assert warmer == pytest.approx([0, 0.005, 0.01], abs=1e-12)
