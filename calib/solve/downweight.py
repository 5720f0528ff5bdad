"""What a robust loss does to readings, block by block: the error that each may have besides, and the pull that is left.

A wild reading has an error of its own besides the stated ones, so that its variance grows while what it shares with
others stays: least squares with the larger variances is the robust estimate, and a reading of which nothing counts is
left out exactly. The least error besides that a penalty of k times its conditional u allows makes Huber's loss of a
reading that is alone, a penalty for every error besides the truncated square; both hold as they are where readings are
correlated. Sources: She and Owen (2011), Journal of the American Statistical Association 106, 626; Huber (1981),
sections 7.6 to 7.8; Yang, Antonante, Tzoumas, Carlone (2020), IEEE Robotics and Automation Letters 5(2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.blocks import Array, Index, Mixing
from calib.errors import CalibrationError
from calib.solve.loss import L1, Huber
from calib.uncertainty import Gaussian, Weighting

SMALLEST = 1e-8  # weight of a reading that no longer counts; zero would leave a point without any reading
WILD = 3.29  # residual in units of u beyond which one reading in a thousand lies
NEARLY_ZERO = 1e-4  # threshold at which Huber's loss is that of L1 for all that can be seen
LARGEST = 1000  # rows of one block, whose weight matrix is inverted in every step
SWEEPS = 200  # over the readings of a block until their errors besides stand still


@dataclass(frozen=True)
class Truncated:
    """Squares up to a limit and nothing beyond: wild readings are left out, found by graduated non-convexity.

    limit: in units of u.
    """

    limit: float = WILD


RobustLoss = Huber | L1 | Truncated


@dataclass(frozen=True)
class Alike:
    """Blocks of correlated readings of one size: rows (m, k), covariance and weight matrix (m, s, s), s = k dim."""

    rows: Index
    covariance: Array
    weight: Array

    @staticmethod
    def of(weighting: Weighting, name: str) -> tuple[Alike, ...]:
        """The blocks of a group; name: of it, for the message where they are too large."""
        found = []
        largest = max(factor.rows.shape[1] for factor in weighting.factors)
        if largest > LARGEST:
            raise CalibrationError(f"{name}: {largest} readings are correlated with one another, and a robust loss "
                                   f"weighs each given all others, which is done for up to {LARGEST}; state shorter "
                                   "chains, or solve by least squares and look at the w-tests")
        for factor in weighting.factors:
            root = np.einsum("md,de->mde", factor.matrix, np.eye(factor.matrix.shape[1])) \
                if factor.matrix.ndim == 2 else factor.matrix
            covariance = root @ root.transpose(0, 2, 1)
            found.append(Alike(factor.rows, covariance, np.linalg.inv(covariance)))
        return tuple(found)

    def gather(self, values: Array) -> Array:
        """Values (n, dim) as (m, s)."""
        return values[self.rows].reshape(len(self.rows), -1)

    def scatter(self, into: Array, values: Array) -> None:
        """Put (m, s) back to (n, dim)."""
        into[self.rows] = values.reshape(*self.rows.shape, into.shape[1])

    def errors(self, loss: RobustLoss, residual: Array, added: Array, convexity: float) -> tuple[Array, Array]:
        """Variance (m, s) of the error that each reading has besides, and its weight (m, s), at residuals (m, s).

        added: the same variance before, from which the search goes on; convexity: of graduated non-convexity.
        """
        if isinstance(loss, Truncated):
            return self._graduated(loss.limit, residual, added, convexity)
        return self._bounded(_threshold(loss), residual)

    def _bounded(self, threshold: float, residual: Array) -> tuple[Array, Array]:
        """The least errors besides with which no reading pulls by more than a threshold of its conditional u."""
        own = np.sqrt(np.einsum("mss->ms", self.weight))
        most = threshold * own
        error = np.zeros_like(residual)
        pull = np.einsum("mst,mt->ms", self.weight, residual)
        for _ in range(SWEEPS):
            before = error.copy()
            for i in range(residual.shape[1]):
                wanted = pull[:, i] / own[:, i] ** 2 + error[:, i]
                shrunk = np.sign(wanted) * np.maximum(np.abs(wanted) - most[:, i] / own[:, i] ** 2, 0.0)
                pull -= self.weight[:, :, i] * (shrunk - error[:, i])[:, None]
                error[:, i] = shrunk
            if float(np.max(np.abs(error - before) * own, initial=0.0)) < 1e-12 or residual.shape[1] == 1:
                break
        added = np.abs(error) / most
        return added, _kept(self._inflated(added), added)

    def _graduated(self, limit: float, residual: Array, added: Array, convexity: float) -> tuple[Array, Array]:
        """Each reading weighed by its residual given all others of its block, in units of its own u there."""
        added, weights = added.copy(), np.ones_like(added)
        inflated = self._inflated(added)
        for i in range(residual.shape[1]):
            pull, own = np.einsum("mt,mt->m", inflated[:, i], residual), inflated[:, i, i]
            alone = 1.0 - added[:, i] * own       # what is left of the weight of the reading beside its error besides
            squared = pull**2 / (own * alone)
            weights[:, i] = _weight(limit, squared, convexity)
            fresh = (1.0 / weights[:, i] - 1.0) * alone / own
            change = (fresh - added[:, i]) / (1.0 + (fresh - added[:, i]) * own)
            inflated = inflated - change[:, None, None] * inflated[:, :, i : i + 1] * inflated[:, i : i + 1, :]
            added[:, i] = fresh
        return added, weights

    def _inflated(self, added: Array) -> Array:
        """Weight matrices (m, s, s) with variances (m, s) besides."""
        if self.covariance.shape[1] == 1:
            return 1.0 / (self.covariance + added[:, :, None])
        return np.linalg.inv(self.covariance + added[:, :, None] * np.eye(added.shape[1]))

    def loss(self, loss: RobustLoss, residual: Array, added: Array, weights: Array) -> float:
        """The loss at residuals (m, s), with the variances besides that belong to them."""
        own = np.sqrt(np.einsum("mss->ms", self.weight))
        if isinstance(loss, L1):
            return float(np.sum(own * np.abs(residual)))
        if isinstance(loss, Truncated):
            added = np.where(weights < 0.5, np.einsum("mss->ms", self.covariance) / SMALLEST, 0.0)
        pull = np.einsum("mst,mt->ms", self._inflated(added), residual)
        left = residual - added * pull
        squares = 0.5 * float(np.einsum("ms,mst,mt->", left, self.weight, left))
        if isinstance(loss, Truncated):
            return squares + 0.5 * loss.limit**2 * int(np.sum(weights < 0.5))
        return squares + loss.threshold * float(np.sum(own * added * np.abs(pull)))

    def largest(self, residual: Array) -> float:
        """The largest residual given the others of its block, in units of its u there."""
        pull = np.einsum("mst,mt->ms", self.weight, residual)
        return float(np.max(np.abs(pull) / np.sqrt(np.einsum("mss->ms", self.weight)), initial=0.0))

    def pulls(self, loss: RobustLoss, residual: Array, weights: Array) -> tuple[Mixing, Mixing]:
        """Row operations whose products with their transposes are the slope of the pull of each block, and its mean
        square, for Gaussian errors as stated of all readings that are not wild."""
        own = np.sqrt(np.einsum("mss->ms", self.weight))
        diagonal = np.einsum("mss->ms", self.covariance)
        eye = np.eye(residual.shape[1])
        if isinstance(loss, L1):
            inside = np.abs(residual) <= WILD * np.sqrt(diagonal)
            slope = (np.sqrt(2.0 / np.pi) * own / np.sqrt(diagonal) * inside)[:, :, None] * eye
            correlation = self.covariance / np.sqrt(diagonal[:, :, None] * diagonal[:, None, :])
            # The arcsine law: the mean product of the signs of two correlated normal numbers.
            signs = 2.0 / np.pi * np.arcsin(np.clip(correlation, -1.0, 1.0))
            return Mixing(self.rows, _rooted(slope)), Mixing(self.rows, _rooted(own[:, :, None] * signs
                                                                                * own[:, None, :]))
        limit = loss.threshold if isinstance(loss, Huber) else loss.limit
        outside = weights < wild_below(loss)
        within = math.erf(limit / math.sqrt(2.0))
        square = within - 2.0 * limit * math.exp(-0.5 * limit**2) / math.sqrt(2.0 * math.pi)
        both = ~outside[:, :, None] & ~outside[:, None, :]
        rest = np.linalg.inv(np.where(both, self.covariance, diagonal[:, :, None] * eye)) * both
        if isinstance(loss, Truncated):
            rooted = _rooted(square / within * rest)
            return Mixing(self.rows, rooted), Mixing(self.rows, rooted)
        # What is wild pulls by its limit, whatever the others do, and they lean on it where they are correlated. The
        # others count by what is expected of them: residuals of few readings seldom show how many errors are bounded.
        lean = outside[:, :, None] * eye - rest @ (self.covariance * outside[:, None, :])
        bounded = lean * (limit * own)[:, None, :]
        mean = (square + limit**2 * (1.0 - within)) * rest + bounded @ bounded.transpose(0, 2, 1)
        return Mixing(self.rows, _rooted(within * rest)), Mixing(self.rows, _rooted(mean))


def gaussian(blocks: tuple[Alike, ...], added: Array) -> Gaussian:
    """The uncertainty of a group with variances (n, dim) besides."""
    if all(block.covariance.shape[1] == added.shape[1] for block in blocks):
        whole = np.empty((len(added), added.shape[1], added.shape[1]))
        for block in blocks:
            whole[block.rows[:, 0]] = block.covariance
        diagonal = np.einsum("nss->ns", whole)
        if np.count_nonzero(whole) == np.count_nonzero(diagonal):
            return Gaussian.standard(np.sqrt(diagonal + added))
        return Gaussian.matrix(whole + added[:, :, None] * np.eye(added.shape[1]))
    index = np.empty(len(added), dtype=np.int64)
    matrices: dict[object, Array] = {}
    for block in blocks:
        for rows, covariance in zip(block.rows, block.covariance, strict=True):
            order = np.argsort(rows)      # a group of rows is stated in the order of the rows
            places = (order[:, None] * added.shape[1] + np.arange(added.shape[1])).ravel()
            index[rows] = len(matrices)
            matrices[len(matrices)] = covariance[np.ix_(places, places)] + np.diag(added[rows[order]].ravel())
    return Gaussian.groups(index, matrices)


def _threshold(loss: Huber | L1) -> float:
    return loss.threshold if isinstance(loss, Huber) else NEARLY_ZERO


def _kept(inflated: Array, added: Array) -> Array:
    """Part (m, s) of its weight, given all others, with which each reading still pulls."""
    return 1.0 - added * np.einsum("mss->ms", inflated)


def _weight(limit: float, squared: Array, convexity: float) -> Array:
    upper, lower = (convexity + 1) / convexity * limit**2, convexity / (convexity + 1) * limit**2
    between = limit * np.sqrt(convexity * (convexity + 1)) / np.sqrt(np.maximum(squared, 1e-24)) - convexity
    return np.clip(np.where(squared >= upper, 0.0, np.where(squared <= lower, 1.0, between)), SMALLEST, 1.0)


def _rooted(matrices: Array) -> Array:
    """K (m, s, s) with K'K each of some symmetric matrices without negative eigenvalues."""
    values, axes = np.linalg.eigh(matrices)
    return np.sqrt(np.maximum(values, 0.0))[:, :, None] * axes.transpose(0, 2, 1)


def wild_below(loss: RobustLoss) -> float:
    """Weight below which a reading lies beyond one in a thousand of good ones, or is left out."""
    return 0.5 if isinstance(loss, Truncated) else min(_threshold(loss) / WILD, 1.0 - 1e-9)
