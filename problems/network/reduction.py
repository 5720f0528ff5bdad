"""The part of a survey that can be adjusted, where its caller wants that: what is left out is said point by point."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from calib import Gaussian, linearise, solve
from calib.errors import InputError
from problems.network.blunders import worst_reading
from problems.network.checks import checked, started
from problems.network.declare import declare
from problems.network.frames import labels
from problems.network.lacking import Contradicting, Lacking
from problems.network.measures import fitting_unit
from problems.network.stations import Ranging, Sightings
from problems.network.survey import Batch, Correlated, Survey

LEAVE_OUT = {"unreadable": "rows of tables with a cell that is empty, NaN or no number",
             "duplicated": "contradicting coordinates of a point that is listed twice",
             "lacking": "points, epochs of frames and parts that lack readings, readings to ids that do not exist",
             "contradicting": "readings of a table in another unit than the others",
             "blunders": "readings that no random error explains, worst first"}
MOST = 50        # readings that are left out as blunders, one after the other; with more, something else is wrong


def reduced(survey: Survey, allowed: Collection[str] = ("lacking",)) -> Survey:
    """The survey without what may be left out of it, ready to be declared.

    allowed: of `LEAVE_OUT`; the remarks say what was left out, and why: points with all their readings, readings of one
    group, single readings. Raises InputError where nothing is left, or something else is wrong.
    """
    count = 0
    while True:
        try:
            placed = started(checked(survey))
            found = _misfitting(placed, allowed) if count < MOST else None
            if found is None:
                return placed
            survey, count = found, count + 1
        except Lacking as error:
            if "lacking" not in allowed or not error.points:
                raise
            remark = f"Left out with all {'its' if len(error.points) == 1 else 'their'} readings: {error}."
            survey = replace(without(survey, set(error.points)), remarks=(*survey.remarks, remark))
            if not survey.read:
                raise InputError(f"nothing is left of the network: {error}") from None
        except Contradicting as error:
            if "contradicting" not in allowed:
                raise
            survey = _without_groups(survey, error)


def _misfitting(survey: Survey, allowed: Collection[str]) -> Survey | None:
    """The survey without readings of another unit, or without its worst blunder, where these may be left out."""
    if not {"contradicting", "blunders"} & set(allowed):
        return None
    estimate = solve(declare(survey))
    if "contradicting" in allowed and (error := fitting_unit(survey, estimate.objective, estimate.dof)):
        return _without_groups(survey, error)
    worst = worst_reading(linearise(estimate)) if "blunders" in allowed else None
    if worst is None:
        return None
    group, row, sentence = worst
    return replace(without_rows(survey, {row}, group), remarks=(*survey.remarks, f"Left out: {sentence}"))


def _without_groups(survey: Survey, error: Contradicting) -> Survey:
    batches = [batch for batch in survey.batches if (batch.group or batch.kind) not in error.groups]
    rest = replace(survey, batches=batches, remarks=(*survey.remarks, f"Left out with all its readings: {error}."))
    if not rest.read:
        raise InputError(f"nothing is left of the network: {error}") from None
    return rest


def without(survey: Survey, names: set[str]) -> Survey:
    """The survey without some points, or without some places of points in frames, and all readings of them."""
    left_out = np.array(sorted(names))

    def stays(epochs: Any, *ends: Any) -> np.ndarray:
        return ~np.any([np.isin(labels(survey, end, epochs), left_out) for end in ends], axis=0)

    reduced_to = _reading(replace(
        survey,
        sightings=[_rows(one, stays(one.epoch, one.target)) for one in survey.sightings],
        ranging=[_rows(one, stays(one.epoch, one.target)) for one in survey.ranging],
    ), lambda batch: stays(batch.epoch, *batch.ends))
    return replace(reduced_to, points={
        key: point for key, point in survey.points.items()
        if key not in names and (not point.frame or key in reduced_to.read)})


def without_rows(survey: Survey, rows: set[int], group: str | None = None) -> Survey:
    """The survey without the readings in some rows: of a group, or of a file that numbers all its readings."""
    def stays(numbers: np.ndarray, name: str) -> np.ndarray:
        return ~np.isin(numbers, list(rows)) if group in (None, name) else np.ones(len(numbers), bool)

    rest = _reading(survey, lambda batch: stays(batch.numbers, batch.group or batch.kind))
    if group is None:
        return rest
    return replace(rest, sightings=[_rows(one, stays(_numbers(one), one.group)) for one in rest.sightings],
                   ranging=[_rows(one, stays(_numbers(one), one.group)) for one in rest.ranging])


def _numbers(one: Sightings | Ranging) -> np.ndarray:
    return np.arange(1, len(one.target) + 1) if one.rows is None else np.asarray(one.rows)


def _reading(survey: Survey, stays: Callable[[Batch], np.ndarray]) -> Survey:
    """The survey with those readings of its batches that stay, and without what is then empty."""
    batches = [_kept(batch, stays(batch)) for batch in survey.batches]
    clusters = [_members(cluster, [bool(stays(member)[0]) for member in cluster.members])
                for cluster in survey.correlated]
    return replace(
        survey,
        batches=[batch for batch in batches if len(batch)],
        correlated=[cluster for cluster in clusters if cluster.members],
        sightings=[one for one in survey.sightings if len(one.target)],
        ranging=[one for one in survey.ranging if len(one.target)],
    )


def _column(values: Any, keep: np.ndarray) -> Any:
    if values is None or np.ndim(values) == 0:
        return values
    array = np.asarray(values)
    return array[keep] if len(array) == len(keep) else values


def _uncertainty(u: Any, keep: np.ndarray) -> Any:
    return u.kept(keep) if isinstance(u, Gaussian) else _column(u, keep)


def _kept(batch: Batch, keep: np.ndarray) -> Batch:
    names = ("station", "target", "readings", "back", "orientation", "station_height", "target_height", "epoch")
    columns = {name: _column(getattr(batch, name), keep) for name in names}
    return replace(batch, **columns, u=_uncertainty(batch.u, keep), rows=batch.numbers[keep],
                   covariates=_covariates(batch.covariates, keep))


def _covariates(covariates: Mapping[str, Any], keep: np.ndarray) -> dict[str, Any]:
    return {name: (_column(v[0], keep), v[1]) if isinstance(v, tuple) else _column(v, keep)
            for name, v in covariates.items()}


def _members(cluster: Correlated, stays: list[bool]) -> Correlated:
    inside = np.repeat(stays, [len(member.model.components) for member in cluster.members])
    return replace(cluster, members=tuple(m for m, s in zip(cluster.members, stays, strict=True) if s),
                   covariance=cluster.covariance[np.ix_(inside, inside)])


def _rows(one: Any, keep: np.ndarray) -> Any:
    assert isinstance(one, (Sightings, Ranging))
    who = "station" if isinstance(one, Sightings) else "instrument"
    # Three numbers are those of range and circles, whatever the number of rows.
    u: Any = one.u
    if not (isinstance(one, Sightings) and not isinstance(u, Gaussian) and np.ndim(u) == 1):
        u = _uncertainty(u, keep)
    return replace(one, **{who: _column(getattr(one, who), keep)}, target=_column(one.target, keep),
                   epoch=_column(one.epoch, keep), covariates=_covariates(one.covariates, keep),
                   readings=_column(one.readings, keep), u=u, rows=_numbers(one)[keep])
