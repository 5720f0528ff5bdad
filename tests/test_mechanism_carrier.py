"""The three-locator carrier as closed loops: the kinematics of the paper's problem, and what its calibration says."""

import numpy as np
import pytest

import calib
from calib import Constraint, Observations, Pose, Problem, Shared, Unknown
from calib.geometry import rotation_vector
from calib.mechanism import observe
from calib.mechanism.loop import held_by
from calib.units import um
from problems import locator_carrier
from problems.locators import kinematics, paper
from problems.locators.errors import SHIFTS, TURNS

SETUP = paper.setup()
POSES = [*paper.part_poses().values(), *locator_carrier.plan(6)]


def test_places_of_locators_and_balls_are_those_of_the_paper():
    for locator in SETUP.locators:
        np.testing.assert_allclose(locator_carrier.LOCATORS[locator.key], locator.frames.base, atol=1e-15)
        np.testing.assert_allclose(locator_carrier.BALLS[locator.key], locator.ball_in_part, atol=1e-15)


def test_travels_that_close_the_loops_are_the_strokes_of_the_paper_to_rounding():
    found = locator_carrier.closing_travels(POSES, list(locator_carrier.BALLS.values()), {})
    np.testing.assert_allclose(found, [paper.strokes(SETUP, pose).ravel() for pose in POSES], atol=1e-15)


def test_six_driven_axes_bring_the_part_into_its_pose_and_the_others_follow():
    mechanism, wanted = locator_carrier.carrier(), POSES[1]
    strokes = paper.strokes(SETUP, wanted).ravel()
    part, travel = Pose("part", translation=(0, 0, 1)), Unknown("travel", np.zeros(9), "mm", parts=locator_carrier.AXES)
    driven = tuple(mechanism.index(axis) for axis in locator_carrier.DRIVEN)
    read = Observations(observe.encoders(driven), travel, readings=strokes[None, driven], u=1 * um, group="driven")
    loops = [Constraint(key, held_by(mechanism.pose(f"ball_{key}")), part, Shared(ball), travel, Shared(np.zeros(3)),
                        tolerance=1e-12, unit="mm") for key, ball in locator_carrier.BALLS.items()]
    estimate = calib.solve(Problem([read], constraints=loops))
    np.testing.assert_allclose(estimate[travel], strokes, atol=1e-13)
    np.testing.assert_allclose(estimate[part].translation, wanted.translation, atol=1e-13)
    np.testing.assert_allclose(rotation_vector(wanted.rotation.T @ estimate[part].rotation), np.zeros(3), atol=1e-13)


def readings_of_the_paper(pose, turns):
    """Travels (3,) of locator A by the paper's model with errors, which are taken at the recorded travel."""
    locator, reading = SETUP.locators[0], np.zeros(3)
    for _ in range(5):
        reading = np.asarray(calib.predict(Problem([Observations(
            kinematics.axis_reading, Pose("part", pose.rotation, pose.translation), Shared(locator.ball_in_part),
            Shared(locator.frames.matrix), Shared(reading), Shared(np.ones(3)), Shared(np.zeros(3)),
            Shared(np.zeros(len(SHIFTS))), Shared(turns), u=1.0, group="A")]))["A"][0])
    return reading


@pytest.mark.parametrize(("ours", "theirs"), [("EC0AY (AY)", "exy"), ("EA0AZ (AZ)", "eyz"), ("EB0AZ (AZ)", "ezx")])
def test_a_squareness_tilts_an_axis_as_the_paper_writes_it(ours, theirs):
    """Small angles there and exact turns here agree to the square of the angle; points that they turn about differ, so
    that the change between two poses counts."""
    angle, poses = 2e-4, POSES[:2]
    found = locator_carrier.closing_travels(poses, list(locator_carrier.BALLS.values()), {ours: angle})[:, :3]
    turns = np.where(np.array(TURNS) == theirs, angle, 0.0)
    expected = [readings_of_the_paper(pose, turns) for pose in poses]
    np.testing.assert_allclose(found[1] - found[0], expected[1] - expected[0], atol=0.3 * angle ** 2)
    strokes = [paper.strokes(SETUP, pose)[0] for pose in poses]
    assert np.abs((found[1] - found[0]) - (strokes[1] - strokes[0])).max() > 0.3 * um


def part_brought_by(driven_travels, errors, balls):
    """hall_from_part that six travels bring about in a carrier with known errors."""
    mechanism = locator_carrier.carrier()
    part, travel = Pose("part", translation=(0, 0, 1)), Unknown("travel", np.zeros(9), "mm")
    driven = tuple(mechanism.index(axis) for axis in locator_carrier.DRIVEN)
    rows = [Observations(observe.encoders(driven), travel, readings=[driven_travels], u=1e-9, group="driven")]
    rows += [Observations(held_by(mechanism.pose(f"ball_{key}")), part, Shared(ball), travel, Shared(np.zeros(3)),
                          readings=np.zeros((1, 3)), u=1e-9, group=key)
             for key, ball in zip(locator_carrier.LOCATORS, balls, strict=True)]
    problem = Problem(rows, effects=locator_carrier.effects())
    start = {problem.parameters(label).name: np.atleast_2d(value) for label, value in errors.items()}
    return calib.solve(problem, start=start)[part]


@pytest.mark.slow
def test_calibrated_set_points_bring_the_part_where_the_tracker_wants_it():
    estimate, design = calib.solve(locator_carrier.example(3)), list(locator_carrier.BALLS.values())
    errors = {k: v for k, v in locator_carrier.TRUTH.items() if k != "ball"}
    six = [locator_carrier.AXES.index(axis) for axis in locator_carrier.DRIVEN]
    found, targets = estimate["tracker_from_hall"], np.array(list(locator_carrier.TARGETS.values()))
    missed = []
    for pose in locator_carrier.plan(12)[-3:]:
        wanted = locator_carrier.WORLD @ pose       # as the tracker shall see it
        in_hall = found.inverse() @ wanted
        designed = locator_carrier.closing_travels([in_hall], design, {})[0]
        for travels in (designed, locator_carrier.set_points(estimate, in_hall)):
            real = part_brought_by(travels[six], errors, locator_carrier.TRUTH["ball"])
            missed.append(np.linalg.norm(locator_carrier.WORLD @ real @ targets - wanted @ targets, axis=1).max())
    assert max(missed[1::2]) < 25 * um < 100 * um < min(missed[::2])
