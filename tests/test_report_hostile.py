"""Reports of awkward jobs: names that are markup, formulas or very long; no uncertainty."""

from __future__ import annotations

import json
import re

import pytest
from browser import browsing, found
from command import runner

NAMES = ["<script>alert(1)</script>", "\"' onload=alert(2) x=", "a & b &lt; c", "$\\frac{1}$ $", "轴 Ω–ß", "x" * 300,
         "{{ 7*7 }}", "]]> --> </style>"]
PROBLEM = """
import numpy as np
from calib import Observations, Parameter, Effect, Problem, Quantity, Unknown, direct
NAMES = {names!r}

def seen(place, scale, *, tap=direct):
    return tap(place) * scale

def from_job(job):
    table = job.table("readings")
    keys = list(dict.fromkeys(table.text("item")))
    index = np.array([keys.index(one) for one in table.text("item")])
    place = Unknown("place " + NAMES[0], [[1.0]] * len(keys), "mm", keys=keys)
    reading = table.number("value", "length")
    readings = Observations(seen, place[index], np.ones(len(index)), readings=reading, u=1e-6, unit="um",
                            group="group " + NAMES[1],
                            covariates={{"item " + NAMES[3]: table.text("item"), NAMES[4]: reading}})
    first = Quantity("twice " + NAMES[2], lambda p: 2 * p, place[0], unit="mm")
    return Problem([readings], quantities=[first], name="hostile " + NAMES[5])
"""
BENT = """
from casadi import sqrt
from calib import Observations, Problem, Quantity, Unknown

def from_job(job):
    place = Unknown("place", 0.0, "mm")
    none = 0 * job.table("readings").number("value", "length")
    readings = Observations(lambda p: p, place, readings=none, u=1e-6, unit="um")
    return Problem([readings], quantities=[Quantity("root", lambda p: sqrt(p), place, unit="1")], name="bent")
"""


def quoted(text):
    return '"' + text.replace('"', '""') + '"'


@pytest.fixture
def solve(capsys, tmp_path):
    """Solve a job with a problem file of one's own; return the answer and the folder of its files."""

    def act(problem, *words):
        rows = [f"{quoted(name)},{1000 + i + 0.001 * k}" for i, name in enumerate(NAMES) for k in range(3)]
        (tmp_path / "readings.csv").write_text("\n".join(["item,value_um", *rows]) + "\n", encoding="utf-8")
        (tmp_path / "mine.py").write_text(problem, encoding="utf-8")
        job = tmp_path / "<b>job & co.toml"
        job.write_text('problem = "problems.mine"\n[data.readings]\nfile = "readings.csv"\n[[exclude]]\nrows = [2]\n'
                       f"reason = {json.dumps(NAMES[0])}\n", encoding="utf-8")
        answer = runner(capsys)("solve", job, "--problem-file", tmp_path / "mine.py", "--out", tmp_path / "out", *words)
        return answer, tmp_path / "out"

    return act


def test_nothing_that_a_person_wrote_becomes_markup_or_a_formula(solve):
    answer, folder = solve(PROBLEM.format(names=NAMES))
    assert answer.status == 0, answer.error
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert "<script" not in text
    assert "onload=alert" not in re.sub(r">[^<]*<", "><", text), "in no attribute"
    assert text.count("</style>") == text.count("<style")
    for name in ("&lt;script&gt;", "a &amp; b &amp;lt; c", "轴 Ω–ß", "{{ 7*7 }}", "x" * 300):
        assert name in text, name
    assert "frac{1}$" in text


@pytest.mark.slow
@pytest.mark.skipif(found() is None, reason="no Chromium on this machine")
def test_a_page_of_hostile_names_runs_nothing_and_keeps_its_width(solve):
    _, folder = solve(PROBLEM.format(names=NAMES))
    with browsing() as browser:
        for width in (400, 1400):
            browser.open(folder / "report.html", width)
            assert browser.evaluate("document.documentElement.scrollWidth") == width
            assert browser.evaluate("document.scripts.length") == 0
            assert browser.said == []


def test_a_result_without_uncertainty_is_not_printed_as_a_number(solve):
    answer, folder = solve(BENT)
    assert answer.status in (0, 1), answer.error
    text = re.sub(r"<[^>]+>", " ", (folder / "report.html").read_text())
    assert "Not stated, because no uncertainty follows for it: root" in text
    assert "Not stated" in answer.out
    assert "root  0" not in answer.out
