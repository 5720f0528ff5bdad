import casadi as ca
import numpy as np
import pytest

from calib import geometry
from calib.errors import InputError
from calib.geometry import Transform

SEEDS = (1, 2, 3)


def random_rotation(generator):
    axis = geometry.unit(generator.normal(size=3))
    return geometry.rotation_about(axis, generator.uniform(-3.0, 3.0))


def evaluated(function, *values):
    """The same function traced with CasADi symbols and evaluated at the values."""
    symbols = [ca.SX.sym("v", *np.shape(value)) for value in values]
    answer = np.array(ca.Function("f", symbols, [function(*symbols)])(*values))
    return answer[:, 0] if answer.shape[1] == 1 else answer


@pytest.mark.parametrize("seed", SEEDS)
def test_expressions_and_numbers_follow_the_same_formulas(seed):
    generator = np.random.default_rng(seed)
    a, b, c, d = generator.normal(size=(4, 3))
    frame, angle = random_rotation(generator), generator.uniform(-3.0, 3.0)
    axis = geometry.unit(a)
    cases = [(geometry.cross, a, b), (geometry.unit, a), (geometry.skew, a), (geometry.rotation_about, axis, angle),
             (geometry.small_rotation, a), (geometry.small_rotation_vector, frame), (geometry.rotation_vector, frame),
             (geometry.rotation_x, angle), (geometry.rotation_y, angle), (geometry.rotation_z, angle),
             (geometry.rotation_from_rpy, *a), (geometry.rpy_from_rotation, frame), (geometry.polar_from_cartesian, a),
             (geometry.cartesian_from_polar, *a), (geometry.move_direction, frame, a[:2]),
             (geometry.local_direction, frame, axis), (geometry.foot_on_line, a, b, axis),
             (geometry.wrap, 9.0 * a, 2.0),
             (lambda *lines: geometry.common_perpendicular(*lines)[0], a, b, c, d),
             (lambda *lines: geometry.common_perpendicular(*lines)[1], a, b, c, d)]
    for function, *values in cases:
        np.testing.assert_allclose(evaluated(function, *values), function(*values), atol=4e-15, rtol=4e-15)
    for function, *values in [(geometry.dot, a, b), (geometry.norm, a), (geometry.distance_to_line, a, b, axis),
                              (geometry.signed_line_distance, a, b, c, d),
                              (geometry.signed_distance_to_plane, a, b, axis)]:
        assert evaluated(function, *values)[0] == pytest.approx(float(function(*values)), rel=1e-14)


@pytest.mark.parametrize("seed", SEEDS)
def test_known_numbers_and_symbols_mix_in_one_expression(seed):
    generator = np.random.default_rng(seed)
    a, b, point = generator.normal(size=(3, 3))
    rotation, other = random_rotation(generator), random_rotation(generator)
    a_from_b, b_from_c = Transform(rotation, a), Transform(other, b)
    chained = (a_from_b @ b_from_c) @ point
    np.testing.assert_allclose(evaluated(lambda p: (a_from_b @ b_from_c) @ p, point), chained, atol=1e-14)
    np.testing.assert_allclose(evaluated(lambda t: a_from_b @ (Transform(other, t) @ point), b), chained, atol=1e-14)
    np.testing.assert_allclose(evaluated(lambda r: Transform(r, a) @ (b_from_c @ point), rotation), chained, atol=1e-14)
    np.testing.assert_allclose(evaluated(lambda d: geometry.foot_on_line(point, a, d), geometry.unit(b)),
                               geometry.foot_on_line(point, a, geometry.unit(b)), atol=1e-14)
    np.testing.assert_allclose(evaluated(lambda o: geometry.cross(a, o) + geometry.cross(o, b), point),
                               np.cross(a, point) + np.cross(point, b), atol=1e-14)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_transform_and_its_inverse_cancel_and_chain(seed):
    generator = np.random.default_rng(seed)
    a_from_b = Transform(random_rotation(generator), generator.normal(size=3))
    b_from_c = Transform(random_rotation(generator), generator.normal(size=3))
    points = generator.normal(size=(5, 3))
    np.testing.assert_allclose(a_from_b.inverse() @ (a_from_b @ points), points, atol=1e-14)
    np.testing.assert_allclose((a_from_b @ b_from_c) @ points, a_from_b @ (b_from_c @ points), atol=1e-14)
    np.testing.assert_allclose(a_from_b @ points[0], (a_from_b @ points)[0], atol=1e-15)
    moved = a_from_b @ points
    np.testing.assert_allclose(a_from_b.turn(points[1] - points[0]), moved[1] - moved[0], atol=1e-14)
    np.testing.assert_array_equal(Transform.identity() @ points, points)


