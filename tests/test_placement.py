"""The best places, continuously: targets, stations and settings as the unknowns of one declared problem."""

from __future__ import annotations

import numpy as np
import pytest
from casadi import vertcat
from test_selection import curve

import calib
from calib import A, Observations, Problem, Quantity, Unknown
from calib.errors import InputError, RankDefect
from calib.solve.placement import as_settings, best_places, declare
from calib.units import mm
from problems import base_point_layout

BEGIN = np.array([[1.0, 0.1], [0.2, 1.0], [-0.7, -0.3], [0.5, 0.5]])


@pytest.mark.parametrize("count, zero", [(3, base_point_layout.KNOWN),
                                         pytest.param(4, base_point_layout.FREE, marks=pytest.mark.slow)])
def test_targets_of_a_base_point_are_placed_where_the_bound_says(count, zero):
    plan = base_point_layout.planar(BEGIN[:count], (0.0, 0.0), zero)
    problem, (target,) = as_settings(plan, "tracker", {"guide": ((-1, -1, 0), (1, 1, 0))})
    found = best_places(problem, [target], "base_point.x", "base_point.y", starts=2, seed=1)
    assert found.value == pytest.approx(base_point_layout.bound(count), rel=1e-6) and found.begin > 1.1 * found.value
    there = calib.linearise(problem, {target: found.places[target]})
    assert np.linalg.norm(calib.covariance(there, "base_point.x", "base_point.y").u) == pytest.approx(found.value,
                                                                                                       rel=1e-9)


@pytest.mark.slow
def test_settings_of_a_cubic_are_placed_no_worse_than_chosen_from_a_fine_grid_and_no_better_than_its_bound():
    grid, _ = curve(np.linspace(-1, 1, 101))
    chosen = calib.select(calib.linearise(grid), 6, A("c.a"))
    plan, _ = curve(np.linspace(-0.8, 0.9, 6))
    problem, (x,) = as_settings(plan, "curve", {"x": (-1.0, 1.0)}, "1")
    found = best_places(problem, [x], "c.a", starts=2, seed=2)
    best = np.sqrt(chosen.value) * mm
    assert found.value <= best * (1 + 1e-6)
    # Between two places of the grid a cubic changes by little.
    assert found.value >= np.sqrt(chosen.bound) * mm * (1 - 1e-3)
    assert np.all(np.abs(found.places[x]) <= 1 + 1e-9)


def distance(point, station):
    return ((point[0] - station[0]) ** 2 + (point[1] - station[1]) ** 2) ** 0.5


def test_a_third_station_is_placed_across_the_two_that_see_a_point_in_one_line():
    point = Unknown("point", [0.0, 0.0], "mm", parts=("x", "y"))
    stations = Observations(distance, point, np.array([[5.0, 0.0], [-5.0, 0.4]]), u=1e-3, group="stations", unit="mm")
    station = Unknown("station", [4.0, 2.0], "m", parts=("x", "y"), lower=-6.0, upper=6.0)
    third = Observations(distance, point, station, u=1e-3, group="third", unit="mm")
    plan = Problem([stations, third], held=[station], name="three stations")
    found = best_places(plan, [station], point, starts=2, seed=3)
    x, y = found.places[station][0]
    across = np.array([0.4, 10.0]) / np.hypot(0.4, 10.0)      # to the line of the other two
    assert abs(np.array([x, y]) @ across) / np.hypot(x, y) > 0.999


def on_circle(centre, radius, angle):
    from casadi import cos, sin

    return vertcat(centre[0] + radius * cos(angle), centre[1] + radius * sin(angle))


def test_angles_of_a_turntable_are_spread_as_evenly_as_their_range_allows():
    centre, radius = Unknown("centre", [0.0, 0.0], "mm", parts=("x", "y")), Unknown("radius", 0.3, "mm")
    angle = np.radians([5.0, 15.0, 25.0, 50.0])
    plan = Problem([Observations(on_circle, centre, radius, angle, u=1e-5, group="target", unit="mm")], name="arc")
    problem, (placed,) = as_settings(plan, "target", {"angle": (0.0, np.pi / 2)}, "deg")
    found = best_places(problem, [placed], centre, starts=2, seed=4)
    ends = np.degrees(np.sort(found.places[placed].ravel()))
    np.testing.assert_allclose(ends, [0, 0, 90, 90], atol=0.01)      # the two ends of the arc, two readings each


def test_what_cannot_be_placed_is_refused():
    plan, unknown = curve(np.linspace(-1, 1, 6))
    with pytest.raises(InputError, match="no known argument 'z'; there are x"):
        as_settings(plan, "curve", {"z": (-1.0, 1.0)})
    with pytest.raises(InputError, match="no group 'kurve'; there are curve"):
        as_settings(plan, "kurve", {"x": (-1.0, 1.0)})
    problem, (x,) = as_settings(plan, "curve", {"x": (-1.0, 1.0)}, "1")
    with pytest.raises(InputError, match="'c' is not held"):
        declare(problem, [unknown], "middle")
    with pytest.raises(RankDefect, match="begin elsewhere"):
        declare(problem, [x], "middle", start={x: np.full((6, 1), 0.3)})
    with pytest.raises(InputError, match="is a function of 'x'"):
        declare(problem.with_quantities(Quantity("twice", lambda c, x: c[0] * x, unknown, x[0])), [x], "middle")
    with pytest.raises(InputError, match="at least one"):
        declare(problem, [], "middle")
