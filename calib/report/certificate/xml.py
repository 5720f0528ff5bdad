"""The certificate as a tree of elements, in the order that the schema wants."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Sequence
from typing import Any

from calib import units
from calib.report import numbers
from calib.report.certificate.dsi import dsi
from calib.report.certificate.stated import Stated
from calib.report.page import agreement
from calib.report.provenance import Provenance
from calib.workflow.conformity import UNDECIDED, Conformity
from calib.workflow.solution import Solution

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
VERSION = "3.3.0"
COVERAGE_FACTOR, COVERAGE = 2, 0.95
LANGUAGE = "en"
ADDRESS = ("street", "street_number", "post_code", "city", "state", "country_code")
NAMES = {"street_number": "streetNo", "post_code": "postCode", "country_code": "countryCode"}
RULE = ("Decision rule of ISO 14253-1: pass where the result conforms with a probability of at least 95 %, fail where "
        "it conforms with at most 5 %; a result between the two proves neither, and is stated as noPass.")
EXPANDED = ("The expanded uncertainty is the standard uncertainty times the coverage factor k = 2, for a coverage "
            "probability of about 95 % (JCGM 100:2008), from the stated uncertainties of readings and prior knowledge.")


def tree(solution: Solution, stated: Stated, provenance: Provenance) -> Any:
    """The certificate of a solved job.

    solution: with a passed certificate of its estimate; stated: what the job says for the certificate; provenance: of
    the run.
    return: the root element.
    """
    from lxml import etree

    root = etree.Element(f"{{{DCC}}}digitalCalibrationCertificate", nsmap={"dcc": DCC, "si": SI},
                         attrib={"schemaVersion": VERSION})
    _administration(_under(root, "administrativeData"), stated, provenance)
    _measurement(_under(root, "measurementResults", "measurementResult"), solution, stated, provenance)
    return root


def _under(parent: Any, *names: str, text: str | None = None, space: str = DCC, **attributes: str) -> Any:
    """A new element, or a chain of them, at the end of another; the last holds the text."""
    from lxml import etree

    for name in names:
        parent = etree.SubElement(parent, f"{{{space}}}{name}")
    parent.attrib.update(attributes)
    if text is not None:
        parent.text = printable(text)
    return parent


def printable(text: str) -> str:
    """A text that XML can hold and whose spaces are in order."""
    return " ".join("".join(" " if unicodedata.category(x) in ("Cc", "Cs", "Cn") else x for x in text).split())


def _said(parent: Any, name: str, *lines: str) -> Any:
    """A text in the language of the certificate."""
    element = _under(parent, name)
    for line in lines:
        _under(element, "content", text=line, lang=LANGUAGE)
    return element


# --- administrative data ---------------------------------------------------------------------------------------------


def _administration(data: Any, stated: Stated, provenance: Provenance) -> None:
    _software(_under(data, "dccSoftware", "software"), provenance)
    core = _under(data, "coreData")
    _under(core, "countryCodeISO3166_1", text=stated["country_code"])
    _under(core, "usedLangCodeISO639_1", text=LANGUAGE)
    _under(core, "mandatoryLangCodeISO639_1", text=LANGUAGE)
    _under(core, "uniqueIdentifier", text=stated["certificate_number"])
    if stated.get("receipt_date"):
        _under(core, "receiptDate", text=stated["receipt_date"])
    _under(core, "beginPerformanceDate", text=stated.begin)
    _under(core, "endPerformanceDate", text=stated["calibration_date"])
    _under(core, "performanceLocation", text=stated["performance_location"])
    _under(core, "issueDate", text=stated["issue_date"])
    item = _under(data, "items", "item")
    _said(item, "name", stated["item"])
    if stated.get("item_manufacturer"):
        _said(_under(item, "manufacturer"), "name", stated["item_manufacturer"])
    if stated.get("item_model"):
        _under(item, "model", text=stated["item_model"])
    identification = _under(item, "identifications", "identification")
    _under(identification, "issuer", text=stated["item_identified_by"])
    _under(identification, "value", text=stated["item_identification"])
    laboratory = _under(data, "calibrationLaboratory")
    if stated.get("laboratory_code"):
        _under(laboratory, "calibrationLaboratoryCode", text=stated["laboratory_code"])
    _contact(_under(laboratory, "contact"), "laboratory", stated)
    person = _under(data, "respPersons", "respPerson")
    _said(_under(person, "person"), "name", stated["responsible_person"])
    if stated.get("responsible_role"):
        _under(person, "role", text=stated["responsible_role"])
    _under(person, "mainSigner", text="true")
    _contact(_under(data, "customer"), "customer", stated)
    _said(_under(data, "statements", "statement"), "declaration", EXPANDED)


def _contact(element: Any, who: str, stated: Stated) -> None:
    _said(element, "name", stated[who])
    for key, name in (("email", "eMail"), ("phone", "phone")):
        if stated.get(f"{who}_{key}"):
            _under(element, name, text=stated[f"{who}_{key}"])
    location = _under(element, "location")
    for key in ADDRESS:
        if stated.get(f"{who}_{key}"):
            _under(location, NAMES.get(key, key), text=stated[f"{who}_{key}"])


def _software(software: Any, provenance: Provenance) -> None:
    _said(software, "name", "calib")
    found = re.match(r"\d{1,3}(\.\d{1,3}){0,3}", provenance.version)
    _under(software, "release", text=f"v{found.group() if found else 0}")
    _under(software, "type", text="application")
    libraries = ", ".join(f"{name} {version}" for name, version in provenance.libraries.items())
    _said(software, "description", f"version {provenance.version}, {provenance.python}, {libraries}")


# --- results ---------------------------------------------------------------------------------------------------------


def _measurement(result: Any, solution: Solution, stated: Stated, provenance: Provenance) -> None:
    estimate = solution.estimate
    _said(result, "name", solution.problem.name)
    _said(result, "description", agreement(solution))
    method = _under(result, "usedMethods", "usedMethod")
    _said(method, "name", f"least-squares adjustment of one declared model, {estimate.method}")
    _said(method, "description", f"{estimate.certificate.why}; {estimate.dof} degrees of freedom")
    _under(method, "reference", text="JCGM 100:2008")
    _software(_under(result, "usedSoftware", "software"), provenance)
    if len(solution.job.instruments):
        equipment = _under(result, "measuringEquipments")
        for name in solution.job.instruments:
            _said(_under(equipment, "measuringEquipment"), "name", name)
    condition = _under(result, "influenceConditions", "influenceCondition")
    _said(condition, "name", "influence conditions")
    _said(_under(condition, "data"), "text", stated["influence_conditions"])
    one = _under(result, "results", "result")
    _said(one, "name", "results")
    data = _under(one, "data")
    verdicts = {judged.quantity: judged for judged in solution.conformities}
    for name, value, u, unit in certified(solution):
        quantity = _under(data, "quantity", refType="basic_measuredValue")
        _said(quantity, "name", name)
        _real(quantity, value, u, unit)
        if name in verdicts:
            _conformity(_under(quantity, "measurementMetaData", "metaData"), verdicts[name])
    origin = _under(result, "measurementMetaData", "metaData")
    _said(origin, "name", "provenance")
    hashes = "; ".join(f"sha256 of {name}: {digest}" for name, digest in provenance.data.items())
    _said(origin, "declaration", f"command: {provenance.command}; {hashes}")


def certified(solution: Solution) -> Sequence[tuple[str, float, float, str]]:
    """(name, value, u, unit) of the results that a certificate states: those that have an uncertainty."""
    return [(name, value, u, unit) for name, value, u, unit in solution.displayed
            if value is not None and u > 0 and math.isfinite(u)]


def _real(parent: Any, value: float, u: float | None, unit: str) -> None:
    """A number with its unit, and the expanded uncertainty to two digits where there is an uncertainty."""
    text, factor = dsi(unit)
    real = _under(parent, "real", space=SI)
    expanded = None if u is None else COVERAGE_FACTOR * u * factor
    _under(real, "value", text=decimal(value * factor, expanded), space=SI)
    _under(real, "unit", text=text, space=SI)
    if expanded is not None:
        univariate = _under(real, "measurementUncertaintyUnivariate", "expandedMU", space=SI)
        _under(univariate, "valueExpandedMU", text=decimal(expanded, expanded), space=SI)
        _under(univariate, "coverageFactor", text=str(COVERAGE_FACTOR), space=SI)
        _under(univariate, "coverageProbability", text=str(COVERAGE), space=SI)
        _under(univariate, "distribution", text="normal", space=SI)


def decimal(value: float, u: float | None) -> str:
    """A number as XML wants it, rounded to two digits of an uncertainty where there is one."""
    if u is None:
        return f"{value:.15g}"
    places = numbers.decimals(u)
    rounded = round(value, places) + 0.0
    # Of a large power of ten only the digits that mean something are written.
    return f"{rounded:.{places}f}" if 0 <= places <= 12 else f"{value:.{max(0, places + _power(value, u))}e}"


def _power(value: float, u: float) -> int:
    return math.floor(math.log10(max(abs(value), u)))


def _conformity(meta: Any, judged: Conformity) -> None:
    _said(meta, "name", "conformity with the tolerance")
    _under(meta, "norm", text="ISO 14253-1:2017")
    undecided = judged.verdict == UNDECIDED
    words = "undecided: neither conformity nor nonconformity is proven" if undecided else judged.verdict
    _said(meta, "declaration", f"{words}; probability of conformity {judged.probability:.3g}. {RULE}")
    _under(meta, "conformity", text="noPass" if undecided else judged.verdict)
    data = _under(meta, "data")
    for name, limit in (("lower limit", judged.lower), ("upper limit", judged.upper)):
        quantity = _under(data, "quantity")
        _said(quantity, "name", name)
        _real(quantity, limit / units.factor(judged.unit), None, judged.unit)
