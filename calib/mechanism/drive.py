"""What the drive of an axis does to its position: scale, zero, backlash, encoder, deflection under load, thermal
growth."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
from casadi import cos, sin

from calib.effect import Effect, Parameter
from calib.errors import DeclarationError
from calib.mechanism.axis import COMPONENTS, Axis
from calib.mechanism.chain import Mechanism
from calib.units import ppm, um, urad

ENCODER = "ISO 230-2:2014 (positioning); Deumlich and Staiger, Instrumentenkunde, Wichmann 2002 (circle eccentricity)"
DEFLECTION = "Hollerbach, Khalil and Gautier, Springer Handbook of Robotics 2016, ch. 6: joint compliance"
WINDUP = "Tuttle, Understanding and modeling the behavior of a harmonic drive gear transmission, MIT AI-TR 1365, 1992"
THERMAL = "ISO 230-3:2020 (thermal effects); linear expansion"


def _asking(function: Callable[..., Any], *inputs: str) -> Callable[..., Any]:
    """The function (value, p, *inputs) under names that are known only when it is made, such as a covariate's."""
    names = ["value", "p", *inputs]
    function.__signature__ = inspect.Signature(                                           # type: ignore[attr-defined]
        [inspect.Parameter(n, inspect.Parameter.POSITIONAL_OR_KEYWORD) for n in names])
    return function


def _displayed(axis: Axis) -> tuple[str, tuple[float, float]]:
    return ("mrad", (1 * urad, 10e-3)) if axis.is_rotary else ("um", (0.1 * um, 1e-3))


def scale(axis: Axis) -> Effect:
    """The position is the command times 1 + k: pitch of a screw or gear, scale of an encoder."""
    return Effect(f"scale_{axis.name}", f"{axis.name}_position", lambda value, p: p.k * value,
                  (Parameter("k", "ppm", (1 * ppm, 1e-2)),), channel=axis.name, source=ENCODER)


def zero_offset(axis: Axis) -> Effect:
    """The position is the command plus a constant; the same as the location error along or about the axis itself."""
    return Effect(f"zero_{axis.name}", f"{axis.name}_position", lambda value, p: p.offset,
                  (Parameter("offset", *_displayed(axis)),), channel=axis.name, source=ENCODER)


def backlash(axis: Axis, approach: str = "approach") -> Effect:
    """Half the backlash forward of the command or behind it, by the direction of approach.

    approach: name of the covariate or argument that is +1 where the axis came from below and -1 where from above.
    """
    def half(value: Any, p: Any, **named: Any) -> Any:
        return -0.5 * p.width * named[approach]
    return Effect(f"backlash_{axis.name}", f"{axis.name}_position", _asking(half, approach),
                  (Parameter("width", *_displayed(axis)),), channel=axis.name, source=ENCODER)


def encoder_harmonic(axis: Axis, order: int = 1, period: float | None = None) -> Effect:
    """A harmonic of the position, order times a turn: 1 for an eccentric circle, 2 for an elliptic one, more for
    gears.

    period: of the first harmonic; a turn for a rotary axis, for a linear one the pitch of its screw or scale [m].
    Raises DeclarationError for a linear axis without a period.
    """
    if period is None and not axis.is_rotary:
        raise DeclarationError(f"encoder of the linear axis '{axis.name}': a harmonic of what? Give the period, such "
                               "as the pitch of its screw or scale in metres.")
    rate = order * 2 * np.pi / (period or 2 * np.pi)
    return Effect(f"encoder_{order}x_{axis.name}", f"{axis.name}_position",
                  lambda value, p: p.c * cos(rate * value) + p.s * sin(rate * value),
                  tuple(Parameter(n, *_displayed(axis)) for n in "cs"), channel=axis.name, source=ENCODER)


def sag(mechanism: Mechanism, axis: Axis, loads: Sequence[str] | None = None) -> Effect:
    """Deflection of the drive of an axis by the weight of the loads together, in ratio of their masses.

    loads: names (all that the axis carries if not given). The parameter is the deflection per metre of lever arm of the
    whole weight: an angle per metre, or a length for a linear axis.
    """
    chosen = [i for i, load in enumerate(mechanism.loads) if loads is None or load.name in loads]
    masses = np.array([mechanism.loads[i].mass for i in chosen])
    share = masses / masses.sum()
    return Effect(f"sag_{axis.name}", f"{axis.name}_position",
                  lambda value, p, levers: p.compliance
                  * sum(float(s) * levers[i] for i, s in zip(chosen, share, strict=True)),
                  (Parameter("compliance", *_compliance(axis)),), channel=axis.name, source=DEFLECTION)


