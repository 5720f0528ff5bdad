"""What every instrument module owes, collected from the package so that a new one is tested without being listed."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from types import ModuleType

import numpy as np
import pytest

import instruments
from calib import Effect, Problem, Unknown, covariance, linearise, predict, simulate, solve
from calib.errors import RankDefect
from calib.units import dimension

FOUND = [importlib.import_module(f"instruments.{found.name}") for found in pkgutil.iter_modules(instruments.__path__)]
INSTRUMENTS = [module for module in FOUND if hasattr(module, "example")]
NAMES = [module.__name__.rpartition(".")[2] for module in INSTRUMENTS]
each_instrument = pytest.mark.parametrize("instrument", INSTRUMENTS, ids=NAMES)


@cache
def first_example(instrument: ModuleType) -> Problem:
    """The example of an instrument with seed 1; problems are frozen, so tests may share it."""
    return instrument.example(1)


def plausible_size(effect: Effect) -> np.ndarray:
    """The geometric middle of the plausible range of each parameter."""
    return np.array([np.sqrt(np.prod(parameter.plausible)) for parameter in effect.parameters])


def check_example(instrument: ModuleType, seed: int) -> Problem:
    """The example has readings, is solved with a passed certificate, and fits its own noise."""
    problem = instrument.example(seed)
    estimate = solve(problem)
    assert estimate.converged and estimate.certificate.passed, estimate.certificate.why
    # v'Pv of an honest problem is chi-square with its degrees of freedom; five standard deviations.
    assert abs(estimate.objective - estimate.dof) < 5 * np.sqrt(2 * estimate.dof)
    return problem


def truth_of(problem: Problem) -> dict[Unknown, object]:
    """Values near the truth of an example: its estimate."""
    estimate = solve(problem)
    return {unknown: estimate[unknown] for unknown in problem.unknowns}


def change(problem: Problem, values: dict, effect: Effect, parameters: np.ndarray) -> np.ndarray:
    """What an effect with these parameters adds to all predicted readings [SI]."""
    with_it, without = predict(problem, {**values, effect: parameters}), predict(problem, values)
    return np.concatenate([(with_it[group] - without[group]).ravel() for group in without])


def check_effects(problem: Problem) -> None:
    """Each effect has its own name, a source, units that exist, a plausible range, and acts at once."""
    labels = [effect.label for effect in problem.effects]
    assert len(set(labels)) == len(labels)
    values = truth_of(problem)
    for effect in problem.effects:
        assert effect.source, effect.label
        for parameter in effect.parameters:
            dimension(parameter.unit)
            low, high = parameter.plausible
            assert 0 < low < high <= parameter.upper
        size = plausible_size(effect)
        assert np.all(change(problem, values, effect, 0 * size) == 0.0), effect.label
        for one in np.diag(size):
            full, half = change(problem, values, effect, 1e-2 * one), change(problem, values, effect, 5e-3 * one)
            assert np.abs(full).max() > 0.0, effect.label
            # First order at zero: twice the parameter, twice the change, to the rounding of the readings.
            assert np.allclose(full, 2 * half, rtol=1e-4, atol=1e-12), effect.label


def check_recovery(problem: Problem, seed: int) -> list[str]:
    """An effect that is present is found without bias, or refused where the unknowns hide it: labels of the hidden."""
    hidden, values = [], truth_of(problem)
    for effect in problem.effects:
        truth = plausible_size(effect)
        present = simulate(problem.free(effect), {**values, effect: truth}, seed, noise=False)
        try:
            estimate = solve(present)
        except RankDefect:
            hidden.append(effect.label)
            continue
        assert estimate.certificate.passed, f"{effect.label}: {estimate.certificate.why}"
        found = np.ravel(estimate[effect])
        assert np.all(np.abs(found - truth) < 1e-3 * covariance(linearise(estimate), effect).u), effect.label
    return hidden


@each_instrument
def test_the_example_of_every_instrument_is_solved_and_fits_its_noise(instrument):
    check_example(instrument, 3)


@each_instrument
def test_every_effect_is_described_and_acts_to_first_order_from_exactly_nothing(instrument):
    check_effects(first_example(instrument))


# What the free unknowns of the examples hide, and why: the answer "cannot be known from these data" is the right one.
HIDDEN = {
    "coordinate_machine": {f"zero_offset ({axis})" for axis in "xyz"},      # the plate lies anywhere
    "level": {"zero (reading)"},                                  # the zero is an unknown of the problem
    "theodolite": {"standing_axis_tilt (standing_axis)"},         # every target direction is unknown
}


@each_instrument
@pytest.mark.slow
def test_every_effect_of_an_instrument_is_recovered_where_the_data_see_it(instrument):
    name = instrument.__name__.rpartition(".")[2]
    assert set(check_recovery(first_example(instrument), 1)) == HIDDEN.get(name, set())


@each_instrument
def test_the_example_attaches_every_effect_of_the_module(instrument):
    attached = {(effect.name, effect.slot) for effect in first_example(instrument).effects}
    assert {(effect.name, effect.slot) for effect in instrument.effects()} <= attached


# The vocabulary of the discrepancy cases that belongs to instruments: effects, channels, parameters with their units.
# A cosine error is reported there as beta; its parameter is kappa = beta^2/2, because beta has no first-order effect.
VOCABULARY = [
    ("level", "drift", ("reading",), {"rate": "arcsec/h"}), ("level", "thermal", ("reading",), {"coef": "arcsec/K"}),
    ("level", "hysteresis", ("reading",), {"width": "arcsec"}), ("level", "gain", ("reading",), {"k": "1"}),
    ("level", "step", ("reading@2",), {"offset": "arcsec"}),
    ("theodolite", "vertical_index", ("V",), {"i": "arcsec"}), ("theodolite", "collimation", ("H",), {"c": "arcsec"}),
    ("theodolite", "trunnion_tilt", ("H",), {"t": "arcsec"}),
    ("theodolite", "drift", ("H", "V"), {"rate": "arcsec/h"}),
    ("theodolite", "thermal", ("H", "V"), {"coef": "arcsec/K"}),
    ("theodolite", "hysteresis", ("H", "V"), {"width": "arcsec"}),
    ("theodolite", "step", ("H@2", "V@2"), {"offset": "arcsec"}),
    ("encoder", "encoder_ecc", ("theta",), {"c": "arcsec", "s": "arcsec"}),
    ("encoder", "encoder_2nd", ("theta",), {"c": "arcsec", "s": "arcsec"}),
    ("encoder", "angle_scale", ("theta",), {"k": "ppm"}),
    ("encoder", "hysteresis", ("theta",), {"width": "arcsec"}),
    ("laser_tracker", "drift", ("azimuth", "zenith"), {"rate": "arcsec/h"}),
    ("laser_tracker", "drift", ("range", "tracker_x", "tracker_y", "tracker_z"), {"rate": "um/h"}),
    ("laser_tracker", "thermal", ("range",), {"coef": "um/K"}),
    ("laser_tracker", "range_offset", ("range",), {"d": "um"}),
    ("laser_tracker", "scale", ("range",), {"k": "ppm"}),
    ("laser_tracker", "transit_tilt", ("azimuth",), {"t": "arcsec"}),
    ("laser_tracker", "step", ("azimuth@2", "zenith@2"), {"offset": "arcsec"}),
    ("laser_tracker", "step", ("range@2", "tracker_x@2", "tracker_y@2", "tracker_z@2"), {"offset": "um"}),
    ("interferometer", "scale", ("d",), {"k": "ppm"}), ("interferometer", "drift", ("d",), {"rate": "um/h"}),
    ("interferometer", "thermal", ("d",), {"coef": "um/K"}), ("interferometer", "step", ("d@2",), {"offset": "um"}),
    ("interferometer", "time_sync", ("d",), {"tau": "ms"}),
    ("interferometer", "cyclic", ("d",), {"c": "nm", "s": "nm"}),
    ("coordinate_machine", "scale", ("x", "y", "z"), {"k": "ppm"}),
    ("coordinate_machine", "cosine", ("x", "y", "z"), {"kappa": "1"}),
    ("coordinate_machine", "pitch_abbe", ("x", "y"), {"kappa": "urad/m"}),
    ("coordinate_machine", "squareness", ("xy", "yz", "zx"), {"eps": "urad"}),
    ("coordinate_machine", "straightness", ("y(x)", "z(x)", "x(y)", "z(y)", "x(z)", "y(z)"), {"w": "um"}),
    ("coordinate_machine", "hysteresis", ("x", "y", "z"), {"width": "um"}),
    ("coordinate_machine", "zero_offset", ("x", "y"), {"o": "um"}),
]


@pytest.mark.parametrize("module, name, channels, parameters", VOCABULARY)
def test_the_instruments_speak_the_vocabulary_of_the_discrepancy_cases(module, name, channels, parameters):
    problem = first_example(importlib.import_module(f"instruments.{module}"))
    for channel in channels:
        effect = problem.attached_effect(f"{name} ({channel})").effect
        assert {p.name: p.unit for p in effect.parameters} == parameters
