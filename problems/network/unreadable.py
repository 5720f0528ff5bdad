"""Rows of tables that cannot be read, left out where the caller of a job asks for that, each with its reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib import columns
from calib.columns import Column
from calib.errors import InputError
from calib.job import Job
from calib.table import Table

TEXTS = ("station", "target", "instrument", "back", "set", "epoch", "frame")


def readable(job: Job, names: list[str]) -> tuple[Job, list[str]]:
    """The job without rows of some of its tables that have a cell which is empty, no number or no uncertainty.

    names: of the tables. Returns the job and a remark for each row. Raises InputError where nothing of a table is left.
    """
    tables, remarks = dict(job.tables), []
    for name in names:
        table = tables[name]
        wrong: dict[int, str] = {}
        for place, column in enumerate(table.columns):
            for row, why in _unreadable(table, place, column):
                wrong.setdefault(row, f"{table.place(row, column)}: {why}")
        if len(wrong) == len(table):
            raise InputError(f"{table.path}: no row can be read, the first because of {wrong[0]}")
        remarks += [f"Left out: {why}" for _, why in sorted(wrong.items())]
        tables[name] = table.where(~np.isin(np.arange(len(table)), list(wrong)))
    return replace(job, tables=tables), remarks


def _unreadable(table: Table, place: int, column: Column) -> list[tuple[int, str]]:
    """(row, why) of the cells of a column that hold nothing to go on with."""
    cells = [row[place] for row in table.cells]
    if column.unit is None:
        return [(row, "the name is missing") for row, cell in enumerate(cells)
                if column.name in TEXTS and not cell.strip()]
    stated = column.name == "u" or column.name.startswith("u_")
    try:
        values = np.array(cells, dtype=float)     # a million good cells at once
        suspects = np.flatnonzero(~np.isfinite(values) | (stated & ~(values > 0.0))).tolist()
    except ValueError:
        suspects = list(range(len(cells)))
    found = []
    for row in suspects:
        try:
            value = columns.number(cells[row], column.unit, table.decimal)
            if stated and not value > 0.0:
                found.append((row, f"an uncertainty of {cells[row].strip()} is none"))
        except InputError as error:
            found.append((row, error.sentence))
    return found
