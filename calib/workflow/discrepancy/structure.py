"""Descriptions of structure that no effect explains: harmonics of angles, smooth functions, levels of what has few
values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array
from calib.workflow.discrepancy.readings import Channel

HARMONICS = (1, 2, 3, 4, 5, 6)
DEGREES = 5  # of the polynomials over one covariate
FEW = 12  # different values up to which a covariate is taken level by level
SPLIT_BY = 6  # different keys up to which a channel is also looked at key by key


@dataclass(frozen=True)
class Pattern:
    """One description: channel, covariate and what of it; columns (n, k) over all whitened rows."""

    channel: str
    covariate: str
    kind: str
    columns: Array


def patterns(channels: Sequence[Channel], n: int) -> list[Pattern]:
    """All descriptions of structure that the recorded covariates allow, for n whitened rows."""
    found: list[Pattern] = []
    for channel in channels:
        for name, inside in _parts(channel):
            for covariate, values in channel.covariates.items():
                found += [
                    Pattern(name, covariate, kind, _place(columns, channel.places[inside], n))
                    for kind, columns in _shapes(values[inside], channel.units.get(covariate, "1"))
                ]
    return found


def _parts(channel: Channel) -> Iterator[tuple[str, NDArray]]:
    """The whole channel, and its readings key by key where a text covariate has a few keys."""
    yield channel.name, np.arange(len(channel.places))
    for covariate, values in channel.covariates.items():
        if values.dtype.kind not in "fiub":
            keys = list(dict.fromkeys(values.tolist()))
            if 1 < len(keys) <= SPLIT_BY:
                for key in keys:
                    yield f"{channel.name}, {covariate} {key}", np.flatnonzero(values == key)


def _shapes(values: NDArray, unit: str) -> Iterator[tuple[str, Array]]:
    if values.dtype.kind not in "fiub":
        different = list(dict.fromkeys(values.tolist()))
        if 1 < len(different) <= FEW:
            yield "level", np.stack([values == v for v in different], axis=1).astype(float)
        return
    numbers = values.astype(float)
    levels = np.unique(numbers)
    if len(levels) < 2:
        return
    if unit in ("rad", "deg"):
        for order in HARMONICS:
            if len(levels) > 2 * order:
                yield f"harmonic {order}", np.stack([np.cos(order * numbers), np.sin(order * numbers)], axis=1)
    if len(levels) <= FEW:
        yield "level", (numbers[:, None] == levels).astype(float)
        return
    scaled = 2 * (numbers - levels[0]) / (levels[-1] - levels[0]) - 1
    yield "smooth", np.polynomial.legendre.legvander(scaled, DEGREES)[:, 1:]
    yield "trend", scaled[:, None]
    yield "curve", (scaled**2)[:, None]
    edges = np.linspace(levels[0], levels[-1], 9)[1:-1]
    yield "pieces", (np.digitize(numbers, edges)[:, None] == np.arange(8)).astype(float)


def _place(columns: Array, places: NDArray, n: int) -> Array:
    whole = np.zeros((n, columns.shape[1]))
    whole[places] = columns
    return whole
