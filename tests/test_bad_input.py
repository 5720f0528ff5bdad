"""Bad input through the command: one message that names file, line, column and remedy, and never a traceback."""

from __future__ import annotations

import json

import pytest
from command import runner

JOB = """problem = "problems.plumb"
[data.level]
file = "level.csv"
instrument = "level"
[instruments.level]
kind = "level"
u = "0.2 arcsec"
"""
READINGS = "angle_deg,reading_arcsec\n0,61.2\n30,60.4\n60,60.1\n90,60.5\n120,61.4\n150,62.5\n180,63.7\n"
# The 4 m long way round: two conditions that no point keeps.
CONTRADICTION = '''
from calib import Constraint
from problems import plumb

def one(tilt):
    return tilt[0]

def from_job(job):
    problem = plumb.from_job(job)
    tilt = next(unknown for unknown in problem.unknowns if unknown.name == "plumb")
    demands = [Constraint(f"tilt is {value}", one, tilt, tolerance=1e-12, unit="rad", lower=value, upper=value)
               for value in (0.0, 1e-3)]
    return type(problem)(problem.observations, constraints=demands, name="two demands")
'''


@pytest.fixture
def solve(capsys, tmp_path):
    calib = runner(capsys)

    def solve(job=JOB, readings=READINGS, *words):
        (tmp_path / "job.toml").write_text(job)
        (tmp_path / "level.csv").write_bytes(readings if isinstance(readings, bytes) else readings.encode())
        answer = calib("solve", tmp_path / "job.toml", "--out", tmp_path / "out", *words)
        assert "Traceback" not in answer.error
        assert "fault of calib" not in answer.error
        return answer

    solve.folder = tmp_path
    return solve


