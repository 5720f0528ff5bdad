"""Autocollimator on the faces of an optical polygon that an indexing table turns.

Angles about the axis of the table, positive counter-clockwise seen from above. A face deviation is the angle of the
face normal from its nominal place; a table deviation is the true turn minus the nominal one. The autocollimator reads
positive where the normal is turned counter-clockwise from its line of sight, and upward where the normal points up.
`sense` is not needed: an instrument that counts the other way has a gain of -1, given as negative readings.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from casadi import cos, sin

from calib import Constraint, Effect, Observations, Parameter, Problem, Unknown, direct, hands_slots_to, simulate
from calib.units import arcsec, hour, minute

from . import influence, stated

ANGLES = "Estler and Queen, CIRP Annals 42 (1993) 573-576, an advanced angle metrology system"
INDEXING = "Reeve, The calibration of indexing tables by subdivision, NBSIR 75-750, National Bureau of Standards 1975"
COLLIMATORS = ("Yandayan, Akgoz, Asar, Meas. Sci. Technol. 25 (2014) 015010, calibration of high-resolution electronic "
               "autocollimators")


def indication(angle: Any, zero: Any, *, mirror: Any = direct, autocollimator: Any = direct) -> Any:
    """Reading of an autocollimator on one mirror.

    angle: of the mirror normal from the line of sight [rad]; zero: reading at angle zero [rad].
    Slots: `mirror` (the angle seen) and `autocollimator` (the reading shown). Returns zero + angle [rad].
    """
    return autocollimator(zero + mirror(angle), angle=angle)


@hands_slots_to(indication)
def polygon_face(face: Any, table: Any, zero: Any, **slots: Any) -> Any:
    """Reading on the polygon face that the table has turned to the autocollimator.

    face: deviation of that face [rad]; table: deviation of the table at this turn [rad]; zero: of this mounting of
    the polygon [rad].
    Slots: those of `indication`. Returns zero + face + table [rad].
    """
    return indication(face + table, zero, **slots)


@hands_slots_to(indication)
def polygon_face_in_two_axes(face: Any, pyramid: Any, table: Any, zero: Any, *, mirror_tilt: Any = direct,
                             autocollimator_tilt: Any = direct, **slots: Any) -> tuple[Any, Any]:
    """Reading of both axes of an autocollimator on a polygon face.

    face, table: as for `polygon_face` [rad]; pyramid: pyramidal error, the angle of the face normal above the base
    plane [rad]; zero: (2,) of both axes [rad]. Slots: those of `indication`, `mirror_tilt` (the tilt seen) and
    `autocollimator_tilt` (the tilt shown). Effects at `autocollimator` may ask for `tilt`, at `autocollimator_tilt`
    for `angle`.
    Returns horizontal zero + face + table, vertical zero + pyramid [rad].
    """
    tilt, angle = mirror_tilt(pyramid), face + table
    autocollimator = slots.pop("autocollimator", direct)

    def with_tilt(value: Any, **asked: Any) -> Any:
        return autocollimator(value, tilt=tilt, **asked)

    return (indication(angle, zero[0], autocollimator=with_tilt, **slots),
            autocollimator_tilt(zero[1] + tilt, angle=angle))


def closure(name: str, deviations: Unknown, tolerance: float = 1e-12) -> Constraint:
    """The deviations of a full circle, of the faces of a polygon or the positions of a table, add up to zero.

    name: of the constraint; deviations: an unknown of scalar instances, one for each division of the circle [rad];
    tolerance [rad].
    Returns the constraint. Source: the closure of the circle, Estler and Queen (1993).
    """
    return Constraint(name, _sum_of(deviations.count), *(deviations[i] for i in range(deviations.count)),
                      tolerance=tolerance, unit="arcsec")


def _sum_of(count: int) -> Callable[..., Any]:
    """Sum of `count` arguments, with a name for each, because a constraint binds its arguments by name."""
    def total(*angles: Any) -> Any:
        return sum(angles[1:], start=angles[0])

    total.__signature__ = inspect.Signature(    # type: ignore[attr-defined]
        [inspect.Parameter(f"angle_{i + 1}", inspect.Parameter.POSITIONAL_ONLY) for i in range(count)])
    return total


def stated_uncertainty(limit: float, last_digit: float, scatter: float, count: int) -> stated.Lines:
    """Standard uncertainty of the mean of autocollimator readings on one face.

    limit: a of an accuracy of +- a over the range in use, taken as rectangular [rad]; last_digit [rad]; scatter:
    repeatability of one reading [rad]; count: readings averaged. Assumption: the error within the accuracy changes
    from face to face at random.
    Returns the lines `accuracy`, `resolution`, `repeats` [rad]. Source: JCGM 100:2008, 4.2.3, 4.3.7, F.2.2.1.
    """
    return stated.Lines({"accuracy": stated.rectangular(limit), "resolution": stated.resolution(last_digit),
                         "repeats": stated.of_mean(scatter, count)})


def table_uncertainty(limit: float, repeatability: float) -> stated.Lines:
    """Standard uncertainty of the turn of a multi-tooth indexing table between two positions.

    limit: a of a stated accuracy of +- a for any position [rad]; repeatability: standard deviation of engaging again
    [rad]. Assumption: the deviation of each position is rectangular within +- a and independent of the others; a turn
    is the difference of two positions.
    Returns the lines `accuracy` and `repeatability` of a turn [rad]. Source: JCGM 100:2008, 4.3.7; Reeve (1975) for
    the model.
    """
    return stated.Lines({"accuracy": np.sqrt(2.0) * stated.rectangular(limit),
                         "repeatability": np.sqrt(2.0) * repeatability})


def effects(blocks: Sequence[int] = (), interpolation_period: float = 10 * arcsec) -> tuple[Effect, ...]:
    """The effects of an autocollimator on a polygon and a table.

    blocks: mountings at which the reading may have jumped; interpolation_period: period of the interpolation of the
    image [rad].
    Returns gain, interpolation (c, s), roll (of the autocollimator about its line of sight, by which a tilt is read
    as an angle), wobble of the table (c, s, needs the covariate `table_angle` [rad]), drift, thermal, steps.
    """
    waves = 2 * np.pi / interpolation_period
    small = (0.01 * arcsec, 1 * arcsec)
    return (
        influence.gain("gain", "mirror", "1", (1e-4, 0.02), channel="autocollimator", source=COLLIMATORS),
        Effect("interpolation", "mirror", lambda value, p: p.c * cos(waves * value) + p.s * sin(waves * value),
               (Parameter("c", "arcsec", small), Parameter("s", "arcsec", small)), "autocollimator",
               source=COLLIMATORS),
        Effect("roll", "autocollimator", lambda value, p, tilt: p.rho * tilt,
               (Parameter("rho", "mrad", (1e-4, 2e-2)),), source=ANGLES),
        Effect("wobble", "mirror_tilt", lambda value, p, table_angle: p.c * cos(table_angle) + p.s * sin(table_angle),
               (Parameter("c", "arcsec", (0.1 * arcsec, 20 * arcsec)),
                Parameter("s", "arcsec", (0.1 * arcsec, 20 * arcsec))), source=INDEXING),
        influence.drift("autocollimator", "arcsec", (0.02 * arcsec / hour, 5 * arcsec / hour), source=COLLIMATORS),
        influence.thermal("autocollimator", "arcsec", (0.01 * arcsec, 2 * arcsec), source=COLLIMATORS),
        *influence.steps("autocollimator", "arcsec", (0.02 * arcsec, 10 * arcsec), blocks, source=COLLIMATORS),
    )


def example(seed: int) -> Problem:
    """A polygon and a table calibrated against each other, after a mirror at known angles; simulated readings.

    The eight-sided polygon is mounted on each position of the table; in the last two mountings both axes are read.
    seed: of the simulated noise. Returns the problem, its circles closed by constraints, with every effect of this
    module as a held candidate.
    """
    count = 8
    face, table, pyramid = (Unknown(name, np.zeros((count, 1)), "arcsec", keys=range(1, count + 1))
                            for name in ("face", "table", "pyramid"))
    zero, both_zeros = Unknown("zero", np.zeros((6, 1)), "arcsec"), Unknown("both_zeros", np.zeros((2, 2)), "arcsec")
    mirror_zero = Unknown("mirror_zero", 0.0, "arcsec")

    def mounted(mountings: int) -> tuple[np.ndarray, np.ndarray]:
        """Mounting and position of the table, reading after reading."""
        return np.repeat(np.arange(mountings), count), np.tile(np.arange(count), mountings)

    def influences(position: np.ndarray, start: float) -> dict[str, Any]:
        time = start + np.arange(len(position)) * minute
        return {"time": (time, "s"), "temperature_difference": (0.1 * np.sin(time / hour), "K"),
                "block": np.where(time < 30 * minute, 1.0, 2.0), "table_angle": (2 * np.pi * position / count, "rad")}

    known = np.linspace(-20.0, 20.0, 9) * arcsec
    mirror = Observations(indication, known, mirror_zero, u=0.05 * arcsec, group="mirror", unit="arcsec",
                          covariates=influences(np.zeros(9), -hour))
    mounting, position = mounted(6)
    one_axis = Observations(polygon_face, face[(position + mounting) % count], table[position], zero[mounting],
                            u=0.05 * arcsec, group="one axis", unit="arcsec", covariates=influences(position, 0.0))
    mounting, position = mounted(2)
    seen = (position + mounting + 6) % count
    two_axes = Observations(polygon_face_in_two_axes, face[seen], pyramid[seen], table[position], both_zeros[mounting],
                            u=0.05 * arcsec, group="two axes", unit="arcsec", components=("horizontal", "vertical"),
                            covariates=influences(position, hour))
    problem = Problem([mirror, one_axis, two_axes], effects=effects(blocks=(2,)), name="polygon against indexing table",
                      constraints=[closure("faces close", face), closure("table closes", table),
                                   closure("pyramid has no mean", pyramid)])
    turns = 2 * np.pi * np.arange(count)[:, None] / count
    truth = {face: 1.5 * arcsec * np.cos(2 * turns), table: 0.4 * arcsec * np.sin(3 * turns),
             pyramid: 8 * arcsec * np.sin(turns)}
    return simulate(problem, truth, seed)
