"""The command: what is written, what is said, and with which exit status."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command import runner

from calib.catalogue import problem_modules, published
from calib.report.observations import COLUMNS

EXAMPLES = [module.__name__ for module in problem_modules() if hasattr(module, "example_job")]
PRIOR = '\n[[priors]]\nquantity = "plumb[two-axis].x"\nvalue = "-1.4 arcsec"\nu = "0.1 arcsec"\n'


@pytest.fixture
def calib(capsys):
    return runner(capsys)


@pytest.fixture
def job(calib, tmp_path):
    """A plumb job with simulated readings."""
    assert calib("example", "plumb", "--seed", 3, "--out", tmp_path / "plumb", "--quiet").status == 0
    return tmp_path / "plumb" / "job.toml"


def result(calib, job, *words):
    answer = calib("solve", job, "--json", *words)
    assert answer.status == 0, answer.error
    return json.loads(answer.out)


def test_solve_writes_result_observations_and_report(calib, job, tmp_path):
    answer = calib("solve", job, "--out", tmp_path / "out")
    assert answer.status == 0
    assert "plumb[three-axis].x" in answer.out
    content = json.loads((tmp_path / "out" / "result.json").read_text())
    assert set(content) >= {
        "format", "problem", "job", "method", "converged", "certificate", "vtpv", "dof", "p_value", "variance_factor",
        "unknowns", "derived", "covariance", "variance_components", "estimability", "provenance"}
    assert content["certificate"]["passed"]
    plumb = next(one for one in content["unknowns"] if (one["name"], one["instance"]) == ("plumb", "two-axis"))
    assert (plumb["part"], plumb["unit"], plumb["held"]) == ("x", "arcsec", False)
    assert len(content["provenance"]["data_sha256"]) == 64
    with (tmp_path / "out" / "observations.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0])[: len(COLUMNS)] == COLUMNS
    assert all(name.startswith("influence_") for name in tuple(rows[0])[len(COLUMNS) :])
    assert len(rows) == sum(1 for line in (job.parent / "level.csv").read_text().splitlines() if line[0] != "#") - 1
    assert sum(float(row["redundancy"]) for row in rows) == pytest.approx(content["dof"], abs=1e-8)
    for row in rows:
        assert float(row["reading"]) - float(row["predicted"]) == pytest.approx(float(row["residual"]), abs=1e-9)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page


def test_json_is_alone_on_standard_output_and_quiet_says_nothing(calib, job):
    assert set(json.loads(calib("solve", job, "--json").out)) >= {"unknowns", "covariance"}
    assert calib("solve", job, "--quiet").out == ""


def test_every_method_gives_the_same_answer_through_the_command(calib, job):
    one, other, third = (result(calib, job, "--method", name) for name in ("gauss-newton", "ipopt", "convex"))
    for entries in zip(one["unknowns"], other["unknowns"], third["unknowns"]):
        if not entries[0]["held"]:
            for entry in entries[1:]:
                assert entry["value"] == pytest.approx(entries[0]["value"], abs=1e-8 * entry["u"])


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_every_example_can_be_solved(calib, tmp_path, name):
    short = name.removeprefix("problems.")
    assert calib("example", short, "--out", tmp_path, "--quiet").status == 0
    toml = next(iter(sorted(tmp_path.glob("*.toml"))))
    answer = calib("solve", tmp_path if toml.name == "case.toml" else toml, "--json")
    assert answer.status == 0, answer.error
    assert json.loads(answer.out)["certificate"]["passed"]


def test_an_example_overwrites_nothing(calib, job):
    again = calib("example", "plumb", "--out", job.parent)
    assert again.status == 2
    assert "is there already" in again.error


def test_a_prior_pulls_its_quantity_and_enters_the_budget(calib, job):
    free = result(calib, job)
    job.write_text(job.read_text() + PRIOR)
    with_prior = result(calib, job)
    place = free["covariance"]["names"].index("plumb[two-axis].x")
    before, after = (np.array(one["covariance"]["matrix"])[place, place] for one in (free, with_prior))
    assert 1 / after == pytest.approx(1 / before + 1 / 0.1**2, rel=1e-9)
    budget = next(one for one in with_prior["budgets"] if one["quantity"] == "plumb[two-axis].x")
    assert "prior plumb[two-axis].x" in [line["label"] for line in budget["contributions"]]


def test_an_earlier_result_is_a_prior_with_its_covariance(calib, job, tmp_path):
    first = result(calib, job, "--out", tmp_path / "earlier", "--quiet")
    job.write_text(job.read_text() + f'\n[[priors]]\nfrom = "{tmp_path}/earlier/result.json"\nquantity = "plumb"\n')
    # The same readings twice: the estimate stays, its variance halves (the zero, unknown anew, only limits that).
    second = result(calib, job)
    assert set(second["provenance"]["data"]) == {"job.toml", "level.csv", "result.json"}
    for one, other in zip(first["unknowns"], second["unknowns"]):
        if one["name"] == "plumb":
            assert other["value"] == pytest.approx(one["value"], abs=1e-6 * one["u"])
            assert other["u"] == pytest.approx(one["u"] / np.sqrt(2), rel=1e-6)


def test_excluded_rows_are_reported_with_the_result_including_them(calib, job, tmp_path):
    whole = result(calib, job)
    job.write_text(job.read_text() + '\n[[exclude]]\nrows = [1, 2]\nreason = "the table was touched"\n')
    content = result(calib, job, "--out", tmp_path / "out", "--quiet")
    (excluded,) = content["excluded"]
    assert (excluded["rows"], excluded["reason"]) == ([1, 2], "the table was touched")
    assert content["dof"] == whole["dof"] - 2
    before = {one["name"]: one["value"] for one in whole["derived"]}
    including = {one["name"]: one["value"] for one in excluded["including_them"] if one["name"] in before}
    assert including == pytest.approx(before)
    assert "the table was touched" in (tmp_path / "out" / "report.html").read_text()


def test_tolerances_are_judged_by_the_guard_band(calib, job):
    limits = {"parallelism.total": "10 arcsec", "plumb[three-axis].x": "0.1 arcsec", "plumb[two-axis].y": "0.7 arcsec"}
    text = ", ".join(f'"{name}" = "{limit}"' for name, limit in limits.items())
    job.write_text(job.read_text() + f"\n[report]\ntolerances = {{ {text} }}\n")
    judged = {one["quantity"]: one for one in result(calib, job)["tolerances"]}
    for one in judged.values():
        inside = min(one["upper"] - one["value"], one["value"] - one["lower"]) / one["u"]
        if abs(inside) > 1.7:
            assert one["verdict"] == ("pass" if inside > 0 else "fail")
        if abs(inside) < 1.6:
            assert one["verdict"] == "undecided"
    assert judged["parallelism.total"]["verdict"] == "pass"
    assert judged["plumb[three-axis].x"]["verdict"] == "fail"


@pytest.mark.slow
def test_montecarlo_confirms_the_linear_result_and_repeats_itself(calib, job, tmp_path):
    answers = [calib("montecarlo", job, "--trials", 3000, "--seed", 5, "--json", "--out", tmp_path) for _ in range(2)]
    first, second = (json.loads(answer.out)["quantities"] for answer in answers)
    assert first == second
    for one in first:
        if one["name"] != "parallelism.total":
            assert one["u"] == pytest.approx(one["linear_u"], rel=4 / np.sqrt(2 * 3000))
    samples = np.load(tmp_path / "samples.npz")
    assert samples["samples"].shape == (3000, len(first))
    assert json.loads((tmp_path / "montecarlo.json").read_text())["seed"] == 5


def test_simulated_readings_are_a_job_whose_truth_the_estimate_covers(calib, job, tmp_path):
    words = ("--seed", 11, "--with-effect", "drift=0.4 arcsec/h")
    assert calib("simulate", job, *words, "--out", tmp_path / "new", "--quiet").status == 0
    truth = json.loads((tmp_path / "new" / "truth.json").read_text())
    (drift,) = (one for one in truth["truth"] if one["name"] == "drift (reading)")
    assert (drift["value"], drift["unit"]) == (pytest.approx(0.4), "arcsec/h")
    calm = json.loads(calib("simulate", job, "--seed", 11, "--json").out)
    drifting = json.loads(calib("simulate", job, *words, "--json").out)
    place = calm["tables"]["level"]["columns"].index("reading_arcsec")
    minutes = calm["tables"]["level"]["columns"].index("time_min")
    for one, other in zip(calm["tables"]["level"]["rows"], drifting["tables"]["level"]["rows"]):
        assert float(other[place]) - float(one[place]) == pytest.approx(0.4 * float(one[minutes]) / 60, abs=1e-9)
    assert calib("solve", tmp_path / "new" / "job.toml", "--quiet").status == 0


def test_simulating_over_the_job_itself_is_refused(calib, job):
    answer = calib("simulate", job, "--out", job.parent)
    assert answer.status == 2
    assert "would be lost" in answer.error


def test_the_lists_name_every_problem_and_its_effects(calib, job):
    listed = {one["name"] for one in json.loads(calib("problems", "--json").out)}
    assert {f"problems.{name}" for name in listed} == {module.__name__ for module in problem_modules()}
    assert "angle, reading" in calib("problems", "plumb").out
    assert {one["name"] for one in json.loads(calib("effects", job, "--json").out)} >= {"drift", "hysteresis", "gain"}


def test_reproduce_writes_one_file_a_paper_with_a_reasoned_verdict_for_every_key(calib, tmp_path):
    answer = calib("reproduce", "base-point", "--out", tmp_path)
    assert answer.status == 0
    content = json.loads((tmp_path / "base-point.json").read_text())
    for one in content["quantities"]:
        assert one["verdict"] in ("agrees", "differs", "not determinable")
        assert one["why"] or one["verdict"] == "agrees"
    assert (tmp_path / "report.html").exists()
    assert set(published()) == {"base-point", "five-axis", "locators", "turntable"}


def test_an_unknown_paper_is_named_with_its_neighbour(calib):
    answer = calib("reproduce", "five-axes")
    assert answer.status == 2
    assert "did you mean 'five-axis'" in answer.error


def test_a_problem_file_of_ones_own_is_named_on_the_command_line(calib, job, tmp_path):
    own = tmp_path / "mine.py"
    own.write_text("from problems.plumb import from_job\n")
    text = job.read_text()
    job.write_text(text.replace('"problems.plumb"', '"mine"'))
    assert "there is no problem 'mine'" in calib("solve", job).error
    assert calib("solve", job, "--problem-file", own, "--quiet").status == 0


def test_a_foreign_package_of_our_name_is_detected_and_both_paths_are_named(tmp_path):
    foreign = tmp_path / "problems"
    foreign.mkdir()
    (foreign / "__init__.py").write_text("")
    finished = subprocess.run([sys.executable, "-m", "calib", "problems"], cwd=tmp_path, capture_output=True, text=True,
                              check=False)
    assert finished.returncode == 2
    assert str(foreign) in finished.stderr
    assert str(Path(__file__).resolve().parent.parent / "problems") in finished.stderr
    assert "Traceback" not in finished.stderr
