"""Base-point jobs and case folders: columns, options, bad input, formulations."""

import numpy as np
import pytest
from folders import put
from tracked_lines import BASE, box

import calib
from calib.errors import InputError
from calib.job import Job
from calib.solve.convex import Convex
from calib.units import mm, nm, um
from problems import base_point


def job_in(folder, **changes):
    files = base_point.example_job(4)
    for old, new in changes.get("replace", {}).items():
        files = {name: text.replace(old, new) for name, text in files.items()}
    return Job.read(put(folder, files))


def test_the_example_job_is_solved_and_every_key_is_known(tmp_path):
    job = job_in(tmp_path)
    problem = base_point.from_job(job)
    estimate = calib.solve(problem)
    job.refuse_unknown_keys()
    known = calib.covariance(calib.linearise(estimate), "base_point")
    assert np.abs((known.values - [-0.2, 1.4, -0.23]) / known.u).max() < 4.5
    assert "sign of z" in base_point.remarks(job)[0]


def test_a_wrong_sense_in_a_job_is_named(tmp_path):
    job = job_in(tmp_path, replace={'counts = "shortening"': 'counts = "lengthening"'})
    with pytest.raises(InputError, match="wrong counting sense"):
        base_point.from_job(job)


def test_coordinates_with_uncertainty_need_an_instrument(tmp_path):
    job = job_in(tmp_path, replace={"[options]\n": '[options]\ncoordinates = "adjusted"\n'})
    with pytest.raises(InputError, match="line_instrument"):
        base_point.from_job(job)
    job = job_in(tmp_path, replace={"[options]\n": '[instruments.rail]\nu = "0.2 um"\n[options]\n'
                                    'coordinates = "adjusted"\nline_instrument = "rail"\n'})
    estimate = calib.solve(base_point.from_job(job))
    assert estimate.certificate.passed and "coordinates" in estimate.residuals


@pytest.mark.parametrize("old, new, message", [
    ("d_mm", "d", "column 'd': has no unit"), ("d_mm", "r_mm", "column 'd' is missing"),
    ('u = "0.5 um"\n', "", "u"), ('kind = "tracking_interferometer"', 'kind = "level"', "tracking_interferometer"),
    ('start_reading = "free"', 'start_reading = "loose"', "not known")])
def test_bad_input_is_named(tmp_path, old, new, message):
    with pytest.raises(InputError, match=message):
        base_point.from_job(job_in(tmp_path, replace={old: new}))


def test_a_job_of_two_trackers_with_absolute_ranges_and_all_columns(tmp_path):
    points, _ = box(n=6)
    bases = {"A": BASE, "B": np.array([0.9, -0.4, -0.5])}
    names = np.repeat(["x", "y", "z"], 6)
    rows = [f"{1 + 18 * k + i},{name},{names[i]},{1 + i // 6},1,{i},20.5," + ",".join(f"{c / mm:.5f}" for c in point)
            + f",{np.linalg.norm(point - base) / mm:.5f}"
            for k, (name, base) in enumerate(bases.items()) for i, point in enumerate(points)]
    header = "row,tracker,line,block,direction,time_min,temperature_C,x_mm,y_mm,z_mm,d_mm"
    (tmp_path / "lines.csv").write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    (tmp_path / "job.toml").write_text(base_point.EXAMPLE_JOB.replace('"shortening"', '"lengthening"').replace(
        '"free"\nstart_point_mm = [0.0, 0.0, 0.0]', '"absolute"'), encoding="utf-8")
    job = Job.read(tmp_path / "job.toml")
    problem = base_point.from_job(job)
    estimate = calib.solve(problem)
    job.refuse_unknown_keys()
    assert estimate["base_point"] == pytest.approx(np.array(list(bases.values())), abs=0.1 * um)
    assert np.all(estimate["dead_path"] == 0.0) and estimate.dof == 36 - 6
    labels = {effect.label for effect in problem.effects}
    assert {"drift (d)", "thermal (d)", "step (d@2)", "hysteresis (x)", "squareness (xy)"} <= labels
    assert "pitch_abbe (x)" not in labels                        # the Abbe offsets were not recorded


def test_the_formulations_of_a_job_agree_where_they_say_the_same(tmp_path):
    found = base_point.formulations(job_in(tmp_path))
    free, tied, squares = (calib.solve(found[name]) for name in ("start free", "start tied", "difference of squares"))
    u = calib.covariance(calib.linearise(free), "base_point").u
    convex = calib.solve(found["difference of squares"], Convex())
    assert np.abs((squares["base_point"] - free["base_point"]) / u)[:2].max() < 0.01       # z is not in the linear one
    assert np.abs((squares["base_point"] - convex["base_point"]) / u)[:2].max() < 1e-6
    assert np.abs((tied["base_point"] - free["base_point"]) / u).max() < 4.5 and tied.dof == free.dof + 1


