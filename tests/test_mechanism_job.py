"""A mechanism that nobody wrote a module for: read from a table or a URDF, measured by several instruments, as a
job."""

import json

import numpy as np
import pytest
from command import runner
from folders import put

import calib
from calib.job import Job
from calib.mechanism import table, tabulated
from calib.mechanism.identified import identified
from problems import mechanism, serial_arm
from problems.mechanism.stand import STAND, TRUTH

FILES = mechanism.example_job(4)


@pytest.fixture
def job(tmp_path):
    def job(**changed):
        put(tmp_path, {**FILES, **changed})
        return tmp_path / "job.toml"
    return job


def test_errors_that_three_instruments_can_know_come_back_and_the_rest_is_said(job):
    read = Job.read(job())
    problem = mechanism.from_job(read)
    estimate = calib.solve(problem)
    assert estimate.certificate.passed
    free = [a.unknown for a in problem.attached if not problem.is_held(a.unknown).all()]
    found = calib.covariance(calib.linearise(estimate), *free)
    truth = [TRUTH.get(name, 0.0) for name in found.names]
    errors = (found.values - truth) / found.u
    assert set(TRUTH) <= set(found.names) and np.abs(errors).max() < 4.0
    said = " ".join(mechanism.remarks(read))
    assert "EC0A (A) cannot be told from others" in said and "EC0C (C)" in said


def test_the_identified_geometry_is_written_as_tables_that_stand_where_the_true_one_does(job, tmp_path):
    read = Job.read(job())
    estimate = calib.solve(mechanism.from_job(read))
    put(tmp_path, mechanism.identified_files(read, estimate))
    by_axes = tabulated.read_axes(tmp_path / "identified_axes.csv")
    by_table = tabulated.read_table(tmp_path / "identified_dh.csv")
    positions = np.random.default_rng(1).uniform([-0.4, -3, -1], [0.4, 3, 1], (20, 3))
    turned, places = by_axes.poses("table", positions)
    for one, other in zip((turned, places), by_table.poses("tip", positions), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
    located = mechanism.effects_of(STAND)["location"]
    known = identified(STAND, {e: [TRUTH[e.label]] for e in located if e.label in TRUTH})
    # what nobody can know (where the mechanism stands) moves both alike: how far points travel is left
    travelled = [m.poses("table", positions)[1] for m in (by_axes, known.mechanism, STAND)]
    apart = [np.linalg.norm(t[:, None] - t, axis=2) for t in travelled]
    assert np.abs(apart[0] - apart[1]).max() < 0.3 * np.abs(apart[2] - apart[1]).max()


@pytest.mark.slow
def test_the_same_mechanism_as_a_table_of_denavit_and_hartenberg_fits_the_same(job):
    by_axes = calib.solve(mechanism.from_job(Job.read(job())))
    written = tabulated.write_table(table.standard(STAND, "table"))
    again = FILES["job.toml"]
    for before, after in (("data.axes", "data.table"), ("axes.csv", "dh.csv"), ('"table"', '"tip"')):
        again = again.replace(before, after)
    by_table = calib.solve(mechanism.from_job(Job.read(job(**{"job.toml": again, "dh.csv": written}))))
    assert by_table.dof == by_axes.dof
    assert by_table.objective == pytest.approx(by_axes.objective, abs=0.02)     # the same to the square of the errors


@pytest.mark.slow
def test_seats_of_an_arm_from_its_urdf_are_solved_and_the_urdf_is_written_back(capsys, tmp_path):
    files = serial_arm.example_job(1)
    names = [f"joint{i + 1}" for i in range(6)]
    lines = [f"{row},{socket}" for socket in (1, 2) for row in files[f"bench_{socket}.csv"].split()]
    job = """problem = "problems.mechanism"
[data.seats]
file = "seats.csv"
instrument = "ball"
[data.apart]
file = "apart.csv"
instrument = "ball"
[instruments.ball]
u = "0.1 mm"
[options]
urdf = "arm.urdf"
tip = "ball"
u_length = "0.3 mm"
u_angle = "5 mrad"
"""
    texts = {"job.toml": job, "arm.urdf": files["arm.urdf"], "apart.csv": "first,second,distance_mm\n1,2,50\n",
             "seats.csv": ",".join(f"{n}_rad" for n in names) + ",socket\n" + "\n".join(lines) + "\n"}
    put(tmp_path, texts)
    answer = runner(capsys)("solve", tmp_path / "job.toml", "--out", tmp_path / "out")
    assert answer.status == 0, answer.error
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["certificate"]["passed"]
    assert "<robot" in (tmp_path / "out" / "identified.urdf").read_text()


@pytest.mark.slow
def test_a_scale_that_was_left_out_is_named(capsys, job, tmp_path):
    command = runner(capsys)
    drawn = command("simulate", job(), "--seed", 3, "--with-effect", "scale_C=300 ppm", "--out", tmp_path / "s")
    assert drawn.status == 0, drawn.error
    assert command("discover", tmp_path / "s" / "job.toml", "--out", tmp_path / "d").status == 0
    answer = json.loads((tmp_path / "d" / "answer.json").read_text())
    assert [e["name"] for e in answer["effects"]] == ["scale_C"]


@pytest.mark.parametrize(("file", "before", "after", "words"), [
    ("job.toml", '[data.axes]\nfile = "axes.csv"', "", "names no mechanism; name one file, as [data.axes]"),
    ("job.toml", "[options]", '[options]\nurdf = "a.urdf"', "names axes and urdf; name one file"),
    ("job.toml", '["location"]', '["locations"]', "'locations' is no family; there are: location, scale"),
    ("job.toml", 'frame = "table"', 'frame = "tabel"', "has no frame 'tabel'; did you mean 'table'?"),
    ("distances.csv", ",S1,", ",S9,", "station 'S9' is not in [data.places]; say there roughly where it is"),
    ("points.csv", "C_deg", "C_rad", "the angles of 'C' are degrees given as radians"),
    ("points.csv", "A_deg", "a_deg", "column 'A' is missing"),
    ("axes.csv", "rotary,C", "rotary,B", "carried by 'C', which is no axis"),
])
def test_a_job_that_cannot_be_is_refused_with_the_remedy(file, before, after, words, capsys, job, tmp_path):
    assert before in FILES[file]
    path = job(**{file: FILES[file].replace(before, after, 1)})
    answer = runner(capsys)("solve", path, "--out", tmp_path / "out")
    said = " ".join(answer.error.split())
    assert answer.status == 2 and "fault of calib" not in said and any(w in said for w in words.split("|")), said
