"""Epochs of a network: each adjusted by itself in a free datum, then compared (which points moved).

Fixed points that both epochs fix at the same place stay fixed, unless they are to be tested too; all other datums are
opened. Observed coordinates that both epochs share are one observation that says nothing of a movement: left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib import Estimate, Gaussian, covariance, linearise, solve
from calib.analyse.congruence import Congruence, Shifts
from calib.analyse.congruence import congruence as compared
from calib.errors import InputError
from calib.job import Job
from calib.workflow.epochs import EpochComparison, Rules
from problems.network.declare import declare, declare_free
from problems.network.start import positions
from problems.network.survey import ADJUSTED, CONSTRAINED, FIXED, LEFT_HANDED, Batch, Survey

Array = NDArray[np.float64]
COLUMN = "epoch"    # of tables that hold several epochs


@dataclass(frozen=True)
class Epoch:
    """An epoch in a free datum: its estimate; labels: (point, part) of its m coordinates, values (m,) [m], covariance
    (m, m), and datum (m, k): what its readings leave open."""

    estimate: Estimate
    labels: tuple[tuple[str, str], ...]
    values: Array
    covariance: Array
    datum: Array

    def of(self, labels: Sequence[tuple[str, str]]) -> list[int]:
        """Places of some coordinates."""
        place = {label: i for i, label in enumerate(self.labels)}
        return [place[label] for label in labels]


def compare_epochs(first: tuple[str, Job], second: tuple[str, Job], rules: Rules) -> EpochComparison:
    """Two epochs beside each other: (name, job) of each, and how to compare.

    Raises InputError where the epochs share too few points or cannot be compared.
    """
    from problems.network import surveyed

    surveys = [surveyed(job) for _, job in (first, second)]
    return comparison((first[0], second[0]), surveys[0], surveys[1], rules)


def congruence(first: Survey, second: Survey, level: float = 0.01) -> Congruence:
    """Which points moved between two surveys with positions, of the same marks; level: of each test."""
    return comparison(("first", "second"), first, second, Rules(level)).found


def comparison(names: tuple[str, str], first: Survey, second: Survey, rules: Rules) -> EpochComparison:
    """Find the points that moved between two epochs.

    names; first, second: surveys with positions, of the same marks (others are ignored); rules: how to compare.
    Raises InputError where the epochs share too few points, their axes differ, or frames move in them.
    """
    if first.frames or second.frames:
        raise InputError("points in frames move as their frames are declared to; `calib solve` gives their places in "
                         "every epoch. Compare epochs without [data.frames]")
    if first.sense != second.sense or first.axes != second.axes:
        raise InputError(f"the axes of the epochs differ ({first.axes} and {second.axes}, or their circles turn "
                         "against each other); give both in the same axes")
    kept = set() if rules.release else _fixed_alike(first, second)
    first, second = _without_shared_coordinates(first, second)
    one, two = _adjusted(first, first, kept), _adjusted(second, first, kept)
    labels = [label for label in one.labels if label in two.labels]
    places = one.of(labels), two.of(labels)
    datum = _spanned(np.hstack([one.datum[places[0]], two.datum[places[1]]]))
    if len(labels) <= datum.shape[1]:
        shared = len({key for key, _ in labels})
        raise InputError(f"{names[0]} and {names[1]} share {shared} adjusted point(s), too few to compare; measure "
                         "more of the marks again")
    keys, parts = zip(*labels, strict=True)
    dof = one.estimate.dof + two.estimate.dof
    if rules.a_posteriori and dof <= 0:
        raise InputError("no reading of either epoch is checked by others, so that their scatter is not known; "
                         "compare with the stated uncertainties")
    factor = (one.estimate.objective + two.estimate.objective) / dof if rules.a_posteriori else 1.0
    found = compared(Shifts(
        keys, parts, two.values[places[1]] - one.values[places[0]],
        one.covariance[np.ix_(places[0], places[0])] + two.covariance[np.ix_(places[1], places[1])], datum,
        (factor, dof) if rules.a_posteriori else None), rules.level)
    adjusted = [{key for key, _ in epoch.labels} for epoch in (one, two)]
    return EpochComparison(
        names, (one.estimate, two.estimate), found,
        np.array([[dict(zip(one.labels, one.values)).get((key, part), np.nan) for part in "xyz"]
                  for key in found.points]),
        first.axes in LEFT_HANDED, tuple(sorted(kept)), tuple(sorted(adjusted[0] ^ adjusted[1])), factor)


def _fixed_alike(first: Survey, second: Survey) -> set[str]:
    """Points that both epochs fix at one place."""
    found = set()
    for key, point in first.points.items():
        other = second.points.get(key)
        if other is not None and FIXED in (point.plane, point.height) and \
                (point.plane, point.height) == (other.plane, other.height):
            fixed = [part for part in "xyz" if point.role(part) == FIXED]
            if all(point.position["xyz".index(p)] == other.position["xyz".index(p)] for p in fixed):
                found.add(key)
    return found


def _without_shared_coordinates(first: Survey, second: Survey) -> tuple[Survey, Survey]:
    """Both surveys without the coordinates that were observed once and stand in both."""
    def content(batch: Batch) -> tuple[object, ...]:
        u = batch.u.matrices if isinstance(batch.u, Gaussian) and hasattr(batch.u, "matrices") else batch.u
        values = None if batch.values is None else batch.values.tobytes()
        return batch.kind, tuple(batch.ends[0].tolist()), values, repr(u)

    known = [{content(batch) for batch in one.batches if batch.model.points == 1} for one in (first, second)]
    both = known[0] & known[1]
    return tuple(replace(one, batches=[b for b in one.batches if b.model.points != 1 or content(b) not in both])
                 for one in (first, second))  # type: ignore[return-value]


def _adjusted(survey: Survey, like: Survey, kept: set[str]) -> Epoch:
    """An epoch in a free datum over its points, laid onto the positions of another survey."""
    def role(key: str, old: str) -> str:
        return CONSTRAINED if old == ADJUSTED or (old == FIXED and key not in kept) else old

    placed = survey.placed(_onto(survey, like))
    points = {key: replace(p, plane=role(key, p.plane), height=role(key, p.height)) for key, p in placed.points.items()}
    free = positions(replace(survey, points=points))
    estimate = solve(declare(free))
    fit, open_datum = estimate.fit, linearise(declare_free(free))
    point = next(u for u in fit.layout.unknowns if u.name == "point")
    own = next(u for u in open_datum.layout.unknowns if u.name == "point")
    null = np.zeros((open_datum.layout.size, open_datum.factor.defect))
    if open_datum.factor.defect:
        null[open_datum.layout.free_columns] = open_datum.factor.null
    there = np.asarray(fit.layout.free[fit.layout.span(point)], dtype=bool)
    names = [(key, part) for key in point.keys for part in point.parts]
    found = covariance(fit, point)
    return Epoch(estimate, tuple(name for name, free_one in zip(names, there, strict=True) if free_one),
                 np.ravel(found.values)[there], found.matrix[np.ix_(there, there)],
                 null[open_datum.layout.span(own)][there])


def _onto(survey: Survey, like: Survey) -> dict[str, Array]:
    """Positions (3,) of the points of a survey in the frame of another: where that has them there, else carried over
    by the similarity that fits the common points (start values only)."""
    if survey is like:
        return {}
    found = {key: np.array(like.points[key].position) for key in survey.points if key in like.points}
    mine = {key: np.array(point.position) for key, point in survey.points.items()}
    for parts in ((0, 1), (2,)):
        columns = list(parts)
        both = [key for key in found if np.isfinite([found[key][columns], mine[key][columns]]).all()]
        a, b = (np.array([one[key][columns] for key in both]).reshape(-1, len(columns)) for one in (mine, found))
        carried = _similarity(a, b)
        for key in set(mine) - set(found):
            position = found.setdefault(key, np.full(3, np.nan))
            if carried is not None:
                position[columns] = carried(mine[key][columns])
    # What only one survey places in a coordinate keeps the place it has there.
    return {key: np.where(np.isfinite(position), position, mine[key]) for key, position in found.items()}


def _similarity(a: Array, b: Array):  # type: ignore[no-untyped-def]
    """The map of points (n, d) onto (n, d) by shift, and in the plane turn and scale; None where too few are common."""
    if len(a) < a.shape[1]:
        return None
    middle, target = a.mean(axis=0), b.mean(axis=0)
    if a.shape[1] == 1:
        return lambda x: x - middle + target
    z, w = ((p - m) @ np.array([1.0, 1j]) for p, m in ((a, middle), (b, target)))
    turn = np.vdot(z, w) / np.vdot(z, z)
    matrix = np.array([[turn.real, -turn.imag], [turn.imag, turn.real]])
    return lambda x: matrix @ (x - middle) + target


def _spanned(directions: Array) -> Array:
    """An orthonormal basis (m, k) of what some directions (m, j) span."""
    if not directions.size:
        return directions[:, :0]
    left, lengths, _ = np.linalg.svd(directions, full_matrices=False)
    return np.asarray(left[:, lengths > 1e-9 * max(lengths[0], 1e-300)])


def by_epoch(job: Job) -> Iterator[tuple[str, Job]]:
    """Each epoch of a job whose tables of readings have a column `epoch`, as a job of its own; nothing where none has.

    Raises InputError where one table of readings says the epoch of its rows and another does not.
    """
    telling = {name: table for name, table in job.tables.items() if table.has(COLUMN)}
    if not telling:
        return
    silent = [name for name in job.tables if name not in (*telling, "points", "frames")]
    if silent:
        raise InputError(f"{job.path}: table '{silent[0]}' has no column '{COLUMN}', others have; say of all readings "
                         "to which epoch they belong")
    when = {name: table.text(COLUMN) for name, table in telling.items()}
    for epoch in dict.fromkeys(str(e) for column in when.values() for e in column):
        tables = {name: table.where(when[name] == epoch) if name in when else table
                  for name, table in job.tables.items()}
        yield epoch, replace(job, tables={name: table for name, table in tables.items() if len(table)})
