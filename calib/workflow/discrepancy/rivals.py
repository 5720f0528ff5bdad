"""Kinds of noise as rivals: how well each accounts for what a model leaves, on one scale with what a model costs.

The scale is twice the negative logarithm of the likelihood with the price of a Schwarz criterion: the logarithm of
the degrees of freedom for each parameter, and twice the logarithm of the number of choices for each choice among many.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Field
from calib.blocks import Array
from calib.workflow.discrepancy.noise import BARELY, standardised, student
from calib.workflow.discrepancy.readings import Channel, sequences

STATED, SCALED, UNEVEN, HEAVY, SERIAL = "as stated", "of another size", "uneven", "heavy-tailed", "serial"
STEEPNESS = np.array([-1.2, -0.8, -0.4, 0.4, 0.8, 1.2])  # logarithm of the size of noise at the end of a covariate
LASTING = (0.8, 0.9, 0.96, 0.99)  # correlation, from one reading to the next, of something that runs on between them
VARIANCES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # of what runs on, over the stated one
CORRELATIONS = np.concatenate([np.linspace(-0.7, 0.9, 17), [0.95, 0.98]])
SMALLEST = 4.0  # redundancy of the smallest group of rows whose scatter is estimated
LARGE = 3_000_000  # numbers in a basis, from which it is not made again for one more look
BOUND = 0.05  # smallest variance that an estimate may take
NOTHING = 1e-9  # sum of squares that is none, so that exact readings have a logarithm


@dataclass(frozen=True)
class Noise:
    """One account of the noise: kind, score (smaller is better), scale of every row (n,), serial correlation, where,
    and the sequences of places along which it is correlated."""

    kind: str
    score: float
    rows: Array
    correlation: float = 0.0
    where: str = "all readings"
    way: tuple[NDArray[np.int64], ...] = ()


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
        found += [*_uneven(left, channels, dof), _heavy(left), _serial(left, channels, dof, price)]
    return sorted(found, key=lambda one: one.score)


def _uneven(left: Field, channels: Sequence[Channel], dof: int) -> Iterator[Noise]:
    """Another variance in parts of the readings, in some alike or in each, or one that grows along a covariate."""
    from scipy.special import gammaln

    splits, slopes = _different(_partitions(channels, len(left.residual))), list(_slopes(channels, len(left.residual)))
    choice = 2 * np.log(max(len(splits) + len(slopes), 1))
    squared = left.residual**2
    for name, keys in splits:
        codes = np.unique(keys, return_inverse=True)[1]
        seen, squares = np.bincount(codes, left.redundancy), np.bincount(codes, squared)
        enough = (seen >= SMALLEST) & (np.bincount(codes, keys >= 0) > 0)
        variance = np.where(enough, np.maximum(squares / np.maximum(seen, 1e-9), BOUND), 1.0)
        gains = squares - seen * np.log(variance) - squares / variance
        count = int(enough.sum())
        if count > 1:
            score = left.squares - float(gains.sum()) + count * np.log(dof) + choice
            yield Noise(UNEVEN, score, np.sqrt(variance)[codes], where=name)
        for order in (np.argsort(variance), np.argsort(-variance)) if len(seen) > 1 else ():
            # The parts of the smallest or the largest scatter alike, the rest as stated.
            order = order[enough[order]][: len(seen) - 1]
            sizes, sums = np.cumsum(seen[order]), np.cumsum(squares[order])
            common = np.maximum(sums / np.maximum(sizes, 1e-9), BOUND)
            number = np.arange(1, len(order) + 1)
            chosen = 2 * (gammaln(count + 1) - gammaln(number + 1) - gammaln(np.maximum(count - number, 0) + 1))
            scores = left.squares - (sums - sizes * np.log(common) - sums / common) + chosen
            if len(order):
                best = int(np.argmin(scores))
                alone = np.where(np.isin(codes, order[: best + 1]), np.sqrt(common[best]), 1.0)
                label = f"{best + 1} of {len(seen)} parts by {name}"
                yield Noise(UNEVEN, float(scores[best]) + np.log(dof) + choice, alone, where=label)
    for name, scaled in slopes:
        grown = np.exp(2 * np.outer(STEEPNESS, scaled))  # variance: the size grows exponentially along a covariate
        seen, squares = grown**0 @ left.redundancy, (1 / grown) @ squared
        variance = np.maximum(squares / seen, BOUND)
        scores = seen * np.log(variance) + np.log(grown) @ left.redundancy + squares / variance
        best = int(np.argmin(scores))
        rows = np.sqrt(variance[best] * grown[best])
        yield Noise(UNEVEN, float(scores[best]) + 2 * np.log(dof) + choice, rows, where=f"growing along {name}")


def _different(splits: Iterable[tuple[str, Array]]) -> list[tuple[str, Array]]:
    """Splits of the rows without those that split alike under another name."""
    found: dict[bytes, tuple[str, Array]] = {}
    for name, keys in splits:
        _, first, places = np.unique(keys, return_index=True, return_inverse=True)
        found.setdefault((np.argsort(np.argsort(first))[places]).tobytes(), (name, keys))
    return list(found.values())


def _slopes(channels: Sequence[Channel], n: int) -> Iterator[tuple[str, Array]]:
    """Numbers along which the noise may grow, from -1 to 1 over all readings."""
    for name in dict.fromkeys(name for channel in channels for name in channel.covariates):
        values = np.full(n, np.nan)
        for channel in channels:
            if name in channel.covariates and channel.covariates[name].dtype.kind in "fiu":
                values[channel.places] = channel.covariates[name]
        known = np.isfinite(values)
        if len(np.unique(values[known])) > 6:
            middle, half = (values[known].max() + values[known].min()) / 2, np.ptp(values[known]) / 2
            yield name, np.where(known, (values - middle) / half, 0.0)


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


def _heavy(left: Field) -> Noise:
    """Student's t, its likelihood averaged over sizes and shapes: what is not fitted costs nothing."""
    gain, shape, size = student(left)
    rows = np.ones(len(left.residual))
    seen = left.redundancy > BARELY
    standard, _ = standardised(left)
    rows[seen] = size * np.sqrt((shape + (standard / size) ** 2) / (shape + 1))
    return Noise(HEAVY, left.squares - 2 * gain, rows)


