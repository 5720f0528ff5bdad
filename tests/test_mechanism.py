"""Mechanisms: kinematics, errors by their ISO names, and refusals in sentences."""

import casadi as ca
import numpy as np
import pytest

import calib
from calib.errors import DeclarationError, InputError
from calib.geometry import Transform, rotation_vector, rotation_x, rotation_z
from calib.mechanism import (
    Frame,
    Linear,
    Load,
    Mechanism,
    Rotary,
    backlash,
    encoder_harmonic,
    error_motion,
    error_motions,
    location_error,
    location_errors,
    mounting_errors,
    observe,
    sag,
    sag_by_load,
    scale,
    thermal_growth,
    thermal_scale,
    zero_offset,
)
from calib.mechanism.basis import error_motion_basis
from calib.units import degree


def gimbal() -> Mechanism:
    return Mechanism("gimbal", axes=[Rotary("C", (0, 0, 1)),
                                     Rotary("A", (1, 0, 0), through=(0, 0, 0.1), carried_by="C")],
                     frames=[Frame("mirror", (0.2, 0.0, 0.1), carried_by="A"), Frame("ring", carried_by="C")],
                     loads=[Load("mirror", (0, 0.2, 0.1), "A", mass=2.0)])


def machine() -> Mechanism:
    return Mechanism("machine", axes=[
        Linear("X", (1, 0, 0), limits=(0.0, 0.5)), Linear("Y", (0, 1, 0), limits=(0.0, 0.3)),
        Linear("Z", (0, 0, 1), carried_by="X", limits=(0.0, 0.2))],
        frames=[Frame("spindle", carried_by="Z"), Frame("table", (0, 0, -0.1), carried_by="Y")])


def predictions(model, effects, values, positions, target=(0.0, 0.0, 0.0)):
    """Points of a frame [m] at positions with effects at values, by the engine."""
    observations = calib.Observations(observe.measured_point(model), calib.Pose("world"), np.asarray(positions, float),
                                      calib.Shared(target), readings=np.zeros((len(positions), 3)), u=1e-6,
                                      group="point",
                                      covariates={"approach": np.ones(len(positions)),
                                                  "temperature_difference": np.full(len(positions), 2.0)})
    problem = calib.Problem([observations], effects=effects)
    return calib.predict(problem, {problem.parameters(e): np.atleast_2d(v) for e,
                                   v in zip(effects, values, strict=True)})["point"]


def test_a_gimbal_turns_as_the_product_of_its_rotations():
    positions = np.array([[0.3, -0.4], [2.0, 1.1]])
    turned, places = gimbal().poses("mirror", positions)
    for (c, a), rotation, place in zip(positions, turned, places, strict=True):
        by_hand = Transform(rotation_z(c), np.zeros(3)) @ Transform(rotation_x(a), np.array([0, 0, 0.1])) \
            @ Transform(np.eye(3), np.array([0.2, 0, 0]))
        np.testing.assert_allclose(rotation, by_hand.rotation, atol=1e-15)
        np.testing.assert_allclose(place, by_hand.translation, atol=1e-15)


def test_a_frame_of_one_branch_is_seen_from_another():
    _, places = machine().poses("spindle", [[0.1, 0.2, 0.05]], seen_from="table")
    np.testing.assert_allclose(places, [[0.1, -0.2, 0.15]], atol=1e-15)
    _, places = gimbal().poses("mirror", [[1.0, 0.0]], seen_from="ring")
    np.testing.assert_allclose(places, [[0.2, 0.0, 0.1]], atol=1e-15)


def test_a_squareness_moves_points_by_angle_times_travel():
    spindle = machine().pose("spindle")
    squareness = location_error(machine().axis("Z"), "B")         # tilt of Z about Y
    moved = predictions(spindle, [squareness], [1e-4], [[0.0, 0.0, 0.2]])
    np.testing.assert_allclose(moved, [[0.2 * 1e-4, 0.0, 0.2]], atol=1e-9)


def test_location_errors_carry_their_iso_names():
    names = [e.name for e in location_errors(machine())]
    assert names == ["EX0X", "EB0X", "EC0X", "EY0Y", "EA0Y", "EC0Y", "EZ0Z", "EA0Z", "EB0Z"]
    assert [e.name for e in location_errors(gimbal(), ["A"])] == ["EY0A", "EZ0A", "EA0A", "EB0A", "EC0A"]
    assert [e.name for e in error_motions(machine(), ["X"])] == ["EXX", "EYX", "EZX", "EAX", "EBX", "ECX"]


def test_error_motions_are_orthogonal_to_location_errors_over_the_travel():
    x = np.linspace(0.0, 0.5, 200001)
    straightness = np.array(error_motion_basis(machine().axis("X"), 1, None).values(x))
    assert np.abs(np.trapezoid(straightness * np.stack([np.ones_like(x), x])[:, None], x)).max() < 1e-9
    partial = Rotary("A", (1, 0, 0), limits=(-0.5, 0.9))
    q = np.linspace(-0.5, 0.9, 200001)
    tilt = np.array(error_motion_basis(partial, 4, (2, 3)).values(q))
    assert np.abs(np.trapezoid(tilt * np.stack([np.ones_like(q), np.cos(q), np.sin(q)])[:, None], q)).max() < 1e-9
    with pytest.raises(DeclarationError, match="orders from 2 upward"):
        error_motion(machine().axis("X"), "Y", (1, 2))


