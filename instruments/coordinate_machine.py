"""Coordinate measuring machine, or any three guides at right angles: recorded coordinates and the point they belong to.

Sign: an error E is what must be added to the recorded coordinates X to give the point, P = X + E(X). Its parts are
named as in ISO 230-1: scale, straightness b(a) of the motion along a in the direction b, squareness of two guides,
pitch times Abbe offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from casadi import DM
from numpy.typing import ArrayLike

from calib import Effect, Observations, Parameter, Pose, Problem, direct, hands_slots_to, simulate
from calib.units import arcsec, ppm, um, urad

from . import stated

GUIDES = "ISO 230-1:2012; Schwenke et al., CIRP Annals 57 (2008) 660-675, geometric error measurement and compensation"
ABBE = "Bryan, Precision Engineering 1 (1979) 129-132, the Abbe principle revisited"
LIMITS = "ISO 10360-2:2009, coordinate measuring machines used for measuring linear dimensions"
AXES = ("x", "y", "z")
_ALONG = tuple(DM(row) for row in np.eye(3).tolist())


def position(coordinates: Any, *, machine_point: Any = direct) -> Any:
    """The point that belongs to recorded coordinates.

    coordinates: (3,) recorded [m]. Slot: `machine_point` ((3,), the point; nominally the recorded coordinates).
    Returns P (3,) [m]. The error of a machine that reads c is position(c) - c.
    """
    return machine_point(coordinates, coordinates=coordinates)


@hands_slots_to(position)
def indication(point: Any, **slots: Any) -> Any:
    """The coordinates that the machine records at a point.

    point: (3,) [m]. Slots: those of `position`. Returns X = P - E(P) (3,) [m]: the error is taken at the point
    instead of at the reading, which differs in second order of E.
    """
    return 2 * point - position(point, **slots)


@hands_slots_to(position)
def artefact_point(machine_from_artefact: Any, point: Any, **slots: Any) -> Any:
    """The coordinates that the machine records at a point of a calibrated artefact, such as a ball plate.

    machine_from_artefact: Transform of this set-up; point: (3,) calibrated, in the frame of the artefact [m]. Returns
    X (3,) [m].
    """
    return indication(machine_from_artefact @ point, **slots)


def length_uncertainty(fixed: float, rate: float, length: ArrayLike) -> np.ndarray:
    """Standard uncertainty of a measured length from a maximum permissible error E_L,MPE = A + L/K.

    fixed: A [m]; rate: 1/K [m/m]; length: (n,) [m]. Assumption: the machine keeps its limit and nothing more is
    known, so the error of a length is rectangular within +- MPE; calibration and temperature of the part come on top.
    Returns (n,) (A + L/K)/sqrt(3) [m].
    Source: ISO 10360-2:2009 (the limit); JCGM 100:2008, 4.3.7.
    """
    return stated.rectangular(fixed + rate * np.abs(np.asarray(length, float)))


def coordinate_uncertainty(fixed: float, rate: float, length: float) -> float:
    """Standard uncertainty of one coordinate of a point from E_L,MPE = A + L/K.

    fixed: A [m]; rate: 1/K [m/m]; length: typical distance between the points of the task [m]. Assumption: as for
    `length_uncertainty`, and a length is the difference of two points with independent errors, so each has 1/sqrt(2)
    of it.
    Returns u [m].
    """
    return float(length_uncertainty(fixed, rate, length) / np.sqrt(2.0))


def guide_effects(slot: str = "machine_point", prefix: str = "", groups: Sequence[str] | None = None,
                  middle: ArrayLike = (0.0, 0.0, 0.0), half_range: ArrayLike = (0.5, 0.5, 0.5),
                  angle_unit: str = "urad",
                  ) -> tuple[Effect, ...]:
    """Errors of three guides as effects for any slot that holds the recorded coordinates (3,).

    slot: where they act; prefix: of the channels, such as "A."; groups: observation groups they are confined to;
    middle, half_range: (3,) of the travel, straightness being w xi^2 with xi = (X - middle)/half_range [m];
    angle_unit: of squareness.
    Returns zero_offset (a), scale (a), squareness (xy: E_x - eps y, yz: E_y - eps z, zx: E_x + eps z), straightness
    (b(a)), pitch_abbe (x, y: kappa X_a times the input `abbe_x`, `abbe_y` [m]) and hysteresis (a: width/2 times the
    input `direction_a`, +-1 or 0 where the axis did not move).
    """
    middle, half_range = np.broadcast_to(middle, 3), np.broadcast_to(half_range, 3)
    confined = None if groups is None else tuple(groups)

    def effect(name: str, channel: str, function: Any, parameter: Parameter, source: str = GUIDES) -> Effect:
        return Effect(name, slot, function, (parameter,), prefix + channel, groups=confined, source=source)

    def zero_offset(a: int) -> Effect:
        return effect("zero_offset", AXES[a], lambda value, p: p.o * _ALONG[a],
                      Parameter("o", "um", (0.5 * um, 500 * um)))

    def scale(a: int) -> Effect:
        return effect("scale", AXES[a], lambda value, p: p.k * value[a] * _ALONG[a],
                      Parameter("k", "ppm", (0.2 * ppm, 200 * ppm)))

    def squareness(channel: str, moved: int, of: int, sign: int) -> Effect:
        return effect("squareness", channel, lambda value, p: sign * p.eps * value[of] * _ALONG[moved],
                      Parameter("eps", angle_unit, (0.1 * arcsec, 60 * arcsec)))

    def straightness(b: int, a: int) -> Effect:
        return effect("straightness", f"{AXES[b]}({AXES[a]})",
                      lambda value, p: p.w * ((value[a] - middle[a]) / half_range[a]) ** 2 * _ALONG[b],
                      Parameter("w", "um", (0.2 * um, 200 * um)))

    kappa = Parameter("kappa", "urad/m", (0.5 * urad, 200 * urad))
    width = Parameter("width", "um", (0.2 * um, 100 * um))
    return (
        *(zero_offset(a) for a in range(3)), *(scale(a) for a in range(3)),
        squareness("xy", 0, 1, -1), squareness("yz", 1, 2, -1), squareness("zx", 0, 2, 1),
        *(straightness(b, a) for a in range(3) for b in range(3) if b != a),
        effect("pitch_abbe", "x", lambda value, p, abbe_x: p.kappa * abbe_x * value[0] * _ALONG[0], kappa, ABBE),
        effect("pitch_abbe", "y", lambda value, p, abbe_y: p.kappa * abbe_y * value[1] * _ALONG[1], kappa, ABBE),
        effect("hysteresis", "x", lambda value, p, direction_x: 0.5 * p.width * direction_x * _ALONG[0], width),
        effect("hysteresis", "y", lambda value, p, direction_y: 0.5 * p.width * direction_y * _ALONG[1], width),
        effect("hysteresis", "z", lambda value, p, direction_z: 0.5 * p.width * direction_z * _ALONG[2], width),
    )


def cosine_effects(slot: str = "machine_point", prefix: str = "",
                   groups: Sequence[str] | None = None) -> tuple[Effect, ...]:
    """Cosine error of an axis read by a beam at an angle beta to its motion: E_a + kappa X_a, kappa = 1/cos(beta) - 1.

    The motion is longer than what the beam sees, so kappa is not negative; it is beta^2/2 to fourth order
    (`interferometer.cosine_angle` turns it back). Arguments as for `guide_effects`. Returns one effect for each axis.
    """
    confined = None if groups is None else tuple(groups)

    def cosine(a: int) -> Effect:
        return Effect("cosine", slot, lambda value, p: p.kappa * value[a] * _ALONG[a],
                      (Parameter("kappa", "1", (0.5e-8, 1.25e-5), lower=0.0),), prefix + AXES[a], groups=confined,
                      source=GUIDES)

    return tuple(cosine(a) for a in range(3))


def thermal_effect(slot: str = "machine_point", channel: str = "machine",
                   groups: Sequence[str] | None = None) -> Effect:
    """Expansion of all scales with temperature: E + coef (T - T_reference) X.

    slot, channel, groups: as of an Effect. Returns the effect, with input `temperature_difference` [K].
    """
    return Effect("thermal", slot, lambda value, p, temperature_difference: p.coef * temperature_difference * value,
                  (Parameter("coef", "ppm/K", (0.2 * ppm, 25 * ppm)),), channel, groups=groups,
                  source="ISO 230-3:2020, determination of thermal effects")


def effects() -> tuple[Effect, ...]:
    """All effects of a machine whose travel is 0.5 m to either side: its guides, cosine errors and expansion."""
    return (*guide_effects(), *cosine_effects(), thermal_effect())


def example(seed: int) -> Problem:
    """A calibrated ball plate in five set-ups of a coordinate measuring machine; simulated readings.

    seed: of the simulated noise. Returns the problem with every effect of this module as a held candidate.
    """
    side = np.linspace(-0.2, 0.2, 4)
    balls = np.array([[x, y, 0.0] for x in side for y in side])
    level = np.eye(3)
    front = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    flank = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    oblique = np.array([[0.5, -np.sqrt(0.5), 0.5], [0.5, np.sqrt(0.5), 0.5], [-np.sqrt(0.5), 0.0, np.sqrt(0.5)]])
    rotation = np.stack([level, front, flank, oblique, level])
    translation = np.array([[0.1, 0.05, -0.2], [0.0, 0.2, 0.1], [-0.2, 0.1, 0.0], [0.05, -0.1, 0.05],
                            [-0.15, -0.1, 0.25]])
    plate = Pose("plate", rotation=rotation, translation=translation, unit="mm",
                 keys=["level", "front", "flank", "oblique", "high"])
    index = np.repeat(np.arange(5), len(balls))
    count = len(index)
    back_and_forth = np.where(np.arange(count) % 2, 1.0, -1.0)
    readings = Observations(
        artefact_point, plate[index], balls[np.tile(np.arange(len(balls)), 5)],
        u=coordinate_uncertainty(1.2 * um, 3e-6, 0.3), group="balls", unit="um", components=AXES,
        covariates={"direction_x": back_and_forth, "direction_y": np.where(np.arange(count) % 3, 1.0, -1.0),
                    "direction_z": back_and_forth[::-1] * np.where(np.arange(count) % 5, 1.0, -1.0),
                    "abbe_x": (0.05 + 0.1 * (index % 3), "m"), "abbe_y": (0.2 - 0.1 * (index % 2), "m"),
                    "temperature_difference": (0.1 * index, "K")})
    problem = Problem([readings], effects=effects(), name="ball plate on a coordinate measuring machine")
    return simulate(problem, {}, seed)
