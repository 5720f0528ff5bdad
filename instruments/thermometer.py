"""Thermometer: one that shows a temperature, and a platinum resistance read as a resistance.

Temperatures are kelvin. The sensor feels its own temperature, which lag, self-heating and conduction move away from
that of the medium.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from casadi import fmin
from numpy.typing import ArrayLike

from calib import Effect, Observations, Parameter, Problem, Unknown, direct, simulate
from calib.errors import InputError
from calib.units import hour, kelvin, minute

from . import influence, stated

PLATINUM = "IEC 60751:2022, industrial platinum resistance thermometers and platinum temperature sensors"
PRACTICE = "Nicholas and White, Traceable Temperatures, 2nd ed., Wiley 2001"
ZERO_CELSIUS = 273.15            # K
CALLENDAR_VAN_DUSEN = (3.9083e-3, -5.775e-7, -4.183e-12)         # A [1/K], B [1/K^2], C [1/K^4] of IEC 60751
# Fixed part [K] and part in proportion to |t| [K/K], IEC 60751.
_TOLERANCES = {"AA": (0.1, 0.0017), "A": (0.15, 0.002), "B": (0.3, 0.005), "C": (0.6, 0.01)}


def indication(temperature: Any, *, sensor: Any = direct, temperature_reading: Any = direct) -> Any:
    """Reading of a thermometer that shows temperature.

    temperature: of the medium [K]. Slots: `sensor` (temperature of the sensor) and `temperature_reading` (what is
    shown).
    Returns the temperature [K].
    """
    return temperature_reading(sensor(temperature), temperature=temperature)


def resistance(temperature: Any, resistance_at_zero: Any, *, sensor: Any = direct,
               resistance_reading: Any = direct) -> Any:
    """Resistance of a platinum sensor.

    temperature: of the medium, -200 to 850 degC [K]; resistance_at_zero: R0 at 0 degC, in any unit of resistance.
    Slots: `sensor` (temperature of the sensor [K]) and `resistance_reading`.
    Returns R0 (1 + A t + B t^2 + C (t - 100 K) t^3), the last term below 0 degC only, in the unit of R0.
    Source: IEC 60751:2022 (Callendar and Van Dusen).
    """
    a, b, c = CALLENDAR_VAN_DUSEN
    t = sensor(temperature) - ZERO_CELSIUS
    below = fmin(t, 0)
    return resistance_reading(resistance_at_zero * (1 + a * t + b * t**2 + c * (below - 100) * below**3),
                              temperature=temperature)


def tolerance_uncertainty(tolerance_class: str, temperature: ArrayLike) -> np.ndarray:
    """Standard uncertainty of an uncalibrated platinum thermometer of a tolerance class.

    tolerance_class: "AA", "A", "B" or "C"; temperature: (n,) [K]. Assumption: the sensor lies within its tolerance
    and nothing more is known (rectangular). The error is common to all readings of one sensor: give it as a prior on
    the effect `zero_offset`, not to each reading.
    Returns (n,) tolerance/sqrt(3) [K]. Raises InputError for another class. Source: IEC 60751:2022, table of
    tolerance classes.
    """
    if tolerance_class not in _TOLERANCES:
        raise InputError(f"There is no tolerance class '{tolerance_class}' in IEC 60751; there are "
                         f"{', '.join(_TOLERANCES)}. For another limit use stated.rectangular.")
    fixed, rate = _TOLERANCES[tolerance_class]
    return stated.rectangular(fixed + rate * np.abs(np.asarray(temperature, float) - ZERO_CELSIUS))


def effects(blocks: Sequence[int] = (), reference_temperature: float = 293.15) -> tuple[Effect, ...]:
    """The effects of a thermometer, all on the temperature of its sensor.

    blocks: blocks at which the sensor may have jumped (a knock); reference_temperature: where the gain has no effect
    [K].
    Returns zero_offset, gain (of the departure from the reference), lag (needs the covariate `temperature_rate`
    [K/s]), self_heating (at the nominal current; needs `current_squared`, the square of the ratio to that),
    conduction along the stem (needs `ambient` [K]), drift, hysteresis, steps.
    """
    return (
        influence.offset("zero_offset", "sensor", "o", "K", (1e-3, 1.0), source=PRACTICE),
        Effect("gain", "sensor", lambda value, p: p.k * (value - reference_temperature),
               (Parameter("k", "1", (1e-5, 0.02)),), source=PRACTICE),
        Effect("lag", "sensor", lambda value, p, temperature_rate: -p.tau * temperature_rate,
               (Parameter("tau", "s", (0.5, 600.0), lower=0.0),), source=PRACTICE),
        Effect("self_heating", "sensor", lambda value, p, current_squared: p.h * current_squared,
               (Parameter("h", "K", (5e-4, 0.2), lower=0.0),), source=PRACTICE),
        Effect("conduction", "sensor", lambda value, p, ambient: p.k * (ambient - value),
               (Parameter("k", "1", (1e-4, 0.1), lower=0.0),), source=PRACTICE),
        influence.drift("sensor", "K", (1e-4 / hour, 0.1 / hour), source=PRACTICE),
        influence.hysteresis("sensor", "K", (1e-3, 0.1), source=PRACTICE),
        *influence.steps("sensor", "K", (1e-3, 0.5), blocks, source=PRACTICE),
    )


def example(seed: int) -> Problem:
    """A thermometer and a platinum sensor compared with a reference in a bath, up and down; simulated readings.

    seed: of the simulated noise. Returns the problem with every effect of the thermometer under test as a held
    candidate.
    """
    levels = np.array([5.0, 12.0, 20.0, 28.0, 35.0, 28.0, 20.0, 12.0, 5.0]) + ZERO_CELSIUS
    index = np.repeat(np.arange(len(levels)), 3)
    count = len(index)
    bath, at_zero = Unknown("bath", levels[:, None], "K"), Unknown("resistance_at_zero", 100.0, "1")
    covariates = {"time": (np.arange(count) * 10 * minute, "s"), "direction": np.where(index < 5, 1.0, -1.0),
                  "block": 1 + (index > 4),
                  "temperature_rate": (1e-4 * (np.arange(count) % 3 == 0) * np.where(index < 5, 1, -1), "K/s"),
                  "current_squared": np.where(np.arange(count) % 3 == 2, 2.0, 1.0),
                  "ambient": (294.0 + 0.3 * np.sin(np.arange(count)), "K")}
    reference = Observations(indication, bath[index], u=2e-3 * kelvin, group="reference", unit="K")
    under_test = Observations(indication, bath[index], u=5e-3 * kelvin, group="thermometer", unit="K",
                              covariates=covariates)
    platinum = Observations(resistance, bath[index], at_zero, u=1e-3, group="platinum", unit="1")
    candidates = [replace(effect, groups=("thermometer",)) for effect in effects(blocks=(2,))]
    problem = Problem([reference, under_test, platinum], effects=candidates, name="thermometers in a bath")
    return simulate(problem, {}, seed)
