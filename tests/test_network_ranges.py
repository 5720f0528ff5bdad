"""Networks of ranges alone, with and without dead paths, from nothing but readings; inclinometers of trackers."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import runner
from test_network_stations import workshop

from calib import covariance, linearise, simulate, solve
from calib.errors import InputError
from calib.units import arcsec, um
from problems import network
from problems.network import Batch, Point, Ranging, Survey
from problems.network.stations import based
from problems.network.survey import ADJUSTED, FIXED
from problems.network.tilts import Tilts

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))
from network_ranges import KINDS, tried

FAST = ("5 stations, 12 points 60 m away", "5 interferometers, 12 targets")


@pytest.mark.parametrize("kind", FAST)
def test_ranges_place_everything_they_can(kind):
    assert tried(*KINDS[kind], seed=1)[0] == "right"


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(KINDS))
def test_nearly_every_random_layout_of_ranges_is_placed(kind):
    outcomes = [tried(*KINDS[kind], seed)[0] for seed in range(5)]
    assert outcomes.count("right") >= 4


@pytest.mark.slow
def test_interferometers_alone_are_read_from_a_table(tmp_path, capsys):
    generator = np.random.default_rng(6)
    bases, targets = generator.uniform(-3.0, 3.0, (6, 3)), generator.uniform(-1.0, 1.0, (14, 3))
    rows = [f"I{a},T{b},{0.4 * a - np.linalg.norm(bases[a] - targets[b]) + 1e-6 * generator.normal():.7f}"
            for a in range(6) for b in range(14)]
    (tmp_path / "ranges.csv").write_text("instrument,target,reading_m\n" + "\n".join(rows) + "\n")
    (tmp_path / "points.csv").write_text("point,role\n" + "".join(f"T{b},constrained\n" for b in range(14)))
    (tmp_path / "job.toml").write_text('''problem = "network"
[data.points]
file = "points.csv"
[data.ranges]
file = "ranges.csv"
instrument = "tracker"
[instruments.tracker]
u = "1 um"
counts = "shortening"
''')
    answer = runner(capsys)("solve", tmp_path / "job.toml")
    assert answer.status == 0, answer.error
    assert "agree with the model" in answer.out


def test_targets_in_one_plane_give_the_base_point_on_one_side_of_it():
    generator = np.random.default_rng(2)
    targets = np.column_stack([generator.uniform(-2.0, 2.0, (9, 2)), np.full(9, 0.7)])
    base, dead_path = np.array([1.0, -0.5, 3.1]), 0.25
    found = based(np.linalg.norm(targets - base, axis=1) - dead_path, targets)
    assert found[[0, 1, 3]] == pytest.approx([1.0, -0.5, 0.25], abs=1e-9)
    assert abs(found[2] - 0.7) == pytest.approx(2.4, abs=1e-9)


def test_targets_that_only_interferometers_read_are_placed_by_them():
    generator = np.random.default_rng(3)
    bases, places = generator.uniform(-3.0, 3.0, (5, 3)), generator.uniform(-2.0, 2.0, (9, 3))
    readings = np.linalg.norm(bases[:, None] - places, axis=2) - generator.uniform(-1.0, 1.0, (5, 1))
    readings += 1e-6 * generator.normal(size=readings.shape)
    points = {f"T{i}": Point(tuple(place), FIXED, FIXED) if i < 6 else Point(plane=ADJUSTED, height=ADJUSTED)
              for i, place in enumerate(places)}
    known = Batch("coordinates", ["T0"], [""], places[:1], np.full(3, 1 * um))
    survey = Survey(points, [known], ranging=[Ranging(np.repeat(list("ABCDE"), 9), np.tile(list(points), 5),
                                                      readings.ravel(), 1 * um)])
    estimate = solve(network.declare(network.started(network.checked(survey))))
    assert np.abs(estimate["point"] - places).max() < 50 * um
    assert estimate.objective < 3.0 * estimate.dof + 10.0


def with_tilts(seed: int) -> Survey:
    """The workshop of `test_network_stations` with an inclinometer on each tracker."""
    survey = workshop(seed)
    plan = replace(survey, tilts=[Tilts("station", ["A", "B", "C"], None, 1 * arcsec)])
    drawn = {o.group: np.array(o.readings) for o in simulate(network.declare(plan), None, seed).observations}
    return replace(plan, tilts=[replace(plan.tilts[0], readings=drawn["tilts"])],
                   batches=[replace(plan.batches[0], readings=drawn["bar"])],
                   sightings=[replace(plan.sightings[0], readings=drawn["tracker"])],
                   ranging=[replace(plan.ranging[0], readings=drawn["ranges"][:, 0])])


def test_inclinometers_say_what_is_vertical():
    survey = with_tilts(2)
    estimate, without = (solve(network.declare(one)) for one in (survey, replace(survey, tilts=())))
    assert estimate.dof == without.dof + 6 - 2
    assert abs(estimate.objective - estimate.dof) < 4.5 * np.sqrt(2.0 * estimate.dof)
    station = next(unknown for unknown in estimate.problem.unknowns if unknown.name == "station")
    u = covariance(linearise(estimate), station[0].part("rx", "ry")).u
    assert np.all(u < 1.01 * arcsec)
    assert np.all(u > 0.3 * arcsec)


def test_tilts_of_a_station_that_reads_nothing_are_named():
    survey = workshop(1)
    with pytest.raises(InputError, match="station 'Z' has tilts and no readings of a tracker"):
        network.declare(replace(survey, tilts=[Tilts("station", ["Z"], [[0.0, 0.0]], 1 * arcsec)]))
