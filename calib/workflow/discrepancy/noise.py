"""Is the noise what was stated: its size, its size here and there, its tails, its independence from reading to
reading."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Field
from calib.blocks import Array
from calib.workflow.discrepancy.looks import effective_looks
from calib.workflow.discrepancy.readings import Channel, sequences

DRAWS = 200  # simulated residuals from which mean and spread of every figure are taken
_SERIAL = "serial correlation"
FEW = 12  # different values up to which a covariate is taken part by part
FEWEST = 8  # readings from which their tails and their memory can be judged
BARELY = 0.02  # redundancy below which a residual shows nothing of its reading
SHAPES = np.array([2.5, 3.0, 4.0, 6.0])  # degrees of freedom of Student's t, from violent to mild
SIZES = np.exp(np.linspace(-1.2, 1.6, 12))  # of its scale over the stated standard uncertainty


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


def tail_test(field: Field) -> NoiseTest:
    """Likelihood of Student's t, averaged over sizes and shapes, against the stated normal one.

    Under the stated noise such a ratio exceeds 1/p with a probability of p at most (Markov; Ville 1939), and with a
    much smaller one where many readings make it nearly certain: 1/(n p) for 30 to 300 simulated readings, of which
    twice is taken.
    """
    if field.dof < FEWEST:
        return NoiseTest("heavy tails", "all readings", 0.0, 1.0)
    gain = student(field)[0]
    return NoiseTest("heavy tails", "all readings", gain, float(min(1.0, 2 / field.dof * np.exp(-gain))))


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


def noise_tests(
    field: Field, channels: Sequence[Channel], scale: float, seed: int
) -> tuple[list[NoiseTest], dict[str, float]]:
    """Looks at uneven size and serial correlation of what is left, and how many independent looks each of the two is.

    field: residuals after everything found is taken; scale: variance of the noise; seed: of the simulated residuals
    that each look is judged against.
    """
    simulated = field.draw(seed, DRAWS)
    together = np.concatenate([(field.residual / np.sqrt(scale))[:, None], simulated], axis=1)
    together /= np.sqrt(np.where(field.redundancy > 1e-6, field.redundancy, np.inf))[:, None]
    names, figures = [], []
    for what, where, values in _looks(together, channels):
        names.append((what, where))
        figures.append(values)
    if not figures:
        return [], {}
    every = np.concatenate(figures)
    drawn = every[:, 1:]
    from scipy.special import erfc

    z = np.abs(every - drawn.mean(axis=1, keepdims=True)) / np.maximum(drawn.std(axis=1, keepdims=True), 1e-12)
    p = erfc(z / np.sqrt(2))
    tests = [NoiseTest(*name, float(figure), float(one)) for name, figure, one in
             zip(names, every[:, 0], p[:, 0], strict=True)]
    looks = {}
    for what in dict.fromkeys(what for what, _ in names):
        of = [i for i, (kind, _) in enumerate(names) if kind == what]
        looks[what] = effective_looks(p[of, 1:].min(axis=0), len(of))
    return tests, looks


def _looks(standard: Array, channels: Sequence[Channel]) -> Iterator[tuple[str, str, Array]]:
    """What is looked at, where, and its figure (1, draws) for each column of standardised residuals."""
    # The cube root of a square is nearly normal, so that a few rows and many are judged alike and one blunder is no
    # uneven size (Wilson and Hilferty 1931).
    sizes, squares = np.cbrt(standard**2), standard**2
    ways = sequences(channels)
    for way, label in zip(ways, ("channels", "groups"), strict=False):
        pairs = [(order, np.sum(standard[order[1:]] * standard[order[:-1]], axis=0)) for order in way if len(order) > 3]
        for k, (order, product) in enumerate(pairs):
            if len(order) >= FEWEST and len(pairs) == len(channels) and label == "channels":
                yield _SERIAL, channels[k].name, (product / np.maximum(np.sum(squares[order], axis=0), 1e-300))[None]
        if len(pairs) > 1 or label == "groups":
            total = sum(np.sum(squares[order], axis=0) for order, _ in pairs)
            yield _SERIAL, f"all {label}", (sum(product for _, product in pairs) / np.maximum(total, 1e-300))[None]
    for channel in channels:
        own = sizes[channel.places]
        mean = np.maximum(own.mean(axis=0, keepdims=True), 1e-300)
        for name, column in _uneven(channel):
            centred = (column - column.mean()) / max(float(np.std(column)), 1e-12)
            yield "uneven size", f"{channel.name}, {name}", centred[None, :] @ own / mean
    if len(channels) > 1:
        whole = sizes.sum(axis=0, keepdims=True)
        for channel in channels:
            own = sizes[channel.places].sum(axis=0, keepdims=True)
            yield "uneven size", channel.name, own / np.maximum(whole, 1e-300)


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
