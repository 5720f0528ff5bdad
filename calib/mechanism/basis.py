"""Functions of the position of an axis that describe its error motions and do not imitate its location errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from calib.errors import DeclarationError
from calib.mechanism.axis import Axis

NODES = 64      # Gauss points over the travel: exact for all orders that a person would ask for

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


def harmonic(name: str, order: int) -> Function:
    """cos or sin of a multiple of a position [rad]; name: "c" or "s"."""
    def value(position: Any) -> Any:
        of = ca if isinstance(position, (ca.SX, ca.MX, ca.DM)) else np
        return (of.cos if name == "c" else of.sin)(order * position)
    return value


def without(function: Function, imitated: Sequence[Function], lower: float, upper: float) -> Function:
    """A function less its projection on others over a travel, so that it is orthogonal to all of them there."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
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
    lower, upper = axis.travel
    own = component % 3 == axis.along
    if not axis.is_rotary:
        lowest = 1 if component >= 3 or own else 2
        imitated = [legendre(n, lower, upper) for n in range(lowest)]
        chosen = tuple(orders) if orders is not None else tuple(range(lowest, 4))
        names, functions = [f"p{n}" for n in chosen], [legendre(n, lower, upper) for n in chosen]
    else:
        lowest = 1 if own else 2
        imitated = [legendre(0, lower, upper)] + ([] if own else [harmonic(n, 1) for n in "cs"])
        chosen = tuple(orders) if orders is not None else tuple(range(lowest, 4))
        names = [f"{n}{order}" for order in chosen for n in "cs"]
        functions = [harmonic(n, order) for order in chosen for n in "cs"]
    if not chosen or min(chosen) < lowest:
        raise DeclarationError(f"error motion of axis '{axis.name}': order {min(chosen, default=0)} is a location "
                               f"error or a mounting of what the axis carries; give orders from {lowest} upward.")
    return Basis(tuple(names), tuple(without(f, imitated, lower, upper) for f in functions))
