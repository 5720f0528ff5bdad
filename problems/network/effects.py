"""What a network can lack: constants of its instruments and stations that moved, zero and held until somebody asks.

Survey instruments have one constant a kind of reading; trackers, interferometers and standpoints have their own at each
station, where only the other instruments of the network can show them.
Source: Rueger (1996), Electronic Distance Measurement; ISO 17123; `instruments.laser_tracker`, `.interferometer`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from casadi import sqrt, vertcat

from calib import Effect, Observations, Parameter, Problem
from calib.units import arcsec, hour, mm, ppm
from instruments import influence, interferometer, laser_tracker

EARTH = 6_371_000.0     # mean radius [m]; a curvature of the sight is stated as a part of that of the earth
SOURCE = "Rueger, Electronic Distance Measurement, 4th edition (1996); ISO 17123-3, -4"
AXES = "Deumlich and Staiger, Instrumentenkunde der Vermessungstechnik, 9th ed. (2002): axis and circle errors"
BAR = "ISO 1:2022, reference temperature; expansion of steel 11.5 ppm/K, of carbon fibre below 1 ppm/K"
CENTRING = "Ghilani, Adjustment Computations, 5th edition (2010), chapter 7"
ASKED_ONE_BY_ONE = 24   # stations up to which each is asked by itself: with more, nobody compares so many candidates


def effects(blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """Zero offset and scale of distances, index and refraction of zenith angles, scale of levelling staffs, and for
    each standpoint its centring; where readings have times or blocks, a twisting circle and a standpoint that moved.

    blocks: at whose beginning a standpoint may have moved.
    """
    return (
        Effect("zero_offset", "distance", lambda value, p: p.a, (Parameter("a", "mm", (0.1 * mm, 20 * mm)),),
               "distance", source=SOURCE),
        Effect("scale", "distance", lambda value, p, length: p.s * length,
               (Parameter("s", "ppm", (1 * ppm, 200 * ppm)),), "distance", source=SOURCE),
        _angular("index", "zenith", lambda value, p: p.i, "vertical circle"),
        Effect("refraction", "zenith", lambda value, p, length: -p.k * length / (2.0 * EARTH),
               (Parameter("k", "1", (0.05, 0.5)),), "vertical circle", source=SOURCE),
        Effect("staff_scale", "height", lambda value, p, rise: p.s * rise,
               (Parameter("s", "ppm", (5 * ppm, 500 * ppm)),), "level", source=SOURCE),
        _of_standpoint("centring", lambda value, p: _in_plan(value, p), "{key}", (0.2 * mm, 20 * mm), CENTRING),
        replace(influence.drift("circle", "arcsec", (1 * arcsec / hour, 60 * arcsec / hour), source=SOURCE,
                                channel="{key} circle"), per="station"),
        *(_moved(int(block)) for block in blocks),
    )


def effects_in_two_faces() -> tuple[Effect, ...]:
    """Collimation, tilt of the trunnion axis and vertical index of circles whose readings say their face.

    Readings of both faces are those reduced to face 1: what the axes do wrong changes its sign with the face.
    """
    return (
        _angular("index", "zenith", lambda value, p, face: p.i * face, "vertical circle, two faces"),
        _angular("collimation", "circle", lambda value, p, face, steepness: p.i * face * sqrt(1 + steepness**2),
                 "circle"),
        _angular("trunnion_tilt", "circle", lambda value, p, face, steepness: p.i * face * steepness, "circle"),
    )


def effects_of_aids() -> tuple[Effect, ...]:
    """Index of inclinometers, expansion of scale bars with their temperature."""
    return (
        _angular("tilt_index", "inclination", lambda value, p: p.i, "inclinometer"),
        Effect("expansion", "bar",
               lambda value, p, length, temperature_difference: p.a * length * temperature_difference,
               (Parameter("a", "ppm/K", (0.1 * ppm, 25 * ppm)),), "bar", source=BAR),
    )


def _angular(name: str, slot: str, function: Any, channel: str) -> Effect:
    return Effect(name, slot, function, (Parameter("i", "arcsec", (1 * arcsec, 60 * arcsec)),), channel,
                  source=SOURCE if channel != "circle" else AXES)


def _in_plan(value: Any, p: Any) -> Any:
    """The shift x, y of an effect as a column of as many coordinates as the standpoint has."""
    return vertcat(p.x, p.y, *([0] * (value.shape[0] - 2)))


def _of_standpoint(name: str, function: Any, channel: str, usual: tuple[float, float], source: str) -> Effect:
    return Effect(name, "standpoint", function, tuple(Parameter(part, "mm", usual) for part in "xy"), channel,
                  per="station", source=source)


def _moved(first: int) -> Effect:
    return _of_standpoint("step", lambda value, p, block: (block >= first) * _in_plan(value, p), f"{{key}}@{first}",
                          (0.5 * mm, 50 * mm), CENTRING)


def station_effects(problem: Problem, blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """The effects of `instruments.laser_tracker` and `.interferometer`, for each station by itself.

    problem: the network, for its groups of readings; blocks: at whose beginning a reading or a station may have jumped.
    """
    found: list[Effect] = []
    for slot, offered in (("tracker_point", laser_tracker.effects), ("displacement", interferometer.effects)):
        groups = [o.group for o in problem.observations if slot in o.slots]
        found += [replace(effect, per="station", channel=f"{{key}} {effect.channel}", groups=groups)
                  for effect in offered(blocks)] if groups else []
    return tuple(found)


def _of_each_instrument(effect: Effect, observations: Sequence[Observations]) -> list[Effect]:
    """An effect on all readings, or, where several instruments have read what it acts on, one for each by name."""
    groups: dict[str, list[str]] = {}
    for one in observations:
        if effect.slot in one.slots:
            groups.setdefault(str(np.ravel(one.covariates.get("instrument", ""))[0]), []).append(one.group)
    if effect.per is not None or len(groups) < 2:
        return [replace(effect, groups=[one.group for one in observations])]
    return [replace(effect, groups=of_one, channel=name or effect.channel) for name, of_one in groups.items()]


def with_candidates(problem: Problem) -> Problem:
    """The network with every effect that can act on its readings, held at zero.

    problem: as `declare` returns it; where it has more than 24 stations, no station is asked by itself.
    """
    read = [o for o in problem.observations if not o.is_prior]
    blocks = sorted({int(b) for o in read for b in o.covariates.get("block", ())})[1:]
    stations = {str(key) for o in read for key in np.unique(o.covariates.get("station", ()))}
    surveyed = [o for o in read if not {"tracker_point", "displacement"} & set(o.slots)]
    faced = [o for o in surveyed if "face" in o.covariates]
    found = [one for effect in effects_in_two_faces() for one in _of_each_instrument(effect, faced)]
    known = {("index", o.group) for o in faced}
    for effect in (*effects(blocks), *effects_of_aids()):
        found += _of_each_instrument(effect, [o for o in surveyed if (effect.name, o.group) not in known])
    if not any(one.name == "point" and one.freedom == 3 for one in problem.unknowns):
        found = [effect for effect in found if effect.name != "trunnion_tilt"]      # sights in a plane do not show it
    found += station_effects(problem, blocks)
    if len(stations) > ASKED_ONE_BY_ONE:
        found = [effect for effect in found if effect.per is None]
    return problem.with_effects(*problem.acting(found))
