"""Criteria as functions of the information: value, tangent and curvature, and what one more candidate would give.

Every loss is the logarithm of a value that is to be small (for D: minus that of det^(1/p)), so that exp(-loss) is
concave in the information and homogeneous of degree one. Written with C the inverse information, A the rows of a
candidate, F the functions asked for and S = F C F'.
Source: Pukelsheim (2006), Optimal Design of Experiments, chapters 5 and 6.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.blocks import Array

SINGULAR = 1e-12      # smallest eigenvalue of the information, of all information together, that counts as seen
HIDDEN = 1e-10        # share of a function in unseen directions from which on it cannot be known


@dataclass(frozen=True, eq=False)
class Tangent:
    """A criterion near one information.

    level: loss of the weighed criterion that the bound is about; loss: what an optimiser follows (a smooth form of the
    same); spread: (p, p) with tr(A spread A') the decrease of loss by each candidate; curvature: Hessian (u, u) for the
    rows (u, m, p) of some candidates.
    """

    level: float
    loss: float
    spread: Array
    curvature: Callable[[Array], Array]

    def gain(self, rows: Array) -> Array:
        """Decrease of the loss (n,) by each candidate, per unit of weight."""
        flat = rows.reshape(-1, rows.shape[2])
        return np.asarray(np.einsum("ij,ij->i", flat @ self.spread, flat).reshape(rows.shape[:2]).sum(axis=1))


def _summed(products: Array, count: int) -> Array:
    """Products of rows (u m, u m) summed over the rows of each pair of candidates."""
    width = len(products) // count
    if width == 1:
        return products
    return np.asarray(products.reshape(count, width, count, width).sum(axis=(1, 3)))


def _flat(rows: Array) -> Array:
    return rows.reshape(-1, rows.shape[2])


@dataclass(frozen=True, eq=False)
class Term:
    """A criterion on candidates: rows (n, m, p) and fixed information (p, p)."""

    rows: Array
    fixed: Array
    sharp = False      # whether a smooth form with a sharpness stands in for it

    def information(self, weights: Array) -> Array:
        """Information (p, p) with weights (n,)."""
        used = np.flatnonzero(weights)
        flat = _flat(self.rows[used])
        return np.asarray(self.fixed + flat.T @ (flat * np.repeat(weights[used], self.rows.shape[1])[:, None]))

    def loss(self, information: Array) -> Array:
        """Losses (b,) of informations (b, p, p), infinite where something asked for cannot be known."""
        values, vectors = np.linalg.eigh(information)
        seen = values > SINGULAR
        inverse = np.where(seen, 1.0 / np.where(seen, values, 1.0), 0.0)
        return self._loss(values, vectors, seen, inverse)

    def _loss(self, values: Array, vectors: Array, seen: Array, inverse: Array) -> Array:
        turned = self.functions @ vectors      # (b, f, p)
        size = np.linalg.norm(self.functions, axis=1)
        hidden = np.sqrt(np.sum(np.where(seen[:, None, :], 0.0, turned**2), axis=2)) > HIDDEN * size
        covariance = (turned * inverse[:, None, :]) @ turned.transpose(0, 2, 1)
        return np.where(hidden.any(axis=1), np.inf, self.of_covariance(covariance))

    @property
    def functions(self) -> Array:
        """F (f, p)."""
        raise NotImplementedError

    def of_covariance(self, covariance: Array) -> Array:
        """Losses of covariances (b, f, f) of the functions."""
        raise NotImplementedError

    def after(self, inverse: Array, rows: Array) -> Array:
        """Losses (n,) after each candidate (n, m, p) has been added to what has the inverse information (p, p)."""
        seen = rows @ inverse
        within = np.eye(rows.shape[1]) + seen @ rows.transpose(0, 2, 1)
        through = seen @ self.functions.T
        less = through.transpose(0, 2, 1) @ np.linalg.solve(within, through)
        return self.of_covariance(self.functions @ inverse @ self.functions.T - less)

    def tangent(self, inverse: Array, sharpness: float) -> Tangent:
        """The criterion near an inverse information (p, p)."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Determinant(Term):
    """D: minus the logarithm of det^(1/p); log_scale: log det of the coordinates' own information."""

    log_scale: float

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.fixed)

    def _loss(self, values: Array, vectors: Array, seen: Array, inverse: Array) -> Array:
        logarithm = np.sum(np.log(np.where(seen, values, 1.0)), axis=1)
        return np.where(seen.all(axis=1), -(logarithm + self.log_scale) / self.size, np.inf)

    def after(self, inverse: Array, rows: Array) -> Array:
        base = (np.linalg.slogdet(inverse)[1] - self.log_scale) / self.size
        within = np.eye(rows.shape[1]) + rows @ inverse @ rows.transpose(0, 2, 1)
        grown = np.log(within[:, 0, 0]) if rows.shape[1] == 1 else np.linalg.slogdet(within)[1]
        return np.asarray(base - grown / self.size)

    def tangent(self, inverse: Array, sharpness: float) -> Tangent:
        loss = float((np.linalg.slogdet(inverse)[1] - self.log_scale) / self.size)

        def curvature(rows: Array) -> Array:
            flat = _flat(rows)
            return _summed((flat @ inverse @ flat.T) ** 2, len(rows)) / self.size

        return Tangent(loss, loss, inverse / self.size, curvature)


