"""Digital calibration certificates: what they need, what they say, how they are checked; E_n; the budget as a table."""

from __future__ import annotations

import csv
import dataclasses
import json
import re
import sys
from xml.etree import ElementTree

import pytest
from command import runner

from calib import GaussNewton, catalogue, units
from calib.errors import InputError
from calib.job import Job
from calib.report.certificate import dsi, earlier
from calib.report.certificate.stated import NEEDED, stated
from calib.report.certificate.write import schema_at_hand, write
from calib.report.certificate.xml import decimal
from calib.report.provenance import provenance
from calib.workflow.conformity import compared
from calib.workflow.solution import solved

NAMES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
ENTRIES = """
[report]
tolerances = { "parallelism.x" = "9 arcsec", "parallelism.y" = "1 arcsec", "parallelism.total" = "3.2 arcsec" }
[certificate]
certificate_number = "2024-17"
country_code = "DE"
performance_location = "laboratory"
laboratory = "Angle & <Length>"
laboratory_city = "Berlin"
laboratory_country_code = "DE"
responsible_person = "A. \\"Q\\" Person"
customer = "轴 Ω ]]>"
customer_city = "Paris"
customer_country_code = "FR"
item = "level"
item_identification = "17"
item_identified_by = "owner"
influence_conditions = "air temperature (20.1 ± 0.2) °C"
calibration_date = 2024-05-17
issue_date = 2024-05-18
"""


@pytest.fixture
def solve(capsys, tmp_path):
    """Solve a plumb job with more lines in it; return the answer and its folder."""
    calib = runner(capsys)
    calib("example", "plumb", "--out", tmp_path / "job", "--quiet")
    text = (tmp_path / "job" / "job.toml").read_text()

    def act(more, *words):
        (tmp_path / "job" / "job.toml").write_text(text + more, encoding="utf-8")
        return calib("solve", tmp_path / "job" / "job.toml", *words)

    act.folder = tmp_path
    return act


@pytest.mark.slow
def test_a_certificate_states_what_was_found_and_keeps_every_rule_of_the_dcc(solve):
    pytest.importorskip("dcclib")
    path = solve.folder / "certificate.xml"
    answer = solve(ENTRIES, "--certificate", path, "--out", solve.folder / "out")
    assert answer.status == 0, answer.error
    root = ElementTree.fromstring(path.read_bytes())
    assert root.get("schemaVersion").startswith("3.")
    said = [one.text for one in root.iter("{https://ptb.de/dcc}content")]
    for text in ("Angle & <Length>", 'A. "Q" Person', "轴 Ω ]]>", "level"):
        assert text in said
    quantities = {one.findtext("dcc:name/dcc:content", None, NAMES): one
                  for one in root.findall(".//dcc:result//dcc:data/dcc:quantity[si:real]", NAMES)}
    result = json.loads((solve.folder / "out" / "result.json").read_text())
    for entry in result["derived"]:
        real = quantities[f"{entry['name']}"].find("si:real", NAMES)
        expanded = float(real.findtext(".//si:valueExpandedMU", None, NAMES))
        assert expanded == pytest.approx(2 * entry["u"], rel=0.05)
        assert float(real.findtext("si:value", None, NAMES)) == pytest.approx(entry["value"], abs=0.006)
        assert real.findtext("si:unit", None, NAMES) == r"\arcsecond"
        assert real.findtext(".//si:coverageFactor", None, NAMES) == "2"
    verdicts = {name: one.findtext(".//dcc:conformity", None, NAMES) for name, one in quantities.items()}
    assert verdicts["parallelism.x"] == "pass"
    assert verdicts["parallelism.y"] == "fail"
    assert verdicts["parallelism.total"] == "noPass"
    from dcclib.validation.schematron import SchematronValidator

    found = SchematronValidator.for_dcc().validate_file(str(path))
    assert found.is_valid
    assert [one.text for one in found.successful_reports if one.role in ("error", "warning")] == []


@pytest.mark.slow
def test_a_certificate_keeps_the_schema_where_that_is_at_hand(solve):
    pytest.importorskip("dcclib")
    schema = schema_at_hand()
    if schema is None:
        pytest.skip("no library has the schema on this machine")
    from dcclib.validation.xsd import XsdValidator

    path = solve.folder / "certificate.xml"
    assert solve(ENTRIES, "--certificate", path).status == 0
    assert XsdValidator.from_file(str(schema)).validate_file(str(path)).errors == []


@pytest.mark.parametrize("key", sorted(NEEDED))
def test_whatever_is_missing_is_named_and_nothing_is_invented(tmp_path, key):
    complete = {"calibration_date": 1, "issue_date": 2}
    given = {one: complete.get(one, "x") for one in NEEDED if one != key}
    with pytest.raises(InputError, match=rf"no certificate without {key} \("):
        stated(given, tmp_path / "job.toml")


def test_a_job_without_certificate_data_gets_none_and_hears_everything_that_is_missing(solve):
    pytest.importorskip("dcclib")
    answer = solve("", "--certificate", solve.folder / "c.xml")
    assert answer.status == 2
    assert all(key in answer.error for key in NEEDED)
    assert not (solve.folder / "c.xml").exists()


