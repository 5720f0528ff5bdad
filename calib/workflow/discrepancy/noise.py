"""Is the noise what was stated: its size, its size here and there, its tails, its independence from reading to
reading."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Field
from calib.blocks import Array
from calib.workflow.discrepancy.looks import corrected, effective_looks
from calib.workflow.discrepancy.readings import Channel, sequences

DRAWS = 200  # simulated residuals from which mean and spread of every figure are taken
SERIAL, UNEVEN = "serial correlation", "uneven size"
SPREAD, EVENNESS, MEMORY = 0.5, 0.25, 0.25  # shares of the level: heavy tails are the last to show
FEW = 12  # different values up to which a covariate is taken part by part
FEWEST = 8  # readings from which their tails and their memory can be judged
BARELY = 0.02  # redundancy below which a residual shows nothing of its reading
SHAPES = np.array([2.5, 3.0, 4.0, 6.0])  # degrees of freedom of Student's t, from violent to mild
SIZES = np.exp(np.linspace(-1.6, 1.6, 24))  # of the noise over the stated standard uncertainty
MANY = 100  # degrees of freedom from which on the ratio of likelihoods is as rarely large


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


def upper_tail(field: Field) -> float:
    """Probability of residuals as large as these under the stated noise."""
    from scipy.special import gammaincc

    return float(gammaincc(field.dof / 2, field.squares / 2)) if field.dof else 1.0


def spread_test(field: Field) -> NoiseTest:
    """Likelihood of noise of another size, normal or of Student's t, averaged over sizes and shapes, against the stated
    one; named after the likelier of the two.

    Under the stated noise such a ratio exceeds 1/p with a probability of p at most (Markov; Ville 1939), and of p over
    the degrees of freedom where many readings make it nearly certain: seen in simulated residuals of 1 to 100 degrees
    of freedom; of up to 900, 100 serves.
    """
    if field.dof < 1:
        return NoiseTest("size", "all readings", 1.0, 1.0)
    normal, heavy = _sized(field), student(field)[0] if field.dof >= FEWEST else -np.inf
    p = np.exp(-float(np.logaddexp(normal, heavy) - np.log(2))) / min(field.dof, MANY)
    what = "heavy tails" if heavy > normal else "size"
    return NoiseTest(what, "all readings", float(np.sqrt(field.squares / field.dof)), float(min(1.0, p)))


def _sized(field: Field) -> float:
    """Logarithm of the mean likelihood over sizes of normal noise, even in their logarithm, less that of the stated."""
    from scipy.special import gammaln

    half, squares = field.dof / 2, max(field.squares, 1e-12) / 2
    return float(gammaln(half) - half * np.log(squares) + squares - np.log(2 * np.log(SIZES[-1] / SIZES[0])))


def student(field: Field) -> tuple[float, float, float]:
    """Logarithm of the mean likelihood over a grid of sizes and shapes of Student's t, less that of the stated noise;
    shape and size where it is largest."""
    from scipy.special import gammaln

    standard, weight = standardised(field)
    constant = gammaln((SHAPES + 1) / 2) - gammaln(SHAPES / 2) - 0.5 * np.log(SHAPES / 2)
    inside = np.log1p((standard[None, None, :] / SIZES[:, None, None]) ** 2 / SHAPES[None, :, None]).sum(axis=2)
    logs = len(standard) * (constant - np.log(SIZES)[:, None]) - (SHAPES + 1) / 2 * inside
    logs = weight * logs + field.squares / 2
    size, shape = np.unravel_index(np.argmax(logs), logs.shape)
    top = float(logs[size, shape])
    return top + float(np.log(np.mean(np.exp(logs - top)))), float(SHAPES[shape]), float(SIZES[size])


def standardised(field: Field) -> tuple[Array, float]:
    """Residuals that can be seen, each of unit variance, and how many independent ones each of them is worth."""
    seen = field.redundancy > BARELY
    standard = field.residual[seen] / np.sqrt(field.redundancy[seen])
    return standard, max(field.dof, 1) / max(len(standard), 1)


def noise_tests(field: Field, channels: Sequence[Channel], scale: float, seed: int) -> list[tuple[NoiseTest, float]]:
    """All looks at the noise of what is left, each with its p-value corrected for their number.

    field: residuals after everything found is taken; channels: of its rows; scale: variance of the noise, against which
    its evenness and its memory are judged; seed: of the simulated residuals of the same geometry that each of these
    looks is compared with.
    """
    from scipy.special import erfc

    together = np.concatenate([(field.residual / np.sqrt(scale))[:, None], field.draw(seed, DRAWS)], axis=1)
    families = ((SERIAL, MEMORY, list(_memory(together, channels))),
                (UNEVEN, EVENNESS / 2, list(_of_channels(field, together, channels))),
                (UNEVEN, EVENNESS / 2, list(_along_covariates(field, together, channels))))
    present = SPREAD + sum(share for _, share, looks in families if looks)
    spread = spread_test(field)
    found = [(spread, spread.p_value * present / SPREAD)]
    for what, share, looks in families:
        if not looks:
            continue
        figures = np.array([values for _, values in looks])
        drawn = figures[:, 1:]
        z = np.abs(figures - drawn.mean(axis=1, keepdims=True)) / np.maximum(drawn.std(axis=1, keepdims=True), 1e-12)
        p = erfc(z / np.sqrt(2))
        among = effective_looks(p[:, 1:].min(axis=0), len(looks))
        found += [(NoiseTest(what, where, float(values[0]), float(one)), corrected(float(one), among) * present / share)
                  for (where, values), one in zip(looks, p[:, 0], strict=True)]
    return found


def _memory(residuals: Array, channels: Sequence[Channel]) -> Iterator[tuple[str, Array]]:
    """Where one reading may remember the one before, and the correlation of each column of residuals."""
    squares = residuals**2
    for label, way in sequences(channels).items():
        pairs = [(np.sum(residuals[order[1:]] * residuals[order[:-1]], axis=0), np.sum(squares[order], axis=0))
                 for order in way if len(order) > 3]
        if label == "channels":
            yield from ((channel.name, product / np.maximum(total, 1e-300))
                        for channel, (product, total) in zip(channels, pairs, strict=False)
                        if len(pairs) == len(channels) and len(channel.places) >= FEWEST)
        if len(pairs) > 1 or (pairs and label != "channels"):
            yield f"all {label}", sum(p for p, _ in pairs) / np.maximum(sum(t for _, t in pairs), 1e-300)


def _sizes(field: Field, residuals: Array) -> Array:
    """Size of every residual, weighted by what it shows of the noise of its reading.

    The cube root of a square is nearly normal, so that a few rows and many are judged alike and one blunder is no
    uneven size (Wilson and Hilferty 1931).
    """
    seen = field.redundancy[:, None]
    return seen * np.cbrt(residuals**2 / np.where(seen > BARELY, seen, np.inf))


def _of_channels(field: Field, residuals: Array, channels: Sequence[Channel]) -> Iterator[tuple[str, Array]]:
    """Share of each channel in the size of all residuals."""
    if len(channels) < 2:
        return
    sizes = _sizes(field, residuals)
    whole = np.maximum(sizes.sum(axis=0), 1e-300)
    for channel in channels:
        yield channel.name, sizes[channel.places].sum(axis=0) / whole


def _along_covariates(field: Field, residuals: Array, channels: Sequence[Channel]) -> Iterator[tuple[str, Array]]:
    """How the size of the residuals of each channel goes with what was recorded beside them."""
    sizes = _sizes(field, residuals)
    for channel in channels:
        own, weights = sizes[channel.places], field.redundancy[channel.places]
        mean = np.maximum(own.mean(axis=0), 1e-300)
        for name, column in _uneven(channel):
            centred = column - np.average(column, weights=np.maximum(weights, BARELY))
            yield f"{channel.name}, {name}", centred @ own / mean


def _uneven(channel: Channel) -> Iterator[tuple[str, Array]]:
    """Along what the size of the residuals may run: each part, each covariate, and away from its middle."""
    for covariate, values in channel.covariates.items():
        different = list(dict.fromkeys(values.tolist()))
        if len(different) < 2:
            continue
        if len(different) <= FEW:
            for value in different:
                inside = values == value
                if 4 <= np.sum(inside) < len(values):
                    yield f"{covariate} {value}", inside.astype(float)
        elif values.dtype.kind in "fiu":
            numbers = values.astype(float)
            yield covariate, numbers
            yield f"{covariate} away from its middle", np.abs(numbers - np.median(numbers))


def lagged(array: Array, sequences: Sequence[NDArray[np.int64]], correlation: float) -> Array:
    """Rows (n, k) whitened for a first-order serial correlation along each sequence of places."""
    whitened = array.copy()
    for order in sequences:
        whitened[order[1:]] = (array[order[1:]] - correlation * array[order[:-1]]) / np.sqrt(1 - correlation**2)
    return whitened