def sag_by_load(mechanism: Mechanism, axis: Axis) -> Effect:
    """Deflection of the drive of an axis with a parameter for each load that it carries, where masses are not known."""
    carried = [i for i, load in enumerate(mechanism.loads) if axis in mechanism.path_of(load)]
    parameters = tuple(Parameter(mechanism.loads[i].name, *_compliance(axis)) for i in carried)
    return Effect(f"sags_{axis.name}", f"{axis.name}_position",
                  lambda value, p, levers: sum(k * levers[i] for k, i in zip(p, carried, strict=True)),
                  parameters, channel=axis.name, source=DEFLECTION)


def soft_windup(mechanism: Mechanism, axis: Axis, knee: float) -> Effect:
    """Windup of a gear that is soft under small torque: the weight takes up the play and friction of its teeth.

    knee: lever arm of the whole weight [m] at which three quarters of it are taken up. The parameter is the deflection
    to either side beyond the knee, where only the stiff part, `sag`, goes on.
    """
    share = _shares(mechanism)
    return Effect(f"windup_{axis.name}", f"{axis.name}_position",
                  lambda value, p, levers: p.windup * ca.tanh(ca.dot(share, levers) / knee),
                  (Parameter("windup", *_displayed(axis)),), channel=axis.name, source=WINDUP)


def bending(mechanism: Mechanism, axis: Axis) -> Effect:
    """Tilt of an axis by the moment of all loads across it: compliance of its bearing and of the link before it.

    The parameter is the tilt per metre of lever arm of the whole weight, the same in every direction across the axis.
    """
    share = _shares(mechanism)
    across = ca.DM([0.0 if i == axis.along else 1.0 for i in range(3)])

    def tilt(value: Any, p: Any, moments: Any) -> Any:
        return ca.vertcat(ca.SX.zeros(3), p.compliance * across * ca.mtimes(moments, share))
    return Effect(f"bending_{axis.name}", f"{axis.name}_location", tilt, (Parameter("compliance", *_compliance(axis)),),
                  channel=axis.name, source=DEFLECTION)


def _shares(mechanism: Mechanism) -> ca.DM:
    masses = np.array([load.mass for load in mechanism.loads])
    return ca.DM(masses / masses.sum())


def _compliance(axis: Axis) -> tuple[str, tuple[float, float]]:
    return ("mrad/m", (1e-5, 2e-2)) if axis.is_rotary else ("um", (0.1 * um, 1e-3))


def thermal_growth(axis: Axis, component: str, temperature: str = "temperature_difference") -> Effect:
    """A displacement of the place of an axis in proportion to a temperature difference: growth of what carries it.

    component: X, Y, Z, A, B or C of its reference; temperature: name of the covariate or argument [K].
    """
    place = COMPONENTS.index(component)
    unit, plausible = ("um/K", (0.1e-6, 1e-4)) if place < 3 else ("urad/K", (0.1e-6, 1e-4))

    def growth(value: Any, p: Any, **named: Any) -> Any:
        vector = ca.SX.zeros(6)
        vector[place] = p.rate * named[temperature]
        return vector
    return Effect(f"growth_{component}_{axis.name}", f"{axis.name}_location", _asking(growth, temperature),
                  (Parameter("rate", unit, plausible),), channel=axis.name, source=THERMAL)


def thermal_scale(axis: Axis, temperature: str = "temperature_difference") -> Effect:
    """Expansion of the scale or screw of a linear axis in proportion to a temperature difference [K]."""
    def stretch(value: Any, p: Any, **named: Any) -> Any:
        return p.rate * value * named[temperature]
    return Effect(f"expansion_{axis.name}", f"{axis.name}_position", _asking(stretch, temperature),
                  (Parameter("rate", "ppm/K", (0.1 * ppm, 100 * ppm)),), channel=axis.name, source=THERMAL)
