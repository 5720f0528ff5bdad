"""report.html of `calib reproduce`: printed numbers beside the numbers computed anew, with the studies' figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calib import files
from calib.report import numbers
from calib.report.provenance import Provenance
from calib.report.template import Cell, Drawing, render
from calib.workflow.reproduce import AGREES, DIFFERS, Item, Reproduction

HEADER = ("number", "printed", "computed", "u", "joint", "u", "unit", "verdict")
STYLES = {AGREES: "good", DIFFERS: "warning"}


def write(found: Sequence[Reproduction], provenance: Provenance, path: str | Path) -> Path:
    """Write the page, whole or not at all.

    found: one comparison a paper; provenance: of the run; path: of the file.
    return: the path.
    raises InputError where it cannot be written.
    """
    return files.write_text(path, html(found, provenance))


def html(found: Sequence[Reproduction], provenance: Provenance) -> str:
    """The page as text, self-contained.

    found: one comparison a paper; provenance: of the run.
    return: the HTML document.
    """
    total = sum(len(one.items) for one in found)
    agreeing = sum(one.counts()[AGREES] for one in found)
    papers = "one paper" if len(found) == 1 else f"{len(found)} papers"
    return render(
        "reproduction.html.j2",
        title="Published numbers, computed anew",
        answer=f"{agreeing} of {total} printed numbers of {papers} agree to half of their last digit.",
        papers=[_paper(one) for one in found],
        provenance=provenance.lines(),
    )


def _paper(found: Reproduction) -> dict[str, Any]:
    drawings = []
    for title, figure in found.figures.items():
        drawn = figure() if callable(figure) else figure
        drawings.append(Drawing.of(drawn, f"{found.name} {title}", title))
    return {
        "name": found.name, "counts": found.summary(), "drawings": drawings,
        "header": HEADER, "all": [_row(item) for item in found.items],
        "others": [_row(item) for item in found.items if item.verdict != AGREES and item.printed is not None],
    }


def _row(item: Item) -> dict[str, Any]:
    """One number: the cells of its line, and the quantity and the reason below them."""
    printed = item.printed.text if item.printed is not None else item.printed_text or "–"
    value = "–" if item.value is None else _rounded(item)
    joint, joint_u = ("", "") if item.joint is None else numbers.with_uncertainty(item.joint, item.joint_u)
    u = "" if item.u is None else numbers.with_uncertainty(0.0, item.u)[1]
    unit = "" if item.unit == "1" else item.unit
    stated = printed if item.printed is not None and item.printed.number is not None else Cell(printed, "prose")
    cells = [item.key, stated, value, u, joint, joint_u, Cell(unit, "prose"),
             Cell(item.verdict, STYLES.get(item.verdict, "quiet"))]
    return {"cells": cells, "quantity": item.quantity, "why": item.why}


def _rounded(item: Item) -> str:
    """The computed value to one digit more than was printed, so that the verdict can be seen."""
    assert item.value is not None
    if item.printed is None or item.printed.number is None or not item.printed.half_digit:
        return numbers.plain(item.value)
    return numbers.with_uncertainty(item.value, 2.0 * item.printed.half_digit)[0]
