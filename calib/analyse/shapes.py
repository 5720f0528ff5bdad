"""What the unknowns of a problem say of space: points with their covariance, axes, lines of sight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from calib import units
from calib.analyse.covariance import covariance
from calib.linearisation import Linearisation
from calib.scene import Axes, Points, Scene, Sights
from calib.unknown import Unknown

WITH_ELLIPSOID = 60     # points of one unknown whose covariance is drawn
SIGHTS = 2000           # lines of sight of one group


def scene(fit: Linearisation) -> Scene:
    """The scene that follows from the unknowns of a problem with one frame.

    fit: a linearisation.
    return: points for every unknown with parts x, y (and z) of a length; axes for every direction that has a point of
    its own; lines of sight for every group two of whose covariates name points. Nothing where poses or rotations are
    unknown: then there is more than one frame, and only the problem can say what stands where.
    """
    unknowns = fit.layout.unknowns
    if any(one.kind in ("pose", "rotation") for one in unknowns):
        return Scene(())
    points = [points_of(fit, one) for one in places_in(fit)]
    return Scene((*points, *_axes(fit), *sights(fit, points)))


def places_in(fit: Linearisation) -> list[Unknown]:
    """The unknowns that are points: their parts begin with x, y of a length, and z if there is more.

    fit: a linearisation.
    return: the unknowns, none of them parameters of an effect.
    """
    parameters = set(fit.effects.values())
    return [one for one in fit.layout.unknowns if one not in parameters and _is_place(one)]


def _is_place(unknown: Unknown) -> bool:
    parts, dim = unknown.parts, 2 if len(unknown.parts) == 2 else 3
    return (unknown.kind == "vector" and parts[:dim] == ("x", "y", "z")[:dim]
            and all(units.dimension(unit) == "length" for unit in unknown.units[:dim]))


def points_of(fit: Linearisation, unknown: Unknown) -> Points:
    """An unknown as points with their covariance; without z they stand at height zero, those nowhere are left out.

    fit: a linearisation; unknown: of it, a point or several.
    return: the points.
    """
    dim = min(3, unknown.freedom)
    places, spread = np.zeros((unknown.count, 3)), np.zeros((unknown.count, 3, 3))
    places[:, :dim] = np.asarray(fit.values[unknown], float).reshape(unknown.count, -1)[:, :dim]
    keys = unknown.keys if unknown.count > 1 or unknown.named_keys else (unknown.name,)
    free = np.asarray(fit.layout.free[fit.layout.span(unknown)]).reshape(unknown.count, -1)[:, :dim]
    for instance in np.flatnonzero(free.any(axis=1))[:WITH_ELLIPSOID]:
        spread[instance, :dim, :dim] = covariance(fit, unknown[int(instance)]).matrix[:dim, :dim]
    # A point of which only the height counts has no place in plan.
    there = np.flatnonzero(np.isfinite(places).all(axis=1))
    return Points(unknown.name, places[there], [keys[i] for i in there], spread[there])


def stations_of(fit: Linearisation, pose: Unknown) -> Points:
    """Where instruments stand whose poses are `instrument_from_world`, in the world.

    fit: a linearisation; pose: of it.
    return: their places, without covariance.
    """
    shown: Any = pose.show(fit.values[pose])
    places = [one.inverse().translation for one in (shown if isinstance(shown, Sequence) else [shown])]
    name = pose.name.split("_from_")[0].replace("_", " ")
    keys = pose.keys if pose.count > 1 or pose.named_keys else (name,)
    return Points(name, np.array([np.ravel(place) for place in places], float), keys)


def sights(fit: Linearisation, points: Sequence[Points]) -> Iterator[Sights]:
    """Lines of sight: of every group two of whose covariates hold nothing but names of points.

    fit: a linearisation; points: that have names.
    return: one bundle a group, each line once.
    """
    known = {key: place for one in points for key, place in zip(one.keys, one.places) if key}
    for group in fit.groups:
        ends = []
        for values in group.covariates.values():
            texts = [str(value) for value in np.ravel(values)] if values.dtype.kind in "UO" else []
            if texts and all(text in known for text in texts):
                ends.append(texts)
        if len(ends) == 2:
            pairs = list(dict.fromkeys(zip(*ends)))[:SIGHTS]
            first, second = (np.array([known[pair[side]] for pair in pairs]) for side in (0, 1))
            yield Sights(group.name, first, second)


def _axes(fit: Linearisation) -> Iterator[Axes]:
    """Directions drawn through the one point that comes in the same number."""
    for direction in fit.layout.unknowns:
        own = [one for one in places_in(fit) if one.count == direction.count]
        if direction.kind == "direction" and len(own) == 1:
            through = np.asarray(fit.values[own[0]], float).reshape(direction.count, -1)[:, :3]
            keys = direction.keys if direction.count > 1 else (direction.name,)
            towards: Any = direction.show(fit.values[direction])
            yield Axes(direction.name, through, np.reshape(towards, (-1, 3)), keys)
