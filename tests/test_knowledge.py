"""Prior knowledge of a job: single values and earlier results, of unknowns and of derived quantities."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib import Observations, Problem, Quantity, Unknown, covariance, files, linearise, solve
from calib.errors import InputError
from calib.job import PriorKnowledge
from calib.units import arcsec, mm, um
from calib.workflow.knowledge import named, with_priors


def twice(a, b):
    return 2.0 * a + b


def both(a, b):
    return [a, b]


@pytest.fixture
def problem():
    """Two lengths, each read once with u = 1 um, and their combination 2 a + b as a derived quantity."""
    a, b = Unknown("a", 1 * mm, unit="um"), Unknown("b", 2 * mm, unit="mm")
    readings = Observations(both, a, b, readings=[[1 * mm, 2 * mm]], u=1 * um, unit="um", components=("a", "b"))
    return Problem([readings], quantities=[Quantity("combination", twice, a, b, unit="um")], name="two lengths")


def knowledge(name, value, u, unit="um"):
    return PriorKnowledge(name, value, u, unit, None, "job.toml, line 1, key 'priors.1'")


def variance(problem, *what):
    return covariance(linearise(solve(problem)), *what).matrix


def test_a_prior_of_an_unknown_adds_its_weight(problem):
    with_prior = with_priors(problem, [knowledge("a", 1.003 * mm, 0.5 * um)])
    # Weights 1 and 1/0.25 = 4: the mean of 1.000 and 1.003 is 1.0024, its variance 1/5 um^2.
    assert solve(with_prior)["a"] == pytest.approx(1.0024 * mm, rel=1e-12)
    assert variance(with_prior, "a")[0, 0] == pytest.approx(0.2 * um**2, rel=1e-9)


def test_a_prior_of_a_derived_quantity_adds_its_weight(problem):
    with_prior = with_priors(problem, [knowledge("combination", 4.005 * mm, 1 * um)])
    # u(2a + b)^2 = 5 um^2 before; 1/(1/5 + 1/1) = 5/6 um^2 after; the value moves by 5 um * (5/6).
    assert variance(with_prior, "combination")[0, 0] == pytest.approx(5 / 6 * um**2, rel=1e-9)
    moved = covariance(linearise(solve(with_prior)), "combination").values[0] - 4 * mm
    assert moved == pytest.approx(5 * um * 5 / 6, rel=1e-9)


def test_an_earlier_result_comes_with_its_correlations(problem, tmp_path):
    matrix = [[4.0, -3.0e-3], [-3.0e-3, 9.0e-6]]
    files.write_json(tmp_path / "result.json", {
        "unknowns": [{"name": "a", "instance": None, "part": None, "value": 1000.0, "unit": "um"},
                     {"name": "b", "instance": None, "part": None, "value": 2.0, "unit": "mm"}],
        "derived": [], "covariance": {"names": ["a", "b"], "matrix": matrix}})
    earlier = PriorKnowledge(None, 0.0, 0.0, "", tmp_path / "result.json", "job.toml")
    before = np.array([[4.0, -3.0], [-3.0, 9.0]]) * um**2
    expected = np.linalg.inv(np.linalg.inv(before) + np.eye(2) / um**2)
    assert variance(with_priors(problem, [earlier]), "a", "b") == pytest.approx(expected, rel=1e-9)


def test_a_name_that_is_not_there_is_refused_with_its_neighbour(problem):
    with pytest.raises(InputError, match="'combinatoin' is not in two lengths; did you mean 'combination'"):
        named(problem, "combinatoin", "job.toml")


def test_a_prior_of_another_dimension_is_refused(problem):
    with pytest.raises(InputError, match="u is of angle, where 'a' is of length"):
        with_priors(problem, [knowledge("a", 0.0, 1 * arcsec, "arcsec")])


@pytest.mark.parametrize("text, words", [("[]", "no result.json"), ("{", "is not JSON"),
                                         ('{"unknowns": []}', "no result.json")])
def test_an_earlier_result_that_is_none_is_refused(problem, tmp_path, text, words):
    path = Path(tmp_path / "result.json")
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        with_priors(problem, [PriorKnowledge(None, 0.0, 0.0, "", path, "job.toml")])


def test_an_earlier_result_without_the_quantity_is_refused(problem, tmp_path):
    files.write_json(tmp_path / "result.json", {
        "unknowns": [{"name": "c", "instance": None, "part": None, "value": 1.0, "unit": "um"}], "derived": [],
        "covariance": {"names": ["c"], "matrix": [[1.0]]}})
    with pytest.raises(InputError, match="holds no 'a'; it holds c"):
        with_priors(problem, [PriorKnowledge("a", 0.0, 0.0, "", tmp_path / "result.json", "job.toml")])
