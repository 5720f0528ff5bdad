"""Readings in another unit than they say: found by the one factor with which everything fits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from calib import GaussNewton, predict, solve
from calib.errors import CalibrationError, InputError
from problems.network.declare import declare, declare_free
from problems.network.lacking import Contradicting
from problems.network.start import positions
from problems.network.survey import FIXED, Array, Batch, Survey

LENGTHS = (1e-3, 1e-2, 0.3048, 1 / 0.3048, 1e2, 1e3)                  # mm, cm, feet for metres, and the other way
ANGLES = (0.9, 1 / 0.9, np.pi / 180, 180 / np.pi, np.pi / 200, 200 / np.pi)    # gon, degrees, radians for one another
FITS = 0.25       # of the points that contradict each other may be left
LARGEST = 3000    # readings up to which a fit that fits nothing is tried again with each unit
SENSELESS, FAR_BETTER = 1e3, 1e-2      # variance factor of such a fit, and its part that another unit leaves
STEPS = 50        # with the right unit the fit needs few
SOLVED = 3        # units in which the network is adjusted again


def contradicting_unit(survey: Survey, gross: Callable[[Survey], set[str]], before: int) -> Contradicting | None:
    """What is wrong where the unit of a group of readings contradicts all others, or None.

    survey: whose points start from the readings alone; gross: points of a placed survey that its readings miss grossly;
    before: their number as the readings stand.
    """
    for group, factor, changed in _suspicions(survey):
        try:
            left = len(gross(positions(changed)))
        except InputError:
            continue
        if left <= FITS * before:
            return _named(group, factor)
    return None


def fitting_unit(survey: Survey, objective: float, dof: int) -> Contradicting | None:
    """The same for a survey whose adjustment fits nothing (objective: its v'Pv; dof): with one other unit it fits.

    Every group is tried in every unit; only where the readings then agree far better with the places that follow from
    them is the network adjusted again.
    """
    readings = sum(len(batch) for batch in survey.every_batch)
    if dof <= 0 or objective < SENSELESS * dof or readings > LARGEST or survey.sightings or survey.ranging:
        return None
    before = _disagreement(survey)
    found = []
    for group, factor, changed in _suspicions(survey):
        try:
            placed = positions(changed)
        except InputError:
            continue
        found.append((_disagreement(placed), group, factor, placed))
    for miss, group, factor, placed in sorted(found, key=lambda one: one[0])[:SOLVED]:
        try:
            if miss < before and solve(
                    declare(placed), GaussNewton(iterations=STEPS)).objective < FAR_BETTER * objective:
                return _named(group, factor)
        except CalibrationError:
            continue
    return None


def _disagreement(survey: Survey) -> float:
    """Mean misfit of readings at the places of a survey: of angles in radians, else relative, none above one."""
    predicted = predict(declare_free(survey))
    misses = [_misses(batch, predicted[batch.group or batch.kind]) for batch in survey.batches
              if batch.values is not None and len(batch)]
    return float(np.mean(np.minimum(np.concatenate(misses), 1.0))) if misses else 0.0


def _misses(batch: Batch, predicted: Array) -> Array:
    miss = np.abs(np.asarray(batch.values) - predicted)
    if batch.model.angular:
        return np.asarray(np.abs(miss - 2.0 * np.pi * np.rint(miss / (2.0 * np.pi)))[:, 0])
    return np.asarray(np.linalg.norm(miss, axis=1) / np.maximum(np.linalg.norm(predicted, axis=1), 1e-9))


def _named(group: Batch, factor: float) -> Contradicting:
    name = group.group or group.kind
    return Contradicting(f"the readings '{name}' are {1 / factor:.4g} times what all others say: multiplied by "
                         f"{factor:.4g} they fit; correct the unit of their column", [name])


def _suspicions(survey: Survey) -> Iterator[tuple[Batch, float, Survey]]:
    """Each group of readings with each factor, and the survey with them in that unit, started from its readings."""
    fresh = {key: replace(point, position=(np.nan,) * 3) if FIXED not in (point.plane, point.height) else point
             for key, point in survey.points.items()}
    for batch in survey.batches:
        if batch.values is None or len(batch) < 3 or batch.model.points == 1:
            continue
        for factor in ANGLES if batch.model.angular else LENGTHS:
            changed = replace(batch, readings=np.asarray(batch.readings, float) * factor)
            yield batch, factor, replace(survey, points=fresh, batches=[
                changed if one is batch else one for one in survey.batches])
