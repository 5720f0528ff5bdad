"""Networks that cannot be adjusted, or not as they are written: each says which point, what it lacks and what to do."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from command import runner

from calib import linearise, solve
from calib.errors import InputError
from calib.job import Job
from problems import network

SQUARE = {"A": (0, 0), "B": (100, 0), "C": (100, 100), "D": (0, 100)}
SIDES = (("A", "B", 100.0), ("B", "C", 100.0), ("C", "D", 100.0), ("D", "A", 100.0), ("A", "C", 141.4214),
         ("B", "D", 141.4214))


def gkf(points: str, readings: str, head: str = '<network axes-xy="ne">', before: str = "") -> str:
    return (f'<?xml version="1.0"?>\n{before}<gama-local xmlns="http://www.gnu.org/software/gama/gama-local">\n{head}\n'
            f'<parameters sigma-apr="1"/>\n<points-observations>\n{points}\n{readings}\n'
            "</points-observations>\n</network>\n</gama-local>\n")


def point(key: str, role: str = 'adj="xy"', place: tuple[float, float] | None = None) -> str:
    where = "" if place is None else f'x="{place[0]}" y="{place[1]}" '
    return f'<point id="{key}" {where}{role}/>'


def square(fixed: str = "AB", places: dict[str, tuple[float, float]] = SQUARE) -> str:
    return "\n".join(point(key, 'fix="xy"' if key in fixed else 'adj="xy"', place) for key, place in places.items())


def distances(rows: object = SIDES) -> str:
    lines = [f'<distance from="{a}" to="{b}" val="{value}" stdev="1"/>' for a, b, value in rows]
    return "<obs>\n" + "\n".join(lines) + "\n</obs>"


def job(tmp_path: Path, text: str) -> Job:
    path = tmp_path / "job.gkf"
    path.write_text(text, encoding="utf-8")
    return Job.read(path)


def refused(tmp_path: Path, text: str) -> str:
    with pytest.raises(InputError) as caught:
        network.from_job(job(tmp_path, text))
    return str(caught.value)


def test_a_point_with_too_few_readings_is_named_with_what_it_lacks(tmp_path):
    message = refused(tmp_path, gkf(square() + point("E", place=(50, 50)), distances((*SIDES, ("A", "E", 70.7)))))
    assert "point 'E' has 2 unknown coordinates (x, y) and 1 reading for them; it lacks 1" in message


def test_two_parts_that_nothing_joins_are_named(tmp_path):
    far = "".join(point(key, place=place) for key, place in (("P", (500, 0)), ("Q", (600, 0)), ("R", (550, 80))))
    rows = (*SIDES, ("P", "Q", 100.0), ("Q", "R", 94.34), ("P", "R", 94.34))
    message = refused(tmp_path, gkf(square() + far, distances(rows)))
    assert "falls apart" in message
    assert "'P', 'Q', 'R'" in message


def test_a_free_network_in_two_parts_is_named(tmp_path):
    far = "".join(point(key, place=place) for key, place in (("P", (500, 0)), ("Q", (600, 0)), ("R", (550, 80))))
    rows = (*SIDES, ("P", "Q", 100.0), ("Q", "R", 94.34), ("P", "R", 94.34))
    assert "'P', 'Q', 'R' to the rest" in refused(tmp_path, gkf(square(fixed="") + far, distances(rows)))


def test_a_point_that_nothing_reads_is_remarked_and_the_others_are_adjusted(tmp_path):
    one = job(tmp_path, gkf(square() + point("E", place=(50, 50)), distances()))
    assert "'E' is to be adjusted and nothing reads it" in network.remarks(one)[0]
    assert solve(network.from_job(one)).converged


def test_a_station_that_nobody_sees_and_that_sees_one_point_is_named(tmp_path):
    alone = '<obs from="S"><direction to="C" val="10" stdev="5"/></obs>'
    message = refused(tmp_path, gkf(square() + point("S", place=(50, 50)), distances() + alone))
    assert "point 'S' has 2 unknown coordinates (x, y) and 0 readings for them; it lacks 2" in message


def test_a_point_that_no_reading_places_is_named_with_its_readings(tmp_path):
    sights = "".join(f'<obs from="{key}"><direction to="E" val="0" stdev="5"/></obs>' for key in "CD")
    own = '<obs from="E"><direction to="A" val="0" stdev="5"/><direction to="B" val="50" stdev="5"/></obs>'
    message = refused(tmp_path, gkf(square() + point("E"), distances() + own + sights))
    assert "point 'E': its position does not follow from its readings (4 directions)" in message


def test_distances_in_another_unit_than_the_coordinates_are_named(tmp_path):
    rows = [(a, b, 1000.0 * value) for a, b, value in SIDES]
    message = refused(tmp_path, gkf(square(), distances(rows)))
    assert "the distances are 1000 times what the coordinates say" in message


@pytest.mark.parametrize(("value", "words"), [
    ("401.5", "more than a full circle"), ("38-61-10", "no angle in degrees"), ("12:30", "not a number"),
    ("nan", "not a finite number")])
def test_an_angle_that_is_none_is_named_with_its_line(tmp_path, value, words):
    reading = f'<obs>\n<angle from="A" bs="B" fs="C" val="{value}" stdev="5"/>\n</obs>'
    message = refused(tmp_path, gkf(square(), distances() + reading))
    assert words in message
    assert "line 18: <angle>" in message


def test_two_points_of_one_name_are_named_with_both_lines(tmp_path):
    message = refused(tmp_path, gkf(square() + "\n" + point("B", place=(7, 7)), distances()))
    assert "'B' was given other coordinates in line 7" in message


def test_a_point_that_does_not_exist_is_named_with_its_neighbour_in_spelling(tmp_path):
    message = refused(tmp_path, gkf(square() + point("station_1", place=(5, 5)),
                                    distances((*SIDES, ("A", "staton_1", 7.0)))))
    assert "there is no point 'staton_1'; did you mean 'station_1'?" in message


@pytest.mark.parametrize(("matrix", "words"), [
    ('<cov-mat dim="5" band="0">1 1 1 1 1</cov-mat>', "dim=5 for 6 readings"),
    ('<cov-mat dim="6" band="1">1 0 1 0 1</cov-mat>', "need 11"),
    ('<cov-mat dim="6" band="1">1 2 1 0 1 0 1 0 1 0 1</cov-mat>', "not positive definite")])
def test_a_matrix_that_does_not_fit_is_named(tmp_path, matrix, words):
    assert words in refused(tmp_path, gkf(square(), distances().replace("</obs>", matrix + "</obs>")))


@pytest.mark.parametrize(("text", "words"), [
    (gkf(square(), distances(), before='<!DOCTYPE x [<!ENTITY a "b">]>\n'), "document type"),
    (gkf(square(), distances(), head='<network axes-xy="ne"'), "is not XML"),
    (gkf(square(), distances(), head='<network axes-xy="xx">'), "axes-xy='xx'"),
    (gkf(square(), distances(), head='<network angle="left-handed">'), "did you mean 'angles'?"),
    (gkf(square(), distances().replace(' stdev="1"', "")), "has no uncertainty"),
    (gkf(square(), distances().replace('stdev="1"', 'stdev="-1"')), "must be positive"),
    (gkf(square(), distances().replace('to="B"', 'to="A"', 1)), "to itself"),
    (gkf(square(), "<vectors>" + '<vec from="A" to="B" dx="1" dy="1" dz="0"/></vectors>' + distances()),
     "a covariance matrix"),
    (gkf(square(), '<obs><direction to="A" val="1" stdev="1"/></obs>' + distances()), "from which point")])
def test_a_file_that_is_no_network_is_refused_with_its_line(tmp_path, text, words):
    assert words in refused(tmp_path, text)


def test_gross_start_values_are_named_and_the_readings_take_over(tmp_path):
    moved = {**SQUARE, "D": (700, -900), "C": (-300, 40)}
    sights = '<obs from="A"><direction to="B" val="100" stdev="5"/><direction to="D" val="0" stdev="5"/>' \
             '<direction to="C" val="50" stdev="5"/></obs>'
    # Axes x north, y east: B lies east of nothing here, its bearing from A along x is zero.
    sights = sights.replace('to="B" val="100"', 'to="B" val="0"').replace('to="D" val="0"', 'to="D" val="100"')
    one = job(tmp_path, gkf(square(places=moved), distances() + sights))
    remark = network.remarks(one)[0]
    assert "'C' by" in remark
    assert "'D' by" in remark
    estimate = solve(network.from_job(one))
    place = dict(zip(("A", "B", "C", "D"), estimate["point"], strict=True))
    assert place["D"] == pytest.approx([0, 100], abs=1e-3)
    assert place["C"] == pytest.approx([100, 100], abs=1e-3)


@pytest.mark.slow
def test_a_blunder_of_a_metre_is_the_reading_that_the_report_names(tmp_path, capsys):
    centre = [(key, "E", 70.7107) for key in "ABCD"]
    rows = [(a, b, value + (1.0 if (a, b) == ("A", "C") else 0.0)) for a, b, value in (*SIDES, *centre)]
    one = job(tmp_path, gkf(square() + point("E", place=(50, 50)), distances(rows)))
    sentence = network.advice(linearise(solve(network.from_job(one))))[0]
    assert "Row 5 (distance A to C) is off by about 1 m" in sentence
    answer = runner(capsys)("solve", one.path)
    assert "Row 5" in answer.out


def test_the_rest_is_adjusted_where_the_caller_wants_it_and_what_is_left_out_is_said(tmp_path):
    far = "".join(point(key, place=place) for key, place in (("P", (500, 0)), ("Q", (600, 0)), ("R", (550, 80))))
    rows = (*SIDES, ("P", "Q", 100.0), ("Q", "R", 94.34), ("P", "R", 94.34), ("A", "E", 70.7))
    one = job(tmp_path, gkf(square() + far + point("E", place=(50, 50)), distances(rows)))
    survey = network.reduced(network.read_gkf(one.path))
    assert set(survey.points) == set(SQUARE)
    assert "'P', 'Q', 'R'" in survey.remarks[0]
    assert "'E'" in survey.remarks[1]
    whole = solve(network.declare(survey))
    alone = solve(network.from_job(job(tmp_path, gkf(square(), distances()))))
    assert whole["point"] == pytest.approx(alone["point"], abs=1e-12)
    assert whole.dof == alone.dof


def test_readings_to_points_without_the_coordinate_they_need_take_no_part_and_are_named(tmp_path):
    up = '<height-differences><dh from="A" to="B" val="1" stdev="1"/></height-differences>'
    one = job(tmp_path, gkf(square(), distances() + up))
    assert "row 7" in network.remarks(one)[0]
    assert solve(network.from_job(one)).dof == 2


@pytest.mark.slow
@pytest.mark.parametrize(("table", "wrong", "words"), [
    ("slope_distances", "reading_mm", "'slope_distances' are 0.001 times what all others say"),
    ("height_differences", "reading_mm", "'height_differences' are 0.001 times what all others say"),
    ("directions", "reading_gon", "'directions' are 0.9 times what all others say")])
def test_readings_in_another_unit_than_their_column_says_are_named(tmp_path, capsys, table, wrong, words):
    calib = runner(capsys)
    assert calib("example", "problems.network", "--out", tmp_path, "--quiet").status == 0
    path = tmp_path / f"{table}.csv"
    path.write_text(re.sub("reading_(m|deg)", wrong, path.read_text()))
    answer = calib("solve", tmp_path / "job.toml")
    assert words in " ".join((answer.out + answer.error).split())


def test_a_fixed_point_without_coordinates_is_named_and_not_placed_by_its_readings(tmp_path):
    message = refused(tmp_path, gkf(square(fixed="AB") + point("E", 'fix="xy"'),
                                    distances((*SIDES, ("A", "E", 70.7), ("B", "E", 70.7)))))
    assert "point 'E' is fixed and has no x and no y; give its coordinates, or let it be adjusted" in message
