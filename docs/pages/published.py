"""The published comparisons: every printed number that does not agree, and how many do, recomputed for this page."""

from __future__ import annotations

import os
from pathlib import Path

from calib import catalogue
from calib.report import numbers
from calib.workflow.reproduce import AGREES, Item, Reproduction
from pages.words import escaped, table


def write(path: Path) -> None:
    """Recompute all papers and write their page."""
    parts = ["# Published comparisons\n", "The papers whose tables are built in, recomputed when this page was made. "
             "`calib reproduce --out DIR` gives every number with its reason.\n"]
    # A quick look at the site does with one paper: CALIB_DOCS_PAPERS=turntable.
    chosen = os.environ.get("CALIB_DOCS_PAPERS", "").split()
    for name, module in catalogue.published().items():
        if chosen and name not in chosen:
            continue
        found = module.reproduce()
        source = escaped(getattr(module, "source", ""))
        parts += [f"## {name}\n", f"{source}\n", f"{_counted(found)}\n", _differing(found)]
    path.write_text("\n".join(parts), encoding="utf-8")


def _counted(found: Reproduction) -> str:
    return f"{len(found.items)} numbers: {escaped(found.summary())}."


def _differing(found: Reproduction) -> str:
    rows = [[item.key, item.printed.text if item.printed else "", _computed(item), item.unit, item.why]
            for item in found.items if item.printed is not None and item.verdict != AGREES and item.value is not None]
    if not rows:
        return "Every printed number that can be recomputed agrees.\n"
    return table(["number", "printed", "computed ± u", "unit", "why"], rows)


def _computed(item: Item) -> str:
    value, u = numbers.with_uncertainty(item.value, item.u)
    return f"{value} ± {u}" if u else f"{value} (no u)"