CASE = """format = 1
case = "made"
scenario = "basepoint_multilateration"
[instruments]
[known]
reference_temperature_C = 20.0
wavelength_nm = 632.8
base_point_approx_mm = [-205.0, 1385.0, -290.0]
[known.axis_range_mm]
x = [0.0, 800.0]
y = [0.0, 800.0]
z = [0.0, 800.0]
"""


def case_in(folder, width):
    """A case folder whose y axis has a reversal error of some width [m]."""
    points, along = box()
    points, along = np.vstack([points, points[::-1]]), np.vstack([along, along[::-1]])
    fine = np.column_stack([0.7 + np.arange(12) * 0.1e-6, np.zeros((12, 2))])
    points, along = np.vstack([points, fine]), np.vstack([along, np.tile([1.0, 0.0, 0.0], (12, 1))])
    line = np.array([*np.repeat(["X1", "Y1", "Z1"], 9), *np.repeat(["Z1", "Y1", "X1"], 9), *["F1"] * 12])
    way = np.repeat([1, -1, 1], [27, 27, 12])
    is_fine = line == "F1"
    true = points + np.outer(0.5 * width * way * along[:, 1], [0.0, 1.0, 0.0])
    noise = np.random.default_rng(9).normal(0.0, 1.0, len(points)) * np.where(is_fine, 5 * nm, 0.5 * um)
    d = np.linalg.norm(true - BASE, axis=1) - np.where(is_fine, 1.7, 1.4) + noise
    rows = [f"{k + 1},fit,{line[k]},{1 + k // 9},1,{way[k]},0.0,{k * 0.5:.1f},20.1,"
            + ",".join(f"{v / mm:.7f}" for v in (*points[k], d[k])) for k in range(len(d))]
    header = "row,split,line,block,sweep,direction,speed_mm_s,time_min,temp_C,x_mm,y_mm,z_mm,d_mm"
    (folder / "measurements.csv").write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    described = "".join(f"""[[known.lines]]
id = "{name}"
kind = "{kind}"
axis = "{axis}"
abbe_x_mm = 90.0
abbe_y_mm = 70.0
sigma_axis_um = {0.001 if kind == "fine" else 0.05}
sigma_d_um = {0.005 if kind == "fine" else 0.5}
""" for name, kind, axis in (("X1", "long", "x"), ("Y1", "long", "y"), ("Z1", "long", "z"), ("F1", "fine", "x")))
    (folder / "case.toml").write_text(CASE + described, encoding="utf-8")
    return Job.read(folder)


def test_a_case_folder_is_a_job_with_a_zeroing_of_its_own_for_a_fine_line(tmp_path):
    problem = base_point.from_job(case_in(tmp_path, 0.0))
    estimate = calib.solve(problem)
    assert {o.group for o in problem.observations} == {"tracker long", "tracker F1"}
    known = calib.covariance(calib.linearise(estimate), "base_point")
    assert np.abs((known.values - BASE) / known.u).max() < 4.5 and estimate.dof == 66 - 5
    assert estimate.p_value > 0.001


def test_the_effect_of_a_case_is_found_in_its_units(tmp_path):
    problem = base_point.from_job(case_in(tmp_path, 12.0 * um))
    effect = problem.attached_effect("hysteresis (y)").effect
    before, after = calib.solve(problem), calib.solve(problem.free(effect))
    u = calib.covariance(calib.linearise(after), effect).u[0]
    assert before.p_value < 1e-6 and after.p_value > 0.001
    assert abs(after[effect][0] - 12.0 * um) < 4.5 * u


def test_a_case_with_one_line_is_adjusted_by_how_far_off_the_line_the_base_point_lies(tmp_path):
    case_in(tmp_path, 0.0)
    table = (tmp_path / "measurements.csv").read_text().splitlines()
    (tmp_path / "measurements.csv").write_text("\n".join([table[0], *(row for row in table if ",X1," in row), ""]))
    job = Job.read(tmp_path)
    problem = base_point.from_job(job)
    estimate = calib.solve(problem)
    assert estimate.certificate.passed and estimate.dof == 18 - 3 and estimate.p_value > 0.001
    x, y, z = estimate["base_point"]
    u = calib.covariance(calib.linearise(estimate), "base_point").u
    assert abs(np.hypot(y, z) - np.hypot(*BASE[1:])) < 4.5 * np.max(u) and abs(x - BASE[0]) < 4.5 * u[0]
    assert "turning the base point about that line changes no reading" in base_point.remarks(job)[0]


def test_a_wrong_sense_about_a_stated_base_point_is_named():
    points, _ = box()
    with pytest.raises(InputError, match="set counts = \"shortening\""):
        base_point.algebraic.begin(points, -np.linalg.norm(points - BASE, axis=1), np.zeros(len(points), int), 1.0,
                                   approximate=BASE + 0.02)
