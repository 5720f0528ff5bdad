"""Axis points by theodolite: the paper's centres, both faces, sharing of one circle by both circles, bad geometry."""

import os
from pathlib import Path

import numpy as np
import pytest
from folders import put

from calib import covariance, linearise, predict, simulate, solve, variance_components
from calib.errors import InputError, RankDefect
from calib.job import Job
from calib.table import shipped
from calib.units import arcsec, degree, mm
from problems import axis_points, circle_sharing

CASES = Path(os.environ.get("CALIB_REFERENCE_DATA", "absent")).parent / "discrepancy_examples"
QUARTER = np.arange(0.0, 91.0, 5.0) * degree
CENTRE = np.array([[185.49, 90.001]]) * degree
ECCENTRIC = np.array([[0.17, -0.13]]) * mm


def one_target(angle, *, shared, readings=None, **more):
    """One target A at 987.5 mm, read on face 1."""
    return axis_points.declare(readings, ["A"] * len(angle), angle, distance={"A": 0.9875}, shared=shared, **more)


def truth_of(problem, in_h=ECCENTRIC, in_v=ECCENTRIC):
    """Values of a problem of one target; in_v is used where the circles do not share."""
    count = problem.select("eccentricity").unknown.count
    return {"centre": CENTRE, "eccentricity": np.concatenate([in_h, in_v])[:count]}


def test_the_model_is_equations_four_and_five():
    problem = one_target(QUARTER, shared=None)
    h, v = predict(problem, {problem.select(k).unknown: value for k, value in truth_of(problem).items()})["circles"].T
    r, phase = np.hypot(*ECCENTRIC[0]), np.arctan2(ECCENTRIC[0, 1], ECCENTRIC[0, 0])
    assert h == pytest.approx(CENTRE[0, 0] + r * np.cos(QUARTER + phase) / 0.9875, rel=1e-14)
    assert v == pytest.approx(CENTRE[0, 1] + r * np.sin(QUARTER + phase) / 0.9875, rel=1e-14)


def test_both_faces_give_one_line_of_sight():
    face = np.tile([1.0, -1.0], len(QUARTER))
    problem = one_target(np.repeat(QUARTER, 2), shared=None, face=face, elevation={"A": 20 * degree})
    readings = predict(problem, {problem.select(k).unknown: value for k, value in truth_of(problem).items()})["circles"]
    assert readings[1, 0] - readings[0, 0] == pytest.approx(np.pi, abs=1e-14)
    assert readings[1, 1] + readings[0, 1] == pytest.approx(2 * np.pi, abs=1e-14)
    estimate = solve(problem.with_readings({"circles": readings % (2 * np.pi)}))
    assert estimate["centre"] == pytest.approx(CENTRE, abs=1e-6 * arcsec)
    assert estimate["eccentricity"] == pytest.approx(ECCENTRIC, abs=1e-9 * mm)


@pytest.mark.parametrize("shared", [None, ()])
def test_u_of_the_centre_over_a_quarter_turn_is_that_of_the_normal_equations(shared):
    problem = one_target(QUARTER, shared=shared)
    u = covariance(linearise(problem), "centre").u / arcsec
    one, c, s = np.ones(len(QUARTER)), np.cos(QUARTER), np.sin(QUARTER)
    zero = 0 * one
    if shared is None:
        design = np.block([[one[:, None], zero[:, None], c[:, None], -s[:, None]],
                           [zero[:, None], one[:, None], s[:, None], c[:, None]]])
    else:
        design = np.stack([one, c, -s], axis=1)
    expected = np.sqrt(np.linalg.inv(design.T @ design)[0, 0])
    assert u == pytest.approx([expected, expected], rel=1e-9)


def test_over_a_full_turn_the_centre_is_the_mean_of_the_readings():
    angle = np.arange(4) * 90 * degree
    problem = simulate(one_target(angle, shared=()), truth_of(one_target(angle, shared=())), seed=4)
    estimate = solve(problem)
    assert estimate["centre"][0] == pytest.approx(problem.observations[0].readings.mean(axis=0), abs=1e-9 * arcsec)
    assert covariance(linearise(estimate), "centre").u / arcsec == pytest.approx([0.5, 0.5])


