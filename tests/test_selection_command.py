"""`calib select`: files, text and exit status."""

from __future__ import annotations

import json

import pytest
from command import runner
from folders import put

from problems import base_point


@pytest.fixture
def calib(capsys):
    return runner(capsys)


@pytest.fixture
def job(tmp_path):
    put(tmp_path, base_point.example_job(1))
    return tmp_path / "job.toml"


def test_select_writes_the_choice_with_its_bound_and_the_promised_u(calib, job, tmp_path):
    answer = calib("select", job, "--keep", 9, "--criterion", "A", "--quantity", "base_point", "--out",
                   tmp_path / "out")
    assert answer.status == 0, answer.error
    found = json.loads((tmp_path / "out" / "selection.json").read_text(encoding="utf-8"))
    assert found["criterion"] == "A" and found["keep"] == len(found["rows"]) == 9 == len(set(found["rows"]))
    assert found["bound"] <= found["value"] and found["gap"] == pytest.approx(found["value"] / found["bound"] - 1)
    named = {q["name"]: q for q in found["quantities"]}
    assert list(named) == ["base_point.x", "base_point.y", "base_point.z"]
    assert sum(q["u_selected"] ** 2 for q in named.values()) == pytest.approx(found["value"], rel=1e-6)
    assert all(q["u_selected"] > q["u_all"] for q in named.values())
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 2 and "no choice within the same limits can beat it" in page


def test_select_answers_in_json_alone_and_respects_floors(calib, job):
    answer = calib("select", job, "--keep", 12, "--redundancy", 0.4, "--json")
    assert answer.status == 0 and len(json.loads(answer.out)["rows"]) == 12
    assert any("floors" in remark for remark in json.loads(answer.out)["remarks"])


def test_what_cannot_be_chosen_is_refused_with_exit_status_two(calib, job):
    for words, said in ((("--keep", 99), "ask for 1 to 30"), (("--keep", 2), "keep at least"),
                        (("--keep", 9, "--by", "lin"), "did you mean 'line'"),
                        (("--keep", 9, "--criterion", "A", "--quantity", "base"), "base_point"),
                        (("--keep", 9, "--at-most", "line"), "COVARIATE=K"),
                        (("--keep", 9, "--redundancy", 0.95), "ask for that at most")):
        answer = calib("select", job, *words)
        assert answer.status == 2 and said in answer.error, (words, answer.error)


def test_costs_and_exclusions_of_the_command_line_hold(calib, job):
    answer = calib("select", job, "--keep", 8, "--exclusive", "tracker row 1|tracker row 2", "--budget", 20, "--always",
                   "tracker=1-2", "--at-most", "line=5", "--json")
    assert answer.status == 2 and "no candidate 'tracker row 1'" in answer.error      # it is there in any case
    answer = calib("select", job, "--keep", 8, "--exclusive", "tracker row 3|tracker row 4", "--budget", 20, "--always",
                   "tracker=1-2", "--at-most", "line=5", "--json")
    assert answer.status == 0, answer.error
    rows = set(json.loads(answer.out)["rows"])
    assert len(rows) == 8 and not rows & {1, 2} and not {3, 4} <= rows
    assert sum(row <= 15 for row in rows) <= 5 and sum(row > 15 for row in rows) <= 5


def test_floors_of_biases_are_given_with_their_units(calib, job):
    answer = calib("select", job, "--keep", 14, "--influence", "base_point.z=80 um", "--json")
    assert answer.status == 0, answer.error
    for words, said in ((("--mdb", "tracker=5 arcsec"), "length is wanted"), (("--mdb", "trackr=5 um"), "no group"),
                        (("--influence", "base_point.z"), "NAME=VALUE"),
                        (("--influence", "base_pint=1 um"), "did you mean 'base_point")):
        answer = calib("select", job, "--keep", 14, *words)
        assert answer.status == 2 and said in answer.error, (words, answer.error)


def test_the_next_best_measurement_is_ranked_beside_what_is_there(calib, job):
    answer = calib("select", job, "--next", "--criterion", "c", "--quantity", "base_point.z", "--always",
                   "tracker=1-10,16-20", "--json")
    assert answer.status == 0, answer.error
    ranking = json.loads(answer.out)["next"]
    assert len(ranking) == 15 and ranking[0]["ratio"] == min(one["ratio"] for one in ranking) < 1
    said = calib("select", job, "--next", "--criterion", "c", "--quantity", "base_point.z", "--always", "tracker=1-20")
    assert said.status == 0 and "best of 10 further measurements" in said.out
    for words, told in ((("--next",), "say what is there already"), ((), "say how many candidates to keep"),
                        (("--next", "--keep", 3, "--always", "tracker=1-10"), "with --next leave it out"),
                        (("--next", "--always", "tracker=1-10x"), "rows are written as 1-20,25"),
                        (("--next", "--always", "trackr=1-10"), "did you mean 'tracker'")):
        answer = calib("select", job, *words)
        assert answer.status == 2 and told in answer.error, (words, answer.error)


def test_the_measurement_that_separates_two_effects_is_ranked_and_said_where_none_does(calib, job):
    two = ("scale (x)", "scale (y)")
    answer = calib("select", job, "--next", "--separate", *two, "--always", "tracker=1-16", "--json")
    assert answer.status == 0, answer.error
    found = json.loads(answer.out)
    # One reading on the second line does not tell the two scales apart; its far end does best.
    assert found["next"][0]["candidate"] == "tracker row 30" and found["next"][0]["ratio"] == 0.0
    said = calib("select", job, "--next", "--separate", *two, "--always", "tracker=1-16")
    assert "only with it" in said.out and "'scale (x)' and 'scale (y)' apart" in said.out
    none = calib("select", job, "--next", "--separate", *two, "--always", "tracker=1-10")
    assert none.status == 0 and "no single one of 20 further measurements is enough" in none.out


def test_the_worst_of_two_jobs_counts(calib, job, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    put(other, base_point.example_job(2))
    found = [json.loads(calib("select", job, "--keep", 9, "--criterion", "A", "--quantity", "base_point", "--json",
                              *words).out) for words in ((), ("--worst-case", other / "job.toml"))]
    assert found[1]["criterion"] == "worst A" and found[1]["value"] >= found[0]["value"] * (1 - 1e-9)
    assert found[1]["unit"] == "mm^2"
