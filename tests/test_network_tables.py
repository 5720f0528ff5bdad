"""Networks from tables: what is stated of uncertainty, all kinds of readings, instruments, and what may be left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib import Gaussian, covariance, linearise, reliability, solve
from calib.errors import InputError
from calib.job import Job
from calib.units import arcsec, mm
from problems import network
from problems.network import noise

HEAD = 'problem = "network"\n'
CIRCLE = '[instruments.circle]\nu = "2 arcsec"\n'


def job(folder: Path, tables: dict[str, str], more: str = "") -> Job:
    """A job with tables {name: text}, and more text; a text of more than the header is written to its file."""
    listed = "".join(f'[data.{name}]\nfile = "{name}.csv"\n' for name in tables if f"[data.{name}]" not in more)
    for name, text in tables.items():
        (folder / f"{name}.csv").write_text(text, encoding="utf-8")
    (folder / "job.toml").write_text(HEAD + more + listed, encoding="utf-8")
    return Job.read(folder / "job.toml")


def example(folder: Path, options: str = "", **changed: str) -> Job:
    """The example of the module, with other lines in some tables: {table: (old, new)}."""
    for name, text in network.example_job(1).items():
        (folder / name).write_text(text.replace('problem = "problems.network"\n', HEAD + options), encoding="utf-8")
    for name, text in changed.items():
        (folder / f"{name}.csv").write_text(text, encoding="utf-8")
    return Job.read(folder / "job.toml")


def lines(name: str) -> list[str]:
    return network.example_job(1)[f"{name}.csv"].splitlines()


# --- noise ------------------------------------------------------------------------------------------------------------


def test_pointing_counts_as_a_length_at_the_target_and_as_an_angle():
    place = {"station": np.zeros((1, 3)), "target": np.array([[30.0, 40.0, 120.0]]), "back": np.array([[50.0, 0, 0]]),
             "station_height": np.array([[1.5]]), "target_height": np.array([[1.5]])}

    def u(of: Gaussian) -> float:
        return float(of.weighting(1, 1, "here", place.__getitem__).u[0, 0])

    level = noise.of_sights(3e-5, 1 * mm, 2 * mm, 4 * mm)
    assert u(level) == pytest.approx(np.sqrt(9e-10 + (1e-6 + 4e-6 + 16e-6) / 2500.0))
    steep = noise.of_sights(3e-5, pointing=4 * mm, inclined=True)
    assert u(steep) == pytest.approx(np.sqrt(9e-10 + 16e-6 / (2500.0 + 14400.0)))
    aimed = noise.of_sights(3e-5, aiming=4e-5, per_metre=1e-6, aiming_per_metre=2e-6)
    assert u(aimed) == pytest.approx(np.sqrt((3e-5 + 50e-6) ** 2 + 16e-10 + (100e-6) ** 2))
    angle = noise.of_angles(3e-5, pointing=4 * mm, aiming=1e-5)
    assert u(angle) == pytest.approx(np.sqrt(9e-10 + 2e-10 + 2 * 16e-6 / 2500.0))


def test_what_a_job_states_of_a_circle_is_what_its_readings_have(tmp_path):
    points = "point,role,x_m,y_m\nA,fixed,0,0\nB,fixed,30,40\nC,fixed,0,100\n"
    sights = "station,target,reading_deg\nA,B,0\nA,C,36.87\n"
    more = ('[data.directions]\nfile = "directions.csv"\ninstrument = "circle"\n[instruments.circle]\n'
            'u = "2 arcsec + 0.01 arcsec/m"\nstation_centring = "0.4 mm"\npointing = "0.3 mm"\n')
    u = reliability(linearise(network.from_job(job(tmp_path, {"points": points, "directions": sights}, more)))).u
    length = np.array([50.0, 100.0])
    assert u == pytest.approx(np.sqrt(((2.0 + 0.01 * length) * arcsec) ** 2 + (0.25e-6) / length**2), rel=1e-9)


@pytest.mark.parametrize(("line", "words"), [
    ('pointing = "0.2 s"', "'0.2 s' is a time; write a length at the target"),
    ('pointing = "0.2"', "number without a unit"),
    ('target_centring = "0.2 arcsec"', "a length is wanted"),
    ('target_centring = "-0.2 mm"', "is negative")])
def test_a_wrong_unit_of_centring_and_pointing_is_named_with_its_line(tmp_path, line, words):
    points = "point,role,x_m,y_m\nA,fixed,0,0\nB,fixed,30,40\n"
    more = f'[data.azimuths]\nfile = "azimuths.csv"\ninstrument = "circle"\n{CIRCLE}{line}\n'
    with pytest.raises(InputError, match=r"job\.toml, line 7") as caught:
        network.from_job(job(tmp_path, {"points": points, "azimuths": "station,target,reading_deg\nA,B,53\n"}, more))
    assert words in str(caught.value)


# --- covariance -------------------------------------------------------------------------------------------------------

MATRIX = np.array([[4.0, 1, 0, 0, 0, 1], [1, 9, 2, 0, 1, 0], [0, 2, 5, 1, 0, 0], [0, 0, 1, 6, 2, 0],
                   [0, 1, 0, 2, 7, 1], [1, 0, 0, 0, 1, 8]])
NAMES = [f"{key}.{part}" for key in "AB" for part in "xyz"]
OBSERVED = "station,x_m,y_m,z_m\nA,1,2,3\nB,4,5,6\n"
WHOLE = '[data.coordinates]\nfile = "coordinates.csv"\ncovariance = "whole.csv"\n'


def square(names: list[str], matrix: np.ndarray, unit: str = "mm^2") -> str:
    return "\n".join([",".join(f"{name} [{unit}]" for name in names),
                      *(",".join(map(repr, row)) for row in matrix.tolist())]) + "\n"


@pytest.mark.parametrize("order", [range(6), [3, 4, 5, 0, 1, 2]])
def test_coordinates_have_the_covariance_of_their_file_in_any_order_of_its_columns(tmp_path, order):
    names, matrix = [NAMES[i] for i in order], MATRIX[np.ix_(order, order)]
    (tmp_path / "whole.csv").write_text(square(names, matrix))
    fit = linearise(solve(network.from_job(job(tmp_path, {"coordinates": OBSERVED}, WHOLE))))
    point = next(unknown for unknown in fit.layout.unknowns if unknown.name == "point")
    assert covariance(fit, point).matrix == pytest.approx(MATRIX * 1e-6, rel=1e-9, abs=1e-15)


def test_coordinates_have_the_correlations_of_their_columns(tmp_path):
    text = "station,x_m,y_m,z_m,u_x_mm,u_y_mm,u_z_mm,r_xy,r_yz\nA,1,2,3,2,3,4,0.5,-0.25\n"
    fit = linearise(solve(network.from_job(job(tmp_path, {"coordinates": text}))))
    point = next(unknown for unknown in fit.layout.unknowns if unknown.name == "point")
    expected = np.array([[4.0, 3, 0], [3, 9, -3], [0, -3, 16]]) * 1e-6
    assert covariance(fit, point).matrix == pytest.approx(expected, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize(("text", "words"), [
    (square(NAMES[:5], MATRIX[:5, :5]), "must be the 6 readings, A.x, A.y, A.z, B.x"),
    (square(NAMES, MATRIX[:5]), "has 5 rows for 6 columns"),
    (square(NAMES, MATRIX + np.eye(6, k=5)), "not symmetric at A.x, B.z"),
    (square(NAMES, MATRIX - 7 * np.eye(6)), "not positive definite"),
    (square(NAMES, MATRIX, "mm"), "'mm' is a unit of length, where a length^2 is wanted")])
def test_a_covariance_that_does_not_fit_its_table_is_named(tmp_path, text, words):
    (tmp_path / "whole.csv").write_text(text)
    with pytest.raises(InputError) as caught:
        network.from_job(job(tmp_path, {"coordinates": OBSERVED}, WHOLE))
    assert words in str(caught.value)


# --- instruments ------------------------------------------------------------------------------------------------------


def test_constants_of_instruments_are_estimated_where_the_job_frees_them(tmp_path):
    free = '["zero_offset", "index (vertical circle)", "collimation", "staff_scale"]'
    problem = network.from_job(example(tmp_path, f"[options]\nfree = {free}\n"))
    held = network.from_job(example(tmp_path))
    assert solve(problem).dof == solve(held).dof - 4
    fit = linearise(solve(problem))
    for name in ("zero_offset", "index", "collimation", "staff_scale"):
        found = covariance(fit, problem.attached_effect(name).effect)
        assert abs(found.values[0]) < 4.5 * found.u[0]


def test_a_constant_that_no_instrument_has_is_named_with_its_neighbour_in_spelling(tmp_path):
    with pytest.raises(InputError, match="has the constant 'zero_ofset'; did you mean 'zero_offset'"):
        network.from_job(example(tmp_path, '[options]\nfree = ["zero_ofset"]\n'))


def test_two_instruments_of_one_kind_have_constants_of_their_own(tmp_path):
    text = network.example_job(1)["slope_distances.csv"].splitlines()
    example(tmp_path)
    (tmp_path / "slope_distances.csv").write_text("\n".join(text[:7]) + "\n")
    (tmp_path / "others.csv").write_text("\n".join(text[:2] + text[7:]) + "\n")
    settings = (tmp_path / "job.toml").read_text() + ('[data.others]\nkind = "slope_distances"\nfile = "others.csv"\n'
                                                      'instrument = "second"\n[instruments.second]\nu = "1 mm"\n')
    (tmp_path / "job.toml").write_text(settings)
    problem = network.from_job(Job.read(tmp_path / "job.toml"))
    assert {"zero_offset (distance_meter)", "zero_offset (second)"} <= {effect.label for effect in problem.effects}
    (tmp_path / "job.toml").write_text(settings.replace('"slope_distances"\n', '"slope_distance"\n'))
    with pytest.raises(InputError, match="did you mean 'slope_distances'"):
        network.from_job(Job.read(tmp_path / "job.toml"))


def test_settings_that_stations_number_alike_are_different_settings(tmp_path):
    text = lines("directions")
    header, rows = text[1] + ",set", [f"{row},1" for row in text[2:]]
    problem = network.from_job(example(tmp_path, directions="\n".join([header, *rows]) + "\n"))
    orientation = next(unknown for unknown in problem.unknowns if unknown.name == "orientation")
    assert orientation.keys == ("A 1", "B 1")


# --- what may be left out ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("column", "cell", "words"), [
    (2, "nan", "column 'reading_m': the cell is 'nan'"), (2, "", "the cell is empty"), (2, "abc", "is not a number"),
    (1, "", "column 'target'")])
def test_a_row_that_cannot_be_read_is_refused_or_left_out_with_its_reason(tmp_path, column, cell, words):
    text = lines("slope_distances")
    cells = text[3].split(",")
    cells[column] = cell
    text[3] = ",".join(cells)
    changed = {"slope_distances": "\n".join(text) + "\n"}
    with pytest.raises(InputError, match=r"line 4 \(row 2\)"):
        network.from_job(example(tmp_path, **changed))
    one = example(tmp_path, '[options]\nleave_out = ["unreadable"]\n', **changed)
    problem = network.from_job(one)
    assert words in network.remarks(one)[0]
    assert "line 4 (row 2)" in network.remarks(one)[0]
    assert next(o for o in problem.observations if o.group == "slope_distances").rows.tolist() == [1, *range(3, 11)]


def test_a_point_listed_twice_is_refused_or_placed_by_its_readings(tmp_path):
    points = network.example_job(1)["points.csv"] + "4,adjusted,1,2,3\n4,adjusted,1,2,4\n"
    with pytest.raises(InputError, match="point '4' stands in rows 2, 3"):
        network.from_job(example(tmp_path, points=points))
    one = example(tmp_path, '[options]\nleave_out = ["duplicated"]\n', points=points)
    truth, found = solve(network.from_job(example(tmp_path))), solve(network.from_job(one))
    assert found.objective == pytest.approx(truth.objective, rel=1e-6)


def test_a_blunder_of_a_metre_is_left_out_where_that_is_asked_for(tmp_path):
    text = lines("slope_distances")
    cells = text[3].split(",")
    text[3] = ",".join([*cells[:2], str(float(cells[2]) + 1.0), *cells[3:]])
    one = example(tmp_path, '[options]\nleave_out = ["blunders"]\n', slope_distances="\n".join(text) + "\n")
    estimate = solve(network.from_job(one))
    assert estimate.p_value > 0.001
    assert "Left out: Row 2 (slope_distances A to 1) is off by about 1 m" in network.remarks(one)[0]


@pytest.mark.slow
def test_a_table_in_another_unit_is_left_out_where_that_is_asked_for(tmp_path):
    text = network.example_job(1)["height_differences.csv"].replace("reading_m", "reading_mm")
    one = example(tmp_path, '[options]\nleave_out = ["contradicting"]\n', height_differences=text)
    assert solve(network.from_job(one)).p_value > 0.001
    assert "'height_differences' are 0.001 times what all others say" in network.remarks(one)[0]


def test_a_word_that_nothing_can_be_left_out_by_is_named(tmp_path):
    with pytest.raises(InputError, match="'blunder' cannot be left out; did you mean 'blunders'"):
        network.from_job(example(tmp_path, '[options]\nleave_out = ["blunder"]\n'))


@pytest.mark.parametrize(("name", "text", "words"), [
    ("directions", "station,target,reading_deg\nA,A,3\n", "row 1 of 'directions' reads point 'A' from itself"),
    ("points", "point,role,x_m,y_m,z_m\nA,fixed,,0,10\n", "point 'A' is fixed and has no x"),
    ("directions", "station,target,reading_deg,face\nA,B,3,4\n", "4 is no face")])
def test_a_table_that_contradicts_itself_is_named(tmp_path, name, text, words):
    with pytest.raises(InputError) as caught:
        network.from_job(example(tmp_path, **{name: text}))
    assert words in str(caught.value)
