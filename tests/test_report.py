"""Reports: numbers rounded by their uncertainty, pages that are whole, self-contained and say first what matters."""

from __future__ import annotations

import dataclasses
import re
from html.parser import HTMLParser

import pytest
from command import runner

from calib import GaussNewton, catalogue
from calib.cli.output import Output
from calib.cli.solve import say
from calib.job import Job
from calib.report import numbers, page
from calib.report.provenance import provenance
from calib.workflow.conformity import judge
from calib.workflow.propagation import verdict
from calib.workflow.solution import solved

VOID = {"meta", "link", "br", "img", "input", "hr", "path", "use", "rect", "line"}


@pytest.mark.parametrize("value, u, texts", [
    (-1.7123, 0.28, ("−1.71", "0.28")), (1400.90, 0.0031, ("1400.9000", "0.0031")), (3.2, 0.0996, ("3.20", "0.10")),
    (1234567.8, 230.0, ("1234570", "230")), (6.1e-6, 1.2e-7, ("6.10×10⁻⁶", "0.12×10⁻⁶")),
    (-0.001, 0.2, ("0.00", "0.20")), (12.0, None, ("12", "")), (12.0, 0.0, ("12", "")), (None, 0.25, ("–", "0.25")),
    (12.0, float("nan"), ("–", "")), (12.0, float("inf"), ("–", "")),
])
def test_a_value_is_rounded_to_two_digits_of_its_uncertainty(value, u, texts):
    assert numbers.with_uncertainty(value, u) == texts


@pytest.mark.parametrize("value, u, expected", [(0.0, 0.3, "pass"), (0.7, 0.3, "undecided"), (1.6, 0.3, "fail"),
                                                (0.5, 0.31, "undecided"), (0.0, 0.9, "undecided")])
def test_conformity_needs_the_guard_band(value, u, expected):
    assert judge("q", "mm", value, u, -1.0, 1.0).verdict == expected


def test_the_guard_band_of_one_limit_is_1_65_u():
    assert judge("q", "mm", 1.0 - 1.66 * 0.01, 0.01, -1.0, 1.0).verdict == "pass"
    assert judge("q", "mm", 1.0 - 1.63 * 0.01, 0.01, -1.0, 1.0).verdict == "undecided"


def test_the_verdict_on_a_linear_result_needs_enough_trials():
    exact = (-1.959964, 1.959964)
    assert verdict(0.0, 1.0, exact, 10_000_000) == "valid to two digits of u"
    assert verdict(0.0, 1.0, exact, 10_000).startswith("valid to one digit of u; more trials")
    assert verdict(0.0, 1.0, exact, 100) == "undecided: more trials"
    assert verdict(0.0, 1.0, (-1.0, 3.0), 10_000) == "not valid"


class Balance(HTMLParser):
    """Open elements and the identifiers of a page."""

    def __init__(self):
        super().__init__()
        self.open, self.identifiers, self.faults = [], [], []

    def handle_starttag(self, tag, attributes):
        self.identifiers += [value for name, value in attributes if name == "id"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.identifiers += [value for name, value in attributes if name == "id"]

    def handle_endtag(self, tag):
        if tag in VOID:
            return
        if not self.open or self.open.pop() != tag:
            self.faults.append(tag)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("report")


@pytest.fixture
def pages(capsys, folder):
    """The page of a solved job with two groups and a failing tolerance, and that of a reproduction; made once."""
    if not (folder / "solved" / "report.html").exists():
        calib = runner(capsys)
        calib("example", "plumb", "--out", folder / "job", "--quiet")
        job = folder / "job" / "job.toml"
        job.write_text(job.read_text() + """
[[priors]]
quantity = "plumb[two-axis].x"
value = "-1.4 arcsec"
u = "0.2 arcsec"
[[exclude]]
rows = [3]
reason = "door opened"
[report]
tolerances = { "parallelism.total" = "1 arcsec" }
""")
        assert calib("solve", job, "--out", folder / "solved", "--quiet").status == 0
        assert calib("reproduce", "base-point", "--out", folder / "reproduced", "--quiet").status == 0
    return [(folder / name / "report.html").read_text() for name in ("solved", "reproduced")]


def test_pages_are_well_formed_and_their_identifiers_unique(pages):
    for text in pages:
        balance = Balance()
        balance.feed(text)
        assert balance.faults == []
        assert balance.open == []
        assert len(balance.identifiers) == len(set(balance.identifiers))
        used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))
        assert used <= set(balance.identifiers)


def test_pages_load_nothing_from_elsewhere(pages):
    for text in pages:
        addresses = set(re.findall(r"https?://[^\"'< )]+", text))
        assert addresses <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
        assert "<script" not in text
        assert "<link" not in text


def test_the_answer_stands_first_with_unit_and_verdict(pages):
    text = pages[0]
    answer = text[text.index('<div class="answer') : text.index("<h2>")]
    assert "parallelism.total = " in answer
    assert "arcsec" in answer
    assert "fail" in answer
    assert "k = 2" in answer


def test_a_page_holds_budget_exclusion_limits_and_provenance(pages):
    text = re.sub(r"<[^>]+>", " ", pages[0])
    for words in ("prior plumb[two-axis].x", "door opened", "without them", "What cannot be known", "Reliability",
                  "sha256 of level.csv", "remaining step", "degrees of freedom"):
        assert words in text
    assert pages[0].count("<svg") >= 5


def test_a_failed_fit_says_so_at_the_top(capsys, pages, folder):
    job = Job.read(folder / "job" / "job.toml")
    solution = solved(job, catalogue.module(job.problem), GaussNewton())
    estimate = solution.estimate
    certificate = dataclasses.replace(estimate.certificate, passed=False, why="a step of 0.1 u remains")
    failed = dataclasses.replace(solution, estimate=dataclasses.replace(estimate, certificate=certificate))
    written = page.html(failed, provenance(job.files, "calib solve job.toml"))
    answer = written[written.index('<div class="answer') : written.index("<h2>")]
    assert "This fit is not certified: a step of 0.1 u remains" in answer
    say(Output(None, False, False), failed)
    assert capsys.readouterr().out.startswith("NOT CERTIFIED: a step of 0.1 u remains")
    assert "not certified" not in pages[0]
