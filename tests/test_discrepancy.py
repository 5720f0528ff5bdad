"""The parts of the discrepancy workflow: kinds of noise, descriptions of structure, aliases, what is said in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib import Observations, Problem, Unknown, simulate, solve
from calib.errors import CalibrationError
from calib.units import arcsec, degree, hour
from calib.workflow.discrepancy.rivals import HEAVY, SCALED, SERIAL, STATED, UNEVEN, accounts
from calib.workflow.discrepancy.scene import scene_of
from calib.workflow.discrepancy.structure import described, patterns
from problems import plumb

U = 0.2 * arcsec


def turns(errors, time=None, direction=None):
    """A level on one table over several full turns with given errors in units of u."""
    n = len(errors)
    angle = np.arange(n) * 15.0 * degree
    covariates = {"time": (np.arange(n) * 60.0 if time is None else time, "s"), "block": 1 + (np.arange(n) >= n // 2)}
    if direction is not None:
        covariates["direction"] = direction
    have = {*covariates, "angle", "table", "inclination"}
    problem = plumb.declare(angle, 3 * arcsec * np.sin(angle) + U * np.asarray(errors), U, ["T"] * n, None, covariates)
    return problem.with_effects(*(e for e in plumb.effects((2,)) if set(e.inputs) <= have))


def scene(errors):
    problem = turns(errors)
    return scene_of(problem, solve(problem), ())


def kind(errors):
    here = scene(errors)
    return accounts(replace(here.field, signals=(), sizes=()), here.channels)[0].kind


def test_each_kind_of_noise_is_told_from_the_others():
    generator = np.random.default_rng(11)
    white = generator.standard_normal(144)
    memory = white.copy()
    for i in range(1, len(memory)):
        memory[i] = 0.75 * memory[i - 1] + np.sqrt(1 - 0.75**2) * white[i]
    uneven = white * np.where(np.arange(144) < 72, 1.0, 3.0)
    heavy = generator.standard_t(2.5, 144)
    assert [kind(e) for e in (white, 2.5 * white, memory, uneven, heavy)] == [STATED, SCALED, SERIAL, UNEVEN, HEAVY]


def test_a_harmonic_is_described_with_its_order_amplitude_and_phase():
    errors = np.random.default_rng(5).standard_normal(144)
    errors = errors + 2.0 * np.cos(4 * np.arange(144) * 15.0 * degree - 0.6)
    here = scene(errors)
    found, left, _ = described(replace(here.field, signals=(), sizes=()), patterns(here.channels), 1e-3, 1)
    assert found[0].shape == "harmonic 4"
    assert found[0].covariate == "angle"
    assert found[0].figures["amplitude_over_u"] == pytest.approx(2.0, abs=0.4)
    assert np.radians(found[0].figures["phase_deg"]) == pytest.approx(0.6, abs=0.2)
    assert left.squares / left.dof < 1.4


def test_serial_noise_is_no_drift():
    named = 0
    for seed in range(4):
        white = np.random.default_rng(seed).standard_normal(96)
        errors = white.copy()
        for i in range(1, 96):
            errors[i] = 0.8 * errors[i - 1] + 0.6 * white[i]
        named += bool(calib.explain(turns(errors)).effects)
    assert named == 0


def test_effects_driven_alike_are_listed_as_aliases_with_what_would_tell_them_apart():
    n = 96
    time = np.arange(n) * 60.0
    angle = np.arange(n) * 15.0 * degree
    reading = 3 * arcsec * np.sin(angle) + 1.5 * arcsec / hour * time
    reading = reading + U * np.random.default_rng(2).standard_normal(n)
    covariates = {"time": (time, "s"), "temperature_difference": (0.5 * time / hour, "K")}
    problem = plumb.declare(angle, reading, U, None, None, covariates)
    have = {*covariates, "angle", "table", "inclination"}
    found = calib.explain(problem.with_effects(*(e for e in plumb.effects() if set(e.inputs) <= have)))
    (one,) = found.effects
    assert {(one.name, one.channel), *one.aliases} == {("drift", "reading"), ("thermal", "reading")}
    assert "independently of" in found.next_measurement


def test_a_parameter_that_is_only_rounding_in_the_readings_is_held_and_said():
    angle = np.tile(np.arange(0, 360, 60), 5) * degree      # the sine of three turns is zero at all of them
    problem = plumb.declare(angle, np.zeros(30), 0.2 * arcsec)
    problem = problem.with_effects(*(e for e in plumb.effects() if e.name.startswith("tilt_motion")))
    lobes = problem.parameters("tilt_motion_3x (table)")
    found = calib.explain(simulate(problem, {lobes: np.array([[0.5, 0.0]]) * arcsec}, 2))
    assert [e.name for e in found.effects] == ["tilt_motion_3x"]
    value, u, _ = found.effects[0].parameters["c"]
    assert abs(value - 0.5) < 3 * u < 0.3
    assert found.effects[0].parameters["s"][0] == 0.0
    assert any("cannot tell s of tilt_motion_3x" in remark for remark in found.remarks)


def test_an_implausible_size_is_said():
    n = 96
    errors = np.random.default_rng(3).standard_normal(n) + 4000.0 * np.arange(n) / n
    (one,) = calib.explain(turns(errors)).effects
    assert one.name == "drift"
    assert "is implausible" in one.plausibility


def test_blunders_are_listed_by_row_and_are_no_effect():
    errors = np.random.default_rng(8).standard_normal(96)
    errors[[10, 50]] += [12.0, -15.0]
    found = calib.explain(turns(errors))
    assert found.verdict == "outliers"
    assert found.outlier_rows == (11, 51)
    assert found.rms[1] < found.rms[0]


def test_candidates_that_all_hide_are_said_in_words():
    found = calib.explain(turns(np.random.default_rng(1).standard_normal(48)).hold("plumb"))
    assert not any("Not one of the known effects" in remark for remark in found.remarks)
    angle = np.repeat([0.0, 90.0], 6) * degree
    problem = plumb.declare(angle, U * np.random.default_rng(1).standard_normal(12), U)
    only = [e for e in plumb.effects() if e.name.startswith("tilt_motion")]
    found = calib.explain(problem.with_effects(*only).hold("zero"))
    assert any("Not one of the known effects" in remark for remark in found.remarks)


def test_a_fit_that_does_not_converge_is_said_in_words():
    from casadi import exp

    rate = Unknown("rate", 50.0, "1")
    x = np.linspace(0, 1, 20)
    problem = Problem([Observations(lambda k, t: exp(exp(k * t)), rate, x, readings=np.linspace(3, 9, 20), u=1e-3)])
    with pytest.raises(CalibrationError):
        calib.explain(problem)
