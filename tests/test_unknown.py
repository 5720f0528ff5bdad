"""Unknowns as handles: shapes, names, kinds, and what they refuse."""

import numpy as np
import pytest

from calib import Direction, Pose, Rotation, Unknown
from calib.errors import DeclarationError
from calib.geometry import Transform, rotation_about


def test_a_number_is_one_scalar_and_a_row_is_one_instance():
    assert (Unknown("a", 2.0).count, Unknown("a", 2.0).freedom) == (1, 1)
    assert (Unknown("p", [1.0, 2.0, 3.0]).count, Unknown("p", [1.0, 2.0, 3.0]).freedom) == (1, 3)
    assert (Unknown("q", np.zeros((4, 1))).count, Unknown("q", np.zeros((4, 1))).freedom) == (4, 1)


def test_labels_name_instance_and_part_only_where_there_are_several():
    assert Unknown("a", 1.0).labels == ["a"]
    assert Unknown("p", np.zeros((2, 2)), parts=("r", "t"), keys=("A", "B")).labels == [
        "p[A].r",
        "p[A].t",
        "p[B].r",
        "p[B].t",
    ]


def test_a_handle_cannot_be_changed_after_it_is_made():
    with pytest.raises(AttributeError, match="frozen"):
        Unknown("a", 1.0).name = "b"


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: Unknown("p", [1.0, 2.0], parts=("x",)), "2 parts but 1 part names"),
        (lambda: Unknown("p", np.zeros((3, 2)), keys=("A", "A", "B")), "3 instances but 2 different keys"),
        (lambda: Unknown("p", [1.0, np.nan]), "not a finite number"),
        (lambda: Unknown("p", 0.0, lower=1.0, upper=-1.0), "lower bound lies above"),
        (lambda: Unknown("p", np.zeros((2, 3)))[5], "index 5 does not exist"),
        (lambda: Unknown("p", [1.0, 2.0]).part("z"), "no part 'z'; its parts are 1, 2"),
        (lambda: Rotation("R", [[0, 1, 0], [1, 0, 0], [0, 0, 1]]), "not a rotation matrix"),
        (lambda: Direction("n", [0.0, 0.0, 0.0]), "length zero"),
    ],
)
def test_a_contradiction_is_named(make, words):
    with pytest.raises(DeclarationError, match=words):
        make()


@pytest.mark.parametrize(
    "unknown, value",
    [
        (Unknown("p", np.zeros((2, 3))), np.arange(6.0).reshape(2, 3)),
        (Unknown("a", 0.0), 3.5),
        (Rotation("R"), np.asarray(rotation_about(np.array([0.6, 0.0, 0.8]), 2.0), float)),
        (Direction("n", [0, 0, 1.0]), np.array([0.6, 0.0, -0.8])),
    ],
)
def test_values_come_back_as_they_were_stored(unknown, value):
    assert np.allclose(unknown.show(unknown.store(value)), value, atol=1e-15)


def test_a_pose_stores_and_shows_a_transform():
    turn = np.asarray(rotation_about(np.array([0.0, 0.6, 0.8]), -0.7), float)
    pose = Pose("T", turn, [1.0, 2.0, 3.0])
    shown = pose.show(pose.store(Transform(turn, np.array([4.0, 5.0, 6.0]))))
    assert np.allclose(shown.rotation, turn)
    assert np.allclose(shown.translation, [4, 5, 6])


@pytest.mark.parametrize(
    "unknown", [Rotation("R"), Direction("n", [0.3, -0.5, 0.8]), Pose("T"), Unknown("p", [1.0, 2.0])]
)
def test_moving_and_taking_the_difference_are_inverse_to_first_order(unknown):
    step = 1e-5 * np.arange(1.0, unknown.freedom + 1)[None]
    moved = unknown.move(unknown.ambient, step)
    assert np.allclose(unknown.difference(moved, unknown.ambient), step, rtol=0, atol=1e-9)


def test_a_rotation_stays_orthonormal_over_many_moves():
    unknown, stored = Rotation("R"), Rotation("R").ambient
    for k in range(2000):
        stored = unknown.move(stored, np.array([[0.3, -0.2, 0.1 + 0.001 * k]]))
    turn = unknown.show(stored)
    assert np.abs(turn @ turn.T - np.eye(3)).max() < 1e-14
