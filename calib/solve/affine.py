"""Affine problems as matrices: whether a problem is affine, and its conditions and bounds on a scaled step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array
from calib.layout import Layout
from calib.observations import Constraint
from calib.solve.limits import Side
from calib.system import System, Term, Values


def not_affine(term: Term[Any], layout: Layout) -> str | None:
    """A sentence naming the arguments of a term whose free part does not enter affinely; None where all does."""
    symbols = term.traced.symbols
    free = [(source.name, feed.unknown, local[np.flatnonzero(layout.free[columns].any(axis=0)).tolist()])
            for source, feed, local, columns, want in
            zip(term.traced.sources, term.feeds, symbols.local, term.columns, term.any_free, strict=True) if want]
    if not free:
        return None
    # held parameters of effects stand at zero: what they multiply is not there
    resting = [(ambient, local) for feed, ambient, local, want in
               zip(term.feeds, symbols.ambient, symbols.local, term.any_free, strict=True)
               if feed.unknown is not None and not want and not np.any(feed.unknown.ambient)]
    prediction = term.traced.prediction
    if resting:
        zero = [s for pair in resting for s in pair]
        prediction = ca.substitute([prediction], zero, [ca.SX.zeros(s.shape) for s in zero])[0]
    bent = ca.which_depends(prediction, ca.vertcat(*[local for *_, local in free]), 2, False)
    names, begin = [], 0
    for name, unknown, local in free:
        if any(bent[begin:begin + local.shape[0]]):
            kind = "" if unknown is None or unknown.kind == "vector" else f", a {unknown.kind}"
            names.append(f"'{name}'" if unknown is None else f"'{name}' (unknown '{unknown.name}'{kind})")
        begin += local.shape[0]
    if not names:
        return None
    return (f"{term.bound.what} '{term.bound.name}': the model {term.bound.model_name} is not affine in "
            f"argument{'s' if len(names) > 1 else ''} {' and '.join(names)}")


@dataclass(frozen=True)
class Limits:
    """Conditions on a scaled step x (p,): fixed x = target and above x <= room.

    names: where to look when they contradict each other; columns, sides: for each inequality the unknown whose bound it
    is and which one, side 0 where it is none.
    """

    fixed: Array
    target: Array
    above: Array
    room: Array
    names: str
    columns: NDArray[np.int64]
    sides: Side

    def side(self, active: Array) -> Side:
        """Which bound each unknown (p,) is at, for the inequalities that hold."""
        at = np.zeros(self.above.shape[1], dtype=np.int8)
        bounds = active & (self.sides != 0)
        at[self.columns[bounds]] = self.sides[bounds]
        return at

    @staticmethod
    def of(system: System, values: Values, scale: Array) -> Limits:
        """Those of a system at stored values, for steps counted in `scale` (p,)."""
        layout, size = system.layout, len(scale)
        fixed, target, above, room = [np.zeros((0, size))], [np.zeros(0)], [np.zeros((0, size))], [np.zeros(0)]
        for term in system.conditions:
            constraint = term.bound
            assert isinstance(constraint, Constraint)
            value, parts = term.derive(values)
            slope = np.zeros((term.n, term.dim, size + 1))
            for part in parts:
                place = layout.position[part.columns]
                for f in range(place.shape[1]):
                    slope[np.arange(term.n), :, place[:, f]] += part.jacobian[:, :, f]
            slope = slope[:, :, :size].reshape(-1, size) * scale
            unit = np.linalg.norm(slope, axis=1)
            unit = np.where(unit > 0, unit, constraint.tolerance)
            low, high = (np.broadcast_to(limit, value.shape).ravel() - value.ravel()
                         for limit in (constraint.lower, constraint.upper))
            equal = low == high
            fixed.append((slope / unit[:, None])[equal])
            target.append((high / unit)[equal])
            for sign, limit in ((1.0, high), (-1.0, -low)):
                there = np.isfinite(limit) & ~equal
                above.append(sign * (slope / unit[:, None])[there])
                room.append((limit / unit)[there])
        columns, sides = [np.zeros(sum(map(len, room)), dtype=np.int64)], [np.zeros(sum(map(len, room)), dtype=np.int8)]
        for sign, limit in zip((-1, 1), layout.bounds(values), strict=True):
            free = limit[layout.free_columns] / scale
            there = np.flatnonzero(np.isfinite(free))
            above.append(sign * np.eye(size)[there])
            room.append(sign * free[there])
            columns.append(there)
            sides.append(np.full(len(there), sign, dtype=np.int8))
        names = ", ".join(f"'{t.bound.name}'" for t in system.conditions)
        return Limits(np.concatenate(fixed), np.concatenate(target), np.concatenate(above), np.concatenate(room),
                      f"look at {names}" if names else "look at the bounds",
                      np.concatenate(columns), np.concatenate(sides))

    def moved(self, x: Array) -> Limits:
        """The same, seen from x."""
        return Limits(self.fixed, self.target - self.fixed @ x, self.above, self.room - self.above @ x, self.names,
                      self.columns, self.sides)


def within(conditions: Array, target: Array) -> tuple[Array, Array]:
    """The smallest step (p,) onto conditions, and a basis (p, q) of the steps within them."""
    if not len(target):
        return np.zeros(conditions.shape[1]), np.eye(conditions.shape[1])
    _, values, right = np.linalg.svd(conditions)
    rank = int(np.sum(values > 1e-12 * max(values[0], 1.0)))
    return np.asarray(np.linalg.lstsq(conditions, target, rcond=None)[0], float), right[rank:].T