def agreement(in_v, seed):
    """The sharing test on simulated readings whose vertical circle sees another eccentricity."""
    problem = one_target(QUARTER, shared=())
    estimate = solve(simulate(problem, truth_of(problem, in_v=in_v), seed))
    fit = linearise(estimate)
    return circle_sharing.sharing(fit, variance_components(fit))[0]


def test_sharing_is_refused_where_the_vertical_circle_sees_another_eccentricity():
    found = agreement(ECCENTRIC + np.array([[0.0, 0.06]]) * mm, seed=1)
    assert not found.accepted
    assert found.p_stated < 1e-3


def test_sharing_of_one_eccentricity_is_refused_once_in_a_hundred():
    found = [agreement(ECCENTRIC, seed) for seed in range(120)]
    assert sum(not one.accepted for one in found) <= 5           # 120 draws at 1 %: more than 5 has a chance of 0.2 %
    assert np.mean([one.statistic for one in found]) == pytest.approx(2.0, abs=4 * 2 / np.sqrt(120))
    assert np.mean([one.p_scatter for one in found]) == pytest.approx(0.5, abs=4 * 0.29 / np.sqrt(120))


def test_v_pv_grows_by_the_test_statistic_when_the_circles_share():
    apart = simulate(one_target(QUARTER, shared=()), truth_of(one_target(QUARTER, shared=())), seed=7)
    together = one_target(QUARTER, shared=None, readings=apart.observations[0].readings)
    estimate = solve(apart)
    fit = linearise(estimate)
    statistic = circle_sharing.sharing(fit, variance_components(fit))[0].statistic
    assert solve(together).objective - estimate.objective == pytest.approx(statistic, rel=1e-6)


def test_readings_at_one_position_say_what_cannot_be_known():
    readings = np.tile(CENTRE, (6, 1))
    with pytest.raises(RankDefect, match=r"cannot be known.*eccentricity"):
        solve(one_target(np.full(6, 30 * degree), shared=None, readings=readings))


def test_an_arc_of_two_degrees_is_solved_and_its_uncertainty_says_so():
    problem = one_target(np.linspace(0, 2, 9) * degree, shared=())
    assert covariance(linearise(problem), "centre").u.min() > 1000 * arcsec


def test_a_target_without_distance_is_named():
    with pytest.raises(InputError, match=r"target 'A'.*no distance.*B"):
        axis_points.declare(None, ["A"] * 3, QUARTER[:3], distance={"B": 1.0})


def test_the_example_job_is_read_and_its_residuals_are_its_noise(tmp_path):
    job = Job.read(put(tmp_path, axis_points.example_job(2)))
    problem = axis_points.from_job(job)
    job.refuse_unknown_keys()
    estimate = solve(problem)
    assert estimate.p_value > 0.001
    assert len(estimate.residuals["circles"]) == len(job.table("circles"))
    # the job carries the readings of the example, rounded to 1e-7 degrees
    other = solve(axis_points.example(2))
    assert estimate["centre"] == pytest.approx(other["centre"] % (2 * np.pi), abs=1e-3 * arcsec)


def test_a_face_that_is_neither_one_nor_two_is_named_with_its_line(tmp_path):
    files = axis_points.example_job(2)
    lines = files["circles.csv"].splitlines()
    cells = lines[4].split(",")
    cells[2] = "3"
    files["circles.csv"] = "\n".join([*lines[:4], ",".join(cells), *lines[5:]]) + "\n"
    with pytest.raises(InputError, match=r"circles.csv, line 5.*face 3 is neither 1 nor 2"):
        axis_points.from_job(Job.read(put(tmp_path, files)))