def _serial(left: Field, channels: Sequence[Channel], dof: int, price: float) -> Noise:
    """First-order serial correlation of free size along one of the ways in which readings follow each other."""
    ways = list(sequences(channels).values())
    found = [_along(left, way, dof) for way in ways]
    best = int(np.argmin([score for score, _ in found]))
    score, correlation = found[best]
    where = f"correlation {correlation:.2f} from one to the next"
    choice = 2 * np.log(len(ways))
    return Noise(SERIAL, score + 2 * price + choice, np.ones(len(left.residual)), correlation, where, tuple(ways[best]))


def _along(left: Field, way: Sequence[NDArray[np.int64]], dof: int) -> tuple[float, float]:
    """Score and correlation of the serial correlation that goes best with the readings along sequences of places.

    The likelihood is the restricted one, since a fit leaves residuals that hang together by themselves.
    Source: Patterson and Thompson 1971; the inverse covariance is that of a first-order autoregression.
    """
    basis, share = left.basis, 1.0
    if basis.size >= LARGE:  # of so many readings the fit takes a small and even part
        basis, share = basis[:, :0], dof / len(left.residual)
    together = np.column_stack([basis, left.residual])
    squares = np.diag([*np.ones(basis.shape[1]), left.squares + NOTHING])
    later, earlier = (np.concatenate([order[part] for order in way]) for part in (slice(1, None), slice(None, -1)))
    first, last = (alone.T @ alone for alone in (np.delete(together, some, axis=0) for some in (later, earlier)))
    follow = together[later].T @ together[earlier]

    def score(c: float) -> float:
        inside = squares - first - c * (follow + follow.T) + c**2 * (squares - last)
        roots = np.diag(np.linalg.cholesky(first + inside / (1 - c**2)))  # of the unknowns, then of what they leave
        variance = max(float(roots[-1] ** 2) / dof, BOUND)
        determinant = share * len(later) * np.log(1 - c**2) + 2 * np.log(roots[:-1]).sum()
        return float(dof * np.log(variance) + roots[-1] ** 2 / variance + determinant)

    return min((score(c), float(c)) for c in CORRELATIONS)


