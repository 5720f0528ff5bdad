"""Results of an earlier calibration or a second method: a result.json of `calib solve`, or a certificate as XML."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calib import files, units
from calib.errors import InputError
from calib.report.certificate.dsi import factor
from calib.report.certificate.xml import DCC, SI
from calib.workflow.knowledge import label_of

JSON_FACTOR = 2.0       # result.json states standard uncertainties; they are expanded as everywhere else
LARGEST = 50_000_000    # bytes of a certificate that is read


@dataclass(frozen=True)
class Earlier:
    """Results of somebody else: {name: (value, expanded uncertainty)} in SI, and the hashes of the data behind them."""

    values: dict[str, tuple[float, float]]
    hashes: frozenset[str]


def read(path: str | Path) -> Earlier:
    """Read the results of an earlier calibration or a second method.

    path: of a result.json, or of a certificate (.xml).
    return: the results.
    raises InputError where it cannot be read or holds no result with an uncertainty.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; give the result.json or the certificate to compare with")
    found = _certificate(path) if path.suffix.lower() == ".xml" else _result(path)
    if not found.values:
        raise InputError(f"{path}: holds no result with an uncertainty to compare with")
    return found


def _result(path: Path) -> Earlier:
    content = files.read_json(path)
    values: dict[str, tuple[float, float]] = {}
    try:
        for entry in (*content["derived"], *content["unknowns"]):
            if entry["u"]:
                scale = units.factor(entry["unit"])
                values.setdefault(label_of(entry), (entry["value"] * scale, JSON_FACTOR * entry["u"] * scale))
        hashes = frozenset(content["provenance"]["data"].values())
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: is no result.json of `calib solve` ({error!r} is wrong)") from None
    return Earlier(values, hashes)


def _certificate(path: Path) -> Earlier:
    from xml.etree import ElementTree

    text = path.read_bytes()
    # Entities could name other files or grow without end; no certificate needs any.
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text or len(text) > LARGEST:
        raise InputError(f"{path}: declares entities or is far too large for a certificate; it is not read")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: is not XML ({error}); give a certificate as it was issued") from None
    values = {}
    for quantity in root.iter(f"{{{DCC}}}quantity"):
        name = quantity.find(f"{{{DCC}}}name/{{{DCC}}}content")
        real = quantity.find(f"{{{SI}}}real")
        if name is None or real is None or not name.text:
            continue
        stated = real.find(f".//{{{SI}}}valueExpandedMU")
        expanded = stated if stated is not None else real.find(f".//{{{SI}}}uncertainty")
        value, unit = real.find(f"{{{SI}}}value"), real.find(f"{{{SI}}}unit")
        if expanded is None or value is None or unit is None:
            continue
        try:
            scale = factor((unit.text or "").strip())
            values[name.text.strip()] = (float(value.text or "") * scale, float(expanded.text or "") * scale)
        except ValueError:
            raise InputError(f"{path}: the value or uncertainty of '{name.text}' is no number") from None
    return Earlier(values, frozenset())
