"""What the four papers chose among redundant measurements, axes and poses, beside the best choice and its bound.

    python benchmarks/selection_papers.py [part ...]

Writes benchmarks/results/selection_papers.md; with parts (axes, layouts, five_axis, poses) prints these only. Every
choice is made by `calib.select` on the declared problem of the paper; nothing is read, only planned, except for the
five-axis tables and the campaigns of the locators.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from selection_axes import Rows, against_nine, driving, worse_of_both_poses
from selection_five_axis import positions
from selection_layouts import (
    arcs,
    best_on_arc,
    experiment_against_best,
    first_point,
    placed,
    symmetric_against_half,
    three_targets,
)
from selection_poses import identification_poses

RESULTS = Path(__file__).parent / "results"
Parts = list[tuple[str, Rows]]


def table(rows: Sequence[dict[str, object]]) -> str:
    """Rows as a Markdown table."""
    def cell(value: object) -> str:
        return f"{value:.4g}" if isinstance(value, (float, np.floating)) else str(value)
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = ["| " + " | ".join(names) + " |", "|" + " --- |" * len(names)]
    return "\n".join([*lines, *("| " + " | ".join(cell(row.get(n, "")) for n in names) + " |" for row in rows)])


def axes() -> Parts:
    """The 84 choices of driven axes."""
    both = {pose: driving(pose) for pose in ("initial", "target")}
    return [("Six of nine axes: how many choices are what", [both[pose][1] for pose in both]),
            *((f"All 84 choices in the {pose} pose", both[pose][0]) for pose in both),
            ("The worse of both poses", worse_of_both_poses()),
            ("Eq 47, every length error 10 um, every angle error 5 arcsec",
             [*against_nine("initial"), *against_nine("target")])]


def layouts() -> Parts:
    """Base points and turntable."""
    return [("Three targets", three_targets()), ("Symmetric against half-symmetric", symmetric_against_half()),
            ("The experiment against the best layout on its lines", experiment_against_best()),
            ("The next best point after two lines", first_point()),
            ("Placed continuously, sqrt(Q11 + Q22)", placed()),
            ("Turntable: arc, number, radius", arcs()), ("Turntable: the best eight of 37", best_on_arc())]


def five_axis() -> Parts:
    """The tables of the simulator."""
    return [("Five-axis: the fewest positions found that hold u of each of the 12 results within 10 %", positions())]


def poses() -> Parts:
    """The campaigns of the locators."""
    return [("Locators: identification poses, 6 campaigns of 30 poses, 12 poses for checking", identification_poses())]


PARTS: dict[str, Callable[[], Parts]] = {"axes": axes, "layouts": layouts, "five_axis": five_axis, "poses": poses}


def main(names: Sequence[str]) -> None:
    """Run all studies and write the tables; or some, and print them."""
    parts = [part for name in (names or PARTS) for part in PARTS[name]()]
    text = "\n\n".join(f"## {title}\n\n{table(rows)}" for title, rows in parts)
    if not names:
        RESULTS.mkdir(exist_ok=True)
        (RESULTS / "selection_papers.md").write_text(
            "# Redundancy as a decision: the papers\n\n`python benchmarks/selection_papers.py`\n\n" + text + "\n",
            encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main(sys.argv[1:])
