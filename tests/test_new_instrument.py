"""A person adds an instrument by writing one file, in a folder of their own, and edits nothing else."""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest
from test_instruments import check_effects, check_example, check_recovery

from calib import Observations, Problem, Unknown, budget, linearise, simulate, solve
from calib.units import um
from instruments import interferometer, stated

DIAL_INDICATOR = '''
"""Dial indicator: displacement of its plunger, shown by a pointer on gears."""

import numpy as np

from calib import Effect, Observations, Parameter, Problem, Unknown, direct, simulate
from calib.units import hour, minute, mm, um
from instruments import influence, stated

GUIDE = "ISO 463:2006, mechanical dial gauges"


def indication(displacement, zero, *, plunger=direct, pointer=direct):
    """Reading of the dial: its zero plus the displacement of the plunger along its axis [m]."""
    return pointer(zero + plunger(displacement))


def stated_uncertainty(limit, division):
    """Limit of error, rectangular, and reading to a fifth of a division [m]."""
    return stated.Lines({"limit of error": stated.rectangular(limit), "reading": stated.resolution(division / 5)})


def effects(blocks=()):
    """The gain of the gears, their eccentricity (one wave a turn of 1 mm), drift, reversal and knocks."""
    return (influence.gain("gain", "plunger", "1", (1e-4, 0.02), source=GUIDE),
            influence.harmonic("pinion", "plunger", 2 * np.pi / mm, "um", (0.2 * um, 10 * um), source=GUIDE),
            influence.drift("pointer", "um", (0.1 * um / hour, 10 * um / hour), source=GUIDE),
            influence.hysteresis("pointer", "um", (0.2 * um, 5 * um), source=GUIDE),
            *influence.steps("pointer", "um", (0.5 * um, 20 * um), blocks, source=GUIDE))


def example(seed):
    """Compared with gauge blocks up and down; simulated readings."""
    up = np.arange(0.0, 2.0, 0.13) * mm
    known = np.concatenate([up, up[::-1]])
    rows = np.arange(len(known))
    readings = Observations(indication, known, Unknown("zero", 0.0, "um"), u=stated_uncertainty(2 * um, 1 * um).u,
                            group="dial", unit="um",
                            covariates={"time": (rows * minute, "s"), "direction": np.repeat([1.0, -1.0], len(up)),
                                        "block": 1 + rows // 7})
    return simulate(Problem([readings], effects=effects(blocks=(2, 3)), name="dial indicator"), {}, seed)
'''


@pytest.fixture
def dial_indicator(tmp_path, monkeypatch):
    """The new instrument, imported from a folder that holds this one file."""
    (tmp_path / "dial_indicator.py").write_text(DIAL_INDICATOR, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("dial_indicator")
    sys.modules.pop("dial_indicator")


def test_a_new_instrument_written_as_one_file_does_all_that_the_shipped_ones_do(dial_indicator):
    problem = check_example(dial_indicator, 4)
    check_effects(problem)
    assert check_recovery(problem, 4) == []


def test_a_new_instrument_has_its_lines_in_the_budget(dial_indicator):
    fit = linearise(solve(dial_indicator.example(1)))
    lines = stated.itemised(budget(fit, "zero"), {"dial": dial_indicator.stated_uncertainty(2 * um, 1 * um)})
    assert [one.label for one in lines.contributions] == ["dial: limit of error", "dial: reading"]


def test_a_new_instrument_and_a_shipped_one_share_the_unknowns_of_one_problem(dial_indicator):
    truth = np.linspace(0.0, 1e-3, 12)
    place = Unknown("place", truth[:, None], "mm")
    zero, start = Unknown("zero", 0.0, "um"), Unknown("start", 0.0, "um")
    problem = Problem([
        Observations(dial_indicator.indication, place.each, zero, u=1 * um, group="dial"),
        Observations(interferometer.displacement, place.each, start, -np.ones(12), u=0.1 * um, group="interferometer"),
    ], effects=[e for e in dial_indicator.effects() if e.name == "gain"]).free("gain (plunger)")
    # A common shift of all places goes unseen into zero and start.
    estimate = solve(simulate(problem.hold(start), {"gain (plunger)": np.array([5e-3])}, 7, noise=False))
    assert estimate["gain (plunger)"] == pytest.approx(5e-3, rel=1e-9)
