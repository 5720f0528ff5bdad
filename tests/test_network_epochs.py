"""Two epochs of a network: the points that moved are found, and no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib import simulate
from calib.errors import InputError
from calib.units import arcsec, mm
from problems import network
from problems.network import Batch, Point, Survey
from problems.network.epochs import congruence
from problems.network.survey import CONSTRAINED, FIXED

MARKS = {str(i): (60.0 * np.cos(0.7 * i) + 20 * (i % 3), 50.0 * np.sin(0.7 * i) - 9 * (i % 2)) for i in range(9)}


def epoch(seed: int, moved: dict[str, tuple[float, float]], role: str = CONSTRAINED) -> Survey:
    """Directions and distances among nine marks, some of which moved [m]; readings simulated."""
    place = {k: np.array(p) + moved.get(k, (0.0, 0.0)) for k, p in MARKS.items()}
    points = {k: Point((*p, np.nan), role if k in "01" else CONSTRAINED) for k, p in place.items()}
    pairs = [(a, b) for a in MARKS for b in MARKS if a != b]
    station, target = (list(k) for k in zip(*pairs, strict=True))
    batches = [Batch("direction", station, target, None, np.full(len(pairs), 3 * arcsec), orientation=station,
                     group="directions"),
               Batch("distance", station, target, None, np.full(len(pairs), 1 * mm), group="distances")]
    survey = Survey(points, batches)
    drawn = simulate(network.declare(survey), None, seed)
    readings = {o.group: o.readings for o in drawn.observations}
    # Nobody knows of the movement: the positions of the survey are those of the marks as they were.
    known = {k: replace(points[k], position=(*p, np.nan)) for k, p in MARKS.items()}
    return replace(survey, points=known, batches=[replace(b, readings=readings[b.group]) for b in batches])


@pytest.mark.parametrize("role", [CONSTRAINED, FIXED])
def test_two_points_that_moved_are_found_with_their_shifts(role):
    moved = {"3": (4 * mm, 0.0), "7": (-2 * mm, 3 * mm)}
    found = congruence(epoch(1, {}, role), epoch(2, moved, role))
    assert set(found.moved) == set(moved)
    for key, shift in moved.items():
        i = found.points.index(key)
        assert np.all(np.abs(found.shift[i] - shift) < 4 * found.u[i])
        assert found.u[i].max() < 1.5 * mm
    assert any("Point '3' moved by x +" in sentence for sentence in found.sentences())


def test_nothing_is_found_where_nothing_moved():
    quantities = []
    for seed in range(12):
        found = congruence(epoch(100 + seed, {}), epoch(200 + seed, {}))
        quantities.append(found.steps[0].quantity)
        dof = found.steps[0].dof
    assert dof == 2 * len(MARKS) - 3
    # The mean of 12 chi-squared numbers of 15 degrees of freedom has a standard deviation of 1.6.
    assert abs(np.mean(quantities) - dof) < 4 * np.sqrt(2 * dof / 12)


def test_the_answer_does_not_depend_on_where_the_second_epoch_lies():
    first, second = epoch(1, {}), epoch(2, {"3": (4 * mm, 0.0)})
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    elsewhere = {k: (*(turn @ p.position[:2] + [500.0, -80.0]), np.nan) for k, p in second.points.items()}
    a, b = congruence(first, second), congruence(first, second.placed(elsewhere))
    assert a.moved == b.moved
    assert np.abs(a.shift - b.shift).max() < 1e-7


def test_epochs_of_another_datum_are_refused():
    with pytest.raises(InputError, match="leave 3 directions of the datum open"):
        congruence(epoch(1, {}), epoch(2, {}, FIXED))
