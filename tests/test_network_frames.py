"""Frames that move rigidly: what is free of them is found, what is held is exact, from any start; and what is wrong."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from command import runner

from calib import Estimate, Gaussian, Unknown, covariance, linearise, prior, reliability, simulate, solve
from calib.errors import InputError
from calib.units import arcsec, mm
from problems import network
from problems.network import Batch, Point, Survey, noise
from problems.network.frames import RigidFrame, checked_frames, moved, moved_back
from problems.network.survey import ADJUSTED, FIXED

STATIONS = {"A": (0.0, 0.0, 0.0), "B": (12.0, -1.0, 0.5), "C": (5.0, 9.0, 0.2)}
TURNS = (0.0, 0.9, 2.3, -2.0)
# What the frame is, in four epochs: numbers that are free, where it stands in each, and the frame around it.
MOTIONS = {
    "turns about z": (("rz",), [(4.0, 3.0, 1.0, 0.1, -0.2, turn) for turn in TURNS], None),
    "slides along x": (("x",), [(4.0 + turn, 3.0, 1.0, 0.1, -0.2, 0.7) for turn in TURNS], None),
    "lifts along z": (("z",), [(4.0, 3.0, 1.0 + turn, 0.1, -0.2, 0.7) for turn in TURNS], None),
    "moves freely": (("x", "y", "z", "rx", "ry", "rz"),
                     [(4.0 + turn, 3.0 - turn, 1.0, 0.5 * turn, -0.4 * turn, turn) for turn in TURNS], None),
    "turns about an unknown axis": (("rz",), [(0.0, 0.0, 0.0, 0.0, 0.0, turn) for turn in TURNS],
                                    RigidFrame("axis", ("x", "y", "rx", "ry"), (5.0, 4.0, 0.0, 0.3, -0.4, 0.0))),
    "slides along an unknown guide": (("x",), [(turn, 0.0, 0.0, 0.0, 0.0, 0.0) for turn in TURNS],
                                      RigidFrame("guide", ("ry", "rz"), (5.0, 4.0, 0.0, 0.0, -0.3, 0.6))),
}


def body(motion: str, seed: int) -> Survey:
    """Three stations that see five points of a body in four epochs, of which the first says where its points are."""
    free, places, around = MOTIONS[motion]
    generator = np.random.default_rng(seed)
    points = {key: Point(place, FIXED, FIXED) for key, place in STATIONS.items()}
    points |= {f"P{i}": Point(tuple(generator.uniform(-1.0, 1.0, 3)), ADJUSTED, ADJUSTED, "body") for i in range(5)}
    frames = [RigidFrame("body", free if k else (), place, str(k), around.name if around else "")
              for k, place in enumerate(places)] + ([around] if around else [])
    rows = [(a, f"P{i}", str(k)) for k in range(4) for a in STATIONS for i in range(5)]
    rows += [(a, b, "0") for a in STATIONS for b in STATIONS if a != b]
    station, target, epoch = (list(column) for column in zip(*rows, strict=True))
    n = len(rows)
    bare = Survey(points, [
        Batch("direction", station, target, None, noise.of_sights(np.full(n, 2 * arcsec), 0.02 * mm, 0.03 * mm),
              orientation=station, group="directions", epoch=epoch),
        Batch("slope distance", station, target, None, np.full(n, 0.1 * mm), group="lengths", epoch=epoch),
        Batch("zenith angle", station, target, None, np.full(n, 3 * arcsec), group="zeniths", epoch=epoch),
    ], frames=frames)
    drawn = {o.group: o.readings for o in simulate(network.declare(bare), None, seed).observations}
    return replace(bare, batches=[replace(batch, readings=drawn[batch.group]) for batch in bare.batches])


def nowhere(survey: Survey) -> Survey:
    """The survey without start values: of points, and of what is free of the frames."""
    frames = [replace(one, place=tuple(0.0 if part in one.free else value for part, value in
                                       zip(("x", "y", "z", "rx", "ry", "rz"), one.place, strict=True)))
              for one in survey.frames]
    lost = {key: replace(point, position=(np.nan,) * 3) if point.frame else point
            for key, point in survey.points.items()}
    return replace(survey, points=lost, frames=frames)


def solved(survey: Survey) -> Estimate:
    return solve(network.declare(network.started(network.checked(survey))))


def of(estimate: Estimate, name: str) -> Unknown:
    return next(unknown for unknown in estimate.problem.unknowns if unknown.name == name)


def check_recovered(motion: str, seed: int) -> Estimate:
    survey = body(motion, seed)
    estimate = solved(nowhere(survey))
    truth = np.array([one.place for one in survey.frames])
    frame = of(estimate, "frame")
    u = covariance(linearise(estimate), frame).u.reshape(truth.shape)
    apart = estimate[frame] - truth
    apart[:, 3:] = (apart[:, 3:] + np.pi) % (2.0 * np.pi) - np.pi
    if motion == "slides along an unknown guide":       # either sense of the guide is the same motion
        apart = apart[:, :0]
    assert np.all(np.abs(apart) <= 4.5 * u[:, : apart.shape[1]] + 1e-9)
    assert abs(estimate.objective - estimate.dof) < 4.5 * np.sqrt(2.0 * estimate.dof)
    assert reliability(linearise(estimate)).redundancy.sum() == pytest.approx(estimate.dof, abs=1e-6)
    return estimate


def test_a_turn_about_a_known_axis_is_found_from_the_readings_alone():
    check_recovered("turns about z", 1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
@pytest.mark.parametrize("motion", list(MOTIONS))
def test_what_is_free_of_a_frame_is_found_from_the_readings_alone(motion, seed):
    check_recovered(motion, seed)


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["turns about z", "slides along x"])
def test_a_held_number_is_the_same_as_a_free_one_that_is_known_very_well(motion):
    survey = body(motion, 4)
    held = solved(survey)
    every = ("x", "y", "z", "rx", "ry", "rz")
    free = replace(survey, frames=[replace(one, free=every) for one in survey.frames])
    loose = network.declare(network.started(network.checked(free)))
    frame = next(unknown for unknown in loose.unknowns if unknown.name == "frame")
    known = [prior(frame[i].part(*(p for p in every if p not in one.free)),
                   [value for part, value in zip(every, one.place, strict=True) if part not in one.free], 1e-9,
                   name=f"known {one.key}") for i, one in enumerate(survey.frames)]
    tight = solve(loose.with_observations(*known))
    a, b = (covariance(linearise(one), "position") for one in (held, tight))
    assert np.abs(a.values - b.values).max() < 1e-4 * a.u.min()
    assert np.abs(a.matrix - b.matrix).max() < 1e-5 * np.abs(a.matrix).max()
    assert tight.dof == held.dof
    assert tight.objective == pytest.approx(held.objective, rel=1e-6)


def only(survey: Survey, rows: np.ndarray) -> Survey:
    """The survey with some rows of its batches, all of which list the same sights."""
    return replace(survey, batches=[
        replace(batch, **{name: np.asarray(getattr(batch, name))[rows]
                          for name in ("station", "target", "readings", "epoch")},
                u=batch.u.kept(rows) if isinstance(batch.u, Gaussian) else np.asarray(batch.u)[rows],
                orientation=None if batch.orientation is None else np.asarray(batch.orientation)[rows])
        for batch in survey.batches])


def test_a_frame_that_stands_still_changes_nothing():
    survey = body("turns about z", 5)
    first = network.checked(only(survey, np.array(survey.batches[0].epoch) == "0"))
    whole = {key: replace(point, frame="", position=moved(point.position, survey.frames[0].place))
             if point.frame else point for key, point in survey.points.items()}
    inside, outside = (solve(network.declare(one)) for one in (first, replace(first, frames=(), points=whole)))
    assert inside.objective == pytest.approx(outside.objective, rel=1e-9)
    assert np.abs(inside["position"] - outside["point"][3:]).max() < 1e-9
    a, b = covariance(linearise(inside), "position"), covariance(linearise(outside), of(outside, "point"))
    assert np.abs(a.matrix - b.matrix[9:, 9:]).max() < 1e-7 * np.abs(a.matrix).max()


@pytest.mark.slow
def test_residuals_of_moving_frames_are_as_large_as_stated_over_many_draws():
    estimates = [solved(body("turns about an unknown axis", seed)) for seed in range(10, 30)]
    total = sum(one.dof for one in estimates)
    assert abs(sum(one.objective for one in estimates) - total) < 4.0 * np.sqrt(2.0 * total)


def test_turning_back_undoes_a_move():
    place = (1.0, -2.0, 3.0, 0.4, -0.7, 2.1)
    assert moved_back(moved((0.3, 0.5, -0.9), place), place) == pytest.approx((0.3, 0.5, -0.9), abs=1e-15)


@pytest.mark.parametrize(("frames", "words"), [
    ([RigidFrame("a"), RigidFrame("a")], "frame 'a' is described twice"),
    ([RigidFrame("a", ("roll",))], "'roll' cannot be free; write any of x, y, z, rx, ry, rz"),
    ([RigidFrame("a", parent="b")], "stands in 'b', which is not among the frames"),
    ([RigidFrame("a", parent="b"), RigidFrame("b", parent="a")], "stands in itself"),
    ([RigidFrame("a"), RigidFrame("a", epoch="2")], "described with epochs and without")])
def test_frames_that_make_no_sense_are_named(frames, words):
    with pytest.raises(InputError, match=words):
        checked_frames(frames, "xyz")


def test_a_frame_that_cannot_move_so_in_a_plane_network_is_named():
    with pytest.raises(InputError, match=r"'rx' is free, and this network has the coordinates x, y only"):
        checked_frames([RigidFrame("a", ("rx",))], "xy")


def test_a_reading_in_an_epoch_that_no_frame_has_is_named():
    survey = body("turns about z", 1)
    with pytest.raises(InputError, match=r"point 'P0': frame 'body' is not described for epoch '3'"):
        network.checked(replace(survey, frames=survey.frames[:-1]))


def test_an_epoch_with_fewer_readings_than_the_frame_has_free_numbers_is_named_and_can_be_left_out():
    survey = body("moves freely", 1)
    sights = zip(survey.batches[0].station, survey.batches[0].target, survey.batches[0].epoch, strict=True)
    weak = only(survey, np.array([e != "3" or (station, target) == ("A", "P0") for station, target, e in sights]))
    with pytest.raises(InputError, match=r"frame 'body@3' has 6 free numbers .* and 3 readings"):
        network.checked(weak)
    rest = network.reduced(weak)
    assert [one.key for one in rest.frames] == ["body@0", "body@1", "body@2"]
    assert "body@3" in rest.remarks[0]


@pytest.mark.slow
def test_a_plane_figure_that_turns_is_read_from_tables(tmp_path, capsys):
    generator = np.random.default_rng(3)
    stations = {"A": (0.0, 0.0), "B": (20.0, 1.0)}
    own = generator.uniform(-2.0, 2.0, (4, 2))
    points = [f"{key},fixed,{x},{y}," for key, (x, y) in stations.items()]
    points += [f"P{i},fixed,{x!r},{y!r},plate" for i, (x, y) in enumerate(own.tolist())]
    rows = []
    for epoch, turn in (("1", 0.3), ("2", -2.8)):
        for key, (x, y) in stations.items():
            for i, point in enumerate(own):
                place = moved((*point, 0.0), (9.0, 6.0, 0.0, 0.0, 0.0, turn))
                length = np.hypot(place[0] - x, place[1] - y) + generator.normal(0, 1e-4)
                rows.append(f"{key},P{i},{epoch},{length:.6f}")
    (tmp_path / "points.csv").write_text("point,role,x_m,y_m,frame\n" + "\n".join(points) + "\n")
    (tmp_path / "distances.csv").write_text("station,target,epoch,reading_m\n" + "\n".join(rows) + "\n")
    (tmp_path / "frames.csv").write_text("frame,epoch,x_m,y_m,free\nplate,1,9,6,rz\nplate,2,9,6,rz\n")
    (tmp_path / "job.toml").write_text('''problem = "network"
[data.points]
file = "points.csv"
[data.frames]
file = "frames.csv"
[data.distances]
file = "distances.csv"
instrument = "tape"
[instruments.tape]
u = "0.1 mm"
''')
    answer = runner(capsys)("solve", tmp_path / "job.toml", "--json")
    assert answer.status == 0, answer.error
    found = {one["instance"]: (one["value"], one["u"]) for one in json.loads(answer.out)["unknowns"]
             if one["name"] == "frame" and one["part"] == "rz"}
    for key, turn in (("plate@1", 0.3), ("plate@2", -2.8)):
        apart = (found[key][0] - np.degrees(turn) + 180.0) % 360.0 - 180.0
        assert abs(apart) < 4.5 * found[key][1]
