"""Two epochs of a network: the points that moved are found, and no others."""

from __future__ import annotations

import json
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from command import runner
from scipy.special import chdtrc, fdtrc
from test_network_stations import workshop

from calib import simulate
from calib.analyse import congruence as shared
from calib.analyse.congruence import Shifts
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


def test_epochs_in_another_datum_give_the_same_answer():
    moved = {"3": (4 * mm, 0.0)}
    first, alike, other = epoch(1, {}), epoch(2, moved), epoch(2, moved, FIXED)
    a, b = congruence(first, alike), congruence(first, other)
    assert a.moved == b.moved == ("3",)
    # The fixed points too are compared, which only one epoch fixes.
    assert a.points == b.points
    assert np.abs(a.shift - b.shift).max() < 1e-7
    assert a.u == pytest.approx(b.u, rel=1e-5)


def test_points_of_one_epoch_only_are_left_out_and_the_others_compared():
    first, second = epoch(1, {}), epoch(2, {"3": (4 * mm, 0.0)})
    keys = {key: "new" if key == "6" else key for key in MARKS}
    renamed = replace(
        second, points={keys[k]: p for k, p in second.points.items()},
        batches=[replace(b, station=[keys[k] for k in b.station], target=[keys[k] for k in b.target],
                         orientation=None if b.orientation is None else [keys[k] for k in b.orientation])
                 for b in second.batches])
    found = congruence(first, renamed)
    assert found.moved == ("3",)
    assert "6" not in found.points
    assert "new" not in found.points


def test_known_shifts_are_tested_by_their_closed_form():
    # Heights of four points in one levelling each: differences are independent with u = 1 mm, the datum is one height.
    shift = np.array([0.0, 0.0, 0.0, 4.0]) * mm
    known = Shifts("ABCD", "zzzz", shift, np.eye(4) * mm**2, np.full((4, 1), 0.5))
    found = shared.congruence(known, level=0.05)
    assert found.steps[0].dof == 3
    assert found.steps[0].quantity == pytest.approx(np.sum((shift - shift.mean()) ** 2) / mm**2)
    assert found.moved == ("D",)
    assert found.shift[3, 0] == pytest.approx(4 * mm)
    assert found.u[3, 0] == pytest.approx(np.sqrt(1 + 1 / 3) * mm)
    assert found.p_value[3] == pytest.approx(chdtrc(1, 16 / (4 / 3)))
    assert found.adjusted[3] == pytest.approx(4 * found.p_value[3])
    # A single height: found with 0.8 where it moves by so many u that |N(d, 1)| exceeds the quantile of 0.05 / 4.
    far = found.detectable[3] / found.u[3, 0]
    limit = NormalDist().inv_cdf(1 - 0.05 / 8)
    assert NormalDist().cdf(far - limit) + NormalDist().cdf(-far - limit) == pytest.approx(0.8, abs=1e-6)
    scaled = shared.congruence(replace(known, scatter=(4.0, 10)), level=0.05)
    assert scaled.steps[0].quantity == pytest.approx(found.steps[0].quantity / 4)
    assert scaled.steps[0].p_value == pytest.approx(fdtrc(3, 10, found.steps[0].quantity / 12))


def test_where_no_part_keeps_its_figure_that_is_said():
    wild = Shifts("ABC", "zzz", np.array([0.0, 50.0, 120.0]) * mm, np.eye(3) * mm**2, np.full((3, 1), 3**-0.5))
    found = shared.congruence(wild)
    assert not found.settled
    assert "which moved cannot be told" in found.sentences()[0]


def test_a_part_that_moved_as_a_block_is_said_to_be_one():
    shift = np.array([0.0, 0.1, -0.1, 9.0, 9.1]) * mm
    found = shared.congruence(Shifts("ABCDE", "zzzzz", shift, np.eye(5) * mm**2, np.full((5, 1), 5**-0.5)))
    assert found.moved == ("D", "E")
    assert found.block
    assert "moved as a block" in found.sentences()[-1]


@pytest.mark.slow
def test_false_alarms_come_at_their_level_and_movements_are_found_as_often_as_promised():
    seeds, level = 60, 0.05
    alarms = sum(bool(congruence(epoch(3000 + s, {}), epoch(5000 + s, {}), level).moved) for s in range(seeds))
    # Of 60 at 5 %: 3, and 9 or more with a probability of 0.003.
    assert alarms < 9
    # A movement of the detectable size in one coordinate is found with 0.8 or more, since it is stated for the worst.
    far = float(congruence(epoch(1, {}), epoch(2, {}), level).detectable[3])
    found = sum("3" in congruence(epoch(3000 + s, {}), epoch(5000 + s, {"3": (far, 0.0)}), level).moved
                for s in range(30))
    assert found >= 18     # of 30 with 0.8: 24, and fewer than 18 with a probability of 0.003


