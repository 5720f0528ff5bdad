"""Geometry in the report: what follows from the unknowns, how it is drawn, what a problem may say itself."""

from __future__ import annotations

import re

import numpy as np
import pytest

from calib import Direction, Effect, Observations, Parameter, Problem, Unknown, direct, linearise, predict, solve
from calib.analyse.shapes import scene
from calib.errors import DeclarationError
from calib.report.space import space
from calib.scene import Axes, Points, Scene, Sights, Track

STATIONS = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 1.0], [0.0, 8.0, 0.5], [9.0, 9.0, 4.0]])


def measured():
    """Distances from four known stations to two points."""
    place = Unknown("place", [[3.0, 3.0, 2.0], [6.0, 4.0, 3.0]], "mm", parts=("x", "y", "z"), keys=("P", "Q"))
    station = Unknown("station", STATIONS, "mm", parts=("x", "y", "z"), keys=tuple("ABCD"))
    first, second = np.repeat(np.arange(4), 2), np.tile(np.arange(2), 4)

    def distance(a, b):
        return sum((a[i] - b[i]) ** 2 for i in range(3)) ** 0.5

    group = Observations(distance, station[first], place[second], u=1e-4, group="tape", unit="mm",
                         covariates={"from": np.array(list("ABCD"))[first], "to": np.array(list("PQ"))[second]})
    problem = Problem([group]).hold(station)
    return problem.with_readings(predict(problem))


def test_points_with_their_covariance_and_lines_of_sight_follow_from_the_declaration():
    estimate = solve(measured())
    shapes = scene(linearise(estimate)).shapes
    points = {one.name: one for one in shapes if isinstance(one, Points)}
    (sights,) = [one for one in shapes if isinstance(one, Sights)]
    assert points["station"].covariance.any() == False  # noqa: E712 - held points are exact
    assert points["place"].keys == ("P", "Q")
    from calib import covariance

    place = estimate.problem.select("place").unknown
    expected = covariance(linearise(estimate), place[1]).matrix
    assert np.array_equal(points["place"].covariance[1], expected)
    assert len(sights.ends) == 8


def test_parameters_of_an_effect_are_no_points():
    shift = Effect("centring", "offset", lambda value, p: p.x + p.y,
                   (Parameter("x", "mm", (1e-4, 1e-2)), Parameter("y", "mm", (1e-4, 1e-2))))
    place = Unknown("place", [1.0, 2.0], "mm", parts=("x", "y"))

    def seen(p, *, offset=direct):
        return [offset(p[0]), p[1]]

    problem = Problem([Observations(seen, place, readings=[[1.0, 2.0]], u=1e-3)], effects=[shift])
    assert [one.name for one in scene(linearise(solve(problem))).shapes] == ["place"]


def test_a_direction_is_drawn_through_the_point_it_belongs_to():
    centre = Unknown("centre", [1.0, 2.0, 3.0], "mm", parts=("x", "y", "z"))
    axis = Direction("axis", [0.0, 0.0, 1.0])
    seen = Observations(lambda c, a: [c[0], c[1], c[2], a[0], a[1]], centre, axis, u=1e-3, unit=["mm"] * 3 + ["1"] * 2,
                        readings=np.array([[1.0, 2.0, 3.0, 0.0, 0.0]]))
    (axes,) = [one for one in scene(linearise(solve(Problem([seen])))).shapes if isinstance(one, Axes)]
    assert np.allclose(axes.directions, [[0, 0, 1]])
    assert np.allclose(axes.through, [[1, 2, 3]])


def test_ellipsoids_are_enlarged_by_a_round_number_that_the_caption_names():
    points = Points("P", [[0, 0, 0], [1, 1, 1]], ("a", "b"), np.eye(3) * np.array([[[1e-6]], [[4e-6]]]))
    drawn = space(Scene((points,)))
    assert "drawn 50 times as large" in drawn.caption
    rings = [one for one in drawn.items if one.style.startswith("ellipsoid")]
    assert len(rings) == 6
    half = np.ptp(rings[0].places, axis=0).max() / 2
    assert half == pytest.approx(50 * 1e-3 / np.sqrt(0.75), rel=1e-9)


def test_the_still_drawing_lies_within_its_box():
    generator = np.random.default_rng(3)
    points = Points("P", generator.normal(size=(30, 3)) * [100, 3, 1])
    drawn = space(Scene((points, Track("t", points.places, closed=True), Sights("s", [0, 0, 0], points.places))))
    numbers = np.array([[float(v) for v in re.findall(r"-?[0-9.]+", one.still)[:2]] for one in drawn.items])
    assert np.all(np.abs(numbers) <= [360, 240])


def test_a_left_handed_frame_is_not_drawn_as_its_mirror_image():
    # x north, y east, z up: seen from above east lies on the right of north.
    east, north = [0.0, 100.0, 0.0], [100.0, 0.0, 0.0]
    drawn = space(Scene((Points("P", [[0, 0, 0], east, north], ("O", "E", "N")),), left_handed=True))
    marks = {one.label: re.findall(r"-?[0-9.]+", one.still) for one in drawn.items}
    x, y = ({key: float(value[i]) for key, value in marks.items()} for i in (0, 1))
    assert x["E"] > x["O"]
    assert y["N"] < y["O"]
    assert [name for name, *_ in drawn.corner] == ["y", "x", "z"]


@pytest.mark.parametrize("shapes", [(), (Points("P", np.zeros((0, 3))),), (Points("P", [[1, 2, 3]]),)])
def test_what_spans_no_space_is_not_drawn(shapes):
    assert space(Scene(shapes)) is None


def test_a_scene_refuses_what_cannot_be_drawn():
    with pytest.raises(DeclarationError, match="no numbers"):
        Points("P", [[0, np.nan, 0]])
    with pytest.raises(DeclarationError, match="2 names for 1"):
        Points("P", [[0, 0, 0]], ("a", "b"))
    with pytest.raises(DeclarationError, match="direction"):
        Axes("A", [[0, 0, 0]], [[0, 0, 0]])
