"""Simulated readings of a job's declared model, put back into the columns of its tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib import units
from calib.errors import DeclarationError, InputError
from calib.job import Job
from calib.observations import Observations
from calib.problem import Problem
from calib.settings import signed_quantity
from calib.solve.estimate import Estimate, simulate
from calib.table import Table

InColumns = Callable[[Observations], tuple[str, Mapping[str, Any]] | None]


@dataclass(frozen=True)
class Simulated:
    """Readings drawn from a model: the tables of the job with them, and the groups that stand in no column.

    loose: {group: (n, dim) readings in SI} of groups computed from several columns, such as polar from Cartesian.
    truth: {unknown label: value in its display unit} that the readings were drawn from.
    """

    tables: Mapping[str, Table]
    loose: Mapping[str, Observations]
    truth: Mapping[str, tuple[float, str]]


def simulated(job: Job, problem: Problem, estimate: Estimate, seed: int, effects: Mapping[str, str],
              in_columns: InColumns | None = None) -> Simulated:
    """Draw readings of a job from its estimate, with effects switched on.

    job: as read; problem: its problem; estimate: taken as the truth; seed: of the errors; effects: {effect, or
    effect.parameter: value with unit}; in_columns: of the problem module, for readings that are no column of a table
    as they are: observations -> (table, {column: (n,) in SI}), or None for a group that it does not know.
    return: the tables with simulated readings.
    raises InputError for an effect, parameter or unit that is not there.
    """
    values: dict[Any, Any] = {unknown: estimate[unknown] for unknown in problem.unknowns}
    for name, text in effects.items():
        _set(problem, values, name, text)
    drawn = simulate(problem, values, seed)
    tables, loose = dict(job.tables), {}
    for before, after in zip(problem.observations, drawn.observations):
        if before.is_prior or before.readings is None:
            continue
        place = _place(before, job.tables)
        written = in_columns(after) if place is None and in_columns else None
        if place is not None:
            name, headers = place
            rows, readings = _one_row_each(after)
            filled = dict(zip(headers, readings.T, strict=True))
        elif written is not None:
            name, rows = written[0], after.rows
            filled = {tables[name].column(column).header: reading for column, reading in written[1].items()}
        else:
            loose[before.group] = after
            continue
        for header, column in filled.items():
            tables[name] = _with_column(tables[name], header, rows, column)
    return Simulated(tables, loose, _truth(problem, values))


def _set(problem: Problem, values: dict[Any, Any], name: str, text: str) -> None:
    """Switch one effect on: in every place where it is declared, or at the one key that its label names."""
    names: dict[str, tuple[Any, int, Any]] = {}
    for attached in problem.attached:
        places: dict[str, Any] = dict.fromkeys((attached.effect.label, attached.effect.name), slice(None))
        places |= {f"{attached.effect.name} ({attached.effect.channel_at(key)})": instance
                   for instance, key in enumerate(attached.keys)}
        for part, parameter in enumerate(attached.effect.parameters):
            for label, instances in places.items():
                names.setdefault(f"{label}.{parameter.name}", (attached, part, instances))
                if len(attached.effect.parameters) == 1:
                    names.setdefault(label, (attached, part, instances))
    several = [f"{name}.{p.name}" for attached in problem.attached for p in attached.effect.parameters
               if name in (attached.effect.label, attached.effect.name)]
    if name not in names and several:
        raise InputError(f"--with-effect {name}: it has several parameters; say which: {', '.join(several)}")
    if name not in names:
        near = units.near_matches(name, list(names))
        hint = f"did you mean '{near[0]}'? " if near else ""
        labels = ", ".join(f"{one.effect.label}" for one in problem.attached) or "none"
        raise InputError(f"--with-effect {name}: there is no such effect; {hint}There are: {labels}")
    attached, part, instances = names[name]
    unit = attached.unknown.units[part]
    try:
        plain = float(text)
    except ValueError:
        try:
            value = signed_quantity(text, units.dimension(unit))
        except InputError as error:
            raise InputError(f"--with-effect {name}: {error}; write a number in {unit}, or with its unit") from None
    else:
        value = float(units.to_si(plain, unit))
    parameters = np.reshape(np.array(values[attached.unknown], dtype=float), (attached.unknown.count, -1))
    parameters[instances, part] = value
    values[attached.unknown] = parameters.reshape(attached.unknown.shape)


def _place(observations: Observations, tables: Mapping[str, Table]) -> tuple[str, list[str]] | None:
    """The table and the columns whose numbers are the readings, component by component."""
    of_row, readings = _one_row_each(observations)
    for name, table in tables.items():
        if not np.isin(of_row, table.row_numbers).all():
            continue
        rows = table.places(of_row)
        numbers = dict(_numbers(table))
        headers: list[str] = []
        for component in readings.T:
            equal = [header for header, column in numbers.items() if np.array_equal(column[rows], component)]
            if len(equal) != 1:
                break
            headers.append(equal[0])
        else:
            return name, headers
    return None


def _one_row_each(observations: Observations) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the table, their readings side by side: where each row holds the same number of readings (six legs)."""
    rows, readings = np.asarray(observations.rows), observations.recorded
    each = len(rows) // len(np.unique(rows))
    if each > 1 and np.array_equal(rows, np.repeat(rows[::each], each)):
        return rows[::each], readings.reshape(len(rows) // each, -1)
    return rows, readings


def _numbers(table: Table) -> Any:
    for column in table.columns:
        if column.dimension is None:
            continue
        try:
            yield column.header, table.number(column.header, column.dimension)
        except (InputError, DeclarationError):
            continue


def _with_column(table: Table, header: str, rows: np.ndarray, readings: np.ndarray) -> Table:
    column = table.column(header)
    numbers = table.number(header, column.dimension or "number")
    numbers[table.places(rows)] = readings
    return table.with_number(header, numbers)


def _truth(problem: Problem, values: Mapping[Any, Any]) -> dict[str, tuple[float, str]]:
    found = {}
    for unknown in problem.unknowns:
        if unknown.kind == "vector":
            stored = np.reshape(np.asarray(values[unknown], float), (-1,))
            for i, label in enumerate(unknown.labels):
                unit = unknown.units[i % unknown.freedom]
                found[label] = (float(units.from_si(stored[i], unit)), unit)
    return found