@pytest.mark.parametrize("seed", SEEDS)
def test_rotations_are_orthogonal_and_turn_right_handed(seed):
    generator = np.random.default_rng(seed)
    for rotation in (random_rotation(generator), geometry.small_rotation(generator.normal(size=3)),
                     geometry.rotation_from_rpy(*generator.normal(size=3)),
                     geometry.orthonormal_frame(generator.normal(size=3))):
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-14)
    quarter = np.pi / 2
    np.testing.assert_allclose(geometry.rotation_x(quarter) @ [0, 1, 0], [0, 0, 1], atol=1e-16)
    np.testing.assert_allclose(geometry.rotation_y(quarter) @ [0, 0, 1], [1, 0, 0], atol=1e-16)
    np.testing.assert_allclose(geometry.rotation_z(quarter) @ [1, 0, 0], [0, 1, 0], atol=1e-16)
    for axis, about in zip(np.eye(3), (geometry.rotation_x, geometry.rotation_y, geometry.rotation_z), strict=True):
        np.testing.assert_allclose(geometry.rotation_about(axis, 0.7), about(0.7), atol=1e-16)


def test_the_small_rotation_is_the_identity_with_unit_derivative_at_zero():
    vector = ca.SX.sym("v", 3)
    slope = ca.Function("slope", [vector], [ca.jacobian(geometry.small_rotation(vector), vector)])
    np.testing.assert_array_equal(geometry.small_rotation(np.zeros(3)), np.eye(3))
    for axis, derivative in zip(np.eye(3), np.array(slope(np.zeros(3))).T, strict=True):
        np.testing.assert_array_equal(derivative.reshape(3, 3).T, geometry.skew(axis))


def test_the_small_rotation_turns_by_the_cayley_angle():
    vector = np.array([0.3, -0.4, 1.2])
    length = geometry.norm(vector)
    expected = geometry.rotation_about(vector / length, 2.0 * np.arctan(length / 2.0))
    np.testing.assert_allclose(geometry.small_rotation(vector), expected, atol=1e-15)
    np.testing.assert_allclose(geometry.small_rotation_vector(expected), vector, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 1e-8, 1e-3, 1.0, 3.0, np.pi - 1e-3, np.pi - 1e-8, np.pi - 1e-14])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, -1, 0), (0, 0, 1), (1, 2, -2), (-1, 1e-9, 0)])
def test_the_rotation_vector_is_exact_from_nothing_to_half_a_turn(angle, axis):
    axis = geometry.unit(axis)
    vector = geometry.rotation_vector(geometry.rotation_about(axis, angle))
    np.testing.assert_allclose(vector, angle * axis, atol=4e-15, rtol=4e-15)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 2, -2)])
def test_the_rotation_vector_of_exactly_half_a_turn_has_the_axis_of_either_sense(axis):
    axis = geometry.unit(axis)
    vector = geometry.rotation_vector(2.0 * np.outer(axis, axis) - np.eye(3))
    assert geometry.norm(vector) == pytest.approx(np.pi, abs=1e-14)
    np.testing.assert_allclose(geometry.cross(vector, axis), 0.0, atol=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-6, 0.0632, 0.0633, 0.5, 2.5])
def test_the_symbolic_rotation_vector_and_its_derivatives_are_smooth(size):
    local = ca.SX.sym("v", 3)
    axis = geometry.unit([0.6, -0.3, 0.7])
    log = geometry.rotation_vector(geometry.rotation_about(axis, size) @ geometry.small_rotation(local))
    slope = ca.Function("slope", [local], [log, ca.jacobian(log, local), ca.hessian(ca.dot(log, log), local)[0]])
    value, jacobian, hessian = (np.array(answer) for answer in slope(np.zeros(3)))
    np.testing.assert_allclose(value[:, 0], size * axis, atol=1e-15, rtol=1e-14)
    # the inverse right Jacobian of the rotation group, from its closed form (Sola 2018, equation 144)
    turn = geometry.skew(size * axis)
    second = 1 / 12 if size < 1e-3 else 1 / size**2 - (1 + np.cos(size)) / (2 * size * np.sin(size))
    np.testing.assert_allclose(jacobian, np.eye(3) + turn / 2 + second * turn @ turn, atol=1e-9)
    assert np.all(np.isfinite(hessian))
    if size <= 1e-6:
        np.testing.assert_allclose(hessian, 2 * np.eye(3), atol=1e-8)


