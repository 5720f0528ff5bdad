"""Tables: units from headers, angles in every form, and errors that name file, line, column and remedy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calib import columns, files
from calib.errors import InputError
from calib.table import DATA, Table, shipped, written, xyz_mm
from calib.units import arcsec, degree, gon, mm


def read(folder, text, **options):
    path = folder / "readings.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return Table.read(path, **options)


def refusal(folder, text, column="x", dimension="length", **options):
    with pytest.raises(InputError) as caught:
        read(folder, text, **options).number(column, dimension)
    return str(caught.value)


def test_units_in_headers_become_si(tmp_path):
    table = read(tmp_path, "# source: bench\nx_mm,y [um],speed_mm_s,temp_C,time_min,k\n1,2,3,20,4,5\n")
    assert table.source == "bench"
    assert table.number("x", "length") == [1e-3]
    assert table.number("y", "length") == [2 * 1e-6]
    assert table.number("speed", "length/time") == [3 * 1e-3]
    assert table.number("temp", "temperature") == [293.15]
    assert table.number("time", "time") == [240.0]
    assert table.number("k") == [5.0]


@pytest.mark.parametrize("text", ["185°29'31.5\"", "185-29-31.5", "185d29m31.5s", "185:29:31.5", "185° 29′ 31.5″"])
def test_an_angle_in_degrees_minutes_and_seconds_is_read_exactly(text):
    assert columns.angle(text) == (185 * 3600 + 29 * 60 + 31.5) * arcsec


def test_a_negative_angle_below_one_degree_keeps_its_sign():
    assert columns.angle("-0-00-20.5") == -20.5 * arcsec


@pytest.mark.parametrize("text", ["185-60-00", "185-29-60", "185'29", "a-b-c", "1-2-3-4"])
def test_what_is_no_angle_is_refused(text):
    with pytest.raises(InputError):
        columns.angle(text)


def test_decimal_degrees_gon_arcseconds_and_sexagesimal_cells_mean_the_same_angle(tmp_path):
    table = read(tmp_path, "a_deg,b_gon,c_arcsec,d_dms,e_deg\n27,30,97200,27-00-00,27°00'00\"\n")
    for name in "abcde":
        assert table.number(name, "angle")[0] == pytest.approx(27 * degree, rel=4e-16, abs=0)
    assert table.number("b", "angle")[0] == 30 * gon


def test_a_byte_order_mark_and_blanks_around_cells_do_not_matter(tmp_path):
    assert read(tmp_path, "\ufeffx_mm , y\n 1 , 2 \n").number("x", "length") == [1 * mm]


def test_decimal_commas_are_read_where_they_are_announced(tmp_path):
    assert read(tmp_path, "x_mm;y\n1,5;2\n", decimal=",").number("x", "length") == [1.5 * mm]


def test_another_encoding_is_read_where_it_is_named(tmp_path):
    text = "Länge_mm,y\n1,2\n".encode("latin-1")
    assert read(tmp_path, text, encoding="latin-1").number("Länge", "length") == [1 * mm]


def test_columns_may_be_named_and_given_units_from_outside(tmp_path):
    table = read(tmp_path, "Lage,y\n1,2\n", unit_of={"x": "mm"}, column_of={"x": "Lage"})
    assert table.number("x", "length") == [1 * mm]


@pytest.mark.parametrize("text, words", [
    ("", ["is empty", "header"]),
    ("x_mm,y\n", ["no rows", "add one line"]),
    ("y\n1\n", ["line 1", "column 'x' is missing", "Add the column"]),
    ("xx_mm\n1\n", ["did you mean 'xx'"]),
    ("x\n1\n", ["line 1", "column 'x'", "no unit", "x_mm"]),
    ("x_deg\n1\n", ["line 1", "column 'x_deg'", "unit of angle", "length is wanted"]),
    ("x [furlong]\n1\n", ["line 1", "furlong", "known are"]),
    ("x_mm,y\n1,1\nNaN,2\n", ["line 3", "row 2", "column 'x_mm'", "'NaN'", "write it or take the row out"]),
    ("x_mm,y\n1,1\n,2\n", ["line 3", "column 'x_mm'", "empty"]),
    ("x_mm,y\n1,1\ninf,2\n", ["line 3", "'inf'"]),
    ("x_mm,y\n1,1\n1_000,2\n", ["line 3", "not a number"]),
    ("x_mm,y\n1,2\n3,4\n1,2\n", ["line 4", "repeats line 2", "take it out"]),
    ("n,x_mm\n1,2\n1,3\n", ["line 3", "column 'n'", "stands on line 2 already"]),
    ("x_mm,y\n1,2\n1,2,3\n", ["line 3", "3 cells under a header of 2"]),
    ("x_mm,y\n1,5,3,5\n", ["line 2", "decimal sign is a comma"]),
    ("x_mm;y\n1,5;3\n", ["line 2", "decimal comma", "decimal = \",\""]),
    ("x_mm,x_mm\n1,2\n", ["line 1", "twice"]),
    ("x_mm,\n1,2\n", ["line 1", "column 2 has no name"]),
    ("x_mm,y\n1,\xe9\n".encode("latin-1"), ["line 2", "not utf-8", "latin-1"]),
    ("x_mm\n1\n".encode("utf-16"), ["UTF-16"]),
])
def test_a_table_that_cannot_be_used_is_refused_with_file_line_column_and_remedy(tmp_path, text, words):
    message = refusal(tmp_path, text)
    assert "readings.csv" in message
    for word in words:
        assert word in message


def test_a_name_shared_by_two_columns_is_not_guessed(tmp_path):
    table = read(tmp_path, "hz_dms,hz_deg\n27-00-00,27.1\n")
    with pytest.raises(InputError, match="2 columns give 'hz'"):
        table.number("hz", "angle")
    assert table.number("hz_deg", "angle") == [27.1 * degree]


def test_rows_left_out_leave_the_numbers_of_the_others(tmp_path):
    table = read(tmp_path, "x_mm\n1\n2\n3\n").where(np.array([True, False, True]))
    assert list(table.row_numbers) == [1, 3]
    assert table.place(1, table.column("x")).startswith(f"{table.path}, line 4 (row 3)")


@pytest.mark.parametrize("header, value", [("a_dms", 185.49208 * degree), ("a_gon", -1.25), ("t_C", 293.65),
                                           ("x_mm", 1 / 3)])
def test_written_numbers_are_read_back(tmp_path, header, value):
    table = read(tmp_path, f"{header},k\n{'1-00-00' if header == 'a_dms' else 1},1\n")
    name, dimension = table.columns[0].name, table.columns[0].dimension
    again = Table.read(table.with_number(name, np.array([value])).write(tmp_path / "again.csv"))
    allowed = 1e-6 * arcsec if header == "a_dms" else 4e-16 * abs(value)
    assert again.number(name, dimension)[0] == pytest.approx(value, rel=0, abs=allowed)


def test_every_shipped_table_can_be_read_and_names_its_source():
    tables = sorted(DATA.rglob("*.csv"))
    assert tables
    for path in tables:
        assert shipped(str(path.relative_to(DATA))).source, path.name


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    path = files.write_json(tmp_path / "a" / "result.json", {"value": 1.0})
    before = path.read_bytes()
    with pytest.raises(TypeError):
        files.write_json(path, {"value": 2.0, "bad": object()})
    assert path.read_bytes() == before
    assert [one.name for one in path.parent.iterdir()] == ["result.json"]


def test_json_keeps_full_precision_and_has_no_nan():
    value = 0.1 + 0.2
    read_back = files.json_text({"a": np.float64(value), "b": math.nan, "c": np.array([1.0, np.inf])})
    assert repr(value) in read_back
    assert "NaN" not in read_back
    assert "Infinity" not in read_back


def test_written_columns_read_back_in_si(tmp_path):
    content = {"point": np.array(["A", "B"]), "block": np.array([1, 2]), "angle_deg": np.radians([30.0, -0.125]),
               "temp_C": np.array([293.15, 294.4]), **xyz_mm([(0.1, 0.2, -0.3), (1.0, 2.0, 3.0)])}
    (tmp_path / "points.csv").write_text(written("drawn", content))
    assert (tmp_path / "points.csv").read_text().splitlines()[2] == "A,1,30,20,100,200,-300"
    table = Table.read(tmp_path / "points.csv")
    assert table.source == "drawn" and table.text("point").tolist() == ["A", "B"]
    for header in ("angle_deg", "temp_C", "x_mm", "y_mm", "z_mm"):
        column = columns.column(header)
        assert table.number(column.name, column.dimension) == pytest.approx(content[header], rel=1e-9)


def test_a_column_row_numbers_the_rows_where_it_numbers_each_once(tmp_path):
    table = read(tmp_path, "row,x_mm\n7,1\n3,2\n12,3\n")
    assert table.row_numbers.tolist() == [7, 3, 12] and table.places(np.array([12, 7])).tolist() == [2, 0]
    assert read(tmp_path, "x_mm,row\n1,1\n2,1\n").row_numbers.tolist() == [1, 2]
