"""`calib select`: files, text and exit status."""

from __future__ import annotations

import json

import pytest
from command import runner

from problems import base_point


@pytest.fixture
def calib(capsys):
    return runner(capsys)


@pytest.fixture
def job(tmp_path):
    for name, text in base_point.example_job(1).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
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
