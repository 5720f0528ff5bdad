"""URDF: read like an independent implementation, refused in sentences, and written back with identified geometry."""

import numpy as np
import pytest

import calib
from calib.errors import InputError
from calib.mechanism import Frame, Mechanism, Rotary, encoder_harmonic, location_errors, urdf, zero_offset
from calib.mechanism.identified import identified
from problems import serial_arm

TEXT = serial_arm.example_urdf()


def angles(seed, n=20):
    return np.random.default_rng(seed).uniform(-2.0, 2.0, (n, 6))


def poses_by_rotating_link_by_link(description, tip, positions):
    """Poses (n, 4, 4) from the definition of URDF: one matrix a joint, in plain NumPy, sharing no code with the
    package."""
    def matrix(rotation, translation=(0, 0, 0)):
        m = np.eye(4)
        m[:3, :3], m[:3, 3] = rotation, translation
        return m

    def about(axis, angle):
        k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    import xml.etree.ElementTree as ElementTree
    joints = {j.find("child").get("link"): j for j in ElementTree.fromstring(description).findall("joint")}
    chain, link = [], tip
    while link in joints:
        chain.insert(0, joints[link])
        link = joints[link].find("parent").get("link")
    result = []
    for row in positions:
        pose, moving = np.eye(4), iter(row)
        for joint in chain:
            r, p, y = (float(v) for v in joint.find("origin").get("rpy").split())
            turn = about([0, 0, 1], y) @ about([0, 1, 0], p) @ about([1, 0, 0], r)
            pose = pose @ matrix(turn, [float(v) for v in joint.find("origin").get("xyz").split()])
            if joint.get("type") != "fixed":
                pose = pose @ matrix(about([float(v) for v in joint.find("axis").get("xyz").split()], next(moving)))
        result.append(pose)
    return np.array(result)


def test_kinematics_agree_with_the_definition_link_by_link():
    mechanism = urdf.mechanism(urdf.parse(TEXT), tip="ball")
    positions = angles(1)
    rotations, places = mechanism.poses("ball", positions)
    expected = poses_by_rotating_link_by_link(TEXT, "ball", positions)
    np.testing.assert_allclose(rotations, expected[:, :3, :3], atol=1e-14)
    np.testing.assert_allclose(places, expected[:, :3, 3], atol=1e-14)


def test_kinematics_agree_with_pinocchio():
    pinocchio = pytest.importorskip("pinocchio")
    model = pinocchio.buildModelFromXML(TEXT)
    data = model.createData()
    positions = angles(2)
    rotations, places = urdf.mechanism(urdf.parse(TEXT), tip="ball").poses("ball", positions)
    for q, rotation, place in zip(positions, rotations, places, strict=True):
        pinocchio.framesForwardKinematics(model, data, q)
        pose = data.oMf[model.getFrameId("ball")]
        np.testing.assert_allclose(rotation, pose.rotation, atol=1e-12)
        np.testing.assert_allclose(place, pose.translation, atol=1e-12)


def test_identified_geometry_is_written_back_and_read_again():
    description = urdf.parse(TEXT)
    mechanism = urdf.mechanism(description, tip="ball")
    effects = [*location_errors(mechanism), zero_offset(mechanism.axis("joint3")),
               encoder_harmonic(mechanism.axis("joint2"))]
    generator = np.random.default_rng(5)
    values = {e: generator.normal(0, 1e-3, len(e.parameters)) for e in effects}
    moved = identified(mechanism, values)
    assert moved.left_out == ("encoder_1x_joint2 (joint2)",)
    again = urdf.mechanism(urdf.parse(urdf.written(description, moved.mechanism)), tip="ball")
    positions = angles(3, 5)
    # the model with its errors, by the engine, must be where the written URDF says
    from calib.mechanism import observe
    observations = calib.Observations(observe.measured_point(mechanism.pose("ball")), calib.Pose("world"), positions,
                                      calib.Shared((0.0, 0.0, 0.0)), readings=np.zeros((5, 3)), u=1.0, group="ball")
    problem = calib.Problem([observations], effects=effects[:-1])
    expected = calib.predict(problem, {problem.parameters(e): values[e][None] for e in effects[:-1]})["ball"]
    np.testing.assert_allclose(again.poses("ball", positions)[1], expected, atol=1e-13)


@pytest.mark.parametrize("wrong, right, message", [
    ('link="link3"', 'link="link9"', "the parent link 'link9', which does not exist|the child link 'link9'"),
    ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "the axis of joint 'joint1' has zero length"),
    ('type="revolute"', 'type="floating"', "joint 'joint1' is of type 'floating', which is no single axis"),
    ('xyz="0.02 0.01 0.15"', 'xyz="0.02 0.01"', "the origin xyz of 'ball_joint' is '0.02 0.01', not three numbers"),
    ('<child link="link2"/>', '<child link="link1"/>', "link 'link1' is carried by two joints, 'joint1' and 'joint2'"),
    ('lower="-2.9" upper="2.9"', 'lower="2.9" upper="-2.9"', "joint 'joint1' has the limits"),
    ("<robot name", "<!DOCTYPE robot [<!ENTITY a 'b'>]><robot name", "declares a document type or XML entities"),
    ("</robot>", "", "is not XML"),
    ("<robot name", "<sdf name", "is not XML"),
])
def test_a_wrong_description_is_refused_in_a_sentence(wrong, right, message):
    with pytest.raises(InputError, match=message):
        urdf.parse(TEXT.replace(wrong, right, 1), "arm.urdf")


def test_a_tip_that_does_not_exist_is_named():
    with pytest.raises(InputError, match="has no link 'hand' to be the tip; there are: link0"):
        urdf.mechanism(urdf.parse(TEXT), tip="hand")
    with pytest.raises(InputError, match="link 'link2' is not carried by 'link4'"):
        urdf.mechanism(urdf.parse(TEXT), base="link4", tip="link2")


def test_weights_and_limits_come_from_the_description():
    mechanism = urdf.mechanism(urdf.parse(TEXT), tip="ball")
    assert [load.mass for load in mechanism.loads] == [3.5, 3.0, 2.5, 2.0, 1.5, 1.0]
    assert mechanism.axis("joint1").limits == (-2.9, 2.9)
    with pytest.raises(InputError, match="degrees given as radians"):
        mechanism.check_positions(np.full((3, 6), 90.0) + np.arange(3)[:, None])


def test_constant_errors_move_the_axes_and_frames_of_a_mechanism():
    mechanism = Mechanism("one", [Rotary("C", (0, 0, 1))], [Frame("table", (0.1, 0, 0), carried_by="C")])
    tilt = location_errors(mechanism)[2]
    assert tilt.name == "EA0C"
    moved = identified(mechanism, {tilt: [1e-3]}).mechanism
    np.testing.assert_allclose(moved.axis("C").direction, [0, -1e-3, 1], atol=1e-6)
