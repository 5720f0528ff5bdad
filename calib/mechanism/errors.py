"""Geometric errors by their ISO names: location errors (EA0B, EC0X ...) and error motions (EXX, EYX, EAX ...) as
effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca

from calib.effect import Effect, Parameter
from calib.mechanism.axis import COMPONENTS, Axis
from calib.mechanism.basis import Basis, error_motion_basis, periodic_basis, polynomial_basis
from calib.mechanism.chain import Mechanism
from calib.units import mm, um, urad

LOCATION_SOURCE = "ISO 230-1:2012, 3.5 and annex A (location and orientation errors)"
MOTION_SOURCE = "ISO 230-1:2012, 3.4 (error motions of linear axes); ISO 230-7:2015, 3.2 (axes of rotation)"
LENGTH = ("mm", (1 * um, 5 * mm))
ANGLE = ("mrad", (1 * urad, 10e-3))


def _unit(component: int) -> tuple[str, tuple[float, float]]:
    return LENGTH if component < 3 else ANGLE


def _at(component: int, amount: Any) -> ca.SX:
    """The displacement (6,) with one component."""
    vector = ca.SX.zeros(6)
    vector[component] = amount
    return vector


def location_components(axis: Axis) -> tuple[str, ...]:
    """The components of the location of an axis that change its line, its orientation or its zero.

    Two displacements, two tilts and the zero position of a rotary axis; two tilts and the zero position of a linear
    one, which has no place. What an axis does to itself otherwise (a shift along a rotary axis) no reading can see
    here: it belongs to what the axis carries.
    """
    own = axis.along
    if axis.is_rotary:
        return tuple(c for i, c in enumerate(COMPONENTS) if i != own)
    return tuple(c for i, c in enumerate(COMPONENTS) if i == own or (i >= 3 and i - 3 != own))


def location_error(axis: Axis, component: str) -> Effect:
    """One location error, named `E<component>0<axis>`: a constant displacement along or turn about X, Y or Z.

    axis; component: one of X, Y, Z, A, B, C, of its reference, at the point of the axis, with what carries the axis.
    Returns the effect with the parameter `value` [m or rad].
    """
    place = COMPONENTS.index(component)
    unit, plausible = _unit(place)
    return Effect(f"E{component}0{axis.name}", f"{axis.name}_location", lambda value, p: _at(place, p.value),
                  (Parameter("value", unit, plausible),), channel=axis.name, source=LOCATION_SOURCE)


def location_errors(mechanism: Mechanism, axes: Sequence[str] | None = None) -> tuple[Effect, ...]:
    """All location errors of some axes (of all axes if not given), the zero positions included."""
    chosen = mechanism.axes if axes is None else [mechanism.axis(name) for name in axes]
    return tuple(location_error(axis, component) for axis in chosen for component in location_components(axis))


def mounting_errors(mechanism: Mechanism, frame: str, components: Sequence[str] = COMPONENTS) -> tuple[Effect, ...]:
    """Displacements of a frame against the axis that carries it, named `E<component>0<frame>`, along and about its own
    axes."""
    mechanism.frame(frame)

    def one(component: str) -> Effect:
        place = COMPONENTS.index(component)
        unit, plausible = _unit(place)
        return Effect(f"E{component}0{frame}", f"{frame}_mounting", lambda value, p: _at(place, p.value),
                      (Parameter("value", unit, plausible),), channel=frame, source=LOCATION_SOURCE)
    return tuple(one(component) for component in components)


def error_motion(axis: Axis, component: str, orders: Sequence[int] | None = None) -> Effect:
    """One error motion, named `E<component><axis>`: a displacement or turn that depends on the position of the axis.

    axis; component: one of X, Y, Z, A, B, C, of its reference; orders: of the Legendre polynomials over the travel
    (linear axis) or of the harmonics of the position (rotary axis); the lowest that are no location error if not given.
    What would be a location error, a zero position or (rotary, radial and tilt) an eccentric mounting of what is
    carried is taken out of every order over the travel, so that both may be free at once.
    Returns the effect with a parameter for each order: `p2`, `p3` ... or `c2`, `s2` ...
    """
    place = COMPONENTS.index(component)
    return _motion(axis, place, error_motion_basis(axis, place, orders), f"E{component}{axis.name}")


def periodic_error_motion(axis: Axis, component: str, period: float, orders: Sequence[int] = (1,)) -> Effect:
    """An error motion of a linear axis that repeats itself, such as with the pitch of its screw or scale.

    axis, component: as of `error_motion`; period: [m]; orders: harmonics of it. Named `E<component><axis>_periodic`, so
    that the slow error motion may stand beside it; parameters `c1`, `s1` ...
    """
    place = COMPONENTS.index(component)
    return _motion(axis, place, periodic_basis(axis, place, period, orders), f"E{component}{axis.name}_periodic")


def polynomial_error_motion(axis: Axis, component: str, orders: Sequence[int] = (3, 4)) -> Effect:
    """An error motion of a rotary axis that turns within limits, as polynomials over them in place of harmonics.

    Over a part of a turn harmonics are hardly told from each other; orders: see `polynomial_basis`. Named as by
    `error_motion`, parameters `p3`, `p4` ...
    """
    place = COMPONENTS.index(component)
    return _motion(axis, place, polynomial_basis(axis, place, orders), f"E{component}{axis.name}")


def _motion(axis: Axis, place: int, basis: Basis, name: str) -> Effect:
    unit = "um" if place < 3 else "urad"
    return Effect(name, f"{axis.name}_motion", _series(place, basis),
                  tuple(Parameter(n, unit, (0.1e-6, 1e-3)) for n in basis.names), channel=axis.name,
                  source=MOTION_SOURCE)


def _series(place: int, basis: Basis) -> Callable[..., Any]:
    def contribution(value: Any, p: Any, position: Any) -> Any:
        return _at(place, sum(c * f for c, f in zip(p, basis.values(position), strict=True)))
    return contribution


def error_motions(mechanism: Mechanism, axes: Sequence[str] | None = None, components: Sequence[str] = COMPONENTS,
                  orders: Sequence[int] | None = None) -> tuple[Effect, ...]:
    """The error motions of some axes (of all if not given): six each; orders as of `error_motion`."""
    chosen = mechanism.axes if axes is None else [mechanism.axis(name) for name in axes]
    return tuple(error_motion(axis, component, orders) for axis in chosen for component in components)

