"""Write a digital calibration certificate, checked by the rules of the DCC before it is written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calib import files
from calib.errors import CalibrationError, InputError
from calib.report.certificate.stated import stated
from calib.report.certificate.xml import VERSION, certified, tree
from calib.report.provenance import Provenance
from calib.workflow.solution import Solution

INSTALL = "pip install 'calibration-framework[certificate]'"


def write(solution: Solution, provenance: Provenance, path: str | Path) -> Path:
    """Write the certificate of a solved job, whole or not at all.

    solution: a solved job with a table [certificate]; provenance: of the run; path: of the XML file.
    return: the path.
    raises InputError where the library is missing, the job lacks an entry, the estimate is not certified, no result has
    an uncertainty, or the file cannot be written; CalibrationError where the certificate breaks a rule of the DCC.
    """
    estimate, job = solution.estimate, solution.job
    require_library()
    entries = stated(job.certificate, job.path)
    if not (estimate.converged and estimate.certificate.passed):
        why = estimate.certificate.why if estimate.converged else estimate.message
        raise InputError(f"{job.path}: no certificate of a fit that is not certified itself ({why})")
    if not certified(solution):
        raise InputError(f"{job.path}: no result has an uncertainty, so there is nothing to certify")
    from lxml import etree

    root = tree(solution, entries, provenance)
    faults = broken_rules(root)
    if faults:
        raise CalibrationError(f"{job.path}: the certificate breaks rules of the DCC: {'; '.join(faults)}")
    text = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return files.write_bytes(path, text)


def require_library() -> None:
    """Raise InputError with what to install where the library of the PTB is missing."""
    try:
        import dcclib  # noqa: F401
    except ImportError:
        raise InputError(f"a certificate needs the library `dcclib`; install it: {INSTALL}") from None


def broken_rules(root: Any) -> list[str]:
    """What the schematron of the DCC and, where it lies on this machine, its schema have against a certificate.

    root: the root element.
    return: sentences; none where all is well.
    """
    from dcclib.validation.schematron import SchematronValidator

    found = SchematronValidator.for_dcc().validate_tree(root)
    serious = [one for one in found.successful_reports if one.role in ("error", "warning")]
    faults = [" ".join(one.text.split()) for one in (*found.failed_assertions, *serious)]
    schema = schema_at_hand()
    if schema is not None:
        from dcclib.validation.xsd import XsdValidator

        faults += [error.message for error in XsdValidator.from_file(str(schema)).validate_tree(root).errors]
    return list(dict.fromkeys(faults))


def schema_at_hand(version: str = VERSION) -> Path | None:
    """The schema of the DCC where a library has it on this machine already; nothing is loaded from elsewhere.

    version: of the schema.
    return: its path, None where it is not here.
    """
    try:
        from dcc_json_toolkit.cache import CACHE_DIR_PATH  # type: ignore[import-untyped]
    except (ImportError, OSError):      # it makes its folder when it is imported
        return None
    found = sorted(Path(CACHE_DIR_PATH, version).glob("**/dcc.xsd"))
    return found[0] if found else None
