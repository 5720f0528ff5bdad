"""Stated uncertainties against the worked numbers of the GUM and hand-derived ones."""

from __future__ import annotations

import numpy as np
import pytest

from calib import Observations, Problem, Unknown, budget, linearise, simulate, solve
from calib.errors import InputError
from instruments import stated


def test_the_shared_formulas_give_their_numbers():
    assert stated.rectangular(3.0) == pytest.approx(np.sqrt(3.0))
    assert stated.triangular(3.0) == pytest.approx(3 / np.sqrt(6))
    assert stated.arcsine(2.0) == pytest.approx(np.sqrt(2.0))
    assert stated.resolution(1.0) == pytest.approx(0.29, abs=0.005)        # GUM F.2.2.1: 0.29 of the last digit
    assert stated.from_expanded(240e-6, 3.0) == pytest.approx(80e-6)       # GUM 4.3.3: a 1 kg weight, 240 ug at k = 3
    assert stated.of_mean(13e-9, 5) == pytest.approx(5.8e-9, abs=0.05e-9)  # GUM H.1.3.2: five comparisons


def test_repeated_readings_give_mean_type_a_uncertainty_and_degrees_of_freedom():
    # 1, 2, 3, 4: mean 2.5, s^2 = (2.25 + 0.25 + 0.25 + 2.25)/3 = 5/3, u = sqrt(5/12).
    mean, u, dof = stated.repeats([1.0, 2.0, 3.0, 4.0])
    assert (mean, u, dof) == (2.5, pytest.approx(np.sqrt(5 / 12)), 3)
    assert stated.repeats(np.ones((3, 2))).u.shape == (2,)


@pytest.mark.parametrize("wrong, words", [
    (lambda: stated.rectangular(-1.0), "not negative"), (lambda: stated.resolution(np.nan), "finite"),
    (lambda: stated.from_expanded(1.0, 0.0), "coverage factor"), (lambda: stated.repeats([1.0]), "no scatter"),
    (lambda: stated.repeats([1.0, np.nan]), "not a finite"), (lambda: stated.of_mean(1.0, 0), "1 or more"),
    (lambda: stated.Lines({"a": 0.0}).shares(), "zero")])
def test_what_cannot_be_an_uncertainty_is_refused_in_words(wrong, words):
    with pytest.raises(InputError, match=words):
        wrong()


def test_lines_combine_in_squares_and_split_a_contribution_by_their_shares():
    lines = stated.Lines({"repeats": np.full(2, 3.0), "resolution": 4.0})
    assert lines.u == pytest.approx([5.0, 5.0])
    assert lines.shares() == pytest.approx({"repeats": 0.36, "resolution": 0.64})
    assert lines.split(10.0) == pytest.approx({"repeats": 6.0, "resolution": 8.0})


def compared(length, row):
    return length + 0 * row


def test_a_budget_lists_repeats_resolution_and_limits_line_by_line():
    lines = stated.Lines({"repeats": stated.of_mean(0.2, 4), "resolution": stated.resolution(0.1),
                          "limit": stated.rectangular(0.3)})
    length = Unknown("length", 0.0, "1")
    problem = simulate(Problem([Observations(compared, length, np.zeros(9), u=lines.u, group="comparisons")]), None, 5)
    plain = budget(linearise(solve(problem)), length)
    listed = stated.itemised(plain, {"comparisons": lines})
    assert {one.label: one.u for one in listed.contributions} == pytest.approx({
        # nine readings: each line of one reading over 3
        "comparisons: repeats": 0.1 / 3, "comparisons: resolution": 0.1 / np.sqrt(12) / 3,
        "comparisons: limit": 0.3 / np.sqrt(3) / 3})
    assert np.sqrt(sum(one.u**2 for one in listed.contributions)) == pytest.approx(plain.u, rel=1e-12)
    assert sum(one.share for one in listed.contributions) == pytest.approx(1.0)
    with pytest.raises(InputError, match="no line 'elsewhere'"):
        stated.itemised(plain, {"elsewhere": lines})
