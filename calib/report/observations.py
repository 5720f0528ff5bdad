"""observations.csv: one line for each scalar reading, with its residual, test and detectability."""

from __future__ import annotations

from pathlib import Path

from calib import files
from calib.report import robust
from calib.report.result import reliability_rows
from calib.workflow.solution import Solution

COLUMNS = ("row", "group", "component", "reading", "predicted", "residual", "unit", "u", "w", "redundancy", "mdb",
           "p_value")


def write(solution: Solution, path: str | Path) -> Path:
    """Write observations.csv, whole or not at all; an infinite minimal detectable bias is an empty cell. After a robust
    loss the last column is the weight of each reading.

    solution: a solved job; path: of the file.
    return: the path.
    raises InputError where it cannot be written.
    """
    priors = {group.name for group in solution.fit.groups if group.is_prior}
    lines = [line for line in reliability_rows(solution.reliability) if line["group"] not in priors]
    numbered = {(line["row"], line["component"]) for line in lines}
    if len(numbered) == len(lines):
        # Groups that share one numbering come from one file: its order is the order people know.
        lines.sort(key=lambda line: line["row"])
    weights = robust.weight_of(solution)
    columns = (*COLUMNS, "weight") if weights else COLUMNS
    for line in lines if weights else ():
        line["weight"] = weights[line["group"], line["row"], line["component"]]
    return files.write_csv(path, columns, ([line[name] for name in columns] for line in lines))