REFUSED = {
    "a missing column": (JOB, READINGS.replace("angle_deg", "position_deg"),
                         ["level.csv, line 1", "column 'angle' is missing", "Add the column"]),
    "a missing unit": (JOB, READINGS.replace("angle_deg", "angle"),
                       ["level.csv, line 1", "column 'angle'", "no unit", "angle_deg"]),
    "a missing uncertainty": (JOB.replace('u = "0.2 arcsec"\n', ""), READINGS,
                              ["job.toml", "key 'instruments.level.u'", "is missing", "add it"]),
    "an uncertainty without unit": (JOB.replace("0.2 arcsec", "0.2"), READINGS,
                                    ["job.toml, line 7", "instruments.level.u", "number without a unit"]),
    "an uncertainty of zero": (JOB.replace("0.2 arcsec", "0 arcsec"), READINGS,
                               ["job.toml, line 7", "no positive uncertainty"]),
    "a wrong unit": (JOB, READINGS.replace("reading_arcsec", "reading_mm"),
                     ["level.csv, line 1", "'reading_mm'", "angle is wanted", "correct the header"]),
    "a unit that does not exist": (JOB, READINGS.replace("reading_arcsec", "reading [arcsecs]"),
                                   ["level.csv, line 1", "arcsecs", "did you mean"]),
    "not a number": (JOB, READINGS.replace("60.1", "NaN"),
                     ["level.csv, line 4 (row 3)", "column 'reading_arcsec'", "'NaN'", "take the row out"]),
    "an empty cell": (JOB, READINGS.replace("60.1", ""), ["level.csv, line 4 (row 3)", "'reading_arcsec'", "empty"]),
    "a word among numbers": (JOB, READINGS.replace("60.1", "about 60"), ["level.csv, line 4", "'about 60'"]),
    "a repeated row": (JOB, READINGS + "60,60.1\n", ["level.csv, line 9", "repeats line 4", "take it out"]),
    "an empty file": (JOB, "", ["level.csv", "is empty", "header line"]),
    "a header alone": (JOB, "angle_deg,reading_arcsec\n", ["level.csv", "no rows"]),
    "a decimal comma": (JOB, READINGS.replace("60.1", "60,1"), ["level.csv, line 4", "decimal sign is a comma"]),
    "another encoding": (JOB, READINGS.replace("arcsec", "arcsec,Prüfer").encode("latin-1"),
                         ["level.csv, line 1", "not utf-8", "latin-1"]),
    "fewer readings than unknowns": (JOB, "angle_deg,reading_arcsec\n0,1\n90,2\n",
                                     ["cannot be known", "2 readings for 3 unknowns", "add a prior", "add readings"]),
    "all readings at one position": (JOB, "row,angle_deg,reading_arcsec\n1,10,1\n2,10,2\n3,10,3\n4,10,4\n",
                                     ["2 direction(s)", "cannot be known", "add readings"]),
    "a misspelt key": (JOB + '[options]\nstart_raeding = "free"\n', READINGS,
                       ["job.toml, line 9", "options.start_raeding", "is not known"]),
    "a prior of nothing": (JOB + '[[priors]]\nquantity = "plum"\nu = "1 arcsec"\n', READINGS,
                           ["job.toml, line 8", "'plum'", "did you mean 'plumb'"]),
    "a prior in another unit": (JOB + '[[priors]]\nquantity = "plumb.x"\nu = "1 mm"\n', READINGS,
                                ["job.toml, line 8", "length", "angle"]),
    "a report of nothing": (JOB + '[report]\nquantities = ["plumb.z"]\n', READINGS,
                            ["job.toml, line 9", "'plumb.z'", "did you mean"]),
    "a tolerance of nothing": (JOB + '[report]\ntolerances = { "plumb.q" = "1 arcsec" }\n', READINGS,
                               ["plumb.q", "is not among the results", "did you mean"]),
    "a file that is not there": (JOB.replace("level.csv", "levels.csv"), READINGS, ["levels.csv", "cannot be read"]),
    "an instrument that is not there": (JOB.replace("[instruments.level]", "[instruments.levle]"), READINGS,
                                        ["job.toml, line 4", "[instruments.level]", "there: levle"]),
    "a problem that is not there": (JOB.replace("problems.plumb", "problems.plumbs"), READINGS,
                                    ["problems.plumbs", "did you mean 'plumb'"]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_input_that_cannot_be_used_is_refused_with_place_and_remedy(solve, case):
    job, readings, words = REFUSED[case]
    answer = solve(job, readings)
    assert answer.status == 2
    assert answer.out == ""
    for word in words:
        assert word in answer.error
    assert not (solve.folder / "out").exists()


def test_an_arc_of_two_degrees_gives_uncertainties_that_say_so(solve):
    rows = [f"{0.4 * i:.1f},{61.2 - 0.01 * i + 0.1 * (i % 2)}" for i in range(6)]
    readings = "\n".join(["angle_deg,reading_arcsec", *rows, ""])
    answer = solve(JOB, readings)
    assert answer.status == 0
    content = json.loads((solve.folder / "out" / "result.json").read_text())
    u = {one["part"] or one["name"]: one["u"] for one in content["unknowns"] if not one["held"]}
    assert u["x"] > 10 * 0.2
    assert u["zero"] > 1000 * 0.2
    assert "hardly tell plumb.y from zero" in " ".join(content["remarks"])
    assert "hardly tell plumb.y from zero" in " ".join(answer.out.split())


def test_a_gross_reading_is_reported_and_not_dropped(solve):
    answer = solve(JOB, READINGS.replace("60.5", "605"))
    assert answer.status == 0
    content = json.loads((solve.folder / "out" / "result.json").read_text())
    assert content["dof"] == 7 - 3
    assert content["p_value"] < 1e-6
    assert "scatter more" in answer.out


def test_a_start_far_away_ends_in_a_certified_result_or_says_that_it_is_none(capsys, tmp_path):
    calib = runner(capsys)
    calib("example", "base_point", "--out", tmp_path, "--quiet")
    near = json.loads(calib("solve", tmp_path / "job.toml", "--json").out)
    text = (tmp_path / "job.toml").read_text()
    far_start = "[options]\nbase_point_mm = [9000.0, -7000.0, -8000.0]\n"
    (tmp_path / "far.toml").write_text(text.replace("[options]\n", far_start))
    answer = calib("solve", tmp_path / "far.toml", "--json")
    assert "Traceback" not in answer.error
    far = json.loads(answer.out)
    assert answer.status == (0 if far["certificate"]["passed"] and far["converged"] else 1)
    if answer.status == 0:
        # The targets lie in a plane: beyond it, or beside both lines, stand points that fit as well, none fits better.
        assert far["vtpv"] >= near["vtpv"] - 1e-6


def test_contradictory_constraints_are_named(solve):
    (solve.folder / "mine.py").write_text(CONTRADICTION)
    answer = solve(JOB, READINGS, "--problem-file", solve.folder / "mine.py")
    assert answer.status in (1, 2)
    said = answer.error + answer.out
    assert "tilt is 0.0" in said or "tilt is 0.001" in said


def test_a_broken_problem_file_is_a_message(solve):
    (solve.folder / "mine.py").write_text("import nowhere_to_be_found\n")
    answer = solve(JOB, READINGS, "--problem-file", solve.folder / "mine.py")
    assert answer.status == 2
    assert "nowhere_to_be_found" in answer.error


def test_an_option_that_does_not_exist_is_a_message(capsys):
    answer = runner(capsys)("solve", "job.toml", "--methode", "ipopt")
    assert answer.status == 2
    assert "No such option" in answer.error


def test_a_folder_that_cannot_be_written_is_a_message(solve):
    (solve.folder / "out").write_text("a file, not a folder")
    answer = solve()
    assert answer.status == 2
    assert "out" in answer.error


def test_no_text_of_a_job_reaches_the_page_unescaped(solve):
    name = "<script>alert(1)</script>"
    readings = "table," + READINGS.replace("\n", f"\n{name},", 7)
    answer = solve(JOB + f'[[exclude]]\nrows = [1]\nreason = "{name}"\n', readings)
    assert answer.status == 0, answer.error
    assert "<script" not in (solve.folder / "out" / "report.html").read_text()