def test_every_effect_at_zero_changes_nothing_and_at_work_something():
    mechanism = gimbal()
    axis = mechanism.axis("A")
    effects = [*location_errors(mechanism), *error_motions(mechanism), *mounting_errors(mechanism, "mirror"),
               scale(axis),
               zero_offset(axis), backlash(axis), encoder_harmonic(axis, 1), encoder_harmonic(axis, 2),
               sag(mechanism, axis),
               sag_by_load(mechanism, axis), thermal_growth(axis, "Z")]
    positions = [[0.4, 0.3], [2.0, -0.7]]
    pose = mechanism.pose("mirror")
    clean = predictions(pose, effects, [np.zeros(len(e.parameters)) for e in effects], positions, (0.1, 0.2, 0.3))
    rotations, places = mechanism.poses("mirror", positions)
    np.testing.assert_allclose(clean, rotations @ np.array([0.1, 0.2, 0.3]) + places, atol=1e-15)
    for effect in effects:
        moved = predictions(pose, [effect], [np.full(len(effect.parameters), 1e-3)], positions, (0.1, 0.2, 0.3))
        assert np.abs(moved - clean).max() > 1e-6, effect.label


def test_gravity_sags_a_rotary_axis_by_the_horizontal_lever_arm():
    mechanism = gimbal()
    effect = sag(mechanism, mechanism.axis("A"))
    positions = np.array([[0.7, 0.0], [0.7, np.pi / 2], [0.0, np.pi / 3]])
    free = predictions(mechanism.pose("mirror"), [effect], [0.0], positions, (0, 1, 0))
    bent = predictions(mechanism.pose("mirror"), [effect], [1e-3], positions, (0, 1, 0))
    fallen = (free - bent)[:, 2]
    lever = 0.2 * np.cos(positions[:, 1])          # of the load, 0.2 m along the mirror's y
    np.testing.assert_allclose(fallen, 1e-3 * lever * np.cos(positions[:, 1]), atol=1e-6 * 0.2)


def test_a_linear_scale_grows_with_temperature():
    mechanism = machine()
    effect = thermal_scale(mechanism.axis("X"))
    moved = predictions(mechanism.pose("spindle"), [effect], [10e-6], [[0.5, 0.0, 0.0]])
    np.testing.assert_allclose(moved, [[0.5 * (1 + 20e-6), 0, 0]], atol=1e-15)


def test_an_oblique_axis_is_named_by_its_own_frame():
    oblique = Rotary("B", (0, 1, 1))
    assert oblique.along == 2
    np.testing.assert_allclose(np.asarray(oblique.reference)[:, 2], np.array([0, 1, 1]) / np.sqrt(2))


def test_measured_poses_turn_into_readings_and_back():
    rotation = rotation_z(0.3) @ rotation_x(-1.0)
    near = rotation_z(0.31) @ rotation_x(-1.0)
    reading = observe.pose_readings([[1.0, 2.0, 3.0]], rotation[None], near[None])
    np.testing.assert_allclose(reading[0, 3:], rotation_vector(near.T @ rotation), atol=1e-15)
    w = observe.quaternion(rotation)
    np.testing.assert_allclose(observe.rotations_from_quaternions(*w[:, None], where="here")[0], rotation, atol=1e-15)


def test_wrong_declarations_are_refused_in_sentences():
    with pytest.raises(DeclarationError, match="axis 'A' has zero length"):
        Rotary("A", (0, 0, 0))
    with pytest.raises(DeclarationError, match="carried by 'B', which is no axis; did you mean 'B1'"):
        Mechanism("m", [Rotary("B1", (1, 0, 0)), Rotary("A", (0, 0, 1), carried_by="B")])
    with pytest.raises(DeclarationError, match="ring"):
        Mechanism("m", [Rotary("A", (1, 0, 0), carried_by="B"), Rotary("B", (1, 0, 0), carried_by="A")])
    with pytest.raises(DeclarationError, match="no frame 'mirr'; did you mean 'mirror'"):
        gimbal().pose("mirr")
    with pytest.raises(DeclarationError, match="two axes are called"):
        Mechanism("m", [Rotary("A", (1, 0, 0)), Rotary("A", (1, 0, 0))])


def test_positions_beyond_the_limits_are_named_and_degrees_are_recognised():
    mechanism = Mechanism("arm", [Rotary("A", (1, 0, 0), limits=(-2.9, 2.9)),
                                  Rotary("B", (0, 1, 0), limits=(-1.7, 1.7))])
    degrees = np.array([[0.0, 10.0], [90.0, 45.0], [-120.0, 80.0]])
    with pytest.raises(InputError, match="degrees given as radians"):
        mechanism.check_positions(degrees)
    with pytest.raises(InputError, match=r"row 12: axis 'B' is at 1\.9 rad, outside its limits"):
        mechanism.check_positions([[0.0, 0.1], [0.5, 1.9]], rows=[11, 12])
    np.testing.assert_array_equal(mechanism.check_positions(degrees * degree), degrees * degree)


def test_the_model_is_a_plain_casadi_expression():
    pose = gimbal().pose("mirror")(ca.SX.sym("q", 2))
    assert pose.translation.shape == (3, 1)
