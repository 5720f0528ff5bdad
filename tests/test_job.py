"""Jobs: what a TOML file says reaches the model, and what it says wrongly is named with line and key."""

from __future__ import annotations

import datetime
import re
from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from calib.job import Job
from calib.units import arcsec, mm, um, urad

DATA = "row,line,x_mm,d_mm\n1,X,0,0\n2,X,100,1\n3,Y,200,2\n"
JOB = """problem = "problems.base_point"
[data.lines]
file = "lines.csv"
instrument = "tracker"
[instruments.tracker]
kind = "tracking_interferometer"
u = "0.5 um + 0.2 um/m"
[options]
start_reading = "free"
"""


@pytest.fixture
def write(tmp_path):
    (tmp_path / "lines.csv").write_text(DATA)

    def write(more="", text=JOB):
        (tmp_path / "job.toml").write_text(text + more)
        return tmp_path / "job.toml"

    return write


def refusal(path):
    with pytest.raises(InputError) as caught:
        Job.read(path)
    return str(caught.value)


def test_a_job_gives_tables_instruments_and_options_in_si(write):
    job = Job.read(write())
    assert list(job.table("lines").number("x", "length")) == [0.0, 0.1, 0.2]
    tracker = job.instrument("lines")
    assert tracker.uncertainty("u", "length") == pytest.approx((0.5 * um, 0.2e-6), rel=4e-16)
    assert job.options.text("start_reading", among=("free", "tied")) == "free"
    assert tracker.text("kind") == "tracking_interferometer"
    job.refuse_unknown_keys()


def test_a_key_that_nobody_asks_for_is_named_with_its_line_and_the_near_match(write):
    job = Job.read(write(text=JOB.replace("start_reading", "start_raeding")))
    job.options.text("start_reading", "free")
    job.instrument("lines").uncertainty("u", "length")
    with pytest.raises(InputError, match=r"line 9, key 'options.start_raeding'.*did you mean 'start_reading'"):
        job.refuse_unknown_keys()


def test_units_may_stand_in_keys_or_in_texts(write):
    job = Job.read(write("length_mm = 3.0\nangle = \"-2 arcsec\"\npoint_mm = [1.0, 2.0]\n"))
    assert job.options.quantity("length", "length") == 3.0 * mm
    assert job.options.quantity("angle", "angle") == -2.0 * arcsec
    assert list(job.options.quantity("point", "length")) == [1.0 * mm, 2.0 * mm]
    with pytest.raises(InputError, match="is of length, where angle is wanted"):
        job.options.quantity("length", "angle")


def test_priors_have_values_in_their_unit_or_in_that_of_u(write):
    job = Job.read(write("""
[[priors]]
quantity = "squareness"
u = "10 urad"
value = 2.0
[[priors]]
quantity = "dead_path"
u = "5 um"
value = "-1 mm"
[[priors]]
from = "earlier/result.json"
"""))
    first, second, third = job.priors
    assert (first.value, first.u) == (2.0 * urad, 10.0 * urad)
    assert (second.value, second.u) == (-1.0 * mm, 5.0 * um)
    assert third.earlier == job.path.parent / "earlier" / "result.json"


def test_excluded_rows_leave_the_table_but_not_the_job(write):
    job = Job.read(write("[[exclude]]\nrows = [2]\nreason = \"beam was broken\"\n"))
    assert list(job.table("lines").row_numbers) == [1, 3]
    assert list(job.including_excluded().table("lines").row_numbers) == [1, 2, 3]
    assert job.exclude[0].reason == "beam was broken"


def test_tolerances_are_limits_in_si(write):
    job = Job.read(write('[report]\ntolerances = { "a.z" = "0.1 mm", b = { lower = "-1 um", upper = "3 um" } }\n'))
    assert [(one.quantity, one.lower, one.upper) for one in job.tolerances] == [
        ("a.z", -0.1 * mm, 0.1 * mm), ("b", -1.0 * um, 3.0 * um)]


def test_a_certificate_needs_everything_that_is_never_invented(write):
    complete = """[certificate]
laboratory = "L"
customer = "C"
item = "I"
calibration_date = 2024-05-17
issue_date = 2024-05-18
"""
    assert Job.read(write(complete)).certificate["issue_date"] == datetime.date(2024, 5, 18)
    assert "customer missing" in refusal(write(complete.replace('customer = "C"\n', "")))
    assert "is not a date" in refusal(write(complete.replace("2024-05-17", '"soon"')))


