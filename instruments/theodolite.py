"""Theodolite: horizontal and vertical circle, two faces, circles of either sense.

Frame: z along the plumb line upward, x and y horizontal, right-handed. Azimuth about z from x toward y, zenith angle
from z, elevation = pi/2 - zenith angle. `face` is +1 on face 1 (vertical circle left) and -1 on face 2. The same
horizontal and zenith angle describe a line of sight in both faces; the face rule turns them into raw circle readings:

    face 1:  H = horizontal angle,        V = zenith angle
    face 2:  H = horizontal angle + pi,   V = 2 pi - zenith angle

Effects say what they add to the horizontal angle or the zenith angle, both before the face rule, or to a raw reading.
The predicted readings are not reduced to one turn: the period of 2 pi belongs to the observations (`period=PERIOD`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from casadi import DM, atan2, cos, pi, sin, sqrt, tan, vertcat
from numpy.typing import ArrayLike

from calib import Direction, Effect, Observations, Parameter, Problem, Shared, Unknown, direct, simulate
from calib.units import arcsec, degree, hour, minute

from . import influence, stated

AXES = "Deumlich and Staiger, Instrumentenkunde der Vermessungstechnik, 9th ed., Wichmann 2002: axis and circle errors"
FIELD = "ISO 17123-3:2001, theodolites: field procedures; axis and circle errors as in Deumlich and Staiger (2002)"
PERIOD = 2 * np.pi


def face_readings(horizontal_angle: Any, zenith_angle: Any, elevation: Any, face: Any, *, standing_axis: Any = direct,
                  horizontal: Any = direct, zenith: Any = direct, horizontal_circle: Any = direct,
                  vertical_circle: Any = direct) -> tuple[Any, Any]:
    """Raw readings of both circles for a line of sight given by its angles.

    horizontal_angle, zenith_angle: of the line of sight, as the circles count them [rad]; elevation: of the line, as
    the axis errors see it [rad]; face: +1 or -1. Slots: `standing_axis` ((2,) deviation of the standing axis from the
    plumb line toward horizontal angle 0 and pi/2 [rad]), `horizontal` and `zenith` (angles before the face rule),
    `horizontal_circle` and `vertical_circle` (raw readings). Effects there may ask for horizontal_angle,
    zenith_angle, elevation, face.
    Returns H, V [rad]. The tilt of the standing axis acts to first order. Source: Deumlich and Staiger (2002).
    """
    return _circles(horizontal_angle, zenith_angle, elevation, face, (0, 0), (1, 1), standing_axis, horizontal, zenith,
                    horizontal_circle, vertical_circle)


def circles(line: Any, face: Any, zero: Any, sense: Any, *, sight_line: Any = direct, standing_axis: Any = direct,
            horizontal: Any = direct, zenith: Any = direct, horizontal_circle: Any = direct,
            vertical_circle: Any = direct) -> tuple[Any, Any]:
    """Raw readings of both circles, of either sense, for a line of sight given as a vector.

    line: (3,) from the centre of the theodolite to the target in a plumb frame, any length; face: +1 or -1; zero:
    (2,) reading of the horizontal circle at azimuth 0 on face 1 and of the vertical circle at the zenith [rad];
    sense: (2,) +1 where the horizontal circle grows with the azimuth (counter-clockwise seen from above) and the
    vertical one away from the zenith, else -1. A clockwise horizontal circle and zenith angles are sense (-1, 1); a
    circle of elevations has zero pi/2 and sense -1.
    Slots: `sight_line` ((3,), may ask for `distance` [m]) and those of `face_readings`, the horizontal angle counted
    as the circle counts.
    Returns H, V [rad].
    """
    seen = sight_line(line, distance=sqrt(line[0] ** 2 + line[1] ** 2 + line[2] ** 2))
    level_distance = sqrt(seen[0] ** 2 + seen[1] ** 2)
    return _circles(atan2(seen[1], seen[0]), atan2(level_distance, seen[2]), atan2(seen[2], level_distance), face,
                    zero, sense, standing_axis, horizontal, zenith, horizontal_circle, vertical_circle)


def _circles(azimuth: Any, zenith_angle: Any, elevation: Any, face: Any, zero: Any, sense: Any, standing_axis: Any,
             horizontal: Any, zenith: Any, horizontal_circle: Any, vertical_circle: Any) -> tuple[Any, Any]:
    # A standing axis along (tilt, 1) turns the line by (tilt_y, -tilt_x, 0) as the instrument sees it: the zenith angle
    # loses the part of the tilt along the line, the azimuth gains the part across it times tan(elevation).
    tilt = standing_axis(DM.zeros(2))
    along = tilt[0] * cos(azimuth) + tilt[1] * sin(azimuth)
    across = tilt[0] * sin(azimuth) - tilt[1] * cos(azimuth)
    horizontal_angle = zero[0] + sense[0] * (azimuth + across * tan(elevation))
    asked = {"zenith_angle": zenith_angle, "elevation": elevation, "face": face}
    h = horizontal(horizontal_angle, horizontal_angle=horizontal_angle, **asked)
    z = zenith(zenith_angle - along, horizontal_angle=horizontal_angle, **asked)
    turned = pi * (1 - face) / 2
    return (horizontal_circle(h + turned, horizontal_angle=horizontal_angle, **asked),
            vertical_circle(zero[1] + sense[1] * (face * z + 2 * turned), horizontal_angle=horizontal_angle, **asked))


def pointing(u_circles: ArrayLike, distance: ArrayLike, elevation: ArrayLike, u_target: float) -> np.ndarray:
    """Standard uncertainty of pointed circle readings, from the circles and, by distance, from the target.

    u_circles: (2,) of H and V, circle and pointing at infinity [rad]; distance: (n,) [m]; elevation: (n,) [rad];
    u_target: standard uncertainty of the pointed place at the target, across the line, in each direction [m].
    Returns (n, 2): sqrt(u_H^2 + (u_target/(d cos e))^2), sqrt(u_V^2 + (u_target/d)^2) [rad].
    Source: JCGM 100:2008, 5.1.2, with lever arms d cos e and d.
    """
    distance, elevation = np.broadcast_arrays(np.asarray(distance, float), np.asarray(elevation, float))
    u_horizontal, u_vertical = np.broadcast_to(np.asarray(u_circles, float), 2)
    return np.stack([np.hypot(u_horizontal, u_target / (distance * np.abs(np.cos(elevation)))),
                     np.hypot(u_vertical, u_target / distance)], axis=-1)


def stated_uncertainty(deviation_of_two_faces: float, resolution: float) -> stated.Lines:
    """Standard uncertainty of a circle reading on one face from the stated standard deviation of two faces.

    deviation_of_two_faces: experimental standard deviation of the mean of one reading on each face, as ISO 17123-3
    (DIN 18723-3) states it [rad]; resolution: last digit [rad]. The two faces are taken as independent, so one
    reading scatters sqrt(2) times as much.
    Returns the lines `repeatability` and `resolution` [rad]. Source: ISO 17123-3:2001; JCGM 100:2008, F.2.2.1.
    """
    return stated.Lines({"repeatability": np.sqrt(2.0) * deviation_of_two_faces,
                         "resolution": stated.resolution(resolution)})


def effects(blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """The effects of a theodolite; channels H and V as in the field book.

    blocks: blocks at which a step of H or V may have happened. Returns vertical index, collimation, trunnion-axis
    tilt, tilt of the standing axis (what plumbing and compensator leave), eccentricity of each circle, and drift,
    thermal, hysteresis, steps of H and V.
    """
    shared = [function(slot, "arcsec", plausible, channel=channel, source=FIELD)
              for slot, channel in (("horizontal", "H"), ("zenith", "V"))
              for function, plausible in ((influence.drift, (0.1 * arcsec / hour, 20 * arcsec / hour)),
                                          (influence.thermal, (0.05 * arcsec, 5 * arcsec)),
                                          (influence.hysteresis, (0.1 * arcsec, 10 * arcsec)))]
    steps = [step for slot, channel in (("horizontal", "H"), ("zenith", "V"))
             for step in influence.steps(slot, "arcsec", (0.2 * arcsec, 60 * arcsec), blocks, channel=channel,
                                         source=FIELD)]
    return (
        influence.offset("vertical_index", "vertical_circle", "i", "arcsec", (0.5 * arcsec, 60 * arcsec), channel="V",
                         source=AXES),
        Effect("collimation", "horizontal", lambda value, p, elevation, face: face * p.c / cos(elevation),
               (Parameter("c", "arcsec", (0.5 * arcsec, 60 * arcsec)),), "H", source=AXES),
        Effect("trunnion_tilt", "horizontal", lambda value, p, elevation, face: face * p.t * tan(elevation),
               (Parameter("t", "arcsec", (0.5 * arcsec, 30 * arcsec)),), "H", source=AXES),
        Effect("standing_axis_tilt", "standing_axis", lambda value, p: vertcat(p.x, p.y),
               (Parameter("x", "arcsec", (0.2 * arcsec, 60 * arcsec)),
                Parameter("y", "arcsec", (0.2 * arcsec, 60 * arcsec))),
               source=AXES),
        influence.harmonic("circle_eccentricity", "horizontal_circle", 1, "arcsec", (0.2 * arcsec, 20 * arcsec),
                           channel="H", source=AXES),
        influence.harmonic("circle_eccentricity", "vertical_circle", 1, "arcsec", (0.2 * arcsec, 20 * arcsec),
                           channel="V", source=AXES),
        *shared, *steps,
    )


def example(seed: int) -> Problem:
    """Seven targets in unknown directions, two rounds on both faces, and a mark near the horizon; simulated readings.

    seed: of the simulated noise. Returns the problem with every effect of this module as a held candidate.
    """
    azimuth = np.array([0.0, 50.0, 100.0, 155.0, 200.0, 260.0, 310.0]) * degree
    elevation = np.array([5.0, 35.0, -20.0, 50.0, -5.0, 20.0, -35.0]) * degree
    distance = np.array([3.0, 4.0, 2.5, 5.0, 8.0, 6.0, 3.5])
    level = np.cos(elevation)
    toward = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
    targets = Direction("target", toward, keys=[f"P{i}" for i in range(1, 8)])
    index = np.concatenate([np.arange(7), np.arange(7)[::-1]] * 2)
    count = len(index)
    face = np.where(np.arange(count) % 14 < 7, 1.0, -1.0)

    def influences(rows: int) -> dict[str, Any]:
        time = np.arange(rows) * 2 * minute
        return {"time": (time, "s"), "direction": np.where(np.arange(rows) % 14 < 7, 1.0, -1.0),
                "block": 1 + np.arange(rows) // (rows // 2), "temperature_difference": (np.sin(2 * time / hour), "K")}

    round_of_targets = Observations(
        circles, targets[index], face, Shared(np.zeros(2)), Shared(np.array([-1.0, 1.0])),
        u=pointing((1.0 * arcsec, 1.0 * arcsec), distance[index], elevation[index], 5e-6), group="targets",
        unit="arcsec", components=("H", "V"), period=PERIOD, covariates=influences(count))
    horizontal_angle = Unknown("mark_horizontal", 0.3, "deg")
    zenith_angle = Unknown("mark_zenith", 89.5 * degree, "deg")
    faces = np.tile([1.0, -1.0], 4)
    mark = Observations(face_readings, horizontal_angle, zenith_angle, Shared(0.5 * degree), faces, u=1.0 * arcsec,
                        group="mark", unit="arcsec", components=("H", "V"), period=PERIOD,
                        covariates=influences(len(faces)))
    problem = Problem([round_of_targets, mark], effects=effects(blocks=(2,)), name="theodolite on targets")
    return simulate(problem, {}, seed)
