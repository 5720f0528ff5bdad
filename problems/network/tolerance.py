"""Readings of a file that miss by more than it tolerates, or by more than any reading can: left out and named.

Source: GNU Gama manual, 5.2, gross absolute terms (attribute tol-abs): the misfit at the start values; here the error
that all others show (Baarda, 1968) must be as large, so that poor start values condemn nobody.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from calib import Estimate, predict, solve
from calib.errors import CalibrationError
from problems.network.checks import GROSS
from problems.network.declare import declare, declare_free
from problems.network.reduction import without_rows
from problems.network.survey import Array, Batch, Survey

FORMAT = 1.0      # m, tol-abs of a file that does not state it
CLEARLY = 1.25    # times a stated tolerance: an error is known no better, and what is near the limit stays in
ASKED = 8         # readings that are tried one by one
MOST = 20         # readings that are left out; where more are wrong, something else is


def tolerable(survey: Survey) -> Survey:
    """The survey of a .gkf without the readings that are wrong by more than its tol-abs, worst first.

    Where the file states none, a reading must be wrong by more than a metre and a third of its length besides: it is
    then no reading between these points. Remarks name each.
    """
    left: list[str] = []
    rest = survey
    while len(left) <= MOST:
        found = _worst(rest)
        if found is None:
            return replace(rest, remarks=(*survey.remarks, *left)) if left else survey
        batch, row, error = found
        ends = " to ".join(str(keys[batch.numbers == row][0]) for keys in batch.ends)
        why = f"more than tol-abs = {1e3 * survey.tolerance:g} mm of the file" if survey.tolerance is not None else \
            "more than gama-local takes (tol-abs) and more than a reading between these points can be wrong"
        left.append(f"Left out: row {row} ({batch.kind} {ends}) is wrong by about {error:.4g} m, {why}. Check it, read "
                    "it again, or take it out.")
        rest = without_rows(rest, {row})
    return survey


def _worst(survey: Survey) -> tuple[Batch, int, float] | None:
    """The batch, row and error [m] of the reading without which the others agree best, where its error is intolerable.

    Asked are those that miss the start values intolerably; a reading of a mixed cluster is not.
    """
    candidates = []
    for batch, miss, limit in _compared(survey, predict(declare_free(survey)), _places(survey)):
        candidates += [(float(m / most), batch, int(row))
                       for m, most, row in zip(miss, limit, batch.numbers) if m > most]
    best, worst = np.inf, None
    for _, batch, row in sorted(candidates, key=lambda one: -one[0])[:ASKED]:
        rest = without_rows(survey, {row})
        try:
            estimate = solve(declare(rest))
        except CalibrationError:      # nothing controls it; what else is wrong is said where it is solved in earnest
            continue
        if estimate.objective < best:
            adjusted = survey.placed(_places(rest, estimate))
            for other, miss, limit in _compared(adjusted, predict(declare_free(adjusted)), _places(adjusted)):
                inside = other.numbers == row
                if inside.any():
                    best = estimate.objective
                    worst = (batch, row, float(miss[inside][0])) if miss[inside][0] > limit[inside][0] else None
    return worst


def _compared(
    survey: Survey, predicted: Mapping[str, Array], places: Mapping[str, Array]
) -> Iterator[tuple[Batch, Array, Array]]:
    """Each batch with the misfits (n,) [m] of its readings at some places, and what is tolerated (n,) [m]."""
    for batch in survey.batches:
        if batch.values is not None and len(batch):
            lengths = _lengths(batch, places)
            yield batch, _misfit(batch, batch.values - predicted[batch.group or batch.kind], lengths), \
                _limit(survey, lengths)


def _places(survey: Survey, estimate: Estimate | None = None) -> dict[str, Array]:
    """Positions (3,) of all points, adjusted where there is an estimate."""
    found = {key: np.array(point.position) for key, point in survey.points.items()}
    if estimate is not None:
        point = next(unknown for unknown in estimate.values if unknown.name == "point")
        columns = ["xyz".index(part) for part in point.parts]
        for key, values in zip(point.keys, np.reshape(estimate[point], (point.count, -1)), strict=True):
            has = [bool(survey.points[key].role(part)) for part in point.parts]
            found[key][np.array(columns)[has]] = values[has]
    return found


def _misfit(batch: Batch, miss: Array, lengths: Array) -> Array:
    """Size (n,) [m] of misfits (n, dim) of a batch; of angles, across the sights of the lengths (n,)."""
    if not batch.model.angular:
        size: Array = np.linalg.norm(miss, axis=1)
        return size
    turned: Array = np.abs(miss - 2.0 * np.pi * np.rint(miss / (2.0 * np.pi)))[:, 0] * lengths
    return turned


def _lengths(batch: Batch, places: Mapping[str, Array]) -> Array:
    """Length (n,) [m] in the plane from the station of each reading to its target, of angles to the backsight, as in
    the manual; not finite where there is none."""
    if batch.model.points == 1:
        return np.full(len(batch), np.inf)
    ends = [np.array([places[key][:2] for key in keys.tolist()]) for keys in batch.ends[:2]]
    apart = np.hypot(*(ends[1] - ends[0]).T)
    return np.where(np.isfinite(apart), apart, np.inf)


def _limit(survey: Survey, lengths: Array) -> Array:
    """Errors (n,) [m] beyond which readings are left out."""
    if survey.tolerance is not None:
        return np.full(len(lengths), CLEARLY * survey.tolerance)
    return np.maximum(FORMAT, GROSS * lengths)
