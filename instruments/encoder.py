"""Rotary encoder: the angle of a shaft read at a disc, by one head or several.

`zero` is the reading at shaft angle zero, `sense` +1 where the reading grows with the angle, else -1. The effects are
the general ones of any divided circle; `axis_angle_effects` gives them for the angle slot of a mechanism.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from calib import Effect, Observations, Problem, Shared, Unknown, direct, hands_slots_to, simulate
from calib.units import arcsec, degree, hour, minute, ppm

from . import influence, stated

CIRCLE = "Lu, Graetz, Amin-Shahidi, Smeds, CIRP Annals 59 (2010) 529-534, on-axis self-calibration of angle encoders"
POSITIONING = "ISO 230-2:2014, positioning accuracy and repeatability of numerically controlled axes"
PERIOD = 2 * np.pi


def head_reading(angle: Any, head: Any, zero: Any, sense: Any, *, disc_angle: Any = direct,
                 encoder_reading: Any = direct) -> Any:
    """Reading of one head of an encoder.

    angle: of the shaft [rad]; head: place of the head round the disc, from the first head [rad]; zero: reading at
    angle zero [rad]; sense: +1 or -1. Slots: `disc_angle` (the line of the disc under the head, angle + head) and
    `encoder_reading`.
    Returns zero + sense angle, not reduced to one turn [rad]. Opposite heads see an eccentricity with opposite signs.
    """
    place = angle + head
    error = disc_angle(place, angle=angle, head=head) - place
    return encoder_reading(zero + sense * (angle + error), angle=angle)


@hands_slots_to(head_reading)
def indicated_angle(angle: Any, zero: Any, sense: Any, **slots: Any) -> Any:
    """Reading of an encoder with one head: `head_reading` at head 0. Returns zero + sense angle [rad]."""
    return head_reading(angle, 0, zero, sense, **slots)


def stated_uncertainty(limit: float, last_digit: float) -> stated.Lines:
    """Standard uncertainty of an encoder reading from its accuracy grade and its measuring step.

    limit: a of a system accuracy of +- a, taken as rectangular [rad]; last_digit: measuring step [rad]. Assumption:
    the errors of different readings are independent; where they are a function of the angle, free `encoder_ecc` and
    `encoder_2nd` with a prior instead.
    Returns the lines `accuracy` and `resolution` [rad]. Source: JCGM 100:2008, 4.3.7 and F.2.2.1.
    """
    return stated.Lines({"accuracy": stated.rectangular(limit), "resolution": stated.resolution(last_digit)})


def axis_angle_effects(slot: str, channel: str = "", lines: int | None = None) -> tuple[Effect, ...]:
    """Errors of a divided circle for any slot that holds an angle [rad].

    slot, channel: as of an Effect; lines: graduation lines per turn, for the error of the subdivision, None leaves it
    out.
    Returns encoder_ecc (c cos + s sin of the angle), encoder_2nd (of twice the angle), angle_scale (k angle, not
    reduced to one turn), hysteresis (width/2 times the input `direction`) and, with lines, subdivision (c, s over one
    line).
    """
    circle = (0.1 * arcsec, 60 * arcsec)
    subdivision = () if lines is None else (
        influence.harmonic("subdivision", slot, lines, "arcsec", (0.02 * arcsec, 5 * arcsec), channel=channel,
                           source=CIRCLE),)
    return (
        influence.harmonic("encoder_ecc", slot, 1, "arcsec", circle, channel=channel, source=CIRCLE),
        influence.harmonic("encoder_2nd", slot, 2, "arcsec", circle, channel=channel, source=CIRCLE),
        influence.gain("angle_scale", slot, "ppm", (0.2 * ppm, 100 * ppm), channel=channel, source=POSITIONING),
        influence.hysteresis(slot, "arcsec", (0.1 * arcsec, 20 * arcsec), channel=channel, source=POSITIONING),
        *subdivision,
    )


def effects(blocks: Sequence[int] = (), lines: int = 18000) -> tuple[Effect, ...]:
    """The effects of an encoder: those of its circle, and drift, thermal and steps of its reading.

    blocks: blocks at which the reading may have jumped (coupling slipped); lines: graduation lines per turn.
    Returns the effects.
    """
    return (
        *axis_angle_effects("disc_angle", "theta", lines),
        influence.drift("encoder_reading", "arcsec", (0.05 * arcsec / hour, 10 * arcsec / hour), source=POSITIONING),
        influence.thermal("encoder_reading", "arcsec", (0.02 * arcsec, 5 * arcsec), source=POSITIONING),
        *influence.steps("encoder_reading", "arcsec", (0.1 * arcsec, 60 * arcsec), blocks, source=POSITIONING),
    )


def example(seed: int) -> Problem:
    """A disc with three heads over two turns at unknown angles, the first head also against known angles; simulated
    readings.

    seed: of the simulated noise. Returns the problem with every effect of this module as a held candidate.
    """
    known = np.concatenate([np.arange(0.0, 360.0, 15.0), np.arange(345.0, -1.0, -15.0)]) * degree
    positions = np.arange(0.0, 720.0, 23.0) * degree
    heads = np.array([0.0, 95.0, 180.0]) * degree
    zero = Unknown("head_zero", np.zeros((3, 1)), "arcsec", keys=["1", "2", "3"])
    shaft = Unknown("shaft_angle", positions[:, None], "deg")
    position, head = (axis.ravel() for axis in np.meshgrid(np.arange(len(positions)), np.arange(3), indexing="ij"))

    def influences(rows: int) -> dict[str, Any]:
        time = np.arange(rows) * minute
        return {"time": (time, "s"), "temperature_difference": (0.6 * np.sin(2 * time / hour), "K"),
                "direction": np.where(np.arange(rows) < rows // 2, 1.0, -1.0),
                "block": 1 + np.arange(rows) // (rows // 2 + 1)}

    against_known = Observations(indicated_angle, known, zero[0], np.ones(len(known)), u=0.2 * arcsec,
                                 group="known angles",
                                 unit="arcsec", period=PERIOD, covariates=influences(len(known)))
    three_heads = Observations(head_reading, shaft[position], heads[head], zero[head], Shared(1.0), u=0.1 * arcsec,
                               group="three heads",
                               unit="arcsec", period=PERIOD, covariates=influences(len(position)))
    problem = Problem([against_known, three_heads], effects=effects(blocks=(2,), lines=1024),
                      name="encoder with three heads")
    return simulate(problem, {}, seed)
