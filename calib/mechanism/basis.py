"""Functions of the position of an axis that describe its error motions and do not imitate its location errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from calib.errors import DeclarationError
from calib.mechanism.axis import Axis

NODES = 64      # Gauss points over the travel: exact for all polynomials and slow waves that a person would ask for
PER_WAVE = 8    # more of them for each wave over the travel

Function = Callable[[Any], Any]      # of a position, CasADi or NumPy


@dataclass(frozen=True)
class Basis:
    """Functions of a position with the names of their coefficients."""

    names: tuple[str, ...]
    functions: tuple[Function, ...]

    def values(self, position: Any) -> list[Any]:
        """The functions at a position, CasADi or NumPy."""
        return [f(position) for f in self.functions]


def legendre(order: int, lower: float, upper: float) -> Function:
    """Legendre polynomial of an order over a travel; 1 at its upper end. Source: Bonnet's recursion."""
    def value(position: Any) -> Any:
        s = (2.0 * position - (lower + upper)) / (upper - lower)
        before, here = 1.0 + 0.0 * s, s
        if order == 0:
            return before
        for n in range(1, order):
            before, here = here, ((2 * n + 1) * s * here - n * before) / (n + 1)
        return here
    return value


def harmonic(name: str, order: float) -> Function:
    """cos or sin of a multiple of a position; name: "c" or "s"; order: [1/rad or rad/m]."""
    def value(position: Any) -> Any:
        of = ca if isinstance(position, (ca.SX, ca.MX, ca.DM)) else np
        return (of.cos if name == "c" else of.sin)(order * position)
    return value


def without(function: Function, imitated: Sequence[Function], lower: float, upper: float, waves: float = 0.0
            ) -> Function:
    """A function less its projection on others over a travel, so that it is orthogonal to all of them there.

    waves: how many of it pass over the travel.
    """
    nodes, weights = np.polynomial.legendre.leggauss(NODES + int(PER_WAVE * waves))
    positions = 0.5 * (upper - lower) * nodes + 0.5 * (upper + lower)
    design = np.stack([np.broadcast_to(g(positions), positions.shape) for g in imitated], axis=1)
    root = np.sqrt(weights)
    coefficients = np.linalg.lstsq(design * root[:, None], function(positions) * root, rcond=None)[0]
    coefficients = np.where(np.abs(coefficients) < 1e-13, 0.0, coefficients)

    def rest(position: Any) -> Any:
        value = function(position)
        for c, g in zip(coefficients, imitated, strict=True):
            if c:
                value = value - float(c) * g(position)
        return value
    return rest


def error_motion_basis(axis: Axis, component: int, orders: Sequence[int] | None) -> Basis:
    """The functions of an error motion.

    axis; component: 0..5 for X, Y, Z, A, B, C; orders: see `calib.mechanism.errors.error_motion`.
    Taken out: a constant, always (location, zero, mounting); across a linear axis also the slope (its squareness); of a
    radial or tilt motion of a rotary axis also the first harmonic (how what it carries is mounted).
    Raises DeclarationError for orders that would be nothing but what is taken out.
    """
    lowest, imitated = _location(axis, component)
    chosen = tuple(orders) if orders is not None else tuple(range(lowest, 4))
    _refuse_location(axis, chosen, lowest)
    lower, upper = axis.travel
    if axis.is_rotary:
        return _fourier(axis, imitated, {order: float(order) for order in chosen})
    return Basis(tuple(f"p{n}" for n in chosen),
                 tuple(without(legendre(n, lower, upper), imitated, lower, upper) for n in chosen))


def periodic_basis(axis: Axis, component: int, period: float, orders: Sequence[int]) -> Basis:
    """Waves along a linear axis, such as the pitch of a screw, and their harmonics; what is no error motion taken out.

    component: 0..5; period: of the first order [m]; orders: multiples of it.
    Raises DeclarationError for a rotary axis, no order or a period that is not positive.
    """
    if axis.is_rotary or not period > 0 or not orders or min(orders) < 1:
        raise DeclarationError(f"periodic error of axis '{axis.name}': give a linear axis, a positive period in metres "
                               "and orders from 1 upward (a rotary axis repeats itself every turn: `error_motion`).")
    return _fourier(axis, _location(axis, component)[1], {order: 2 * np.pi * order / period for order in orders})


def polynomial_basis(axis: Axis, component: int, orders: Sequence[int]) -> Basis:
    """Polynomials over the limits of a rotary axis that turns less than a full turn.

    component: 0..5; orders: of the Legendre polynomials, from 1 upward along and about the axis, else from 3 upward
    (how what it carries is mounted bends like an arc). Raises DeclarationError for lower ones.
    """
    _, imitated = _location(axis, component)
    _refuse_location(axis, tuple(orders), len(imitated))
    lower, upper = axis.travel
    return Basis(tuple(f"p{n}" for n in orders),
                 tuple(without(legendre(n, lower, upper), imitated, lower, upper) for n in orders))


def _location(axis: Axis, component: int) -> tuple[int, list[Function]]:
    """The lowest order that is an error motion, and the functions that location, zero and mounting can imitate."""
    lower, upper = axis.travel
    own = component % 3 == axis.along
    if axis.is_rotary:
        return (1 if own else 2), [legendre(0, lower, upper)] + ([] if own else [harmonic(n, 1) for n in "cs"])
    lowest = 1 if component >= 3 or own else 2
    return lowest, [legendre(n, lower, upper) for n in range(lowest)]


def _fourier(axis: Axis, imitated: Sequence[Function], frequencies: Mapping[int, float]) -> Basis:
    lower, upper = axis.travel
    names = tuple(f"{n}{order}" for order in frequencies for n in "cs")
    return Basis(names, tuple(without(harmonic(n, w), imitated, lower, upper, w * (upper - lower) / (2 * np.pi))
                              for w in frequencies.values() for n in "cs"))


def _refuse_location(axis: Axis, chosen: Sequence[int], lowest: int) -> None:
    if not chosen or min(chosen) < lowest:
        raise DeclarationError(f"error motion of axis '{axis.name}': order {min(chosen, default=0)} is a location "
                               f"error or a mounting of what the axis carries; give orders from {lowest} upward.")