def test_readings_of_face_two_ask_for_the_column_face(tmp_path):
    files = axis_points.example_job(2)
    files["circles.csv"] = files["circles.csv"].replace("target,face,", "target,side,")
    with pytest.raises(InputError, match=r"circles.csv, line \d+.*column 'V_deg'.*add a column face"):
        axis_points.from_job(Job.read(put(tmp_path, files)))


@pytest.mark.skipif(not CASES.is_dir(), reason="the example cases are not on this machine")
@pytest.mark.parametrize("case, before", [("clean", 1.00847), ("effect", 4.70467)])
def test_the_example_cases_have_their_published_gap(case, before):
    problem = axis_points.from_job(Job.read(CASES / f"example_theodolite_target_{case}"))
    estimate = solve(problem)
    assert np.sqrt(estimate.objective / estimate.dof) == pytest.approx(before, abs=1e-5)


@pytest.mark.skipif(not CASES.is_dir(), reason="the example cases are not on this machine")
def test_the_vertical_index_of_the_example_case_comes_out_as_its_oracle():
    problem = axis_points.from_job(Job.read(CASES / "example_theodolite_target_effect"))
    index = next(effect for effect in problem.effects if effect.name == "vertical_index")
    found = covariance(linearise(solve(problem.free(index))), index)
    assert found.values[0] / arcsec == pytest.approx(-5.707041428522422, abs=1e-5 * 0.099)
    assert found.u[0] / arcsec == pytest.approx(0.09928914008049408, rel=1e-6)


@pytest.mark.parametrize("instrument, target, printed, u", [
    ("T1", "S3", 185 + 29 / 60 + 39 / 3600, 3.9), ("T2", "S3", 27 + 21 / 60 + 21 / 3600, 3.3),
    ("T2", "S2", 27 + 20 / 60 + 35 / 3600, 3.9),
])
def test_filaments_over_a_part_turn_give_the_printed_yaw_axes(instrument, target, printed, u):
    table = shipped("five_axis/table2_filaments.csv")
    table = table.where((table.text("instrument") == instrument) & (table.text("target") == target))
    problem = axis_points.declare_filaments(
        table.number("horizontal", "angle"), table.text("target"), table.number("position", "angle"),
        distance={"S3": 1.417, "S2": 1.420})
    found = covariance(linearise(solve(problem)), "filament")
    assert abs(found.values[0] - printed * degree) < 0.5 * arcsec
    assert found.u[0] / arcsec == pytest.approx(u, abs=0.05)


def test_a_job_of_filaments_alone_needs_no_vertical_circle(tmp_path):
    lines = ["target,angle_deg,H_deg"]
    lines += [f"S,{a},{(359.9999 + 0.002 * np.cos(a * degree)) % 360:.7f}" for a in range(0, 91, 10)]
    files = {"filaments.csv": "\n".join(lines) + "\n", "job.toml": """problem = "problems.axis_points"
[data.filaments]
file = "filaments.csv"
instrument = "theodolite"
[instruments.theodolite]
kind = "theodolite"
u_H = "1 arcsec"
[[known.targets]]
id = "S"
L = "1417 mm"
"""}
    job = Job.read(put(tmp_path, files))
    problem = axis_points.from_job(job)
    job.refuse_unknown_keys()
    assert not any(effect.channel.startswith("V") for effect in problem.effects)
    estimate = solve(problem)
    # the circle passes its zero between the readings
    assert np.sin(estimate["filament"][0, 0] - 359.9999 * degree) == pytest.approx(0.0, abs=1e-3 * arcsec)
    assert estimate["filament circle"][0, 0] == pytest.approx(0.002 * degree * 1.417, rel=1e-4)


def test_the_formulations_differ_by_no_more_than_sharing_costs(tmp_path):
    found = axis_points.formulations(Job.read(put(tmp_path, axis_points.example_job(2))))
    together, apart = (solve(problem) for problem in found.values())
    assert together.dof - apart.dof == 2 * 3
    assert 0.0 < together.objective - apart.objective < 22.5        # chi-squared of 6: beyond that with 0.1 %
