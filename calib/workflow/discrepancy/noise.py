"""Is the noise what was stated: its size, its size here and there, its tails, its independence from reading to
reading."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Field
from calib.blocks import Array
from calib.workflow.discrepancy.readings import Channel

DRAWS = 300  # simulated residuals from which mean and spread of every figure are taken
FEW = 12


@dataclass(frozen=True)
class NoiseTest:
    """One look at the noise: what, where, the figure, and its two-sided p-value, uncorrected."""

    what: str
    where: str
    figure: float
    p_value: float


def size_test(field: Field) -> NoiseTest:
    """Global test: v'Pv against its degrees of freedom, both tails."""
    from scipy.special import gammainc, gammaincc

    if field.dof < 1:
        return NoiseTest("size", "all readings", 1.0, 1.0)
    upper, lower = gammaincc(field.dof / 2, field.squares / 2), gammainc(field.dof / 2, field.squares / 2)
    return NoiseTest(
        "size", "all readings", float(np.sqrt(field.squares / field.dof)), float(min(1.0, 2 * min(upper, lower)))
    )


def noise_tests(field: Field, channels: Sequence[Channel], scale: float, seed: int) -> list[NoiseTest]:
    """Looks at uneven size, heavy tails and serial correlation of what is left, each against simulated residuals.

    field: residuals after everything found is taken; scale: variance of the noise; seed: of the simulation.
    """
    simulated = field.draw(np.random.default_rng(seed), DRAWS)
    observed = field.residual / np.sqrt(scale)
    redundancy = np.where(field.redundancy > 1e-6, field.redundancy, np.inf)
    standard, drawn = observed / np.sqrt(redundancy), simulated / np.sqrt(redundancy)[:, None]
    tests = [_judge("heavy tails", "all readings", _kurtosis, standard, drawn)]
    for channel in channels:
        order = channel.places[channel.order]
        if len(order) >= 8:
            tests.append(_judge("serial correlation", channel.name, _lag_one, standard[order], drawn[order]))
        for name, columns in _uneven(channel):
            tests.append(
                _judge(
                    "uneven size",
                    f"{channel.name}, {name}",
                    _slope(columns),
                    standard[channel.places],
                    drawn[channel.places],
                )
            )
    if len(channels) > 1:
        whole = np.concatenate([c.places for c in channels])
        of = np.concatenate([np.full(len(c.places), float(i)) for i, c in enumerate(channels)])
        for i, channel in enumerate(channels):
            tests.append(
                _judge("uneven size", channel.name, _slope((of == i).astype(float)), standard[whole], drawn[whole])
            )
    return tests


def _judge(what: str, where: str, figure: Callable[[Array], Array], observed: Array, drawn: Array) -> NoiseTest:
    from scipy.special import erfc

    value, sample = float(figure(observed[:, None])[0]), figure(drawn)
    z = (value - sample.mean()) / max(float(sample.std()), 1e-12)
    return NoiseTest(what, where, value, float(erfc(abs(z) / np.sqrt(2))))


def _kurtosis(v: Array) -> Array:
    """Logarithm of the fourth moment over the squared second one: nearly normal under normal noise."""
    return np.log(np.mean(v**4, axis=0) / np.mean(v**2, axis=0) ** 2)


def _lag_one(v: Array) -> Array:
    return np.sum(v[1:] * v[:-1], axis=0) / np.sum(v**2, axis=0)


def _slope(column: Array) -> Callable[[Array], Array]:
    """Share of the squared residuals along a centred column, normalised by their mean."""
    centred = (column - column.mean()) / max(float(np.std(column)), 1e-12)

    def figure(v: Array) -> Array:
        squares = np.minimum(v**2, 9.0)  # a single blunder is no uneven size
        return centred @ squares / (np.mean(squares, axis=0) * np.sqrt(len(centred)))

    return figure


def _uneven(channel: Channel) -> list[tuple[str, Array]]:
    found = []
    for covariate, values in channel.covariates.items():
        different = list(dict.fromkeys(values.tolist()))
        if len(different) < 2:
            continue
        if len(different) <= FEW:
            found += [
                (f"{covariate} {v}", (values == v).astype(float))
                for v in different
                if 4 <= np.sum(values == v) < len(values)
            ]
        elif values.dtype.kind in "fiu":
            numbers = values.astype(float)
            found += [(covariate, numbers), (f"{covariate} away from its middle", np.abs(numbers - np.median(numbers)))]
    return found


def lagged(array: Array, channels: Sequence[Channel], correlation: float) -> Array:
    """Rows (n, k) whitened for a first-order serial correlation within every channel."""
    whitened = array.copy()
    for channel in channels:
        order = channel.places[channel.order]
        whitened[order[1:]] = (array[order[1:]] - correlation * array[order[:-1]]) / np.sqrt(1 - correlation**2)
    return whitened


def serial_likelihood(derivatives: Array, residual: Array, channels: Sequence[Channel], correlation: float) -> float:
    """Twice the negative logarithm of the profile likelihood of a serial correlation, the noise level free."""
    rows, right = lagged(derivatives, channels, correlation), lagged(residual[:, None], channels, correlation)[:, 0]
    basis = np.linalg.qr(rows)[0]
    left = right - basis @ (basis.T @ right)
    steps = sum(len(c.places) - 1 for c in channels)
    return len(residual) * float(np.log(left @ left / len(residual))) + steps * float(np.log(1 - correlation**2))


def best_correlation(derivatives: Array, residual: Array, channels: Sequence[Channel]) -> tuple[float, float]:
    """Serial correlation of largest likelihood, and twice its negative logarithm."""
    grid = np.linspace(-0.6, 0.96, 14)
    values = [serial_likelihood(derivatives, residual, channels, c) for c in grid]
    best = int(np.argmin(values))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    for _ in range(12):  # golden section
        first, second = high - 0.618 * (high - low), low + 0.618 * (high - low)
        if serial_likelihood(derivatives, residual, channels, first) < serial_likelihood(
            derivatives, residual, channels, second
        ):
            high = second
        else:
            low = first
    middle = 0.5 * (low + high)
    return middle, serial_likelihood(derivatives, residual, channels, middle)


def standardised(field: Field, places: NDArray[np.int64]) -> Array:
    """Residuals over their own standard deviation; 0 where nothing of an error would show."""
    seen = field.redundancy[places] > 1e-6
    return np.where(seen, field.residual[places] / np.sqrt(np.where(seen, field.redundancy[places], 1.0)), 0.0)