def running(left: Field, channels: Sequence[Channel]) -> tuple[float, float]:
    """Score of something that runs on from reading to reading beside the stated noise, and its root mean square in u.

    It is what structure of any smooth shape looks like; noise with a memory has no part that is new in every reading.
    The likelihood is the restricted one of V = I + s^2 R with R of an autoregression of first (rough) or second order
    (smooth), whose inverse Q has few diagonals: V^-1 = I - (I + Q/s^2)^-1.
    """
    from scipy.linalg import cho_solve_banded, cholesky_banded

    together = np.column_stack([left.basis, left.residual])
    products, best = together.T @ together, (np.inf, 0.0)
    ways = list(sequences(channels).values())
    ways += [[one] for way in ways if len(way) > 1 for one in way]  # it may be in one channel or target alone
    for way in ways:
        inside = together[np.concatenate(way)]
        since = np.concatenate([np.arange(len(one)) for one in way])  # places since the beginning of a sequence
        for order, c in product((1, 2), LASTING):
            bands, logarithm = _precision(since, order, c)
            for variance in VARIANCES:
                tied = bands / variance
                tied[-1] += 1.0
                factor = cholesky_banded(tied)
                outside = products - inside.T @ cho_solve_banded((factor, False), inside)
                roots = np.diag(np.linalg.cholesky(outside + NOTHING * np.eye(len(outside))))
                determinant = (2 * np.log(factor[-1]).sum() + len(since) * np.log(variance) - logarithm
                               + 2 * np.log(roots[:-1]).sum())
                best = min(best, (float(roots[-1] ** 2 + determinant), float(np.sqrt(variance))))
    return best[0] + 2 * float(np.log(max(left.dof, 1)) + np.log(len(ways))), best[1]


def _precision(since: NDArray[np.int64], order: int, c: float) -> tuple[Array, float]:
    """Upper diagonals (order + 1, n) and logarithm of the determinant of the inverse of R, the correlations of
    (1 - cL)^order x = e along sequences; since (n,): places since the beginning of each."""
    if order == 1:
        steps, new = [[1.0, -c, 0.0], [1.0, -c, 0.0]], [1 - c**2, 1 - c**2]
    else:
        steps = [[1.0, -2 * c / (1 + c**2), 0.0], [1.0, -2 * c, c**2]]
        new = [((1 - c**2) / (1 + c**2)) ** 2, (1 - c**2) ** 3 / (1 + c**2)]
    rows = (np.array([[1.0, 0.0, 0.0], *steps]) / np.sqrt([1.0, *new])[:, None])[np.minimum(since, 2)]
    logarithm = 2 * float(np.log(rows[:, 0]).sum())
    ahead = np.concatenate([rows, np.zeros((2, 3))])  # what comes after the last place
    bands = np.zeros((3, len(rows)))
    bands[2] = ahead[:-2, 0] ** 2 + ahead[1:-1, 1] ** 2 + ahead[2:, 2] ** 2
    bands[1, 1:] = (ahead[1:-1, 0] * ahead[1:-1, 1] + ahead[2:, 1] * ahead[2:, 2])[:-1]
    bands[0, 2:] = (ahead[2:, 0] * ahead[2:, 2])[:-2]
    return bands[2 - order:], logarithm
