"""The coordinate measuring machine: signs of its errors, limits of error, and what a ball plate tells."""

from __future__ import annotations

import numpy as np
import pytest

from calib import Observations, Problem, Shared, predict
from calib.units import um
from instruments import coordinate_machine

POINT = np.array([0.4, -0.2, 0.1])


def error(label, size, model=coordinate_machine.position, middle=0.0, half_range=0.5, **covariates):
    """What one effect adds to the point that belongs to POINT, in micrometres."""
    every = (*coordinate_machine.guide_effects(middle=middle, half_range=half_range),
             *coordinate_machine.cosine_effects(), coordinate_machine.thermal_effect())
    recorded = Observations(model, Shared(POINT), u=um, covariates={k: np.array([v]) for k, v in covariates.items()})
    problem = Problem([recorded], effects=[e for e in every if e.label == label])
    assert len(problem.effects) == 1
    return (predict(problem, {label: np.atleast_1d(size)})["readings"][0] - POINT) / um


@pytest.mark.parametrize("label, size, expected", [
    # X = (0.4, -0.2, 0.1) m; sizes in SI, expected in micrometres.
    ("zero_offset (y)", 3e-6, (0, 3, 0)),
    ("scale (x)", 10e-6, (4, 0, 0)), ("scale (z)", 10e-6, (0, 0, 1)),
    ("squareness (xy)", 5e-6, (1, 0, 0)),              # E_x = -eps y
    ("squareness (yz)", 5e-6, (0, -0.5, 0)),           # E_y = -eps z
    ("squareness (zx)", 5e-6, (0.5, 0, 0)),            # E_x = +eps z
    ("straightness (z(x))", 2e-6, (0, 0, 1.28)),       # (0.4/0.5)^2 = 0.64
    ("straightness (x(y))", 2e-6, (0.32, 0, 0)),       # (0.2/0.5)^2 = 0.16
    ("cosine (y)", 1e-5, (0, -2, 0)),                  # 1/cos(beta) - 1 = 1e-5
])
def test_every_guide_error_has_the_sign_and_size_of_its_definition(label, size, expected):
    assert error(label, size) == pytest.approx(expected, abs=1e-9)


def test_straightness_is_measured_from_the_middle_of_the_travel():
    # (0.4 - 0.2)/0.4 = 0.5, squared 0.25.
    assert error("straightness (y(x))", 4e-6, middle=(0.2, 0, 0), half_range=0.4) == pytest.approx((0, 1, 0), abs=1e-9)


def test_pitch_needs_an_abbe_offset_and_hysteresis_a_direction():
    assert error("pitch_abbe (x)", 10e-6, abbe_x=0.5) == pytest.approx((2, 0, 0), abs=1e-9)
    assert error("hysteresis (z)", 4e-6, direction_z=-1.0) == pytest.approx((0, 0, -2), abs=1e-9)
    assert error("hysteresis (z)", 4e-6, direction_z=0.0) == pytest.approx((0, 0, 0), abs=1e-9)


def test_warm_scales_measure_from_the_origin_of_the_machine():
    assert error("thermal (machine)", 10e-6, temperature_difference=0.5) == pytest.approx((2, -1, 0.5), abs=1e-9)


def test_the_machine_records_the_point_less_its_error():
    assert error("scale (x)", 10e-6, model=coordinate_machine.indication) == pytest.approx((-4, 0, 0), abs=1e-9)


def test_a_prefix_names_the_channels_of_one_of_several_machines():
    labels = {e.label for e in coordinate_machine.guide_effects(prefix="A.")}
    assert {"scale (A.x)", "squareness (A.xy)", "straightness (A.y(x))", "pitch_abbe (A.x)"} <= labels


def test_a_maximum_permissible_error_is_rectangular_and_shared_by_two_points():
    # 1.2 um + 3 um/m times 0.3 m = 2.1 um; /sqrt(3) = 1.212 um; /sqrt(2) = 0.857 um.
    assert coordinate_machine.length_uncertainty(1.2 * um, 3e-6, 0.3) / um == pytest.approx(1.21244, abs=1e-5)
    assert coordinate_machine.coordinate_uncertainty(1.2 * um, 3e-6, 0.3) / um == pytest.approx(0.85732, abs=1e-5)