@pytest.mark.parametrize("more, words", [
    ("[[exclude]]\nrows = [9]\nreason = \"r\"\n", ["row 9 is not in table 'lines'", "rows 1 to 3"]),
    ("[[exclude]]\nrows = [1]\n", ["reason", "is missing"]),
    ("[[exclude]]\nrows = [1]\nreason = \" \"\n", ["say why"]),
    ("[[exclude]]\nrows = [1, 2, 3]\nreason = \"r\"\n", ["every row is excluded"]),
    ("[[priors]]\nquantity = \"q\"\nu = \"10\"\n", ["line 12", "priors.1.u", "has no unit"]),
    ("[[priors]]\nquantity = \"q\"\nu = \"0 mm\"\n", ["no positive uncertainty"]),
    ("[[priors]]\nquantity = \"q\"\nu = \"1 mm\"\nvalue = \"1 arcsec\"\n", ["arcsec"]),
    ("[report]\ntolerances = { q = \"0.1\" }\n", ["report.tolerances.q", "has no unit"]),
    ("[report]\ntolerances = { q = { lower = \"2 mm\", upper = \"1 mm\" } }\n", ["not below the upper"]),
    ("broken\n", ["is not TOML", "line 10"]),
])
def test_a_job_that_cannot_be_used_is_refused_with_the_key_and_what_to_do(write, more, words):
    message = refusal(write(more))
    assert "job.toml" in message or "lines.csv" in message
    for word in words:
        assert word in message


def test_a_missing_table_or_instrument_is_named_with_what_is_there(write):
    job = Job.read(write())
    with pytest.raises(InputError, match=r"table \[data.line\] is missing \(there: lines\)"):
        job.table("line")
    other = Job.read(write(text=JOB.replace('instrument = "tracker"', 'instrument = "level"')))
    with pytest.raises(InputError, match=r"there is no \[instruments.level\] \(there: tracker\)"):
        other.instrument("lines")


def test_a_job_that_is_not_there_is_named_with_its_neighbour(write):
    path = write()
    assert "did you mean" in refusal(path.with_name("jobb.toml"))
    assert "without case.toml" in refusal(path.parent)


def test_the_job_of_the_documentation_is_read_with_everything_in_it(tmp_path):
    page = (Path(__file__).resolve().parent.parent / "docs" / "jobs.md").read_text(encoding="utf-8")
    first, earlier = re.findall(r"^```toml\n(.*?)^```$", page, flags=re.MULTILINE | re.DOTALL)
    lines = "".join(f"{n},{n},0,0,{n}\n" for n in range(1, 16))
    (tmp_path / "lines.csv").write_text(f"row,x_mm,y_mm,z_mm,d_mm\n{lines}")
    (tmp_path / "job.toml").write_text(first)
    job = Job.read(tmp_path / "job.toml")
    assert len(job.table("lines")) == 14
    assert job.priors[0].value == -230 * mm
    assert job.tolerances[0].upper == -190 * mm
    assert job.quantities == ("base_point", "dead_path")
    (tmp_path / "job.toml").write_text(first + earlier)
    assert Job.read(tmp_path / "job.toml").priors[1].quantity == "base_point"


def test_a_case_folder_is_a_job_of_its_scenario(tmp_path):
    (tmp_path / "case.toml").write_text("""format = 1
case = "c"
scenario = "level_plumb"
[instruments.level]
sigma_arcsec = 0.15
[known]
reference_temperature_C = 20.0
[[columns]]
name = "row"
meaning = "row number"
unit = "1"
""")
    (tmp_path / "measurements.csv").write_text("row,angle_deg,reading_arcsec\n1,0,1\n2,90,2\n")
    job = Job.read(tmp_path)
    assert job.problem == "level_plumb"
    assert job.instruments.table("level").quantity("sigma", "angle") == 0.15 * arcsec
    assert job.known.quantity("reference_temperature", "temperature") == 293.15
    assert np.array_equal(job.table("measurements").row_numbers, [1, 2])


def test_files_that_settings_name_belong_to_what_was_read(tmp_path, monkeypatch):
    monkeypatch.delenv("CALIB_REFERENCE_DATA", raising=False)
    (tmp_path / "elsewhere").mkdir()
    for place in ("arm.urdf", "elsewhere/joints.csv", "readings.csv"):
        (tmp_path / place).write_text("a_mm\n1\n", encoding="utf-8")
    (tmp_path / "job.toml").write_text('problem = "x"\n[data.readings]\nfile = "readings.csv"\n[options]\n'
                                       'urdf = "arm.urdf"\nfiles = ["joints.csv"]\n', encoding="utf-8")
    job = Job.read(tmp_path / "job.toml", tmp_path / "elsewhere")
    assert job.named == {"readings.csv": tmp_path / "readings.csv", "arm.urdf": tmp_path / "arm.urdf",
                         "joints.csv": tmp_path / "elsewhere" / "joints.csv"}
    assert [path.name for path in job.everything_read] == ["job.toml", "readings.csv", "arm.urdf", "joints.csv"]
    before = job.sha256()
    (tmp_path / "arm.urdf").write_text("changed", encoding="utf-8")
    assert job.sha256() != before
    with pytest.raises(InputError, match=r"'other.urdf' is not in .*--data"):
        job.file("other.urdf")