@dataclass(frozen=True, eq=False)
class OfFunctions(Term):
    """A criterion of S = F C F'; matrix: F (f, p)."""

    matrix: Array

    @property
    def functions(self) -> Array:
        return self.matrix


@dataclass(frozen=True, eq=False)
class Trace(OfFunctions):
    """A, c and I: logarithm of the trace of S."""

    def __post_init__(self) -> None:
        if len(self.matrix) > self.matrix.shape[1]:      # only F'F matters
            object.__setattr__(self, "matrix", np.linalg.qr(self.matrix, mode="r"))

    def of_covariance(self, covariance: Array) -> Array:
        trace = np.trace(covariance, axis1=-2, axis2=-1)
        return np.log(np.maximum(trace, 1e-300))

    def tangent(self, inverse: Array, sharpness: float) -> Tangent:
        through = self.matrix @ inverse
        trace = float(np.sum(through * self.matrix))
        spread = through.T @ through / trace

        def curvature(rows: Array) -> Array:
            flat = _flat(rows)
            across = flat @ spread @ flat.T
            gain = np.diag(across).reshape(len(rows), -1).sum(axis=1)
            return 2.0 * _summed((flat @ inverse @ flat.T) * across, len(rows)) - np.outer(gain, gain)

        loss = float(np.log(trace))
        return Tangent(loss, loss, spread, curvature)


@dataclass(frozen=True, eq=False)
class Largest(OfFunctions):
    """E: logarithm of the largest eigenvalue of S; smooth form: that of (sum of q-th powers)^(1/q)."""

    sharp = True

    def __post_init__(self) -> None:
        if len(self.matrix) > self.matrix.shape[1]:
            object.__setattr__(self, "matrix", np.linalg.qr(self.matrix, mode="r"))

    def of_covariance(self, covariance: Array) -> Array:
        return np.log(np.maximum(np.linalg.eigvalsh(covariance)[..., -1], 1e-300))

    def tangent(self, inverse: Array, sharpness: float) -> Tangent:
        values, vectors = np.linalg.eigh(self.matrix @ inverse @ self.matrix.T)
        return _of_powers(inverse, vectors.T @ self.matrix @ inverse, np.maximum(values, 1e-300), sharpness, True)


@dataclass(frozen=True, eq=False)
class LargestOf(OfFunctions):
    """G: logarithm of the largest diagonal element of S; smooth form as for E."""

    sharp = True

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

    def tangent(self, inverse: Array, sharpness: float) -> Tangent:
        through = self.matrix @ inverse
        return _of_powers(inverse, through, np.sum(through * self.matrix, axis=1), sharpness, False)


def _of_powers(inverse: Array, through: Array, values: Array, q: float, coupled: bool) -> Tangent:
    """Tangent of the q-norm of values (f,), whose functions times C are `through` (f, p).

    coupled: whether the values are eigenvalues, which also turn.
    """
    largest = values.max()
    relative = values / largest
    total = float(np.sum(relative**q))
    share = relative ** (q - 1.0)
    spread = through.T @ (through * (share / (total * largest))[:, None])

    def curvature(rows: Array) -> Array:
        flat = _flat(rows)
        gain = np.einsum("ij,ij->i", flat @ spread, flat).reshape(len(rows), -1).sum(axis=1)
        hessian = 2.0 * _summed((flat @ inverse @ flat.T) * (flat @ spread @ flat.T), len(rows))
        moved = (flat @ through.T).reshape(len(rows), -1, len(values)) / np.sqrt(largest)
        if coupled:
            gap = relative[:, None] - relative[None, :]
            near = np.abs(gap) < 1e-9
            slope = np.where(near, (q - 1.0) * np.maximum(relative, 1e-300)[:, None] ** (q - 2.0),
                             (share[:, None] - share[None, :]) / np.where(near, 1.0, gap))
            change = np.einsum("umf,umg->ufg", moved, moved) * np.sqrt(slope / total)
            change = change.reshape(len(rows), -1)
        else:
            change = np.sum(moved**2, axis=1) * np.sqrt((q - 1.0) * relative ** (q - 2.0) / total)
        return np.asarray(hessian + change @ change.T - q * np.outer(gain, gain))

    level = float(np.log(largest * total / np.sum(share)))
    return Tangent(level, float(np.log(largest) + np.log(total) / q), spread, curvature)


@dataclass(frozen=True, eq=False)
class DeterminantOfSet(OfFunctions):
    """Ds: logarithm of det^(1/s) of S."""

    def of_covariance(self, covariance: Array) -> Array:
        sign, logarithm = np.linalg.slogdet(covariance)
        return np.where(sign > 0, logarithm, -np.inf) / len(self.matrix)

    def tangent(self, inverse: Array, sharpness: float) -> Tangent:
        s, through = len(self.matrix), self.matrix @ inverse
        covariance = through @ self.matrix.T
        whole = through.T @ np.linalg.solve(covariance, through)

        def curvature(rows: Array) -> Array:
            flat = _flat(rows)
            across = flat @ whole @ flat.T
            return _summed((2.0 * (flat @ inverse @ flat.T) - across) * across, len(rows)) / s

        loss = float(np.linalg.slogdet(covariance)[1] / s)
        return Tangent(loss, loss, whole / s, curvature)
