"""Identification of locator errors from measured poses: what is seen, what is found, how much better poses become."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from calib import A, covariance, estimability, linearise, predict, select, solve
from calib.analyse.selection.request import requested
from calib.job import Job
from problems import locators
from problems.locators import campaign
from problems.locators.identification import (
    Knowledge,
    balance,
    combinations,
    functions_in,
    give_in_joints,
    identified,
    identify,
    leaders_only,
    pose_error,
    pose_error_to_come,
    poses_from_axes,
    unseen,
    with_error_functions,
    with_knowledge,
)
from problems.locators.measured import declare, rigid_fit
from problems.locators.paper import DRIVEN
from problems.locators.vocabulary import error_functions

KNOWLEDGE = Knowledge()
FUNCTIONS = [function for key in "ABC" for function in error_functions(key)]
CHECKS = 12
DRIVEN_ERRORS = {"scale (A.x)": 2e-4, "squareness (B.xy)": 3e-4}


@pytest.fixture(scope="module")
def truth():
    generator = np.random.default_rng(7)
    return {function.label: generator.normal(0.0, KNOWLEDGE.u(function)) for function in FUNCTIONS}


@pytest.fixture(scope="module")
def measured(truth):
    return campaign.measure(campaign.drawn_poses(24 + CHECKS, 1), 3, truth, further=FUNCTIONS, checks=CHECKS)


def scheme(measured, name):
    """Setup and free problem of a scheme, from the poses that are for fitting."""
    setup = replace(measured.setup, axes=DRIVEN) if name == "six axes" else measured.setup
    axes = measured.axes.where(measured.axes.split == "fit")
    targets = None if name == "encoders alone" else measured.targets.where(measured.targets.split == "fit")
    problem = declare(setup, axes, targets, u_axis=campaign.U_AXIS, u_tracker=campaign.U_TRACKER)
    return setup, with_error_functions(problem)


@pytest.fixture(scope="module")
def floating(measured):
    setup, problem = scheme(measured, "nine axes")
    return setup, problem, combinations(linearise(problem), KNOWLEDGE)


def true_values(fit, found, truth, problem):
    columns = np.zeros(fit.layout.size)
    for function in functions_in(problem):
        columns[fit.layout.span(fit.effects[function])] = truth[function.label]
    return np.array([one.derivatives for one in found]) @ columns


def test_a_rigid_fit_takes_points_onto_their_moved_twins():
    part_pose = campaign.drawn_poses(1, 4)[0]
    points = np.random.default_rng(5).normal(size=(5, 3))
    fitted = rigid_fit(points, part_pose @ points)
    assert fitted.rotation == pytest.approx(part_pose.rotation, abs=1e-12)
    assert fitted.translation == pytest.approx(part_pose.translation, abs=1e-12)


def test_errors_that_have_no_lever_arm_are_named_as_unseen(floating):
    _, problem, _ = floating
    labels = unseen(linearise(problem))
    # The ball is the reference point of body Z: it does not turn about itself, and body Y has no arm across its yaw.
    assert set(labels) == {f"{name} ({key}).{part}" for key in "ABC" for part in ("constant", "slope")
                           for name in ("tilt of Z about x", "tilt of Z about y", "roll of Z", "yaw of Y")}


def test_the_rank_defect_of_all_errors_is_named_in_their_words(floating):
    _, problem, _ = floating
    known = estimability(linearise(problem))
    assert known.defect >= 69
    words = " ".join(known.directions)
    assert "squareness Z-X" in words and "straightness of Z in x" in words and "roll of Z" in words


def test_every_combination_that_is_seen_comes_out_within_its_uncertainty(floating, truth):
    _, problem, found = floating
    led = leaders_only(problem, found)
    estimate = solve(led)
    fit = linearise(estimate)
    seen = covariance(fit, *(one.leader for one in found))
    deviation = (seen.values - true_values(fit, found, truth, problem)) / seen.u
    assert 30 < len(found) < 60
    assert np.abs(deviation).max() < 4.5 and 0.7 < deviation.std() < 1.4
    assert estimate.p_value > 1e-3


def test_a_squareness_is_seen_together_with_what_acts_like_it(floating):
    _, _, found = floating
    words = next(one.words for one in found if one.leader == "squareness Z-X (A)")
    for companion in ("straightness of Z in x (A).slope", "roll of Y (A).constant", "pitch of X (A).constant"):
        assert companion in words


def test_with_priors_the_errors_are_found_as_well_as_their_uncertainty_says(floating, truth):
    _, problem, _ = floating
    fit = linearise(identify(problem, KNOWLEDGE))
    found = [covariance(fit, function.label) for function in FUNCTIONS]
    deviation = np.concatenate([(one.values - truth[function.label]) / one.u
                                for one, function in zip(found, FUNCTIONS, strict=True)])
    assert len(deviation) == 144
    assert np.sqrt(np.mean(deviation ** 2)) == pytest.approx(1.0, abs=0.25)
    u_before = np.concatenate([KNOWLEDGE.u(function) for function in FUNCTIONS])
    ratio = np.concatenate([one.u for one in found]) / u_before
    assert ratio.max() < 1 + 1e-9 and np.sum(ratio < 0.8) > 20


def held_out(measured, name):
    """Pose error [m] of the poses held out, from their axes alone: nominal, and with the identified errors."""
    setup, problem = scheme(measured, name)
    checks, true = measured.axes.where(measured.axes.split == "check"), measured.part[-CHECKS:]
    functions = identified(identify(problem, KNOWLEDGE))
    return tuple(pose_error(setup, poses_from_axes(setup, checks, campaign.U_AXIS, known), true)
                 for known in (None, functions))


@pytest.mark.slow
def test_identified_errors_bring_poses_that_were_held_out_nearer_to_the_truth_but_not_from_encoders_alone(measured):
    nine, six, alone = (held_out(measured, name) for name in ("nine axes", "six axes", "encoders alone"))
    assert nine[1] < 0.75 * nine[0] and six[1] < 0.75 * six[0]
    assert nine[1] < six[1] < 0.75 * alone[1]


def test_joints_at_rest_balance_in_the_pose_nearest_to_all_nine_axes(driven):
    setup = driven.setup
    problem = declare(setup, driven.axes, None)
    predicted = predict(problem, {"part": list(driven.part), **DRIVEN_ERRORS})
    part_pose = driven.part[0]
    gives = [(o.readings - predicted[o.group])[0] for o in problem.observations]
    balls = np.array([locator.ball_in_part for locator in setup.locators])
    rest = np.array(ca.DM(balance(part_pose, *(ca.DM(give) for give in gives), ca.DM(balls)))).ravel()
    assert np.abs(rest).max() < 1e-12 < 1e-6 < np.abs(gives).max()


@pytest.fixture(scope="module")
def driven():
    """Nine driven axes whose only errors are a scale and a squareness: nominal travels are read, the part gives way."""
    return campaign.drive(campaign.drawn_poses(20 + CHECKS, 2), 4, DRIVEN_ERRORS, checks=CHECKS)


def test_errors_of_nine_driven_axes_are_found_where_the_joints_may_give_way(driven):
    axes, targets = (readings.where(readings.split == "fit") for readings in (driven.axes, driven.targets))
    problem = declare(driven.setup, axes, targets, u_axis=1e-6, u_tracker=campaign.U_TRACKER)
    names, true = list(DRIVEN_ERRORS), np.array(list(DRIVEN_ERRORS.values()))
    stiff = covariance(linearise(solve(problem.free(*names))), *names)
    giving = covariance(linearise(solve(give_in_joints(problem, driven.setup).free(*names))), *names)
    assert np.abs((giving.values - true) / giving.u).max() < 4
    assert np.abs((stiff.values - true) / stiff.u).max() > 10


def test_encoders_alone_see_fewer_combinations(measured, floating):
    found = combinations(linearise(scheme(measured, "encoders alone")[1]), KNOWLEDGE)
    assert 0 < len(found) < 0.75 * len(floating[2])


def test_a_common_motion_of_the_hall_is_no_pose_error():
    poses = campaign.drawn_poses(4, 9)
    hall = campaign.drawn_poses(1, 10)[0]
    assert pose_error(campaign.HALL, [hall @ one for one in poses], poses) < 1e-12


def test_a_job_can_ask_for_all_errors_as_functions_and_for_some_axes_only(tmp_path):
    extra = ('\n[known.axes_read]\nA = ["x", "y", "z"]\nB = ["y", "z"]\nC = ["z"]\n'
             '[options]\nerrors = "functions"\nprior_length = "15 um"\n')
    for name, text in locators.example_job(5).items():
        (tmp_path / name).write_text(text + (extra if name.endswith(".toml") else ""))
    job = Job.read(tmp_path / "job.toml")
    problem = locators.from_job(job)
    job.refuse_unknown_keys()
    read = [o.components(o.readings.shape[1]) for o in problem.observations[:3]]
    assert read == [("x", "y", "z"), ("y", "z"), ("z",)]
    estimate = solve(problem)
    assert estimate.certificate.passed and estimate.p_value > 1e-3


@pytest.mark.slow
def test_ninety_five_percent_intervals_of_a_named_effect_cover_ninety_five_percent():
    covered, count = 0, 50
    for seed in range(count):
        size = np.random.default_rng([seed, 3]).normal(0.0, 3e-4)
        measured = campaign.measure(campaign.drawn_poses(8, seed), seed, {"squareness (A.xy)": size})
        problem = declare(measured.setup, measured.axes, measured.targets, u_axis=campaign.U_AXIS,
                          u_tracker=campaign.U_TRACKER)
        found = covariance(linearise(solve(problem.free("squareness (A.xy)"))), "squareness (A.xy)")
        covered += abs(found.values[0] - size) < 1.96 * found.u[0]
    assert 43 <= covered <= 50              # binomial: 42 or fewer of 50 has a probability of 0.3 %


@pytest.mark.slow
def test_the_pose_error_to_come_is_what_is_found_and_poses_chosen_by_it_beat_random_ones(measured, truth):
    setup, problem = scheme(measured, "nine axes")
    fit = linearise(with_knowledge(problem, KNOWLEDGE))
    checks, true = measured.axes.where(measured.axes.split == "check"), measured.part[-CHECKS:]
    to_come = pose_error_to_come(fit, setup, checks, campaign.U_AXIS)
    known = {function: truth[function.label] for function in functions_in(problem)}
    found, perfect = (pose_error(setup, poses_from_axes(setup, checks, campaign.U_AXIS, functions), true)
                      for functions in (identified(identify(problem, KNOWLEDGE)), known))
    predicted = np.hypot(np.linalg.norm(covariance(fit, to_come).u), perfect)
    assert 0.6 < found / predicted < 1.6
    request = requested(fit, 8, A(to_come), by="pose")
    choice = select(fit, 8, A(to_come), by="pose")
    drawn = [request.value(request.objective.loss(np.random.default_rng(seed).choice(24, 8, replace=False)))
             for seed in range(20)]
    assert choice.bound <= choice.value < min(drawn)
