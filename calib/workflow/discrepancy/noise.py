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
    runs = [c.places[c.order] for c in channels if len(c.places) >= 4]
    if len(runs) > 1:
        tests.append(_judge("serial correlation", "all channels", _pooled(runs), standard, drawn))
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


def _pooled(runs: Sequence[NDArray[np.int64]]) -> Callable[[Array], Array]:
    def figure(v: Array) -> Array:
        return sum(np.sum(v[run[1:]] * v[run[:-1]], axis=0) for run in runs) / np.sum(v**2, axis=0)

    return figure


def _slope(column: Array) -> Callable[[Array], Array]:
    """How the size of the residuals runs along a centred column, over their mean size.

    The cube root of a square is nearly normal, so that a few rows and many are judged alike and one blunder is no
    uneven size (Wilson and Hilferty 1931).
    """
    centred = (column - column.mean()) / max(float(np.std(column)), 1e-12)

    def figure(v: Array) -> Array:
        sizes = np.cbrt(v**2)
        return centred @ sizes / (np.mean(sizes, axis=0) * np.sqrt(len(centred)))

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
