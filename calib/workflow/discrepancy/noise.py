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
    together = np.concatenate([(field.residual / np.sqrt(scale))[:, None], field.draw(seed, DRAWS)], axis=1)
    families = ((SERIAL, MEMORY, _memory(together, channels)),
                (UNEVEN, EVENNESS / 2, _of_channels(field, together, channels)),
                (UNEVEN, EVENNESS / 2, _along_covariates(field, together, channels)))
    looked = [(what, share, list(looks)) for what, share, looks in families]
    present = SPREAD + sum(share for _, share, looks in looked if looks)
    spread = spread_test(field)
    found = [(spread, spread.p_value * present / SPREAD)]
    for what, share, looks in looked:
        if not looks:
            continue
        p = np.array([own for _, _, own in looks])
        among = effective_looks(p[:, 1:].min(axis=0), len(looks))
        found += [(NoiseTest(what, where, figure, float(own[0])), corrected(float(own[0]), among) * present / share)
                  for where, figure, own in looks]
    return found


def _against_drawn(figures: Array) -> Array:
    """Two-sided p-values of figures that are nearly normal, (1 + draws,), by mean and spread of the drawn ones."""
    from scipy.special import erfc

    drawn = figures[1:]
    return np.asarray(erfc(np.abs(figures - drawn.mean()) / max(float(drawn.std()), 1e-12) / np.sqrt(2)))


def _against_stated(field: Field, places: NDArray[np.int64], squares: Array) -> Array:
    """Two-sided p-values of the sum of squares of some residuals, by the gamma distribution of its mean and variance.

    Of residuals with covariance M these are tr(M) and 2 tr(M^2): the score of a variance component (Rao 1948).
    """
    from scipy.special import gammainc, gammaincc

    taken = field.basis[places]
    inner = taken.T @ taken if taken.shape[1] < len(places) else taken @ taken.T
    mean = len(places) - float(np.trace(inner))
    half = len(places) - 2 * float(np.trace(inner)) + float(np.sum(inner**2))  # of the variance
    shape, size = mean**2 / (2 * half), squares * mean / (2 * half)
    return np.asarray(np.minimum(1.0, 2 * np.minimum(gammainc(shape, size), gammaincc(shape, size))))


Look = tuple[str, float, Array]  # where, the figure, p-values of it and of the drawn ones (1 + draws,)


def _memory(residuals: Array, channels: Sequence[Channel]) -> Iterator[Look]:
    """Where one reading may remember the one before: correlation of successive residuals."""
    squares = residuals**2
    for label, way in sequences(channels).items():
        pairs = [(np.sum(residuals[order[1:]] * residuals[order[:-1]], axis=0), np.sum(squares[order], axis=0))
                 for order in way if len(order) > 3]
        found = [(channel.name, product / np.maximum(total, 1e-300))
                 for channel, (product, total) in zip(channels, pairs, strict=False)
                 if label == "channels" and len(pairs) == len(channels) and len(channel.places) >= FEWEST]
        if len(pairs) > 1 or (pairs and label != "channels"):
            total = np.maximum(sum(t for _, t in pairs), 1e-300)
            found.append((f"all {label}", sum(p for p, _ in pairs) / total))
        yield from ((where, float(figures[0]), _against_drawn(figures)) for where, figures in found)


def _of_channels(field: Field, residuals: Array, channels: Sequence[Channel]) -> Iterator[Look]:
    """Size of the residuals of each channel."""
    yield from (_sized_part(field, residuals, channel.name, channel.places) for channel in channels
                if len(channels) > 1 and field.redundancy[channel.places].sum() > 1)


def _sized_part(field: Field, residuals: Array, where: str, places: NDArray[np.int64]) -> Look:
    squares = np.sum(residuals[places] ** 2, axis=0)
    size = float(np.sqrt(squares[0] / field.redundancy[places].sum()))
    return where, size, _against_stated(field, places, squares)


def _along_covariates(field: Field, residuals: Array, channels: Sequence[Channel]) -> Iterator[Look]:
    """Size of the residuals of each channel for every value of what was recorded beside them, or how it runs along.

    The cube root of a square is nearly normal, so that one blunder is no uneven size (Wilson and Hilferty 1931); each
    counts by what it shows of the noise of its reading.
    """
    seen = field.redundancy[:, None]
    sizes = seen * np.cbrt(residuals**2 / np.where(seen > BARELY, seen, np.inf))
    for channel in channels:
        weights = np.maximum(field.redundancy[channel.places], BARELY)
        own = sizes[channel.places]
        for covariate, values in channel.covariates.items():
            different = list(dict.fromkeys(values.tolist()))
            if 1 < len(different) <= FEW:
                for value in different:
                    places = channel.places[values == value]
                    if len(places) >= 4 and field.redundancy[places].sum() > 1:
                        yield _sized_part(field, residuals, f"{channel.name}, {covariate} {value}", places)
            elif len(different) > FEW and values.dtype.kind in "fiu":
                numbers = values.astype(float)
                away = np.abs(numbers - np.median(numbers))
                for where, column in ((covariate, numbers), (f"{covariate} away from its middle", away)):
                    figures = (column - np.average(column, weights=weights)) @ own / np.maximum(own.sum(axis=0), 1e-300)
                    yield f"{channel.name}, {where}", float(figures[0]), _against_drawn(figures)


def lagged(array: Array, sequences: Sequence[NDArray[np.int64]], correlation: float) -> Array:
    """Rows (n, k) whitened for a first-order serial correlation along each sequence of places."""
    whitened = array.copy()
    for order in sequences:
        whitened[order[1:]] = (array[order[1:]] - correlation * array[order[:-1]]) / np.sqrt(1 - correlation**2)
    return whitened
