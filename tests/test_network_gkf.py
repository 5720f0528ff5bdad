"""Networks in the XML of GNU Gama that are written in unusual ways: each is read as its manual says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command import runner
from test_network_bad_input import SIDES, SQUARE, distances, gkf, job, point, refused, square

from calib import solve
from calib.errors import InputError
from problems import network

FROM_A = '<obs from="A">{}<direction to="B" val="0" stdev="5"/><direction to="C" val="50" stdev="5"/></obs>'


def adjusted(tmp_path: Path, text: str) -> tuple[np.ndarray, int, list[str]]:
    """Coordinates, degrees of freedom and remarks of a network."""
    one = job(tmp_path, text)
    estimate = solve(network.from_job(one))
    return np.asarray(estimate["point"]), estimate.dof, network.remarks(one)


@pytest.fixture
def plain(tmp_path):
    return adjusted(tmp_path, gkf(square(), distances() + FROM_A.format("")))


def same(found, wanted):
    np.testing.assert_allclose(found[0], wanted[0], atol=1e-9)
    assert found[1] == wanted[1]
    assert found[2] == wanted[2]


def test_a_circle_that_counts_on_beyond_a_full_turn_is_the_same_circle(tmp_path, plain):
    same(adjusted(tmp_path, gkf(square(), distances() + FROM_A.format("").replace('"50"', '"450"'))), plain)


def test_a_document_type_that_only_names_its_definition_is_harmless(tmp_path, plain):
    text = gkf(square(), distances() + FROM_A.format(""), before='<!DOCTYPE gama-xml SYSTEM "gama-xml.dtd">\n')
    same(adjusted(tmp_path, text), plain)


def test_sixty_seconds_are_a_rounded_minute(tmp_path):
    found = [adjusted(tmp_path, gkf(square(), distances() + f'<obs><angle from="A" bs="B" fs="C" val="{value}" '
                                    'stdev="5"/></obs>')) for value in ("44-59-60.00", "45-00-00")]
    same(*found)


def test_observed_coordinates_are_not_the_start_values_of_their_point(tmp_path):
    observed = '<coordinates><point id="C" x="100.003" y="100.001"/><cov-mat dim="2" band="0">1 1</cov-mat>' \
               "</coordinates>"
    estimate, dof, remarks = adjusted(tmp_path, gkf(square(), distances() + observed))
    assert remarks == []
    assert dof == 6 + 2 - 4
    place = dict(zip(SQUARE, estimate, strict=True))["C"]
    assert 100.0 < place[0] < 100.003


def test_a_coordinate_by_itself_is_named_where_it_is_no_observation(tmp_path):
    observed = '<coordinates><point id="C" x="100.003"/><cov-mat dim="1" band="0">1</cov-mat></coordinates>'
    assert "has only one of x and y" in refused(tmp_path, gkf(square(), distances() + observed.replace("C", "Q")))
    assert "has neither x and y nor z" in refused(tmp_path, gkf(square(), distances() + observed))


def test_reductions_are_refused_only_where_they_would_change_a_reading(tmp_path, plain):
    text = gkf(square(), distances() + FROM_A.format("")).replace("<parameters ", '<parameters latitude="50" ')
    same(adjusted(tmp_path, text), plain)
    tall = square().replace('"xy"', '"xyz"').replace("/>", ' z="1"/>')
    sight = '<obs from="A"><z-angle to="C" val="100" stdev="9"/><z-angle to="D" val="100" stdev="9"/></obs>'
    with_height = gkf(tall, distances() + sight)
    assert "reductions" in refused(tmp_path, with_height.replace("<parameters ", '<parameters latitude="50" '))


def test_a_height_that_no_reading_depends_on_is_taken_out_and_named(tmp_path, capsys):
    up = '<height-differences><dh from="A" to="C" val="1" stdev="1"/></height-differences>'
    points = square().replace('id="A" x="0" y="0" fix="xy"', 'id="A" x="0" y="0" z="0" fix="xyz"')
    points = points.replace('id="C" x="100" y="100" adj="xy"', 'id="C" x="100" y="100" adj="xyz"')
    points = points.replace('id="D" x="0" y="100" adj="xy"', 'id="D" x="0" y="100" adj="xyz"')
    one = job(tmp_path, gkf(points, distances() + up))
    assert "Point 'D' is to be adjusted in z and no reading depends on that" in network.remarks(one)[0]
    answer = runner(capsys)("solve", one.path, "--out", tmp_path / "out")
    assert answer.status == 0
    entries = json.loads((tmp_path / "out" / "result.json").read_text())["unknowns"]
    heights = {entry["name"]: entry for entry in entries if entry["part"] == "z"}
    assert heights["C"]["value"] == pytest.approx(1.0)
    assert heights["D"]["value"] is None
    assert heights["B"]["value"] is None
    assert heights["A"]["value"] == 0.0


def blundered(size: float, parameters: str = "") -> str:
    centre = [(key, "E", 70.7107) for key in "ABCD"]
    rows = [(a, b, value + (size if (a, b) == ("A", "C") else 0.0)) for a, b, value in (*SIDES, *centre)]
    text = gkf(square() + point("E", place=(50, 50)), distances(rows))
    return text.replace("<parameters ", f"<parameters {parameters} ")


@pytest.mark.parametrize(("size", "parameters", "left_out"), [
    (0.5, 'tol-abs="300"', True), (0.2, 'tol-abs="300"', False), (1.0, "", False), (80.0, "", True)])
def test_readings_beyond_the_tolerance_of_the_file_or_beyond_all_sense_are_left_out_by_name(
    tmp_path, size, parameters, left_out
):
    estimate, dof, remarks = adjusted(tmp_path, blundered(size, parameters))
    assert dof == 10 - 6 - left_out
    if left_out:
        assert "Left out: row 5 (distance A to C) is wrong by about" in remarks[0]
        assert float(remarks[0].split("about ")[1].split(" m")[0]) == pytest.approx(size, abs=1e-3)
        assert np.abs(estimate - [*SQUARE.values(), (50, 50)]).max() < 1e-3
    else:
        assert remarks == []


def test_a_job_may_take_a_network_file_and_leave_out_what_cannot_be_used(tmp_path, capsys):
    rows = (*SIDES, ("A", "Z", 7.0), ("A", "E", 70.7))
    (tmp_path / "survey.gkf").write_text(gkf(square() + point("E", place=(50, 50)), distances(rows)))
    toml = tmp_path / "job.toml"
    toml.write_text('problem = "problems.network"\n[data]\n[options]\nnetwork = "survey.gkf"\n')
    calib = runner(capsys)
    assert "there is no point 'Z'" in calib("solve", toml).error
    toml.write_text(toml.read_text() + "leave_out_weak = true\n")
    answer = calib("solve", toml, "--out", tmp_path / "out")
    assert answer.status == 0
    assert "point 'Z'" in answer.out
    assert "point 'E'" in answer.out
    assert json.loads((tmp_path / "out" / "result.json").read_text())["dof"] == 2


def test_every_point_has_its_ellipse_in_a_table_of_its_own(tmp_path, capsys):
    # A point between two others in line: along the line both distances control it, across it nothing but the circle,
    # 5 cc seen over 50 m from A, whose orientation hangs on B alone, 100 m away.
    points = point("A", 'fix="xy"', (0, 0)) + point("B", 'fix="xy"', (100, 0)) + point("E", 'adj="xy"', (50, 0))
    sights = '<obs from="A"><direction to="B" val="0" stdev="5"/><direction to="E" val="0" stdev="5"/></obs>'
    one = job(tmp_path, gkf(points, distances((("A", "E", 50.0), ("B", "E", 50.001))) + sights))
    assert runner(capsys)("solve", one.path, "--out", tmp_path / "out").status == 0
    line = json.loads((tmp_path / "out" / "result.json").read_text())["tables"]["points"][2]
    cc = np.pi / 2e6
    assert line["ellipse_a_mm"] == pytest.approx(1 / np.sqrt(2), rel=1e-6)
    assert line["ellipse_b_mm"] == pytest.approx(5e3 * cc * 50 * np.sqrt(2), rel=1e-4)
    assert line["ellipse_bearing_gon"] % 200 == pytest.approx(0.0, abs=1e-6)
    assert line["ellipse95_a_mm"] == pytest.approx(np.sqrt(5.991465) * line["ellipse_a_mm"], rel=1e-6)
    assert line["u_aposteriori_x_mm"] == pytest.approx(line["u_x_mm"] / np.sqrt(2), rel=1e-4)  # v'Pv = 0.5, dof = 1
    written = (tmp_path / "out" / "points.csv").read_text().splitlines()
    assert written[0].startswith("point,x_m,y_m,u_x_mm")
    assert len(written) == 4


@pytest.mark.parametrize("encoding", ["iso-8859-2", "windows-1250", "utf-16", "utf-8-sig"])
def test_names_come_through_in_the_encodings_that_surveyors_use(tmp_path, encoding):
    named = gkf(square(), distances()).replace('"D"', '"Č1"')
    named = named.replace('version="1.0"', f'version="1.0" encoding="{encoding}"')
    path = tmp_path / "job.gkf"
    path.write_bytes(named.replace('encoding="utf-8-sig"', "").encode(encoding))
    assert "Č1" in network.read_gkf(path).points


def test_an_encoding_that_cannot_be_read_is_named(tmp_path):
    text = gkf(square(), distances()).replace('version="1.0"', 'version="1.0" encoding="shift_jis"')
    assert "save the file as UTF-8" in refused(tmp_path, text)


def test_a_fixed_point_that_is_observed_elsewhere_stays_and_that_is_said(tmp_path, plain):
    observed = '<coordinates><point id="B" x="100.5" y="0"/><cov-mat dim="2" band="0">1 1</cov-mat></coordinates>'
    estimate, _, remarks = adjusted(tmp_path, gkf(square(), distances() + FROM_A.format("") + observed))
    np.testing.assert_allclose(estimate, plain[0], atol=1e-9)
    assert "The coordinates of B are observed, and fixed at other values" in remarks[0]


def test_a_mixed_cluster_of_coordinates_may_say_what_its_points_are(tmp_path):
    # Q is a bench mark, P a point in space, declared where their coordinates are observed, correlated with one another.
    text = gkf('<point id="A" x="0" y="0" z="0" fix="xyz"/>',
               '<coordinates><point id="P" z="3" y="2" x="1" adj="xyz"/><point id="Q" z="3.5" adj="z"/>'
               '<cov-mat dim="4" band="3">4 1 0 0 4 0 0 9 2 9</cov-mat></coordinates>'
               '<vectors><vec from="A" to="P" dx="1.01" dy="2.0" dz="3.0"/><cov-mat dim="3" band="0">1 1 1</cov-mat>'
               '</vectors><height-differences><dh from="P" to="Q" val="0.5" stdev="2"/></height-differences>')
    one = job(tmp_path, text)
    fit = solve(network.from_job(one)).fit
    assert fit.dof == 4 + 3 + 1 - 4
    # Normal equations by hand: x and y of P, z of P and Q, in mm.
    readings = np.linalg.inv([[4, 1, 0, 0], [1, 4, 0, 0], [0, 0, 9, 2], [0, 0, 2, 9]])
    normal = readings + np.diag([1.0, 1.0, 1.0, 0.0])
    normal[2:, 2:] += np.array([[1, -1], [-1, 1]]) / 4.0
    point = next(u for u in fit.layout.unknowns if u.name == "point")
    place = dict(zip(point.keys, np.reshape(fit.values[point], (-1, 3)), strict=True))
    pull = np.array([10.0, 0.0, 0.0, 0.0])      # only x of P is told twice, 10 mm apart
    np.testing.assert_allclose(place["P"][0], 1.0 + 1e-3 * np.linalg.solve(normal, pull)[0], atol=1e-9)
    np.testing.assert_allclose(place["P"][1], 2.0 + 1e-3 * np.linalg.solve(normal, pull)[1], atol=1e-9)


def test_what_cannot_be_read_is_left_out_by_line_where_the_rest_is_wanted(tmp_path):
    rows = distances().replace('val="141.4214"', 'val="nan"', 1).replace('to="B" val="100.0"', 'val="100.0"')
    observed = '<coordinates><point id="C" x="100.003" y="oops"/><point id="D" x="0" y="100"/>' \
               '<cov-mat dim="4" band="3">1 0 0 0 1 0 0 1 0.5 1</cov-mat></coordinates>'
    bare = '<obs from="A"><z-angle to="C" val="100"/></obs>'
    one = job(tmp_path, gkf(square() + point("C", place=(7, 7)), rows + observed + bare))
    with pytest.raises(InputError, match="other coordinates"):
        network.read_gkf(one.path)
    survey = network.read_gkf(one.path, strict=False)
    assert [remark.split(":")[0] for remark in survey.remarks] == [
        "Taken as without coordinates", *["Left out"] * 4]
    assert "has no to" in survey.remarks[1] or "does not say to which" in survey.remarks[1]
    assert "row 5" in survey.remarks[2]
    assert "y='oops' is not a number" in survey.remarks[3]
    assert "the zenith angle has no uncertainty" in survey.remarks[4]
    numbers = sorted(int(n) for batch in survey.batches for n in batch.numbers)
    assert numbers == [2, 3, 4, 6, 8]
    assert np.isnan(survey.points["C"].position).all()
