"""Electronic level: inclination against gravity, read as a small angle.

Sign: an inclination is positive where it makes the reading grow.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from casadi import cos, sin

from calib import Effect, Observations, Problem, Unknown, direct, hands_slots_to, simulate
from calib.units import arcsec, degree, hour, minute

from . import influence, stated

GUIDE = "ISO 230-1:2012, test code for machine tools: precision levels; magnitudes: bench experience"


def indication(inclination: Any, zero: Any, *, tilt: Any = direct, reading: Any = direct) -> Any:
    """Reading of a level: its zero plus the inclination of its seat.

    inclination: of the seat along the sensitive direction, positive where the reading grows [rad]; zero: reading on a
    horizontal seat [rad]. Slots: `tilt` (what the sensor feels), `reading` (what is shown; may ask for
    `inclination`). Returns the reading [rad].
    """
    felt = tilt(inclination)
    return reading(zero + felt, inclination=felt)


@hands_slots_to(indication)
def on_turning_axis(axis_tilt: Any, angle: Any, zero: Any, **slots: Any) -> Any:
    """Reading of a level fixed to a nearly vertical axis at one turning angle of that axis.

    axis_tilt: (2,) theta_x, theta_y, rotations of the axis about the fixed horizontal x and y [rad]; angle: of the
    axis [rad]; zero: reading on a horizontal seat, including the set of the level against the table [rad]. Slots:
    those of `indication`.
    Returns the reading, zero - theta_y cos(angle) + theta_x sin(angle) [rad].
    Source: Ren, Gao, Zhao (2015), J. Harbin Inst. Tech. 47(10), eq (1)-(3).
    """
    return indication(-axis_tilt[1] * cos(angle) + axis_tilt[0] * sin(angle), zero, **slots)


def stated_uncertainty(limit_fixed: float, limit_share: float, reading: np.ndarray | float,
                       resolution: float) -> stated.Lines:
    """Standard uncertainty of level readings from the resolution and a limit of error fixed + share |reading|.

    limit_fixed [rad], limit_share [1]: limit of error of the indication, taken as rectangular because nothing but the
    limit is known; reading: (n,) [rad]; resolution: last digit [rad]. Returns the lines `limit of error` and
    `resolution` [rad].
    Source: JCGM 100:2008, 4.3.7 and F.2.2.1.
    """
    return stated.Lines({"limit of error": stated.rectangular(limit_fixed + limit_share * np.abs(reading)),
                         "resolution": stated.resolution(resolution)})


def effects(blocks: Sequence[int] = (), settling_time: float = 2 * minute) -> tuple[Effect, ...]:
    """The effects of a level: zero change, sensitivity, drift, temperature, hysteresis, settling and steps.

    blocks: seatings at which a step may have happened; settling_time: time constant of the settling after a new
    seating [s].
    Returns the effects. The zero of a problem that leaves the zero free hides the effect `zero`.
    """
    return (
        influence.offset("zero", "reading", "o", "arcsec", (0.05 * arcsec, 30 * arcsec), source=GUIDE),
        influence.gain("gain", "tilt", "1", (1e-4, 0.05), channel="reading", source=GUIDE),
        influence.drift("reading", "arcsec", (0.02 * arcsec / hour, 5 * arcsec / hour), source=GUIDE),
        influence.thermal("reading", "arcsec", (0.01 * arcsec, 2 * arcsec), source=GUIDE),
        influence.hysteresis("reading", "arcsec", (0.02 * arcsec, 2 * arcsec), source=GUIDE),
        influence.settling("reading", "arcsec", (0.05 * arcsec, 5 * arcsec), settling_time, source=GUIDE),
        *influence.steps("reading", "arcsec", (0.05 * arcsec, 10 * arcsec), blocks, source=GUIDE),
    )


def example(seed: int) -> Problem:
    """A level on a small-angle generator and then on a turning axis, seated anew half-way there; simulated readings.

    seed: of the simulated noise. Returns the problem with every effect of this module as a held candidate.
    """
    def influences(start: float, direction: np.ndarray, seatings: np.ndarray) -> dict[str, Any]:
        time = start + np.arange(len(seatings)) * 3 * minute
        since = np.concatenate([np.arange(np.sum(seatings == b)) * 3 * minute for b in np.unique(seatings)])
        return {"time": (time, "s"), "direction": direction, "block": seatings, "time_since_seating": (since, "s"),
                "temperature_difference": (0.5 * np.sin(time / hour), "K")}

    up = np.linspace(-40.0, 40.0, 9) * arcsec
    known = np.concatenate([up, up[::-1]])
    there = np.arange(-60.0, 61.0, 15.0) * degree
    angle = np.concatenate([there, there[::-1], there, there[::-1]])
    axis_tilt = Unknown("axis_tilt", np.zeros(2), "arcsec", parts=("x", "y"))
    zero, generator_zero = Unknown("zero", 0.0, "arcsec"), Unknown("generator_zero", 0.0, "arcsec")
    on_generator = Observations(
        indication, known, generator_zero, u=0.15 * arcsec, group="small-angle generator", unit="arcsec",
        covariates=influences(0.0, np.repeat([1.0, -1.0], 9), np.zeros(18)))
    on_axis = Observations(
        on_turning_axis, axis_tilt, angle, zero, u=0.15 * arcsec, group="turning axis", unit="arcsec",
        covariates=influences(hour, np.repeat([1.0, -1.0, 1.0, -1.0], 9), np.repeat([1.0, 2.0], 18)))
    problem = Problem([on_generator, on_axis], effects=effects(blocks=(2,)), name="level on a turning axis")
    return simulate(problem, {axis_tilt: np.array([3.0, -2.0]) * arcsec, zero: 12 * arcsec}, seed)