@pytest.mark.parametrize("old, new, words", [
    ('country_code = "DE"\nperf', 'country_code = "Germany"\nperf', "two capital letters"),
    ('"laboratory"\n', '"somewhere"\n', "none of laboratory, customer"),
    ("2024-05-17", "2024-05-19", "not in order"),
    ('item = "level"', 'item = "a\\u0007b"', "cannot be printed"),
    ('item = "level"', 'item = "  "', "is empty"),
])
def test_entries_that_cannot_be_are_refused(solve, old, new, words):
    pytest.importorskip("dcclib")
    assert old in ENTRIES
    answer = solve(ENTRIES.replace(old, new), "--certificate", solve.folder / "c.xml")
    assert answer.status == 2
    assert words in answer.error
    assert not (solve.folder / "c.xml").exists()


def test_without_the_library_a_sentence_says_what_to_install(solve, monkeypatch):
    monkeypatch.setitem(sys.modules, "dcclib", None)
    answer = solve(ENTRIES, "--certificate", solve.folder / "c.xml")
    assert answer.status == 2
    assert "pip install 'calibration-framework[certificate]'" in answer.error


def test_no_certificate_of_a_fit_that_failed(solve):
    pytest.importorskip("dcclib")
    solve(ENTRIES)
    job = Job.read(solve.folder / "job" / "job.toml")
    solution = solved(job, catalogue.module(job.problem), GaussNewton())
    failed = dataclasses.replace(solution.estimate, converged=False, message="it wandered off")
    with pytest.raises(InputError, match="it wandered off"):
        write(dataclasses.replace(solution, estimate=failed), provenance(job.files, "calib"), solve.folder / "c.xml")
    assert not (solve.folder / "c.xml").exists()


@pytest.mark.parametrize("unit", [*units.SYMBOLS, "arcsec/h", "um/m", "ppm/K", "um^2", "mm/s", "urad/m"])
def test_a_unit_keeps_its_size_in_the_si(unit):
    text, times = dsi.dsi(unit)
    assert dsi.factor(text) * times == pytest.approx(units.factor(unit), rel=1e-12)
    assert re.fullmatch(r"(\\[a-z]+(\{\d+\})?)+", text)


@pytest.mark.parametrize("value, u, text", [(0.14692, 0.68516, "0.15"), (-2.0, 0.0996, "-2.00"),
                                            (-0.001, 0.2, "0.00"), (1e-15, 1e-16, "1.00e-15"),
                                            (1234567.0, 230.0, "1.23457e+06"), (1e-9, 1e-10, "0.00000000100"),
                                            (0.5, None, "0.5")])
def test_a_number_is_rounded_to_two_digits_of_its_uncertainty(value, u, text):
    assert decimal(value, u) == text


def test_the_normalised_error_is_the_difference_over_both_expanded_uncertainties():
    found = compared("q", "mm", 1.0, 0.3, 0.5, 0.4)      # 0.5 over the root of 0.09 + 0.16
    assert found.normalised == pytest.approx(1.0, rel=1e-12)
    assert not compared("q", "mm", 1.1, 0.3, 0.5, 0.4).compatible


@pytest.mark.slow
def test_results_are_compared_with_an_earlier_result_and_shared_readings_are_said(solve):
    first = solve("", "--out", solve.folder / "first")
    assert first.status == 0
    answer = solve('\n[[exclude]]\nrows = [3]\nreason = "door"\n', "--out", solve.folder / "second", "--against",
                   solve.folder / "first" / "result.json")
    assert answer.status == 0, answer.error
    assert "compatible with" in answer.out
    assert "not independent" in " ".join(answer.out.split())
    stated_in = json.loads((solve.folder / "second" / "result.json").read_text())["compatibility"]
    one = {entry["quantity"]: entry for entry in stated_in["results"]}["parallelism.x"]
    before = json.loads((solve.folder / "first" / "result.json").read_text())
    after = json.loads((solve.folder / "second" / "result.json").read_text())
    x, y = ({e["name"]: e for e in content["derived"]}["parallelism.x"] for content in (after, before))
    assert one["normalised"] == pytest.approx((x["value"] - y["value"]) / (2 * (x["u"] ** 2 + y["u"] ** 2) ** 0.5),
                                              rel=1e-9)
    assert "Compared with another result" in (solve.folder / "second" / "report.html").read_text()


@pytest.mark.parametrize("name, text, words", [
    ("c.xml", '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><a>&b;</a>', "entities"),
    ("c.xml", "<a>", "is not XML"), ("c.xml", "<a/>", "no result with an uncertainty"),
    ("r.json", "{}", "is no result.json"), ("r.json", "[1]", "is no result.json"),
])
def test_a_file_to_compare_with_that_is_none_is_refused(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words):
        earlier.read(tmp_path / name)


@pytest.mark.slow
def test_the_budget_is_a_table_whose_contributions_combine(solve):
    answer = solve('\n[[priors]]\nquantity = "plumb[two-axis].x"\nvalue = "-1.4 arcsec"\nu = "0.3 arcsec"\n', "--out",
                   solve.folder / "out")
    assert answer.status == 0, answer.error
    with (solve.folder / "out" / "budget.csv").open(encoding="utf-8", newline="") as stream:
        lines = list(csv.DictReader(stream))
    mine = [line for line in lines if line["quantity"] == "parallelism.x"]
    *sources, combined, expanded = mine
    assert {line["source"] for line in sources} >= {"level", "prior plumb[two-axis].x"}
    total = sum(float(line["u_contribution"]) ** 2 for line in sources) ** 0.5
    assert total == pytest.approx(float(combined["u_contribution"]), rel=1e-9)
    assert float(expanded["u_contribution"]) == pytest.approx(2 * total, rel=1e-9)
    assert sum(float(line["share_of_variance"]) for line in sources) == pytest.approx(1.0, rel=1e-9)
