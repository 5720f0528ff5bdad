"""Survey networks declared from Python and from tables: datum, start values, noise, correlated clusters, effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from command import runner

from calib import Estimate, Problem, Quantity, Unknown, covariance, linearise, prior, reliability, simulate, solve
from calib.geometry import norm
from calib.job import Job
from calib.units import arcsec, mm
from problems import network
from problems.network import Batch, Correlated, Point, Survey, noise
from problems.network.example import survey as example_survey
from problems.network.survey import ADJUSTED, CONSTRAINED, FIXED

CORNERS = {"A": (0.0, 0.0), "B": (100.0, 5.0), "C": (110.0, 90.0), "D": (-5.0, 80.0), "E": (45.0, 50.0)}
PAIRS = [(a, b) for i, a in enumerate(CORNERS) for b in list(CORNERS)[i + 1 :]]


def plane(roles: dict[str, str], default: str = ADJUSTED, batches: list[Batch] | None = None) -> Survey:
    points = {k: Point((x, y, np.nan), roles.get(k, default)) for k, (x, y) in CORNERS.items()}
    station, target = (list(keys) for keys in zip(*PAIRS, strict=True))
    lengths = Batch("distance", station, target, None, np.full(len(PAIRS), 2 * mm), group="distances")
    sights = [(a, b) for a in CORNERS for b in CORNERS if a != b]
    station, target = (list(keys) for keys in zip(*sights, strict=True))
    directions = Batch("direction", station, target, None, np.full(len(sights), 4 * arcsec), orientation=station,
                       group="directions", unit="gon")
    return Survey(points, batches or [lengths, directions])


def point_of(problem: Problem) -> Unknown:
    return next(u for u in problem.unknowns if u.name == "point")


def with_readings_of(survey: Survey, problem: Problem) -> Survey:
    readings = {o.group: o.readings for o in problem.observations}
    return replace(survey, batches=[replace(b, readings=readings[b.group]) for b in survey.batches])


def sides(problem: Problem) -> Problem:
    point = point_of(problem)
    i, j = np.array([[point.keys.index(k) for k in pair] for pair in PAIRS]).T
    return problem.with_quantities(Quantity("side", lambda a, b: norm(b - a), point[i], point[j], unit="mm"))


# --- datum ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def readings() -> Survey:
    survey = plane({}, CONSTRAINED)
    return with_readings_of(survey, simulate(network.declare(survey), None, seed=3))


def estimated(survey: Survey) -> tuple[Estimate, np.ndarray, np.ndarray]:
    estimate = solve(sides(network.declare(survey)))
    c = covariance(linearise(estimate), "side")
    return estimate, c.values, c.matrix


def test_every_datum_gives_the_same_estimable_quantities(readings):
    free, values, matrix = estimated(network.settle(readings))
    roles = {"A": FIXED}
    points = {k: replace(p, plane=roles.get(k, ADJUSTED)) for k, p in readings.points.items()}
    held = network.declare(replace(readings, points=points))
    fixed = solve(sides(held.hold(point_of(held)[1].part("y"))))
    stated = network.declare(replace(readings, points={k: replace(p, plane=ADJUSTED) for k, p in points.items()}))
    known = prior(point_of(stated)[[0, 1]], [CORNERS["A"], CORNERS["B"]], 5.0, "known marks")
    loose = solve(sides(stated.with_observations(known)))
    for other in (fixed, loose):
        c = covariance(linearise(other), "side")
        # The prior of 5 m on two marks adds one condition beyond the datum: 2 mm against 5 m.
        assert np.abs(c.values - values).max() < (1e-9 if other is fixed else 1e-6)
        assert np.abs(c.matrix - matrix).max() < 1e-6 * np.abs(matrix).max()
    assert free.dof == fixed.dof
    assert free.objective == pytest.approx(fixed.objective, rel=1e-9)


def test_a_free_network_has_the_smallest_trace_over_its_constrained_points(readings):
    settled = network.settle(readings)
    problem = network.declare(settled)
    point = point_of(problem)
    inner = np.trace(covariance(linearise(solve(problem)), point).matrix)
    some = {k: replace(p, plane=ADJUSTED if k in "CDE" else CONSTRAINED) for k, p in settled.points.items()}
    partly = network.declare(replace(settled, points=some))
    assert inner < np.trace(covariance(linearise(solve(partly)), point_of(partly)).matrix)


def test_a_free_network_stays_where_its_points_were_said_to_be(readings):
    estimate = solve(network.declare(readings))
    shift = estimate["point"] - np.array(list(CORNERS.values()))
    assert np.abs(shift.mean(axis=0)).max() < 1e-9
    turn = np.array(list(CORNERS.values())) @ np.array([[0, 1], [-1, 0]])
    assert abs(np.sum(turn * shift)) < 1e-6


def test_turning_axes_and_circles_together_changes_nothing_but_the_coordinates(readings):
    mirrored = {k: Point((p.position[0], -p.position[1], np.nan), p.plane) for k, p in readings.points.items()}
    a = estimated(network.settle(readings))
    b = estimated(network.settle(replace(readings, points=mirrored, axes="nw")))
    assert b[0].objective == pytest.approx(a[0].objective, rel=1e-9)
    assert np.abs(b[1] - a[1]).max() < 1e-9


# --- start values -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_start_values_are_found_for_points_all_over_the_place(seed):
    generator = np.random.default_rng(seed)
    places = {str(i): (*generator.uniform(0, 1000, 2), np.nan) for i in range(12)}
    points = {k: Point(p, FIXED if k in "01" else ADJUSTED) for k, p in places.items()}
    stations = list(places)[:5]
    sights = [(a, b) for a in stations for b in places if a != b and generator.uniform() < 0.9]
    station, target = (list(k) for k in zip(*sights, strict=True))
    polar = generator.uniform(size=len(sights)) < 0.5
    batches = [Batch("direction", station, target, None, np.full(len(sights), 5 * arcsec), orientation=station,
                     group="directions"),
               Batch("distance", np.array(station)[polar], np.array(target)[polar], None,
                     np.full(polar.sum(), 3 * mm), group="distances")]
    survey = Survey(points, batches)
    full = with_readings_of(survey, simulate(network.declare(survey), None, seed))
    truth = solve(network.declare(full))
    lost = {k: p if p.plane == FIXED else Point(plane=p.plane) for k, p in points.items()}
    found = solve(network.declare(network.positions(replace(full, points=lost))))
    assert found.converged
    assert np.abs(found["point"] - truth["point"]).max() < 1e-6


@pytest.mark.parametrize(("dim", "seed"), [(2, 1), (2, 4), (3, 2), (3, 3), (3, 5)])
def test_networks_of_ranges_alone_start_from_nothing(dim, seed):
    generator = np.random.default_rng(seed)
    keys = [str(i) for i in range(10)]
    places = generator.uniform(0, 20, (10, 3))
    role = {"plane": CONSTRAINED, "height": CONSTRAINED if dim == 3 else ""}
    points = {k: Point(tuple(p), **role) for k, p in zip(keys, places, strict=True)}
    pairs = [(a, b) for i, a in enumerate(keys) for b in keys[i + 1 :] if generator.uniform() < 0.8]
    station, target = (list(k) for k in zip(*pairs, strict=True))
    kind = "slope distance" if dim == 3 else "distance"
    survey = Survey(points, [Batch(kind, station, target, None, np.full(len(pairs), 0.01 * mm), group="ranges")])
    full = with_readings_of(survey, simulate(network.declare(survey), None, seed))
    truth = solve(network.declare(full))
    nowhere = {k: replace(p, position=(np.nan,) * 3) for k, p in points.items()}
    found = solve(network.declare(network.positions(replace(full, points=nowhere))))
    assert found.objective == pytest.approx(truth.objective, rel=1e-6)
    assert found.certificate.passed


# --- noise, clusters, effects -----------------------------------------------------------------------------------------


def test_noise_is_constant_and_part_of_the_length_and_centring():
    lengths = noise.of_lengths(1 * mm, 2e-6, 1.5 * mm)
    u = lengths.weighting(2, 1, "here", lambda name: np.array([[100.0], [1000.0]])).u[:, 0]
    assert u == pytest.approx(np.hypot([1.2e-3, 3.0e-3], 1.5e-3))
    place = {"station": np.array([[0.0, 0.0]]), "target": np.array([[30.0, 40.0]]), "back": np.array([[50.0, 0.0]])}
    sights = noise.of_sights(3e-5, 1 * mm, 2 * mm).weighting(1, 1, "here", place.__getitem__)
    assert sights.u[0, 0] == pytest.approx(np.sqrt(9e-10 + 5e-6 / 2500.0))
    # Two sights of 50 m, 2 arctan(1/2) apart: the station's shift acts with the chord of sqrt(20^2 + 40^2) m.
    angles = noise.of_angles(3e-5, 1 * mm, 2 * mm).weighting(1, 1, "here", place.__getitem__)
    assert angles.u[0, 0] == pytest.approx(np.sqrt(9e-10 + 2 * 4e-6 / 2500.0 + 1e-6 * 2000.0 / 2500.0**2))


def test_a_cluster_of_mixed_readings_with_a_diagonal_matrix_is_the_same_as_single_readings():
    survey = plane({"A": FIXED, "B": FIXED})
    full = with_readings_of(survey, simulate(network.declare(survey), None, seed=5))
    lengths, directions = full.batches

    def one(batch: Batch, i: int) -> Batch:
        of = None if batch.orientation is None else [batch.orientation[i]]
        return replace(batch, station=[batch.station[i]], target=[batch.target[i]], readings=batch.values[i], u=[1.0],
                       orientation=of)

    def rest(batch: Batch) -> Batch:
        n = len(batch)
        of = None if batch.orientation is None else batch.orientation[1:]
        return replace(batch, station=batch.station[1:], target=batch.target[1:], readings=batch.values[1:],
                       u=np.asarray(batch.u)[1:n], orientation=of)

    matrix = np.diag([(2 * mm) ** 2, (4 * arcsec) ** 2])
    joint = replace(full, batches=[rest(lengths), rest(directions)],
                    correlated=[Correlated((one(lengths, 0), one(directions, 0)), matrix, "cluster", 1)])
    a, b = solve(network.declare(full)), solve(network.declare(joint))
    assert np.abs(a["point"] - b["point"]).max() < 1e-10
    assert a.objective == pytest.approx(b.objective, rel=1e-9)
    correlated = matrix + (np.ones((2, 2)) - np.eye(2)) * 0.5 * 2 * mm * 4 * arcsec
    c = solve(network.declare(replace(joint, correlated=[replace(joint.correlated[0], covariance=correlated)])))
    assert np.abs(c["point"] - b["point"]).max() > 1e-8
    total = reliability(linearise(c)).redundancy.sum()
    assert total == pytest.approx(c.dof, abs=1e-8)


def test_a_zero_offset_of_the_distances_is_found_when_it_is_freed():
    survey = example_survey()
    problem = network.declare(survey).with_effects(*network.effects())
    truth = simulate(problem, {"distance.zero_offset": 5 * mm} if "distance.zero_offset" in
                     [u.name for u in problem.unknowns] else {problem.effects[0].label: 5 * mm}, seed=2)
    effect = truth.effects[0]
    estimate = solve(truth.free(effect))
    u = covariance(linearise(estimate), effect).u[0]
    assert abs(float(estimate[effect][0]) - 5 * mm) < 4 * u
    assert u < 1.5 * mm


# --- from files -------------------------------------------------------------------------------------------------------


def test_the_example_job_of_tables_agrees_with_its_declaration(tmp_path, capsys):
    for name, text in network.example_job(seed=1).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    problem = network.from_job(Job.read(tmp_path / "job.toml"))
    estimate = solve(problem)
    assert estimate.certificate.passed
    assert 0.001 < estimate.p_value < 0.999
    truth = {k: np.array(p.position) for k, p in example_survey().points.items()}
    point = point_of(problem)
    u = covariance(linearise(estimate), point).u.reshape(point.count, -1)
    for i, key in enumerate(point.keys):
        assert np.all(np.abs(estimate["point"][i] - truth[key]) <= 4.5 * u[i] + 1e-9)
    answer = runner(capsys)("solve", tmp_path / "job.toml", "--out", tmp_path / "out")
    assert answer.status == 0


def test_two_rows_for_one_point_are_named(tmp_path, capsys):
    for name, text in network.example_job(seed=1).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "points.csv").write_text("point,role,x_m,y_m,z_m\nA,fixed,0,0,10\nA,fixed,1,0,10\n", encoding="utf-8")
    answer = runner(capsys)("solve", tmp_path / "job.toml")
    assert answer.status == 2
    assert "point 'A' stands in rows 1, 2" in answer.error


@pytest.mark.parametrize("seed", [3, 12, 29])
def test_a_network_of_few_ranges_is_unfolded(seed):
    # Half of the 45 ranges of ten points: each of these seeds starts in a fold unless points are tried on both sides.
    generator = np.random.default_rng(seed)
    places, keys = generator.uniform(0, 100, (10, 2)), [f"P{i}" for i in range(10)]
    pairs = [(a, b) for a in range(10) for b in range(a + 1, 10)]
    read = [pairs[k] for k in sorted(generator.permutation(45)[:24])]
    lengths = [float(np.linalg.norm(places[a] - places[b]) + generator.normal() * 2 * mm) for a, b in read]
    station, target = ([keys[k] for k in ends] for ends in zip(*read, strict=True))
    batch = Batch("distance", station, target, np.array(lengths), np.full(24, 2 * mm))
    survey = Survey({key: Point(plane=CONSTRAINED) for key in keys}, [batch])
    estimate = solve(network.declare(network.settle(network.started(network.checked(survey)))))
    assert estimate.objective < 5 * estimate.dof
