"""Influences that many instruments share, written once as effects for any slot.

The inputs have one name everywhere: `time` [s] from the first reading, `temperature_difference` [K] from the
reference temperature, `direction` (+1 approached with increasing value, -1 decreasing), `block` (a whole number that
grows at every new setting-up) and `time_since_seating` [s]. `along` is a constant direction where the slot holds a
vector.
"""

from __future__ import annotations

from collections.abc import Sequence

from casadi import DM, cos, exp, sin

from calib import Effect, Parameter

# A magnitude that may be found at a bench, in SI: (hardly seen, hardly tolerated).
Plausible = tuple[float, float]


def _direction(along: Sequence[float] | None) -> DM | float:
    return 1.0 if along is None else DM(list(along))


def drift(slot: str, unit: str, plausible: Plausible, *, source: str, channel: str = "",
          along: Sequence[float] | None = None) -> Effect:
    """Drift in proportion to time: + rate t.

    slot, channel: where it acts and how answers call that; unit: of the reading, the rate is per hour; plausible: of
    the rate in SI (per second); along: constant direction for a vector slot. Returns the effect, with input `time`
    [s].
    """
    direction = _direction(along)
    return Effect("drift", slot, lambda value, p, time: p.rate * time * direction,
                  (Parameter("rate", f"{unit}/h", plausible),), channel, source=source)


def thermal(slot: str, unit: str, plausible: Plausible, *, source: str, channel: str = "",
            along: Sequence[float] | None = None) -> Effect:
    """Response to temperature: + coef (T - T_reference).

    Arguments as for `drift`, the coefficient per kelvin. Returns the effect, with input `temperature_difference` [K].
    """
    direction = _direction(along)
    return Effect("thermal", slot, lambda value, p, temperature_difference: p.coef * temperature_difference * direction,
                  (Parameter("coef", f"{unit}/K", plausible),), channel, source=source)


def hysteresis(slot: str, unit: str, plausible: Plausible, *, source: str, channel: str = "",
               along: Sequence[float] | None = None) -> Effect:
    """Reversal error: + width/2 times the direction of approach.

    Arguments as for `drift`. Returns the effect, with input `direction` (+1 or -1).
    """
    toward = _direction(along)
    return Effect("hysteresis", slot, lambda value, p, direction: 0.5 * p.width * direction * toward,
                  (Parameter("width", unit, plausible),), channel, source=source)


def steps(slot: str, unit: str, plausible: Plausible, blocks: Sequence[int], *, source: str, channel: str = "",
          along: Sequence[float] | None = None) -> tuple[Effect, ...]:
    """Lasting change at the beginning of a block, one effect for each block in `blocks`: + offset [block >= b].

    Arguments as for `drift`; blocks: the blocks at which a step may have happened. Returns effects of channel
    `channel@b`, with input `block`.
    """
    direction = _direction(along)

    def step(first: int) -> Effect:
        return Effect("step", slot, lambda value, p, block: p.offset * (block >= first) * direction,
                      (Parameter("offset", unit, plausible),), f"{channel or slot}@{first}", source=source)

    return tuple(step(int(first)) for first in blocks)


def settling(slot: str, unit: str, plausible: Plausible, time_constant: float, *, source: str,
             channel: str = "") -> Effect:
    """Settling after a new seating: + start exp(-time_since_seating/time_constant).

    Arguments as for `drift`; time_constant [s] is known (a hypothesis), because the data see it only where `start` is
    not zero.
    Returns the effect, with input `time_since_seating` [s].
    """
    return Effect("settling", slot,
                  lambda value, p, time_since_seating: p.start * exp(-time_since_seating / time_constant),
                  (Parameter("start", unit, plausible),), channel, source=source)


def offset(name: str, slot: str, parameter: str, unit: str, plausible: Plausible, *, source: str, channel: str = "",
           along: Sequence[float] | None = None) -> Effect:
    """Constant addition to the value at a slot.

    name, parameter: how answers call it; the rest as for `drift`. Returns the effect, without inputs.
    """
    direction = _direction(along)
    return Effect(name, slot, lambda value, p: p[0] * direction, (Parameter(parameter, unit, plausible),), channel,
                  source=source)


def gain(name: str, slot: str, unit: str, plausible: Plausible, *, source: str, channel: str = "") -> Effect:
    """Addition in proportion to the value at a slot, scalar or vector: + k value.

    name: how answers call it; unit: of k, "1" or "ppm"; the rest as for `drift`. Returns the effect, without inputs.
    """
    return Effect(name, slot, lambda value, p: p.k * value, (Parameter("k", unit, plausible),), channel, source=source)


def harmonic(name: str, slot: str, order: float, unit: str, plausible: Plausible, *, source: str,
             channel: str = "") -> Effect:
    """Periodic addition over the value at a slot: + c cos(order value) + s sin(order value).

    name: how answers call it; order: waves per turn where the value is an angle, else radians per unit of the value;
    the rest as for `drift`. Returns the effect, without inputs.
    """
    return Effect(name, slot, lambda value, p: p.c * cos(order * value) + p.s * sin(order * value),
                  (Parameter("c", unit, plausible), Parameter("s", unit, plausible)), channel, source=source)