@pytest.mark.parametrize("seed", SEEDS)
def test_roll_pitch_yaw_come_back(seed):
    angles = np.random.default_rng(seed).uniform([-3, -1.5, -3], [3, 1.5, 3])
    np.testing.assert_allclose(geometry.rpy_from_rotation(geometry.rotation_from_rpy(*angles)), angles, atol=1e-14)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, 1.3])
def test_roll_pitch_and_yaw_give_the_rotation_back_at_the_pole_too(pitch):
    rotation = geometry.rotation_from_rpy(0.4, pitch, -1.1)
    again = geometry.rotation_from_rpy(*geometry.rpy_from_rotation(rotation))
    np.testing.assert_allclose(again, rotation, atol=1e-15)


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 1, -1e-17), (1e-9, 0, -1), (3, -4, 12)])
def test_a_frame_stands_on_its_direction_and_a_direction_moves_from_it(direction):
    frame = geometry.orthonormal_frame(direction)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=2e-16)
    np.testing.assert_allclose(frame[:, 2], geometry.unit(direction), atol=1e-16)
    moved = geometry.move_direction(frame, np.array([0.3, -0.2]))
    assert geometry.norm(moved) == pytest.approx(1.0, abs=2e-16)
    np.testing.assert_allclose(geometry.local_direction(frame, moved), [0.3, -0.2], atol=1e-15)
    local = ca.SX.sym("v", 2)
    slope = ca.Function("slope", [local], [ca.jacobian(geometry.move_direction(frame, local), local)])
    np.testing.assert_array_equal(np.array(slope(np.zeros(2))), frame[:, :2])


@pytest.mark.parametrize("seed", SEEDS)
def test_polar_and_cartesian_are_inverse_of_each_other(seed):
    points = np.random.default_rng(seed).normal(size=(20, 3))
    polar = geometry.polar_from_cartesian(points)
    np.testing.assert_allclose(geometry.cartesian_from_polar(*polar.T), points, atol=1e-15)
    np.testing.assert_allclose(geometry.polar_from_cartesian([0.0, 2.0, 0.0]), [2.0, np.pi / 2, np.pi / 2], rtol=1e-16)


def test_the_common_perpendicular_of_two_lines_of_known_distance():
    # line a along x at height 0, line b along y at height 5: feet above each other, b on the side of x cross y = z
    feet = geometry.common_perpendicular(np.array([7.0, 3, 0]), np.array([2.0, 0, 0]),
                                         np.array([-4.0, 9, 5]), np.array([0, -3.0, 0]))
    np.testing.assert_allclose(feet[0], [-4, 3, 0], atol=1e-14)
    np.testing.assert_allclose(feet[1], [-4, 3, 5], atol=1e-14)
    x, y = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    assert geometry.signed_line_distance(np.zeros(3), x, np.array([1.0, 1, 5]), y) == 5.0
    assert geometry.signed_line_distance(np.zeros(3), y, np.array([1.0, 1, 5]), x) == -5.0
    with pytest.raises(InputError, match="parallel"):
        geometry.common_perpendicular(np.zeros(3), x, y, 2.0 * x)


def test_wrapped_angles_lie_within_half_a_period_and_keep_their_derivative():
    values = np.array([-5.0, -1.0, -0.25, 0.0, 0.25, 0.99, 1.0, 7.3])
    wrapped = geometry.wrap(values, 2.0)
    assert np.all((wrapped >= -1.0) & (wrapped < 1.0))
    np.testing.assert_allclose(np.sin(np.pi * wrapped), np.sin(np.pi * values), atol=1e-14)
    angle = ca.SX.sym("angle")
    assert float(ca.Function("slope", [angle], [ca.jacobian(geometry.wrap(angle, 2.0), angle)])(7.3)) == 1.0


def test_a_zero_vector_has_no_direction():
    with pytest.raises(InputError, match="length zero"):
        geometry.unit(np.zeros(3))
