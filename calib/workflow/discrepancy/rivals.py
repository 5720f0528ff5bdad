"""Kinds of noise as rivals: how well each accounts for what a model leaves, on one scale with what a model costs.

The scale is twice the negative logarithm of the likelihood with the price of a Schwarz criterion: the logarithm of
the degrees of freedom for each parameter, and twice the logarithm of the number of choices for each choice among many.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib.analyse.score import Field
from calib.blocks import Array
from calib.workflow.discrepancy.noise import lagged
from calib.workflow.discrepancy.readings import Channel

STATED, SCALED, UNEVEN, HEAVY, SERIAL = "as stated", "of another size", "uneven", "heavy-tailed", "serial"
SHAPES = (2.2, 3.0, 4.0, 6.0, 10.0)  # degrees of freedom of t-distributions that are tried
CORRELATIONS = np.concatenate([np.linspace(-0.7, 0.9, 17), [0.95, 0.98]])
SMALLEST = 4.0  # redundancy of the smallest group of rows whose scatter is estimated
BOUND = 0.05  # smallest variance that an estimate may take


@dataclass(frozen=True)
class Noise:
    """One account of the noise: kind, score (smaller is better), scale of every row (n,), serial correlation, where."""

    kind: str
    score: float
    rows: Array
    correlation: float = 0.0
    where: str = "all readings"


def accounts(left: Field, channels: Sequence[Channel]) -> list[Noise]:
    """Every kind of noise with its score, best first.

    left: the field after a model is taken; channels: of its rows.
    """
    n, dof = len(left.residual), max(left.dof, 1)
    price = np.log(dof)
    found = [Noise(STATED, left.squares, np.ones(n))]
    variance = max(left.squares / dof, BOUND)
    found.append(Noise(SCALED, dof * np.log(variance) + left.squares / variance + price,
                       np.full(n, np.sqrt(variance))))
    if dof >= 8:
        found += [*_uneven(left, channels, dof), _heavy(left, dof, price), _serial(left, channels, dof, price)]
    return sorted(found, key=lambda one: one.score)


def _uneven(left: Field, channels: Sequence[Channel], dof: int) -> Iterator[Noise]:
    """Another variance for each part of the readings: by channel, by what was recorded, by both."""
    parts = list(_partitions(channels, len(left.residual)))
    for name, keys in parts:
        rows = np.ones(len(left.residual))
        score, count = 0.0, 0
        for key in np.unique(keys[keys >= 0]):
            places = np.flatnonzero(keys == key)
            seen = float(np.sum(left.redundancy[places]))
            squares = float(np.sum(left.residual[places] ** 2))
            if seen < SMALLEST:
                score += squares
                continue
            variance = max(squares / seen, BOUND)
            rows[places] = np.sqrt(variance)
            score += seen * np.log(variance) + squares / variance
            count += 1
        outside = keys < 0
        score += float(np.sum(left.residual[outside] ** 2)) + count * np.log(dof) + 2 * np.log(len(parts))
        if count > 1:
            yield Noise(UNEVEN, score, rows, where=name)


def _partitions(channels: Sequence[Channel], n: int) -> Iterator[tuple[str, Array]]:
    by_channel = np.full(n, -1)
    for i, channel in enumerate(channels):
        by_channel[channel.places] = i
    if len(channels) > 1:
        yield "channels", by_channel
    for name in dict.fromkeys(name for channel in channels for name in channel.covariates):
        keys = np.full(n, -1)
        for channel in channels:
            values = channel.covariates.get(name)
            if values is None:
                continue
            different = np.unique(values)
            if len(different) <= 6:
                keys[channel.places] = np.searchsorted(different, values)
            elif values.dtype.kind in "fiu":
                keys[channel.places] = values > np.median(values)
        if len(np.unique(keys[keys >= 0])) > 1:
            yield name, keys
            if len(channels) > 1:
                yield f"channels and {name}", np.where(keys >= 0, keys * len(channels) + by_channel, -1)


def _heavy(left: Field, dof: int, price: float) -> Noise:
    """Student's t of free size and shape."""
    from scipy.special import gammaln

    seen = left.redundancy > 0.02
    standard = left.residual[seen] / np.sqrt(left.redundancy[seen])
    weight = dof / max(len(standard), 1)
    best: tuple[float, float, float] = (np.inf, 1.0, 1.0)
    for shape in SHAPES:
        size = max(float(np.median(np.abs(standard))) / 0.75, 0.05)
        for _ in range(12):  # expectation and maximisation of the size
            size = np.sqrt(np.mean((shape + 1) * standard**2 / (shape + (standard / size) ** 2)))
            size = max(size, 0.05)
        constant = gammaln((shape + 1) / 2) - gammaln(shape / 2) - 0.5 * np.log(shape * np.pi) - np.log(size)
        logs = constant - (shape + 1) / 2 * np.log1p((standard / size) ** 2 / shape)
        score = -2 * weight * float(np.sum(logs + 0.5 * np.log(2 * np.pi)))
        best = min(best, (score, shape, size))
    score, shape, size = best
    rows = np.ones(len(left.residual))
    rows[seen] = size * np.sqrt((shape + (standard / size) ** 2) / (shape + 1))
    return Noise(HEAVY, score + 2 * price, rows)


def _serial(left: Field, channels: Sequence[Channel], dof: int, price: float) -> Noise:
    """First-order serial correlation of free size within every channel."""
    steps = sum(max(len(c.places) - 1, 0) for c in channels) * dof / len(left.residual)
    quick = [_likelihood(lagged(left.residual[:, None], channels, c)[:, 0], steps, c, dof) for c in CORRELATIONS]
    near = CORRELATIONS[int(np.argmin(quick))]
    best, correlation = min(quick), float(near)
    if abs(near) > 0.15:
        # Residuals of a fit look less correlated than the noise was: judge the fit that knows the correlation.
        for trial in sorted({near, *(min(near + more, 0.97) for more in (0.1, 0.2, 0.3) if near > 0)}):
            basis = np.linalg.qr(lagged(left.basis, channels, trial))[0]
            right = lagged(left.residual[:, None], channels, trial)[:, 0]
            right = right - basis @ (basis.T @ right)
            best, correlation = min((best, correlation), (_likelihood(right, steps, trial, dof), float(trial)))
    where = f"correlation {correlation:.2f} from one to the next"
    return Noise(SERIAL, best + 2 * price, np.ones(len(left.residual)), correlation, where)


def _likelihood(whitened: Array, steps: float, correlation: float, dof: int) -> float:
    squares = float(whitened @ whitened)
    variance = max(squares / dof, BOUND)
    return dof * np.log(variance) + squares / variance + steps * np.log(1 - correlation**2)
