"""Laser trackers with six degrees of freedom, interferometers and scale bars in one network."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from command import runner

from calib import Quantity, covariance, linearise, reliability, simulate, solve
from calib.errors import InputError
from calib.geometry import norm
from calib.units import arcsec, um
from problems import network
from problems.network.stations import Ranging, Sightings, laid
from problems.network.survey import ADJUSTED, CONSTRAINED, Batch, Point, Survey

U = np.array([8 * um, 2 * arcsec, 2 * arcsec])


def workshop(seed: int, role: str = ADJUSTED) -> Survey:
    """Three trackers turned anyhow, fourteen targets, one interferometer, one scale bar; readings simulated."""
    generator = np.random.default_rng(seed)
    targets = {f"T{i}": generator.uniform([-4, -4, -1], [4, 4, 2]) for i in range(14)}
    points = {key: Point(tuple(place), role, role) for key, place in targets.items()}
    stations, seen = np.repeat(["A", "B", "C"], 14), np.tile(list(targets), 3)
    survey = Survey(
        points,
        [Batch("slope distance", ["T0"], ["T1"], None, [3 * um], group="bar")],
        sightings=[Sightings(stations, seen, None, U)],
        ranging=[Ranging(["I"] * 14, list(targets), None, 1 * um, counts=-1.0)],
    )
    turns = [np.linalg.qr(generator.normal(size=(3, 3)))[0] for _ in range(3)]
    turns = [t * np.linalg.det(t) for t in turns]
    positions = {key: np.array(place) for key, place in targets.items()}
    plan = replace(survey, ranging=[replace(survey.ranging[0], readings=np.linalg.norm(
        np.array(list(targets.values())) - [6.0, 1.0, 0.5], axis=1) * -1 + 2.0)])
    own = [np.array([t @ (p - [5 * i - 5, 6, 1]) for p in positions.values()]) for i, t in enumerate(turns)]
    from instruments import laser_tracker

    rough = np.concatenate([laser_tracker.polar_readings(one) for one in own])
    plan = replace(plan, sightings=[replace(survey.sightings[0], readings=rough)])
    drawn = simulate(network.declare(plan), None, seed)
    readings = {o.group: np.array(o.readings) for o in drawn.observations}
    return replace(
        plan,
        batches=[replace(plan.batches[0], readings=readings["bar"])],
        sightings=[replace(plan.sightings[0], readings=readings["tracker"])],
        ranging=[replace(plan.ranging[0], readings=readings["ranges"][:, 0])],
    )


@pytest.fixture(scope="module")
def survey() -> Survey:
    return workshop(seed=1)


def nowhere(survey: Survey) -> Survey:
    return replace(survey, points={k: replace(p, position=(np.nan,) * 3) for k, p in survey.points.items()})


def distances(problem):
    point = next(u for u in problem.unknowns if u.name == "point")
    i, j = np.triu_indices(point.count, 1)
    return problem.with_quantities(Quantity("side", lambda a, b: norm(b - a), point[i], point[j], unit="mm"))


def test_a_network_of_trackers_starts_from_its_readings_alone(survey):
    a = solve(distances(network.declare(survey)))
    b = solve(distances(network.declare(network.started(network.checked(nowhere(survey))))))
    assert b.converged
    assert b.certificate.passed
    assert b.objective == pytest.approx(a.objective, rel=1e-7)
    assert np.abs(a["side"] - b["side"]).max() < 1e-9


def test_distances_do_not_depend_on_the_datum(survey):
    first = linearise(solve(distances(network.declare(survey))))
    free = {k: Point(p.position, CONSTRAINED, CONSTRAINED) for k, p in survey.points.items()}
    inner = linearise(solve(distances(network.declare(network.settle(replace(survey, points=free))))))
    a, b = covariance(first, "side"), covariance(inner, "side")
    assert np.abs(a.values - b.values).max() < 1e-9
    assert np.abs(a.matrix - b.matrix).max() < 1e-6 * np.abs(a.matrix).max()
    assert first.dof == inner.dof


def test_residuals_are_as_large_as_stated_over_many_draws():
    ratios = []
    for seed in range(2, 8):
        estimate = solve(network.declare(workshop(seed)))
        assert estimate.dof == 1 + 42 * 3 + 14 - (14 * 3 + 2 * 6 + 4)
        ratios.append(estimate.objective)
    total = 6 * estimate.dof
    assert abs(sum(ratios) - total) < 4 * np.sqrt(2 * total)


def test_the_interferometer_shrinks_the_uncertainty_of_the_points(survey):
    def largest(one: Survey) -> float:
        fit = linearise(solve(distances(network.declare(one))))
        return float(covariance(fit, "side").u.mean())

    assert largest(survey) < 0.9 * largest(replace(survey, ranging=()))


def test_a_levelled_station_has_four_degrees_of_freedom():
    survey = workshop(seed=1)
    level = replace(survey, sightings=[replace(survey.sightings[0], levelled=True)])
    problem = network.declare(level)
    station = next(u for u in problem.unknowns if u.name == "station")
    assert problem.is_held(station).sum() == 6 + 2 * 2


def test_a_station_with_two_targets_is_named(survey):
    few = Sightings(["D", "D"], ["T0", "T1"], np.array([[3.0, 0.1, 1.5], [3.5, 0.4, 1.6]]), U, group="second")
    with pytest.raises(InputError, match=r"station 'D' sees 2 target\(s\)"):
        network.declare(replace(survey, sightings=[*survey.sightings, few]))


def test_an_interferometer_with_targets_in_one_plane_is_named(survey):
    few = Ranging(["J"] * 4, ["T0", "T1", "T2", "T3"], np.arange(4.0), 1 * um, group="second")
    with pytest.raises(InputError, match="interferometer 'J': its targets lie in one plane"):
        network.declare(replace(survey, ranging=[*survey.ranging, few]))


def test_points_laid_onto_points_give_the_turn_and_shift_that_moved_them():
    generator = np.random.default_rng(4)
    world = generator.normal(size=(6, 3))
    turn = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    rotation, shift = laid(world @ turn.T + [1.0, 2.0, 3.0], world)
    assert np.abs(rotation - turn).max() < 1e-12
    assert np.abs(shift - [1.0, 2.0, 3.0]).max() < 1e-12


def test_redundancies_of_every_instrument_add_up(survey):
    fit = linearise(solve(network.declare(survey)))
    assert reliability(fit).redundancy.sum() == pytest.approx(fit.dof, abs=1e-7)


@pytest.mark.slow
def test_trackers_and_ranges_are_read_from_tables(survey, tmp_path, capsys):
    sight, ranges, bar = survey.sightings[0], survey.ranging[0], survey.batches[0]
    rows = [f"{s},{t},{r[0]:.9f},{r[1]:.12f},{r[2]:.12f}"
            for s, t, r in zip(sight.station, sight.target, sight.readings, strict=True)]
    (tmp_path / "tracker.csv").write_text("station,target,range_m,azimuth_rad,zenith_rad\n" + "\n".join(rows) + "\n")
    rows = [f"{i},{t},{r:.9f}" for i, t, r in zip(ranges.instrument, ranges.target, ranges.readings, strict=True)]
    (tmp_path / "ranges.csv").write_text("instrument,target,reading_m\n" + "\n".join(rows) + "\n")
    (tmp_path / "bar.csv").write_text(f"station,target,reading_m\nT0,T1,{bar.values[0, 0]:.9f}\n")
    (tmp_path / "job.toml").write_text('''problem = "problems.network"
[data.tracker]
file = "tracker.csv"
instrument = "tracker"
[data.ranges]
file = "ranges.csv"
instrument = "interferometer"
[data.slope_distances]
file = "bar.csv"
instrument = "bar"
[instruments.tracker]
u_range = "8 um"
u_angle = "2 arcsec"
[instruments.interferometer]
u = "1 um"
counts = "shortening"
[instruments.bar]
u = "3 um"
''')
    answer = runner(capsys)("solve", tmp_path / "job.toml", "--out", tmp_path / "out")
    assert answer.error == ""
    assert answer.status == 0
