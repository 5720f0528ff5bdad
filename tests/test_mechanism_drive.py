"""Drives and what gives under load: gears of soft windup, harmonics of linear scales, joints that stand to friction,
errors that neighbouring postures share."""

import numpy as np
import pytest

import calib
from calib.errors import DeclarationError
from calib.mechanism import Frame, Linear, Load, Mechanism, Rotary, encoder_harmonic, observe
from calib.mechanism.clusters import alike_postures
from calib.mechanism.drive import soft_windup
from calib.mechanism.sensitivity import place_by_positions
from calib.mechanism.smooth import Smooth, distances, smooth_errors
from calib.units import mm, mrad
from problems import serial_arm

KNEE = 0.05


def swing():
    """One horizontal axis with a weight 0.4 m off and a tip 1 m off."""
    return Mechanism("swing", [Rotary("A", direction=(0, 1, 0))], [Frame("tip", at=(1.0, 0, 0), carried_by="A")],
                     [Load("weight", (0.4, 0, 0), "A")])


def drop(position, windup=0.5 * mrad):
    """Height of the tip with the windup less height without [m]."""
    mechanism = swing()
    problem = calib.Problem([calib.Observations(
        observe.measured_point(mechanism.pose("tip")), calib.Pose("world"), np.array([[position]]),
        calib.Shared(np.zeros(3)), u=1.0, group="tip")], effects=[soft_windup(mechanism, mechanism.axis("A"), KNEE)])
    heights = [calib.predict(problem, {"windup_A (A)": [[value]]})["tip"][0, 2] for value in (0.0, windup)]
    return heights[1] - heights[0]


def test_a_gear_of_soft_windup_gives_fully_beyond_its_knee_and_the_other_way_on_the_other_side():
    assert drop(0.0) == pytest.approx(-0.5 * mm, rel=1e-4)                      # weight far beyond the knee
    upright = -np.pi / 2
    assert drop(upright) == pytest.approx(0.0, abs=1e-9)                        # balanced: no torque, no windup
    assert drop(upright + 0.4) * drop(upright - 0.4) > 0                        # it falls to whichever side it leans
    lean = np.arcsin(KNEE / 0.4)                                                # a lever arm of just the knee
    assert drop(upright + lean) / np.sin(lean) == pytest.approx(-0.5 * mm * np.tanh(1.0), rel=2e-2)


def test_a_harmonic_of_a_linear_axis_needs_its_period():
    axis = Linear("X", direction=(1, 0, 0))
    with pytest.raises(DeclarationError, match="a harmonic of what"):
        encoder_harmonic(axis)
    screw, turn = encoder_harmonic(axis, 2, period=5 * mm), encoder_harmonic(Rotary("C", (0, 0, 1)), 2)
    for effect, period in ((screw, 5 * mm), (turn, 2 * np.pi)):
        p = effect.bundle(1.0, 0.3)
        assert float(effect.function(0.2 * period, p)) == pytest.approx(float(effect.function(0.7 * period, p)))


def test_the_derivative_of_a_place_by_the_positions_agrees_with_differences():
    arm, step = serial_arm.example_arm(), 1e-6
    positions = np.random.default_rng(1).uniform(-1, 1, (4, 6))
    found = place_by_positions(arm.mechanism, arm.tip, positions)
    for joint in range(6):
        moved = positions + step * (np.arange(6) == joint)
        away = arm.mechanism.poses(arm.tip, moved)[1] - arm.mechanism.poses(arm.tip, 2 * positions - moved)[1]
        assert found[:, :, joint] == pytest.approx(away / (2 * step), abs=1e-8)


def test_joints_that_stand_to_friction_widen_the_seat_across_the_arm_most():
    arm = serial_arm.example_arm()
    (posture,) = np.array([[[0.1, 0.6, -0.2, 0.9, 0.3, 0.5]]])
    stiff, loose = (serial_arm.seat_covariance(arm, posture, 0.1 * mm, u)[0] for u in (0.0, 0.2 * mrad))
    assert stiff == pytest.approx((0.1 * mm) ** 2 * np.eye(3))
    widened = np.linalg.eigvalsh(loose - stiff)
    assert widened.min() > 0 and widened.max() < 6 * (0.2 * mrad * 1.2) ** 2


def test_smooth_errors_are_alike_for_near_postures_and_close_after_a_turn():
    mechanism = Mechanism("table", [Rotary("C", (0, 0, 1))])
    positions = np.array([[0.0], [0.1], [3.0], [2 * np.pi]])
    apart = distances(mechanism, positions)
    assert apart[0, 3] == pytest.approx(0.0, abs=1e-12) and apart[0, 1] == pytest.approx(0.1, rel=1e-3)
    weighting = smooth_errors(mechanism, positions, [Smooth(1.0, 3.0, 0.5), Smooth(2.0)]).weighting(4, 2, "pose")
    assert weighting.u == pytest.approx(np.tile([np.sqrt(10.0), 2.0], (4, 1)))
    drawn = np.array([weighting.draw(np.random.default_rng(seed)) for seed in range(400)])
    correlation = np.corrcoef(drawn[:, :, 0].T)
    assert correlation[0, 1] == pytest.approx(0.9 * np.exp(-0.02), abs=0.05) and abs(correlation[0, 2]) < 0.15
    with pytest.raises(DeclarationError, match="reach nowhere"):
        smooth_errors(mechanism, positions, [Smooth(1.0, 3.0, 0.0)])


def test_alike_postures_stay_together():
    generator = np.random.default_rng(3)
    positions = np.concatenate([centre + 0.05 * generator.standard_normal((10, 2)) for centre in (-2.0, 0.0, 2.0)])
    cluster = alike_postures(positions, 3, seed=1)
    assert all(len(set(cluster[i:i + 10])) == 1 for i in (0, 10, 20)) and len(set(cluster)) > 1
