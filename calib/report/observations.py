"""observations.csv: one line for each scalar reading, with its residual, test and detectability."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calib import files, units
from calib.analyse.influence import influence
from calib.report import robust
from calib.report.result import reliability_rows
from calib.workflow.solution import Solution

LISTED = 40     # derived results with a column of influences
COLUMNS = ("row", "group", "component", "reading", "predicted", "residual", "unit", "u", "w", "redundancy", "mdb",
           "p_value", "p_value_of_all")


def write(solution: Solution, path: str | Path) -> Path:
    """Write observations.csv, whole or not at all; an infinite minimal detectable bias is an empty cell. p_value_of_all
    has regard to the number of readings (Holm); columns influence_... say what an error of the size of mdb does; after
    a robust loss the last column is the weight of each reading.

    solution: a solved job; path: of the file.
    return: the path.
    raises InputError where it cannot be written.
    """
    priors = {group.name for group in solution.fit.groups if group.is_prior}
    weights, others = robust.weight_of(solution), _influences(solution)
    lines = []
    for i, line in enumerate(reliability_rows(solution.reliability)):
        line |= {name: values[i] for name, values in others.items()}
        if weights:
            line["weight"] = weights.get((line["group"], line["row"], line["component"]))
        if line["group"] not in priors:
            lines.append(line)
    numbered = {(line["row"], line["component"]) for line in lines}
    if len(numbered) == len(lines):
        # Groups that share one numbering come from one file: its order is the order people know.
        lines.sort(key=lambda line: line["row"])
    columns = (*COLUMNS, *others, *(["weight"] if weights else ()))
    return files.write_csv(path, columns, ([line[name] for name in columns] for line in lines))


def _influences(solution: Solution) -> dict[str, Sequence[Any]]:
    """Columns of what an error of the size of the minimal detectable bias does: to the point that it moves most, and to
    each derived result."""
    fit = solution.fit if solution.robust is None else solution.robust.fit
    found = influence(fit, solution.reliability)
    columns: dict[str, Sequence[Any]] = {}
    if len(found.point):
        columns = {"influence_point": found.point.tolist(), "influence_shift_mm": (found.shift / units.mm).tolist()}
    display = dict(zip(fit.functions().labels, fit.functions().units)) if found.results else {}
    for name, values in list(found.results.items())[:LISTED]:
        unit = display[name]
        columns[f"influence_{name}" + ("" if unit == "1" else f"_{unit}")] = (values / units.factor(unit)).tolist()
    return columns
