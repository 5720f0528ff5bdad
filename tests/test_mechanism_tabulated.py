"""Mechanisms in files: axes as lines and Denavit-Hartenberg tables come back as they were, wrong files are named."""

import numpy as np
import pytest
from test_mechanism_table import crooked

from calib.errors import InputError
from calib.mechanism import Frame, Linear, Mechanism, Rotary, table, tabulated
from calib.units import degree, mm

TREE = Mechanism("tree", axes=[Linear("X", (1, 0.2, 0), limits=(-0.1, 0.4)),
                               Rotary("C", (0, 0, -2), (0.1, 0.2, 0), "X"),
                               Rotary("A", (1, 1, 1), (0, 0, 0.3), "C", (-2.0, 1.0))],
                 frames=[Frame("tool", (0.1, 0.2, 0.3), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], "A"),
                         Frame("fixed", (1, 0, 0))])


def alike(one, other, frames, atol):
    positions = np.random.default_rng(3).uniform(-1, 1, (6, len(one.axes)))
    assert [(a.name, a.carried_by, a.is_rotary) for a in one.axes] == [(a.name, a.carried_by, a.is_rotary)
                                                                         for a in other.axes]
    np.testing.assert_allclose([a.limits for a in other.axes], [a.limits for a in one.axes], rtol=1e-14)
    for frame in frames:
        for here, there in zip(one.poses(frame, positions), other.poses(frame, positions), strict=True):
            np.testing.assert_allclose(there, here, atol=atol)


def test_axes_written_to_a_file_are_read_again(tmp_path):
    (tmp_path / "tree.csv").write_text(tabulated.write_axes(TREE, "source: drawn"))
    alike(TREE, tabulated.read_axes(tmp_path / "tree.csv"), ("tool", "fixed", "A"), 1e-15)


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_a_table_written_to_a_file_is_read_again(convention, tmp_path):
    mechanism = crooked(1, 0.1)
    (tmp_path / "dh.csv").write_text(tabulated.write_table(getattr(table, convention)(mechanism), "source: drawn"))
    alike(mechanism, tabulated.read_table(tmp_path / "dh.csv", convention), ("tip",), 1e-12)


def test_parallel_axes_keep_the_angle_of_hayati_in_the_file(tmp_path):
    mechanism = crooked(3, 1e-6)
    text = tabulated.write_table(table.standard(mechanism))
    (tmp_path / "dh.csv").write_text(text)
    assert text.splitlines()[3].split(",")[6] != ""
    alike(mechanism, tabulated.read_table(tmp_path / "dh.csv"), ("tip",), 1e-11)
    with pytest.raises(InputError, match=r"line 4: a modified table has no beta"):
        tabulated.read_table(tmp_path / "dh.csv", "modified")


def test_other_units_in_the_header_mean_the_same(tmp_path):
    (tmp_path / "dh.csv").write_text("kind,name,theta_rad,d_m,a_m,alpha_rad,lower,upper\n"
                                     "rotary,J1,0.5,0.1,0.2,-0.4,-1,1\n")
    (tmp_path / "same.csv").write_text(f"kind,name,theta_deg,d_mm,a_mm,alpha_deg,lower,upper\n"
                                       f"rotary,J1,{0.5 / degree!r},100,{0.2 / mm!r},{-0.4 / degree!r},{-1 / degree!r},"
                                       f"{1 / degree!r}\n")
    alike(tabulated.read_table(tmp_path / "dh.csv"), tabulated.read_table(tmp_path / "same.csv"), ("tip",), 1e-15)


AXES = ("kind,name,carried_by,dx,dy,dz,x_mm,y_mm,z_mm,lower,upper\n"
        "rotary,C,,0,0,1,0,0,0,-90,90\nrotary,A,C,1,0,0,0,0,100,,\n")


@pytest.mark.parametrize(("before", "after", "message"), [
    ("0,0,1,0,0,0", "0,0,0,0,0,0", r"axes.csv, line 2: axis 'C' has zero length .*give the direction"),
    ("A,C,1", "A,D,1", r"'A' is carried by 'D', which is no axis; .*There are: C, A"),
    ("x_mm", "x", r"line 1: the column 'x' needs a unit of length, as in x_mm"),
    ("x_mm", "x_deg", r"line 1: the column 'x_deg' needs a unit of length"),
    ("0,0,100", "0,zero,100", r"line 3, column 'y': 'zero' is no number; write one"),
    ("rotary,A", "revolving,A", r"line 3: the kind is 'revolving'; write one of rotary, linear, frame"),
    ("-90,90", "90,-90", r"line 2: axis 'C': its lower limit .* exchange them"),
    ("100,,", "100,", r"line 3: 10 cells where the header has 11; mend it"),
    (",dz,", ",dw,", r"line 2, column 'dz': '' is no number; add the column"),
])
def test_a_wrong_file_of_axes_is_refused_with_line_and_remedy(before, after, message, tmp_path):
    assert before in AXES
    (tmp_path / "axes.csv").write_text(AXES.replace(before, after, 1))
    with pytest.raises(InputError, match=message):
        tabulated.read_axes(tmp_path / "axes.csv")
