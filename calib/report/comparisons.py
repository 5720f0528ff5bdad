"""A solved job beside an earlier calibration or a second method: E_n of every result that both state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from calib import units
from calib.errors import InputError
from calib.report import numbers
from calib.report.certificate.earlier import read
from calib.report.provenance import Provenance
from calib.report.template import Cell, Grid
from calib.workflow.conformity import Compatibility, compared
from calib.workflow.solution import Solution

SHARED = ("Both rest on a data file in common: the results are not independent, and an E_n below 1 proves less than "
          "it seems.")


def beside(solution: Solution, provenance: Provenance, path: Path) -> tuple[tuple[Compatibility, ...], str]:
    """E_n of every result that another calibration states too.

    solution: a solved job; provenance: of its run; path: of the other result.json or certificate.
    return: the comparisons, and a remark where both rest on the same data ("" where not).
    raises InputError where the file cannot be read or states none of the results.
    """
    earlier = read(path)
    found = []
    for name, value, u, unit in solution.displayed:
        if value is None or not u > 0 or name not in earlier.values:
            continue
        scale = units.factor(unit)
        other, expanded = earlier.values[name]
        found.append(compared(name, unit, value * scale, 2.0 * u * scale, other, expanded))
    if not found:
        raise InputError(f"{path}: states none of the results of this job; there are {', '.join(earlier.values)}, "
                         f"wanted are {', '.join(name for name, *_ in solution.displayed)}")
    # The job file itself may well be the same; readings may not.
    own = {digest for name, digest in provenance.data.items() if name != solution.job.path.name}
    return tuple(found), SHARED if own & earlier.hashes else ""


def grid(found: Sequence[Compatibility]) -> Grid:
    """The comparisons as a table of the page."""
    rows: list[list[str | Cell]] = []
    for one in found:
        scale = units.factor(one.unit)
        value, expanded = numbers.with_uncertainty(one.value / scale, one.expanded / scale)
        other, other_expanded = numbers.with_uncertainty(one.other / scale, one.other_expanded / scale)
        verdict = Cell("compatible" if one.compatible else "not compatible", "good" if one.compatible else "warning")
        rows.append([one.quantity, value, expanded, other, other_expanded, "" if one.unit == "1" else one.unit,
                     numbers.plain(one.normalised, 3), verdict])
    return Grid(["result", "value", "U", "other", "U of other", "unit", "E_n", "verdict"], rows).without_empty()


def content(found: Sequence[Compatibility]) -> list[dict[str, Any]]:
    """The comparisons for result.json, in the units named beside them."""
    entries = []
    for one in found:
        scale = units.factor(one.unit)
        lengths = ("value", "expanded", "other", "other_expanded")
        entries.append({key: value / scale if key in lengths else value for key, value in asdict(one).items()})
    return entries
