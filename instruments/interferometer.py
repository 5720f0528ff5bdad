"""Displacement and tracking interferometer, of either counting sense and with an unknown start.

`sense` is +1 where the reading grows when the path lengthens and -1 where it grows when the path shortens. `start` is
the length at which the counter read zero: reading = sense (length - start). A tied start is a known number or a
function of the base point; a free one an unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from casadi import atan2, cos, dot, pi, sin, sqrt
from numpy.typing import ArrayLike

from calib import Effect, Observations, Parameter, Problem, Unknown, direct, hands_slots_to, simulate
from calib.units import hour, metre, minute, mm, nm, ppm, um, urad

from . import air, influence, stated

FIELD = "Bobroff, Meas. Sci. Technol. 4 (1993) 907-926, recent advances in displacement measuring interferometry"
ABBE = "Bryan, The Abbe principle revisited, Precision Engineering 1 (1979) 129-132"
TRACKING = ("Schwenke et al., CIRP Annals 54 (2005) 475-478, error mapping of CMMs and machine tools by a single "
            "tracking interferometer")
HELIUM_NEON = 632.8 * nm


def displacement(position: Any, start: Any, sense: Any, *, length: Any = direct, displacement: Any = direct,
                 reading: Any = direct) -> Any:
    """Reading of a displacement interferometer.

    position: of the reflector along the line of measurement [m]; start: position at which the counter read zero [m];
    sense: +1 or -1.
    Slots: `length` (the position as the beam sees it; may ask for `position`), `displacement` (as it is counted) and
    `reading` (as it is shown, with the interpolation between the fringes). Returns sense (position - start) [m].
    """
    return reading(displacement(sense * (length(position, position=position) - start), position=position))


def tracking(point: Any, base: Any, start: Any, sense: Any, *, tracked_point: Any = direct, tracking_base: Any = direct,
             length: Any = direct, displacement: Any = direct, reading: Any = direct) -> Any:
    """Reading of a tracking interferometer that turns about a base point.

    point: (3,) of the reflector [m]; base: (3,) base point [m]; start: length at which the counter read zero [m];
    sense: +1 or -1.
    Slots: `tracked_point`, `tracking_base` ((3,) each), `length` (from base to point), `displacement` (as it is
    counted) and `reading` (as it is shown, with the interpolation between the fringes). Effects at `length` and
    `displacement` may ask for `line` ((3,) unit vector from base to point) and `azimuth` (of that, about z from x
    [rad]).
    Returns sense (|point - base| - start) [m]. Source: Chen, Li, Zhang, Zhao (2007), J. Astronautic Metrology and
    Measurement 27(2), eq (1).
    """
    path = tracked_point(point, base=base) - tracking_base(base, point=point)
    distance = sqrt(dot(path, path))
    asked = {"line": path / distance, "azimuth": atan2(path[1], path[0]), "distance": distance}
    return reading(displacement(sense * (length(distance, **asked) - start), **asked))


@hands_slots_to(tracking)
def tracking_in_motion(point: Any, velocity: Any, base: Any, start: Any, sense: Any, **slots: Any) -> Any:
    """Reading of a tracking interferometer whose reflector moves while it is read.

    velocity: (3,) of the reflector when the reading was triggered [m/s], for the effect `time_sync`; the rest as for
    `tracking`.
    Returns the reading [m]; the velocity alone does not change it.
    """
    return tracking(point, base, start, sense, **slots)


def stated_uncertainty(fixed: float, rate: float, length: ArrayLike, last_digit: float,
                       coverage_factor: float = 2.0) -> stated.Lines:
    """Standard uncertainty of interferometer readings from a statement U = a + b L and the resolution.

    fixed: a [m]; rate: b [m/m], which holds wavelength, index and their common error; length: (n,) path length that
    changed since the start [m]; last_digit: resolution [m]; coverage_factor: k of the statement. Assumption: the
    errors of different readings are independent; where b L is one common scale error, give b = 0 here and a prior on
    the effect `scale` instead.
    Returns the lines `stated U` and `resolution` [m]. Source: JCGM 100:2008, 6.2.1 and F.2.2.1.
    """
    return stated.Lines({"stated U": stated.from_expanded(fixed + rate * np.abs(length), coverage_factor),
                         "resolution": stated.resolution(last_digit)})


def cosine_angle(kappa: Any) -> Any:
    """Angle between beam and motion behind the parameter kappa = beta^2/2 of a cosine error.

    kappa: 0 or more [1]. Returns beta = sqrt(2 kappa) [rad], for a derived quantity or a report.
    """
    return sqrt(2 * kappa)


def cosine(slot: str, channel: str, source: str = FIELD) -> Effect:
    """Cosine error of a beam at the angle beta to the motion: - kappa times the value, kappa = beta^2/2 >= 0.

    The beam sees L cos(beta) = L (1 - beta^2/2) to fourth order. kappa and not beta is the parameter, because beta
    has no first-order effect. slot, channel, source: as of an Effect. Returns the effect; 0.1 mrad to 5 mrad are
    plausible.
    """
    return Effect("cosine", slot, lambda value, p: -p.kappa * value,
                  (Parameter("kappa", "1", (0.5e-8, 1.25e-5), lower=0.0),), channel,
                  source=source)


def cyclic(slot: str, channel: str, wavelength: float = HELIUM_NEON, passes: int = 2) -> Effect:
    """Cyclic error of the interpolation: + c cos(psi) + s sin(psi), psi = 2 pi passes/wavelength times the value.

    The fringes follow the path as it is, so the slot is the one after drift, thermal growth and late triggering.
    slot, channel: as of an Effect; wavelength [m]; passes: how often the path is traversed, 2 for a plain reflector.
    Returns the effect. Source: Hou and Wilkening, Precision Engineering 14 (1992) 91-98.
    """
    waves = 2 * pi * passes / wavelength
    return Effect("cyclic", slot, lambda value, p: p.c * cos(waves * value) + p.s * sin(waves * value),
                  (Parameter("c", "nm", (0.5 * nm, 20 * nm)), Parameter("s", "nm", (0.5 * nm, 20 * nm))), channel,
                  source="Hou and Wilkening, Precision Engineering 14 (1992) 91-98")


def effects(blocks: Sequence[int] = (), wavelength: float = HELIUM_NEON) -> tuple[Effect, ...]:
    """Effects of every interferometer, on its length and its reading; channel d is the reading.

    blocks: blocks at which the reading may have jumped (beam lost); wavelength: in air, for the cyclic error [m].
    Returns scale, air temperature error, dead path, cyclic error, drift, thermal, steps. See
    `tracking_effects` and `displacement_effects` for what only one kind has.
    """
    return (
        influence.gain("scale", "displacement", "ppm", (0.05 * ppm, 20 * ppm), channel="d", source=FIELD),
        Effect("air_temperature", "displacement", lambda value, p: -p.error * air.PER_KELVIN * value,
               (Parameter("error", "K", (0.05, 5.0)),), "d", source=air.SOURCE),
        Effect("dead_path", "length",
               lambda value, p, temperature_difference: p.l * air.PER_KELVIN * temperature_difference,
               (Parameter("l", "mm", (5 * mm, 2 * metre), lower=0.0),), "d", source=FIELD),
        cyclic("reading", "d", wavelength),
        influence.drift("displacement", "um", (0.05 * um / hour, 20 * um / hour), channel="d", source=FIELD),
        influence.thermal("displacement", "um", (0.05 * um, 10 * um), channel="d", source=FIELD),
        *influence.steps("displacement", "um", (0.2 * um, 100 * um), blocks, channel="d", source=FIELD),
    )


def displacement_effects() -> tuple[Effect, ...]:
    """Effects of a displacement interferometer on a guide: cosine error, Abbe error and hysteresis.

    The Abbe error is kappa times the covariate `abbe_offset` [m] times the position: a pitch that grows with the
    travel.
    """
    return (
        cosine("length", "d"),
        Effect("pitch_abbe", "length", lambda value, p, abbe_offset: p.kappa * abbe_offset * value,
               (Parameter("kappa", "urad/m", (0.5 * urad, 100 * urad)),), "d", source=ABBE),
        influence.hysteresis("displacement", "um", (0.05 * um, 10 * um), channel="d", source=FIELD),
    )


def tracking_effects() -> tuple[Effect, ...]:
    """Effects of a tracking interferometer: wander of its base with pointing and with time, and late triggering.

    `base_wander`: + c cos(2 azimuth) + s sin(2 azimuth), because one wave per turn is a shift of the base point
    itself. `time_sync` needs the model argument `velocity` ((3,) [m/s]); it adds tau times the component of the
    velocity along the line to the length.
    """
    wander = (0.05 * um, 5 * um)
    return (
        Effect("base_wander", "length", lambda value, p, azimuth: p.c * cos(2 * azimuth) + p.s * sin(2 * azimuth),
               (Parameter("c", "um", wander), Parameter("s", "um", wander)), "d", source=TRACKING),
        *(influence.drift("tracking_base", "um", (0.1 * um / hour, 50 * um / hour), channel=f"base_{axis}",
                          along=direction, source=TRACKING)
          for axis, direction in (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1)))),
        Effect("time_sync", "length", lambda value, p, velocity, line: p.tau * dot(velocity, line),
               (Parameter("tau", "ms", (0.01e-3, 20e-3)),), "d", source=TRACKING),
    )


def example(seed: int) -> Problem:
    """A tracking interferometer on lines of a machine, a displacement interferometer along one; simulated readings.

    The positions of the machine are known; both counters start anywhere. seed: of the simulated noise.
    Returns the problem with every effect of this module as a held candidate.
    """
    run = np.linspace(0.0, 0.7, 8)
    zero = np.zeros_like(run)
    path = np.concatenate([np.stack(line, axis=1) for line in (
        (run, zero, zero), (run[::-1], zero + 0.4, zero + 0.1), (zero + 0.7, run, zero),
        (zero, run[::-1], zero + 0.3), (zero, zero + 0.7, run), (zero + 0.7, zero + 0.7, run[::-1]))])
    forward = np.tile(np.repeat([1.0, -1.0], len(run)), 3)
    velocity = forward[:, None] * np.repeat(np.eye(3), 2 * len(run), axis=0) * 5 * mm
    count = len(path)
    base = Unknown("base_point", np.array([0.5, 0.3, -0.6]), "mm", parts=("x", "y", "z"))
    start = Unknown("start", 0.8, "mm")
    time = np.arange(count) * minute
    temperature = 0.4 * np.sin(3 * time / hour)
    tracker = Observations(
        tracking_in_motion, path, velocity, base, start, -np.ones(count), u=0.3 * um, group="tracking", unit="um",
        covariates={"time": (time, "s"), "temperature_difference": (temperature, "K"), "direction": forward,
                    "block": 1 + np.arange(count) // (count // 2)})
    line_start = Unknown("line_start", 0.0, "mm")
    there = np.concatenate([run, run[::-1]])
    axis = Observations(
        displacement, there, line_start, np.ones(len(there)), u=0.1 * um, group="displacement", unit="um",
        covariates={"time": (time[:len(there)], "s"), "temperature_difference": (temperature[:len(there)], "K"),
                    "direction": forward[:len(there)], "block": np.ones(len(there)),
                    "abbe_offset": (np.full(len(there), 0.1), "m")})
    of_tracking = [replace(effect, groups=("tracking",)) for effect in effects(blocks=(2,))]
    problem = Problem([tracker, axis], effects=(*of_tracking, *displacement_effects(), *tracking_effects()),
                      name="interferometers on a machine")
    return simulate(problem, {start: 0.85, line_start: -0.02}, seed)
