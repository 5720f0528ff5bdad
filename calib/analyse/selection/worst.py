"""Criteria that are the largest of several values: of eigenvalues, of variances, of configurations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.analyse.selection.terms import HIDDEN, OfFunctions, Pieces, Support, flattened, least_of_trace, summed
from calib.blocks import Array

LEADING = 7      # power of the values that says which of them count most for a first look


def mean_of(parts: Sequence[tuple[float, float, Support]]) -> Support:
    """A linear function above the smallest of several exp(-loss): their mean, which that never exceeds.

    parts: share in a change of the loss, loss, and linear function of each.
    """
    top = max(loss for _, loss, _ in parts)
    weights = np.array([share * np.exp(loss - top) for share, loss, _ in parts])
    weights = weights / weights.sum()
    return Support(np.asarray(sum(w * s.gain for w, (_, _, s) in zip(weights, parts, strict=True))),
                   float(sum(w * s.constant for w, (_, _, s) in zip(weights, parts, strict=True))))


class Largest(OfFunctions):
    """E: logarithm of the largest eigenvalue of S."""

    smooth = False

    def __post_init__(self) -> None:
        if len(self.matrix) > self.matrix.shape[1]:
            object.__setattr__(self, "matrix", np.linalg.qr(self.matrix, mode="r"))

    def of_covariance(self, covariance: Array) -> Array:
        return np.log(np.maximum(np.linalg.eigvalsh(covariance)[..., -1], 1e-300))

    def pull(self, inverse: Array) -> Array:
        through = self.matrix @ inverse
        values, vectors = np.linalg.eigh(through @ self.matrix.T)
        through = vectors.T @ through
        return np.asarray(through.T @ (through * (np.maximum(values, 0.0) / values[-1])[:, None] ** LEADING))

    def least(self, dual: Array, mixture: Array | None) -> float:
        # t F'F <= M wherever the largest eigenvalue is 1/t, so tr(M Y) >= t tr(F Y F').
        return float(np.sum((self.matrix @ dual) * self.matrix))


class LargestOf(OfFunctions):
    """G: logarithm of the largest diagonal element of S."""

    smooth = False

    def _loss(self, values: Array, vectors: Array, seen: Array, inverse: Array) -> Array:
        losses = np.empty(len(values))
        size = np.linalg.norm(self.matrix, axis=1)
        for i in range(len(values)):      # one by one: there may be as many predictions as candidates
            turned = self.matrix @ vectors[i]
            hidden = np.any(np.linalg.norm(turned[:, ~seen[i]], axis=1) > HIDDEN * size)
            losses[i] = np.inf if hidden else np.log(np.max(turned**2 @ inverse[i]))
        return losses

    def after(self, inverse: Array, rows: Array) -> Array:
        seen = rows @ inverse
        within = np.eye(rows.shape[1]) + seen @ rows.transpose(0, 2, 1)
        variances = np.einsum("ij,ij->i", self.matrix @ inverse, self.matrix)
        through = seen @ self.matrix.T
        less = np.sum(through * np.linalg.solve(within, through), axis=1)
        return np.log(np.maximum(np.max(variances - less, axis=1), 1e-300))

    def pull(self, inverse: Array) -> Array:
        through = self.matrix @ inverse
        values = np.sum(through * self.matrix, axis=1)
        return np.asarray(through.T @ (through * (values / values.max())[:, None] ** LEADING))

    def pieces(self, inverse: Array) -> Pieces:
        through = self.matrix @ inverse
        values = np.maximum(np.sum(through * self.matrix, axis=1), 1e-300)
        scaled = through / np.sqrt(values)[:, None]

        def gains(rows: Array) -> Array:
            moved = (flattened(rows) @ scaled.T) ** 2
            return np.asarray(moved.reshape(len(rows), -1, len(values)).sum(axis=1).T)

        def spread(multipliers: Array) -> Array:
            return np.asarray(scaled.T @ (scaled * multipliers[:, None]))

        def curvature(rows: Array, multipliers: Array) -> Array:
            flat = flattened(rows)
            return 2.0 * summed((flat @ inverse @ flat.T) * (flat @ spread(multipliers) @ flat.T), len(rows))

        return Pieces(np.log(values), gains, spread, curvature)

    def least(self, dual: Array, mixture: Array | None) -> float:
        # The largest of values is at least any mean of them, and a mean of variances is a trace. The shares of the
        # logarithms are those of the values, divided by them; at the best weights all that count are alike.
        assert mixture is not None
        within = self.matrix.T @ (self.matrix * (mixture / mixture.sum())[:, None])
        values, vectors = np.linalg.eigh(within)
        return least_of_trace((vectors * np.sqrt(np.maximum(values, 0.0))).T, dual)
