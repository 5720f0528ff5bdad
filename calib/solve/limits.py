"""Which bounds and inequalities hold with equality, as active sets that methods hand from step to step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array
from calib.layout import Layout
from calib.system import Values
from calib.unknown import Unknown

Side = NDArray[np.int8]  # -1 where the lower limit holds, +1 where the upper, 0 where none
WRONG = 1e-9  # how hard, in units of u, a limit must pull its way before it is let go


def touched(value: Array, low: Array, high: Array, push: Array) -> Side:
    """Limits that an interior point has come to rest at.

    value, low, high: (m,); push: (m,) multipliers, positive against the upper limit. The point stops short of a limit
    by the barrier over its multiplier, so that the smaller of the two tells.
    """
    at_low = (value - low < -push) & (low < high)
    at_high = (high - value < push) & (low < high)
    return at_high.astype(np.int8) - at_low.astype(np.int8)


def revised(side: Side, value: Array, low: Array, high: Array, push: Array) -> Side:
    """An active set after a full step within it: limits that were crossed join, limits that pull are let go."""
    wrong = ((side < 0) & (push > WRONG)) | ((side > 0) & (push < -WRONG))
    crossed = (value > high).astype(np.int8) - (value < low).astype(np.int8)
    return np.where(side != 0, np.where(wrong, 0, side), np.where(low < high, crossed, 0)).astype(np.int8)


def pinned(low: Array, high: Array, side: Side) -> tuple[Array, Array]:
    """Limits that leave no room where they hold, and their room elsewhere."""
    return np.where(side > 0, high, low), np.where(side < 0, low, high)


def only_pinned(low: Array, high: Array, side: Side) -> tuple[Array, Array]:
    """Limits that leave no room where they hold or are equal, and all room elsewhere."""
    least, most = pinned(low, high, side)
    return np.where(least == most, least, -np.inf), np.where(least == most, most, np.inf)


def set_to_bounds(layout: Layout, values: Values, side: Side) -> dict[Unknown, Array]:
    """Stored values with the free columns (p,) that are at a bound put exactly there, and none beyond."""
    whole = np.zeros(layout.size, dtype=np.int8)
    whole[layout.free_columns] = side
    free, exact = layout.free, dict(values)
    for unknown in layout.unknowns:
        if unknown.kind == "vector":
            shape = (unknown.count, unknown.freedom)
            held = ~free[layout.span(unknown)].reshape(shape)
            at = whole[layout.span(unknown)].reshape(shape)
            inside = np.where(held, values[unknown], np.clip(values[unknown], unknown.lower, unknown.upper))
            exact[unknown] = np.where(at < 0, unknown.lower, np.where(at > 0, unknown.upper, inside))
    return exact
