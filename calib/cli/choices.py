"""What the options of `calib select` mean: rows, limits, floors, criteria, in the words of a job."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from calib import units
from calib.analyse.selection import criterion as criteria
from calib.analyse.selection.floors import Floors
from calib.errors import InputError
from calib.job import Job
from calib.linearisation import Linearisation

CRITERIA = {"D": criteria.D, "A": criteria.A, "E": criteria.E, "G": criteria.G, "I": criteria.I, "c": criteria.C,
            "Ds": criteria.Ds}


def criterion_of(name: str, wanted: Sequence[Any], reported: Sequence[Any], others: Sequence[Linearisation]) -> Any:
    """The criterion of a name.

    wanted: quantities that were named for it; reported: those of the job, where it needs some and none was named;
    others: further configurations, of which the worst counts.
    """
    if name == "D":
        if wanted:
            raise InputError("--quantity: criterion D is about all unknowns; ask for Ds, A, E or c of a quantity")
        found = criteria.D()
    else:
        found = CRITERIA[name](*(wanted or ([] if name in ("G", "I") else reported)))
    return criteria.WorstCase(found, others) if others else found


def rows_of(fit: Linearisation, texts: Sequence[str], option: str) -> dict[str, Any]:
    """{group: row numbers, or None for all} of texts such as "level" or "tracker=1-20,25"."""
    found: dict[str, Any] = {}
    names = [g.name for g in fit.groups if not g.is_prior]
    for text in texts:
        name, numbers = (text, "") if text in names else text.rpartition("=")[::2]
        if name not in names:
            near = units.near_matches(name or text, names)
            hint = f"did you mean '{near[0]}'? " if near else ""
            raise InputError(f"{option}: there is no group '{name or text}'; {hint}There are: {', '.join(names)}. "
                             "Write GROUP or GROUP=1-20,25")
        found[name] = None if not numbers else _numbers(numbers, option, text)
    return found


def _numbers(text: str, option: str, whole: str) -> list[int]:
    rows: list[int] = []
    for piece in text.split(","):
        first, _, last = piece.strip().partition("-")
        if not first.isdigit() or (last and not last.isdigit()):
            raise InputError(f"{option}: '{whole}': rows are written as 1-20,25")
        rows += range(int(first), int(last or first) + 1)
    return rows


def pairs(texts: Sequence[str], option: str, example: str) -> list[tuple[str, str]]:
    """(name, value) of texts NAME=VALUE."""
    found = []
    for text in texts:
        name, equals, value = text.rpartition("=")
        if not equals or not name.strip() or not value.strip():
            raise InputError(f"{option}: '{text}': write {example}")
        found.append((name.strip(), value.strip()))
    return found


def at_most_of(texts: Sequence[str]) -> dict[Any, int]:
    """{covariate: k} of texts COVARIATE=K."""
    limits: dict[Any, int] = {}
    for name, count in pairs(texts, "--at-most", "COVARIATE=K, such as target=2"):
        if not count.isdigit() or int(count) < 1:
            raise InputError(f"--at-most: '{name}={count}': write COVARIATE=K, such as target=2, with K at least 1")
        limits[name] = int(count)
    return limits


def floors_of(fit: Linearisation, redundancy: float, mdb: Sequence[str], influence: Sequence[str]) -> Floors | None:
    """The floors that were asked for, or None."""
    if not (redundancy or mdb or influence):
        return None
    limits: dict[str, float] = {}
    for name, text in pairs(mdb, "--mdb", "GROUP=VALUE UNIT, such as \"tracker=5 um\""):
        group = next((g for g in fit.groups if g.name == name and not g.is_prior), None)
        if group is None:
            names = [g.name for g in fit.groups if not g.is_prior]
            raise InputError(f"--mdb: there is no group '{name}'; there are {', '.join(names)}")
        kinds = {units.dimension(unit) for unit in group.units}
        if len(kinds) > 1:
            raise InputError(f"--mdb: '{name}' reads {' and '.join(sorted(set(group.units)))}, for which no one limit "
                             "holds; limit the influence instead")
        limits[name] = _si(text, group.units[0], f"--mdb {name}")
    changes: dict[Any, float] = {}
    for name, text in pairs(influence, "--influence", "NAME=VALUE UNIT, such as \"base_point.z=20 um\""):
        functions = criteria.functions_of(fit, name)
        if len(set(functions.units)) > 1:
            raise InputError(f"--influence: '{name}' has {' and '.join(sorted(set(functions.units)))}; name one part")
        changes[name] = _si(text, functions.units[0], f"--influence {name}")
    return Floors(redundancy, limits, changes)


def _si(text: str, unit: str, where: str) -> float:
    try:
        return units.quantity(text, units.dimension(unit))
    except InputError as error:
        raise InputError(f"{where}: {error.sentence}") from None


def costs_of(fit: Linearisation, cost: str | None, by: Any) -> Any:
    """{label: cost} from a covariate of the rows: what a candidate costs is the sum over its rows."""
    if cost is None:
        return None
    from calib.analyse.selection.candidates import candidates_of

    candidates = candidates_of(fit, by)
    there = sorted({name for g in fit.groups for name, values in g.covariates.items()
                    if np.asarray(values).dtype.kind in "fiu"})
    total = np.zeros(len(candidates))
    for name, numbers in candidates.members.items():
        group, mine = fit.group(name), numbers >= 0
        if not mine.any():
            continue
        if cost not in there or cost not in group.covariates:
            raise InputError(f"--cost: '{name}' has no numbers '{cost}'; there are: {', '.join(there) or 'none'}")
        np.add.at(total, numbers[mine], np.asarray(group.covariates[cost], dtype=float)[mine])
    return dict(zip(candidates.labels, total.tolist(), strict=True))


def grouping_of(fit: Linearisation, by: Sequence[str]) -> Any:
    """What makes a candidate: what was named; else a row, with rows of one number of a table together."""
    if by:
        return by[0] if len(by) == 1 else tuple(by)
    repeats = any(len(np.unique(g.rows)) < len(g.rows) for g in fit.groups if not g.is_prior)
    return "row" if repeats else None


def places_of(job: Job, fit: Linearisation) -> dict[str, Any]:
    """{group: (n, 3)} [m] of the groups whose rows stand in a table with columns x, y and z."""
    found: dict[str, Any] = {}
    for table in job.tables.values():
        if not all(table.has(axis) for axis in "xyz"):
            continue
        try:
            points = np.column_stack([table.number(axis, "length") for axis in "xyz"])
        except InputError:      # columns of that name that are no lengths
            continue
        row = {int(number): k for k, number in enumerate(table.row_numbers)}
        for group in fit.groups:
            mine = [row.get(int(r)) for r in group.rows]
            if not group.is_prior and len(mine) == len(table) and None not in mine:
                found[group.name] = points[np.array(mine)]
    return found
