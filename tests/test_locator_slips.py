"""Printed equations of the locator paper against the exact model: the counter-examples of docs/slips/locators.md."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from calib.geometry import rotation_from_rpy
from problems.locators import paper
from problems.locators.errors import SHIFTS, TURNS, Frames, ball_centre
from problems.locators.pose_error import linear_form

TURN = 1e-4                 # [rad], one tenth of a millimetre on a metre
TRAVEL = np.array([0.05, 0.1, 0.02])
# Lever arms with every component different from zero; those of table 5 hide most of the slips behind zeros.
FRAMES = Frames(*np.array([[1.44, 0.1, 0.2], [0.2, 0.35, 0.15], [0.03, 0.07, 0.4], [0.02, 0.04, 0.25]]))


def moved(name, frames=FRAMES, travel=TRAVEL, size=TURN):
    """Displacement (3,) [m] of the ball by one error, from the exact model."""
    none = dict.fromkeys((*SHIFTS, *TURNS), 0.0)
    return ball_centre(travel, none | {name: size}, frames) - ball_centre(travel, none, frames)


def test_equation_32_counts_the_yaw_of_x_twice():
    py, pz, q = (getattr(FRAMES, name)[1] for name in ("y_in_x", "z_in_y", "ball_in_z"))
    right, superfluous = -(py + pz + q + TRAVEL[1]) * TURN, -(pz + q + TRAVEL[1]) * TURN
    assert moved("ez_x")[0] == pytest.approx(right, abs=1e-14) == pytest.approx(-56e-6)
    assert right + superfluous == pytest.approx(-77e-6)


def test_equation_33_counts_the_yaw_of_x_twice():
    once = (FRAMES.y_in_x[0] + FRAMES.z_in_y[0] + FRAMES.ball_in_z[0]) * TURN
    assert moved("ez_x")[1] == pytest.approx(once, abs=1e-14) == pytest.approx(25e-6)
    assert 2 * once == pytest.approx(50e-6)


def test_the_squareness_of_equation_33_is_that_of_equations_27_and_34_with_its_indices_exchanged():
    lever = FRAMES.ball_in_z[2] + TRAVEL[2]
    assert moved("eyz")[1] == pytest.approx(-lever * TURN, abs=1e-14) == pytest.approx(-27e-6)
    assert moved("eyz")[2] == pytest.approx(FRAMES.ball_in_z[1] * TURN, abs=1e-14) == pytest.approx(4e-6)


def test_equation_34_adds_an_angle_to_a_length():
    right = (FRAMES.z_in_y[1] + FRAMES.ball_in_z[1]) * TURN
    assert moved("ex_y")[2] == pytest.approx(right, abs=1e-14) == pytest.approx(11e-6)
    printed_in_metres, printed_in_millimetres = right - TURN, (right * 1e3 - TURN) * 1e-3
    assert printed_in_metres == pytest.approx(-89e-6) and printed_in_millimetres == pytest.approx(10.9e-6)


def test_equations_36_and_37_lose_the_ball_and_take_the_rotation_twice():
    angles, ball = np.array([0.3, -0.2, 0.2]) * np.pi / 180, np.array([-0.72, 0.59, 0.0])
    rotation, turned = rotation_from_rpy(*angles), rotation_from_rpy(*(angles + [0.0, 0.0, TURN]))
    offset = np.array([10e-6, 0.0, 0.0])
    of_ball = (rotation @ (ball + offset) - rotation @ ball)[0]          # pose at rest: eq 36 leaves nothing of it
    assert of_ball == pytest.approx(10e-6, rel=1e-4)
    of_turn = (turned @ ball - rotation @ ball)[0]                       # ball at rest: the left side of eq 37 is zero
    left_as_printed = of_turn - ((turned - rotation) @ ball)[0]
    assert left_as_printed == pytest.approx(0.0, abs=1e-15) and of_turn == pytest.approx(-58.7e-6, abs=0.1e-6)


def test_the_sign_of_equation_40_is_right():
    mechanism, poses = paper.setup(), paper.part_poses()
    form = linear_form(mechanism, poses["target"], paper.DRIVEN)
    offset = 10e-6 * form.column("A.dr_x")
    assert offset[0] == pytest.approx(-10e-6, rel=1e-4)                  # the ball sits ahead, so the part hangs back


def test_the_rotation_of_equation_1_takes_part_to_hall_and_not_hall_to_part():
    angles = np.array([0.3, -0.2, 0.2]) * np.pi / 180
    rotation, ball = rotation_from_rpy(*angles), np.array([1.44, 0.0, 0.0])
    assert (rotation @ ball)[2] + 0.010 == pytest.approx(15.0265e-3, abs=1e-7)       # z_A of table 3
    assert (rotation.T @ ball)[2] + 0.010 == pytest.approx(4.9999e-3, abs=2e-6)


def test_the_matrix_m_between_rates_of_angles_and_rotation_is_right():
    angles = ca.SX.sym("angles", 3)
    turned = rotation_from_rpy(angles[0], angles[1], angles[2])
    at = np.array([0.3, -0.2, 0.2]) * np.pi / 180
    derivative = ca.Function("d", [angles], [ca.jacobian(ca.vec(turned), angles)])
    by_angle = np.array(derivative(at)).reshape(3, 3, 3, order="F")
    rotation = rotation_from_rpy(*at)
    (cb, sb), (cg, sg) = ((np.cos(a), np.sin(a)) for a in at[1:])
    rates = np.array([[cb * cg, -sg, 0], [sg * cb, cg, 0], [-sb, 0, 1]])
    for i in range(3):
        skew = by_angle[:, :, i] @ rotation.T
        assert [skew[2, 1], skew[0, 2], skew[1, 0]] == pytest.approx(rates[:, i], abs=1e-14)


def test_with_the_strokes_of_table_3_the_squareness_alone_would_exceed_table_6():
    mechanism, poses = paper.setup(), paper.part_poses()
    form = linear_form(mechanism, poses["target"], paper.DRIVEN)
    stroke = paper.strokes(mechanism, poses["target"])[0, 2]
    sigma = abs(form.column("A.ezx")[0]) * paper.tolerances()["square_z"] / stroke / np.sqrt(3)
    assert sigma == pytest.approx(0.1018e-3, rel=1e-3) and sigma > 3 * 0.027e-3
