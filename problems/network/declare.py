"""A surveyed network as a problem: points, settings of circles, readings, and the datum."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from calib import Gaussian, Observations, Pose, Problem, Shared, Unknown, direct
from calib.effect import slots_of
from calib.errors import InputError
from problems.network import carried, datum, frames, stations, tilts
from problems.network.survey import ADJUSTED, CONSTRAINED, FIXED, Batch, Correlated, Survey


def declare(survey: Survey) -> Problem:
    """Declare the adjustment of a surveyed network at the positions that its points have.

    survey: points, each with a position (`start.positions` finds missing ones), and readings.
    Returns the problem with unknowns `point` (the coordinates the network has, of points in frames those in their
    frame), `orientation` (of each setting of a circle), `station` (of trackers), `interferometer` (base point and dead
    path) and `frame` (where each frame stands in each epoch). Fixed coordinates are held, and what of a frame does not
    move. Where points are constrained and the readings leave the datum open, the condition `datum` keeps these points,
    as a whole, where they are.
    Raises InputError where a point without position takes part.
    """
    problem, point, chosen = _free(survey)
    return datum.inner_constraints(problem, point, chosen)


def declare_free(survey: Survey) -> Problem:
    """The same without inner constraints, whatever the readings leave open."""
    return _free(survey)[0]


def settle(survey: Survey) -> Survey:
    """The survey with constrained points where a free adjustment puts them.

    A free network turns by a little from where its points were said to be; its uncertainty refers to the datum at the
    adjusted positions, so that these become the positions of the declaration. Other networks stay as they are.
    """
    problem = declare(survey)
    if not problem.constraints:
        return survey
    point = next(u for u in problem.unknowns if u.name == "point")
    positions = np.full((point.count, 3), np.nan)
    columns = ["xyz".index(part) for part in point.parts]
    positions[:, columns] = datum.settled(problem, point)
    return survey.placed(dict(zip(point.keys, positions, strict=True)))


def _free(survey: Survey) -> tuple[Problem, Unknown, Any]:
    parts = survey.parts
    read = survey.read
    keys = [key for key in survey.points if key in read]
    roles = np.array([[survey.points[key].role(part) for part in parts] for key in keys])
    places = np.array([[survey.points[key].position["xyz".index(part)] for part in parts] for key in keys])
    lost = np.argwhere(np.isnan(places) & (roles != ""))
    if len(lost):
        i, j = lost[0]
        raise InputError(
            f"point '{keys[i]}' has no {parts[j]}; give its approximate coordinates (problems.network.start finds "
            "them from the readings)"
        )
    point = Unknown("point", np.where(np.isnan(places), 0.0, places), "m", tuple(parts), keys)
    whole = frames.unrolled(survey)
    orientation = _orientation(whole)
    place = {key: i for i, key in enumerate(keys)}
    frame = carried.frame_unknown(survey)
    stand = partial(carried.on_frames, survey=survey, frame=frame)
    observations = [_observations(batch, survey, point, place, orientation, stand) for batch in survey.batches
                    if len(batch)]
    observations += [_jointly(cluster, survey, point, place, orientation, stand) for cluster in survey.correlated]
    positions = {key: np.array([one.position["xyz".index(part)] for part in parts])
                 for key, one in whole.points.items()}
    station = stations.poses(whole.sightings, positions)
    base = stations.bases(whole.ranging, positions)
    observations += stations.observations(survey.sightings, survey.ranging, point, station, base, stand)
    observations += tilts.observations(survey.tilts, station, frame, survey.frames)
    quantities = carried.positions(survey, point, frame) if frame is not None else []
    problem = Problem(observations, quantities=quantities, name=survey.name)
    if frame is not None:
        problem = problem.hold(*(one for one in carried.held(survey, frame) if frame in problem.unknowns))
    free = np.isin(roles, (ADJUSTED, CONSTRAINED))
    problem = problem.hold(
        *(point[np.flatnonzero(~free[:, j])].part(part) for j, part in enumerate(parts) if not free[:, j].all())
    )
    if station is not None:
        problem = problem.hold(*_stations_held(survey, station, roles))
    return problem, point, roles == CONSTRAINED


def _stations_held(survey: Survey, station: Pose, roles: Any) -> list[Any]:
    """The tilts of levelled stations, and the first station where nothing else is a datum."""
    level = {key for batch in survey.sightings if batch.levelled for key in np.asarray(batch.station).tolist()}
    held = [station[i].part("rx", "ry") for i, key in enumerate(station.keys) if key in level]
    observed = any(batch.model.points == 1 for batch in survey.every_batch) or any(
        len(one.free) < 6 for one in survey.frames)
    if observed or np.isin(roles, (FIXED, CONSTRAINED)).any():
        return held
    # Where inclinometers say what is vertical, only the turn about it is open.
    return [*held, station[0].part("x", "y", "z", "rz") if survey.tilts else station[0]]


def _orientation(survey: Survey) -> Unknown | None:
    """The settings of all circles, started from the mean of what their readings to placed points say."""
    turns: dict[str, list[complex]] = {}
    unit = "gon"
    for batch in survey.every_batch:
        if batch.kind != "direction":
            continue
        unit = batch.unit
        values = np.zeros(len(batch)) if batch.values is None else batch.values[:, 0]
        for setting, a, b, reading in zip(np.asarray(batch.orientation), *batch.ends, values, strict=True):
            (x1, y1, _), (x2, y2, _) = survey.points[a].position, survey.points[b].position
            bearing = np.arctan2(survey.sense * (y2 - y1), x2 - x1)
            turns.setdefault(str(setting), []).append(np.exp(1j * (bearing - reading)))
    if not turns:
        return None
    start = [[float(np.angle(sum(of_one)))] for of_one in turns.values()]
    return Unknown("orientation", start, unit, keys=list(turns))


def _arguments(
    batch: Batch, survey: Survey, points: Sequence[Any], orientation: Any, constant: Callable[[float], Any]
) -> list[Any]:
    """What the model of a batch takes after the points."""
    given = {
        "orientation": lambda: orientation,
        "sense": lambda: constant(survey.sense),
        "north": lambda: constant(survey.north),
        "station_height": lambda: batch.heights("station_height"),
        "target_height": lambda: batch.heights("target_height"),
    }
    return [*points, *(given[name]() for name in batch.model.takes)]


def _observations(
    batch: Batch, survey: Survey, point: Unknown, place: dict[str, int], orientation: Unknown | None, stand: Any
) -> Observations:
    points = [point[np.array([place[key] for key in keys.tolist()])] for keys in batch.ends]
    setting = None
    if batch.kind == "direction" and orientation is not None:
        number = {key: i for i, key in enumerate(orientation.keys)}
        setting = orientation[np.array([number[str(key)] for key in np.asarray(batch.orientation)])]
    kind = batch.model
    model, further = stand(kind.model, list(enumerate(batch.ends)), batch.epoch)
    return Observations(
        model,
        *_arguments(batch, survey, points, setting, Shared),
        *further,
        readings=batch.values,
        u=carried.with_noise(batch.u, model),
        group=batch.group or batch.kind,
        unit=batch.unit,
        components=kind.components if len(kind.components) > 1 else None,
        period=kind.period,
        rows=batch.rows,
        covariates={
            "station": batch.ends[0],
            **({"target": batch.ends[-1]} if kind.points > 1 else {}),
            **batch.covariates,
        },
    )


class Together:
    """The models of several readings as one, so that one covariance matrix can hold them all."""

    def __init__(self, terms: Sequence[tuple[Callable[..., Any], tuple[Any, ...]]], names: Sequence[str]):
        self.terms = terms  # each a model and its arguments: ("argument", place) or a number
        slots = dict.fromkeys(slot for model, _ in terms for slot in slots_of(model))
        kind = inspect.Parameter
        self.__signature__ = inspect.Signature(
            [kind(name, kind.POSITIONAL_ONLY) for name in names]
            + [kind(slot, kind.KEYWORD_ONLY, default=direct) for slot in slots]
        )
        self.__name__ = "together"

    def __call__(self, *arguments: Any, **slots: Any) -> list[Any]:
        predicted: list[Any] = []
        for model, takes in self.terms:
            given = [arguments[a[1]] if isinstance(a, tuple) else a for a in takes]
            value = model(*given, **{slot: slots[slot] for slot in slots_of(model) if slot in slots})
            predicted += value if isinstance(value, list) else [value]
        return predicted


def _jointly(
    cluster: Correlated, survey: Survey, point: Unknown, place: dict[str, int], orientation: Unknown | None, stand: Any
) -> Observations:
    bound: list[Any] = []
    number: dict[str, int] = {}

    def argument(name: str, selection: Any) -> tuple[str, int]:
        if name not in number:
            number[name] = len(bound)
            bound.append(selection)
        return ("argument", number[name])

    terms, readings, components, units, periods = [], [], [], [], []
    for member in cluster.members:
        ends = [keys.tolist()[0] for keys in member.ends]
        points = [argument(f"point_{place[key]}", point[place[key]]) for key in ends]
        setting = None
        if member.kind == "direction" and orientation is not None:
            i = orientation.keys.index(str(np.asarray(member.orientation)[0]))
            setting = argument(f"orientation_{i}", orientation[i])
        takes = _arguments(member, survey, points, setting, float)
        model, further = stand(member.model.model, list(enumerate(member.ends)), member.epoch)
        takes += [argument(f"frame_{one.index[0]}", one) for one in further]
        terms.append((model, tuple(a if isinstance(a, tuple) else float(np.ravel(a)[0]) for a in takes)))
        kind = member.model
        components += [f"{member.kind} {' '.join(ends)}{' ' + c if c else ''}" for c in kind.components]
        units += [member.unit] * len(kind.components)
        periods += [kind.period] * len(kind.components)
        readings += np.zeros(len(kind.components)).tolist() if member.values is None else member.values.ravel().tolist()
    return Observations(
        Together(terms, list(number)),
        *bound,
        readings=[readings],
        u=Gaussian.matrix(cluster.covariance),
        group=cluster.group,
        unit=units,
        components=components,
        period=periods,
        rows=[cluster.row],
    )