@pytest.mark.slow
def test_targets_of_trackers_are_compared_whatever_frame_the_trackers_had():
    plan = workshop(seed=1)

    def measured(seed: int, moved: dict[str, list[float]]) -> Survey:
        points = {k: replace(p, position=tuple(np.add(p.position, moved.get(k, 0.0)))) for k, p in plan.points.items()}
        drawn = simulate(network.declare(replace(plan, points=points)), None, seed)
        readings = {o.group: np.array(o.readings) for o in drawn.observations}
        return replace(plan, batches=[replace(plan.batches[0], readings=readings["bar"])],
                       sightings=[replace(plan.sightings[0], readings=readings["tracker"])],
                       ranging=[replace(plan.ranging[0], readings=readings["ranges"][:, 0])])

    found = congruence(measured(5, {}), measured(6, {"T3": [0.1 * mm, 0.0, 0.0]}))
    assert found.steps[0].dof == 3 * 14 - 6
    assert found.moved == ("T3",)
    assert abs(found.shift[3, 0] - 0.1 * mm) < 4 * found.u[3, 0]


@pytest.mark.slow
def test_a_job_with_a_column_of_epochs_is_compared_within_itself(tmp_path, capsys):
    calib = runner(capsys)
    for name, values in (("all", "ab"), ("one", "a")):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "job.toml").write_text('problem = "problems.network"\n[data.height_differences]\nfile = "dh.csv"\n')
        rows = [f"{s},{t},{h + (5e-3 if (e, t) == ('b', 'D') else 0.0):.4f},1,{e}" for e in values
                for s, t, h in (("A", "B", 1.0), ("B", "C", 0.5), ("C", "D", 0.2), ("A", "C", 1.5), ("B", "D", 0.7))]
        (folder / "dh.csv").write_text("\n".join(["station,target,reading_m,u_mm,epoch", *rows]) + "\n")
    answer = calib("epochs", tmp_path / "all" / "job.toml", "--json")
    assert answer.status == 0, answer.error
    (one,) = json.loads(answer.out)["comparisons"]
    assert (one["first"], one["second"], one["moved"]) == ("a", "b", ["D"])
    assert one["points"][3]["dz_mm"] == pytest.approx(5.0, abs=1e-6)
    both = calib("epochs", tmp_path / "all" / "job.toml", tmp_path / "one" / "job.toml")
    assert (both.status, "holds several epochs" in both.error) == (2, True)


@pytest.mark.slow
def test_the_command_writes_which_points_moved(tmp_path, capsys):
    for number, moved in enumerate(({}, {"3": (4 * mm, 0.0)})):
        survey = epoch(number + 1, moved)
        lines = [f'<point id="{k}" x="{p.position[0]:.4f}" y="{p.position[1]:.4f}" adj="XY"/>'
                 for k, p in survey.points.items()]
        (_, distances) = survey.batches
        lines += [f'<obs><distance from="{a}" to="{b}" val="{v:.7f}" stdev="1"/></obs>' for a, b, v in
                  zip(distances.station, distances.target, distances.values[:, 0], strict=True)]
        (tmp_path / f"epoch{number}.gkf").write_text(
            '<gama-local><network><parameters sigma-apr="1"/><points-observations>' + "".join(lines)
            + "</points-observations></network></gama-local>")
    answer = runner(capsys)("epochs", tmp_path / "epoch0.gkf", tmp_path / "epoch1.gkf", "--out", tmp_path / "out")
    assert answer.status == 0, answer.error
    assert "Point '3' moved by x +" in answer.out
    written = json.loads((tmp_path / "out" / "epochs.json").read_text())["comparisons"][0]
    assert written["moved"] == ["3"]
    assert written["global_test"]["dof"] == 2 * len(MARKS) - 3
    assert len((tmp_path / "out" / "shifts.csv").read_text().splitlines()) == 1 + len(MARKS)
    assert "<svg" in (tmp_path / "out" / "report.html").read_text()
    assert "one epoch alone" in runner(capsys)("epochs", tmp_path / "epoch0.gkf").error
