"""budget.csv: the uncertainty budget of every result, source by source, as the GUM tabulates it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from calib import files, units
from calib.workflow.solution import Solution

COLUMNS = ("quantity", "unit", "value", "source", "u_contribution", "share_of_variance")
COMBINED, EXPANDED = "combined standard uncertainty u", "expanded uncertainty U (k = 2)"


def write(solution: Solution, path: str | Path) -> Path:
    """Write budget.csv, whole or not at all.

    solution: a solved job; path: of the file.
    return: the path.
    raises InputError where it cannot be written.
    source: JCGM 100:2008, 5.1 and H: a contribution is the standard uncertainty of a source times the size of its
    sensitivity coefficient; correlated readings of one group stand together.
    """
    return files.write_csv(path, COLUMNS, _lines(solution))


def _lines(solution: Solution) -> Iterator[list[object]]:
    values = {name: value for name, value, _, _ in solution.displayed}
    for one in solution.budgets:
        scale = units.factor(one.unit)
        first = [one.name, one.unit, values.get(one.name)]
        for line in one.contributions:
            yield [*first, line.label, line.u / scale, line.share]
        yield [*first, COMBINED, one.u / scale, 1.0 if one.u > 0 else 0.0]
        yield [*first, EXPANDED, 2.0 * one.u / scale, None]
