"""Kinematics of drawn robot descriptions against an independent implementation: trees, sliders, fixed and parallel
axes."""

import numpy as np
import pytest

from calib.errors import InputError
from calib.mechanism import urdf

SEEDS = range(12)


def drawn(seed):
    """A tree of 3 to 10 joints: turning with limits and without, sliding, fixed; some parallel, some at the pole of
    roll, pitch, yaw; axes of any length and sense."""
    generator = np.random.default_rng(seed)
    lines = ["<link name='base_link'/>", "<link name='base'/>",
             "<joint name='to base' type='fixed'><parent link='base_link'/><child link='base'/>"
             "<origin xyz='0 0 0.1' rpy='0 0 3.14159265'/></joint>"]
    links = ["base_link", "base"]
    for i in range(int(generator.integers(3, 11))):
        kind = generator.choice(["revolute", "continuous", "prismatic", "fixed"], p=[0.4, 0.2, 0.2, 0.2])
        # half of the joints go on from the last link, the others branch off anywhere
        parent = links[-1] if generator.random() < 0.5 else str(generator.choice(links))
        rpy = np.zeros(3) if generator.random() < 0.3 else generator.uniform(-3, 3, 3)
        rpy[1] = np.pi / 2 if generator.random() < 0.2 else rpy[1]
        axis = generator.choice([-1.0, 0.0, 1.0], 3) if generator.random() < 0.5 else generator.normal(0, 2, 3)
        axis = axis if np.any(axis) else np.array([0.0, 0.0, -1.0])
        xyz = generator.normal(0, 0.5, 3)
        lines.append(f"<link name='link-{i}'/><joint name='joint {i}' type='{kind}'><parent link='{parent}'/>"
                     f"<child link='link-{i}'/><origin xyz='{' '.join(map(repr, map(float, xyz)))}' "
                     f"rpy='{' '.join(map(repr, map(float, rpy)))}'/><axis xyz='{' '.join(map(str, axis))}'/>"
                     "<limit lower='-3' upper='3' effort='1' velocity='1'/></joint>")
        links.append(f"link-{i}")
    return f"<robot name='drawn'>{''.join(lines)}</robot>"


def positions_of(mechanism, seed, n=5):
    return np.random.default_rng([seed, 1]).uniform(-3, 3, (n, len(mechanism.axes)))


def everywhere(mechanism, positions):
    return {frame.name: mechanism.poses(frame.name, positions) for frame in mechanism.frames}


@pytest.mark.parametrize("seed", SEEDS)
def test_every_link_of_a_drawn_tree_stands_where_pinocchio_says(seed):
    pinocchio = pytest.importorskip("pinocchio")
    text = drawn(seed)
    model, mechanism = pinocchio.buildModelFromXML(text), urdf.mechanism(urdf.parse(text))
    data, positions = model.createData(), positions_of(mechanism, seed)
    ours = everywhere(mechanism, positions)
    for row, command in enumerate(positions):
        q = pinocchio.neutral(model)
        for value, axis in zip(command, mechanism.axes, strict=True):
            joint = model.joints[next(model.getJointId(n) for n in model.names if urdf.identifier(n) == axis.name)]
            q[joint.idx_q:joint.idx_q + joint.nq] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
        pinocchio.framesForwardKinematics(model, data, q)
        for frame in (f for f in model.frames if f.type == pinocchio.FrameType.BODY and f.name != "universe"):
            pose = data.oMf[model.getFrameId(frame.name, pinocchio.FrameType.BODY)]
            rotations, places = ours[urdf.frame_name(frame.name, "base_link")]
            np.testing.assert_allclose(rotations[row], pose.rotation, atol=1e-12)
            np.testing.assert_allclose(places[row], pose.translation, atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_drawn_tree_is_written_and_read_again(seed):
    description = urdf.parse(drawn(seed))
    mechanism = urdf.mechanism(description)
    again = urdf.mechanism(urdf.parse(urdf.written(description, mechanism)))
    positions = positions_of(mechanism, seed)
    before, after = everywhere(mechanism, positions), everywhere(again, positions)
    assert list(before) == list(after) and [a.limits for a in again.axes] == [a.limits for a in mechanism.axes]
    for name, poses in before.items():
        for one, other in zip(poses, after[name], strict=True):
            np.testing.assert_allclose(one, other, atol=1e-13)


def test_a_link_named_base_that_is_not_the_base_keeps_its_own_place():
    mechanism = urdf.mechanism(urdf.parse(drawn(1)))
    _, place = mechanism.poses("base_", np.zeros((1, len(mechanism.axes))))
    np.testing.assert_allclose(place, [[0.0, 0.0, 0.1]])
    np.testing.assert_allclose(mechanism.poses("base", np.zeros((1, len(mechanism.axes))))[1], np.zeros((1, 3)))


ONE = ("<robot name='r'><link name='a'><inertial><mass value='1'/></inertial></link><link name='b'/><joint name='j' "
       "type='revolute'><parent link='a'/><child link='b'/><limit lower='-1' upper='1' effort='1'/>{}</joint></robot>")


@pytest.mark.parametrize(("wrong", "right", "message"), [
    ("lower='-1'", "lower='low'", "the limit of joint 'j' has lower = 'low', which is no number; correct it"),
    ("effort='1'", "effort='nan'", "the limit of joint 'j' has effort = 'nan', which is no number"),
    ("value='1'", "value='1 kg'", "the mass of link 'a' has value = '1 kg', which is no number"),
    ("name='b'", "name='a'", "child link 'b', which does not exist"),
    ("type='revolute'", "", "joint 'j' has no type; add it"),
    ("<parent link='a'/>", "", "joint 'j': its <parent> has no link; add it"),
])
def test_a_number_that_is_none_and_a_part_that_is_missing_are_named(wrong, right, message):
    with pytest.raises(InputError, match=message):
        urdf.parse(ONE.format("").replace(wrong, right), "arm.urdf")


def test_a_joint_that_mimics_another_is_refused_by_name_where_it_is_on_the_way():
    description = urdf.parse(ONE.format("<mimic joint='k'/>"), "gripper.urdf")
    with pytest.raises(InputError, match=r"gripper\.urdf: joint 'j' mimics another"):
        urdf.mechanism(description)
    assert urdf.mechanism(description, tip="a").axes == ()
