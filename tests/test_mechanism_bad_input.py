"""Wrong mechanisms and wrong readings of them through the command: one sentence with the name and the remedy, status
2."""

import importlib
import math
from functools import cache

import pytest
from command import runner
from folders import put


@cache
def example_job(name):
    return importlib.import_module(f"problems.{name}").example_job(2)


def changed(text, column, change):
    """A table with one column changed: change(cell, row)."""
    first, header, *lines = text.splitlines()
    place = header.split(",").index(column)
    rows = [line.split(",") for line in lines]
    for number, row in enumerate(rows):
        row[place] = change(row[place], number)
    return "\n".join([first, header, *(",".join(row) for row in rows)]) + "\n"


def renamed(text, *pairs):
    for before, after in pairs:
        assert before in text
        text = text.replace(before, after, 1)
    return text


def kept(text, choose):
    """A table with some rows only: choose(cells)."""
    first, header, *lines = text.splitlines()
    return "\n".join([first, header, *(line for line in lines if choose(line.split(",")))]) + "\n"


def reversed_sign(cell, _):
    return str(-float(cell))


def in_degrees(text):
    rows = (",".join(str(math.degrees(float(v))) for v in line.split(",")) for line in text.split())
    return "\n".join(rows) + "\n"


def one_joint(text):
    first = text.split()[0].split(",")
    return "\n".join(",".join([str(0.1 * i), *first[1:]]) for i in range(9)) + "\n"


# problem, file, what somebody does to it, words of the message
CASES = {
    "a parent that does not exist": ("serial_arm", "arm.urdf", lambda t: renamed(
        t, ('<parent link="link2"/>', '<parent link="link9"/>')), ["joint 'joint3'", "'link9'", "Correct the name"]),
    "an axis of zero length": ("serial_arm", "arm.urdf", lambda t: renamed(t, ('xyz="0 0 1"/>', 'xyz="0 0 0"/>')),
                               ["axis of joint 'joint1' has zero length", "give its direction"]),
    "entities": ("serial_arm", "arm.urdf", lambda t: '<!DOCTYPE r [<!ENTITY a "b"><!ENTITY c "&a;&a;">]>' + t.replace(
        '<?xml version="1.0"?>', ""), ["entities", "never expanded", "take the <!DOCTYPE ...> out"]),
    "a file from elsewhere": ("serial_arm", "arm.urdf", lambda t: '<!DOCTYPE r SYSTEM "arm.dtd">' + t.replace(
        '<?xml version="1.0"?>', ""), ["declares a document type", "take the <!DOCTYPE ...> out"]),
    "a limit that is no number": ("serial_arm", "arm.urdf", lambda t: renamed(t, ('lower="-2.9"', 'lower="-2,9"')),
                                  ["limit of joint 'joint1'", "'-2,9'", "no number", "correct it"]),
    "degrees as radians": ("serial_arm", "bench_1.csv", in_degrees, ["bench_1.csv", "axis 'joint1'", "degrees given as "
                                                                     "radians", "Say the unit"]),
    "a joint beyond its limits": ("serial_arm", "bench_1.csv", lambda t: "3.5" + t[t.index(","):],
                                  ["row 1", "'joint1' is at 3.5 rad", "outside its limits -2.9 .. 2.9"]),
    "one joint moves": ("serial_arm", "bench_1.csv", one_joint, ["only 'joint1' moves", "add poses"]),
    "quaternions in the other order": ("positioner", "poses.csv", lambda t: renamed(
        t, ("qw,qx,qy,qz", "qx,qy,qz,qw")), ["other order", "Name the columns qw, qx, qy, qz"]),
    "a quaternion of another length": ("positioner", "poses.csv", lambda t: changed(
        t, "qw", lambda v, k: str(2 * float(v)) if k == 2 else v), ["pose 3", "length", "not 1", "check the columns"]),
    "quaternions in the other order on a hexapod": ("hexapod", "poses.csv", lambda t: renamed(
        t, ("qw,qx,qy,qz", "qx,qy,qz,qw")), ["other order", "Name the columns qw, qx, qy, qz"]),
    "legs exchanged": ("hexapod", "poses.csv", lambda t: renamed(t, ("leg1_mm,leg2_mm", "leg2_mm,leg1_mm")),
                       ["poses.csv", "the loop through leg 2 is not closed", "in row 22", "check signs, units"]),
    "an axis that counts backwards in a loop": ("locator_carrier", "axes.csv", lambda t: changed(
        t, "AX_mm", reversed_sign), ["axes.csv", "the loop through AX is not closed", "in row 12", "check signs"]),
    "too few axes to hold a part": ("locator_carrier", "axes.csv", lambda t: renamed(t, ("CZ_mm", "dz_mm")),
                                    ["5 axes are read", "needs six", "add columns"]),
    "too few targets for a pose": ("locator_carrier", "targets.csv", lambda t: kept(
        t, lambda c: c[0] != "1" or c[1] > "2"), ["2 targets are seen in setting 1", "needs three", "measure more"]),
    "an axis that counts backwards": ("three_axis_turntable", "points.csv", lambda t: changed(
        t, "C_deg", reversed_sign), ["points.csv", "miss the mechanism", "the axis 'C' counts the other way"]),
    "degrees as radians without limits": ("three_axis_turntable", "points.csv", lambda t: renamed(
        t, ("C_deg,A_deg,B_deg", "C_rad,A_rad,B_rad")), ["points.csv", "degrees given as radians", "Correct that"]),
    "one axis moves": ("three_axis_turntable", "points.csv", lambda t: kept(
        t, lambda c: float(c[1]) == float(c[2]) == 0), ["points.csv", "only 'C' moves", "add poses"]),
    "millimetres as metres": ("machine_21", "points.csv", lambda t: renamed(t, ("X_mm", "X_m")),
                              ["axis 'X'", "millimetres given as metres", "Say the unit"]),
    "a reflector without offset": ("machine_21", "points.csv", lambda t: changed(
        t, "reflector", lambda v, k: "9" if k == 0 else v), ["reflector '9' has no offset", "add its row"]),
    "a target that nobody surveyed": ("gimbal", "images.csv", lambda t: changed(
        t, "target", lambda v, k: "99" if k == 4 else v), ["row 5", "target '99'", "Correct the name"]),
    "one target alone": ("gimbal", "images.csv", lambda t: kept(t, lambda c: c[2] == "3"),
                         ["points lie on one line", "measure points off it"]),
    "an image upside down": ("gimbal", "images.csv", lambda t: changed(t, "right_arcsec", reversed_sign),
                             ["images.csv", "miss the gimbal", "check the signs of right and up"]),
    "no target for the camera": ("motion_simulator", "points.csv", lambda t: kept(t, lambda c: c[5] != "T1"),
                                 ["there is no reflector T1", "call those on the seeker"]),
}


@pytest.mark.parametrize("case", CASES)
def test_a_wrong_mechanism_or_reading_is_refused_with_name_and_remedy(case, capsys, tmp_path):
    name, file, change, words = CASES[case]
    files = example_job(name)
    changed_text = change(files[file])
    assert changed_text != files[file]
    put(tmp_path, {**files, file: changed_text})
    answer = runner(capsys)("solve", tmp_path / "job.toml", "--out", tmp_path / "out")
    assert answer.status == 2 and answer.error.count("calib:") == 1
    assert "Traceback" not in answer.error and "fault of calib" not in answer.error
    said = " ".join(answer.error.split())
    for word in words:
        assert word in said, said
    assert not (tmp_path / "out" / "result.json").exists()
