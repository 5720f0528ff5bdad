"""Criteria as functions of the information: value, tangent and curvature, and what one more candidate would give.

Every loss is the logarithm of a value that is to be small (for D: minus that of det^(1/p)), so that exp(-loss) is
concave in the information and homogeneous of degree one. Written with C the inverse information, A the rows of a
candidate, F the functions asked for and S = F C F'. The criteria that are a maximum stand in `worst`.
Source: Pukelsheim (2006), Optimal Design of Experiments, chapters 5 and 6.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.analyse.selection.limits import Limits
from calib.blocks import Array

SINGULAR = 1e-12      # smallest eigenvalue of the information, of all information together, that counts as seen
HIDDEN = 1e-8         # share of a function in unseen directions from which on it cannot be known


@dataclass(frozen=True, eq=False)
class Tangent:
    """A smooth criterion near one information.

    loss; spread: (p, p) with tr(A spread A') the decrease of the loss by each candidate; curvature: Hessian (u, u) for
    the rows (u, m, p) of some candidates.
    """

    loss: float
    spread: Array
    curvature: Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class Pieces:
    """The pieces of which a criterion is the largest, near one information.

    losses (m,); gains: decrease (m, u) of each by the rows (u, m, p) of some candidates; spread: (p, p) of the pieces
    with multipliers (m,), as of a tangent; curvature: of the pieces with multipliers (m,) for rows (u, m, p), without
    the -J'J that the gains J (m, u) of logarithms contribute.
    """

    losses: Array
    gains: Callable[[Array], Array]
    spread: Callable[[Array], Array]
    curvature: Callable[[Array, Array], Array]


@dataclass(frozen=True, eq=False)
class Support:
    """A linear function of the weights that lies above exp(-loss) at all of them: constant + gain.w, gain (n,).

    It is computed from a symmetric matrix (p, p) alone and holds for any, whoever found it: see `Term.support`.
    """

    gain: Array
    constant: float

    def bound(self, limits: Limits, lower: Array, upper: Array) -> float:
        """A loss that no choice within the limits and lower <= w <= upper can fall below; infinite where there is
        none."""
        most = limits.largest(self.gain, lower, upper)
        return np.inf if most is None else -float(np.log(max(self.constant + most, 1e-300)))


def projected(rows: Array, spread: Array) -> Array:
    """tr(A spread A') of the rows A of each candidate (n, m, p)."""
    flat = flattened(rows)
    return np.asarray(np.einsum("ij,ij->i", flat @ spread, flat).reshape(rows.shape[:2]).sum(axis=1))


def summed(products: Array, count: int) -> Array:
    """Products of rows (u m, u m) summed over the rows of each pair of candidates."""
    width = len(products) // count
    if width == 1:
        return products
    return np.asarray(products.reshape(count, width, count, width).sum(axis=(1, 3)))


def flattened(rows: Array) -> Array:
    return rows.reshape(-1, rows.shape[2])


@dataclass(frozen=True, eq=False)
class Term:
    """A criterion on candidates: rows (n, m, p) and fixed information (p, p)."""

    rows: Array
    fixed: Array
    smooth = True      # whether it has a tangent; otherwise it is the largest of several pieces

    def information(self, weights: Array) -> Array:
        """Information (p, p) with weights (n,)."""
        used = np.flatnonzero(weights)
        flat = flattened(self.rows[used])
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

    def tangent(self, inverse: Array) -> Tangent:
        """The criterion near an inverse information (p, p), where it is smooth."""
        raise NotImplementedError

    def pull(self, inverse: Array) -> Array:
        """A matrix (p, p) that tells which candidates help at an inverse information: tr(A pull A')."""
        return self.tangent(inverse).spread

    def pieces(self, inverse: Array) -> Pieces:
        """The pieces of which it is the largest, near an inverse information (p, p): itself, where it is smooth."""
        tangent = self.tangent(inverse)

        def curvature(rows: Array, multipliers: Array) -> Array:
            gain = projected(rows, tangent.spread)
            return float(multipliers[0]) * (tangent.curvature(rows) + np.outer(gain, gain))

        return Pieces(np.array([tangent.loss]), lambda rows: projected(rows, tangent.spread)[None],
                      lambda multipliers: float(multipliers[0]) * tangent.spread, curvature)

    def support(self, dual: Array, mixture: Array | None = None) -> Support:
        """A linear function above exp(-loss), from any positive semidefinite dual matrix (p, p) alone.

        For every information M: exp(-loss) <= tr(M dual) / least, with least the smallest value of tr(M dual) where
        exp(-loss) is one; mixture: (f,) shares of the functions where the loss is the largest of them.
        Source: Pukelsheim (2006), chapter 5 (polars of information functions).
        """
        values, vectors = np.linalg.eigh(0.5 * (dual + dual.T))
        dual = (vectors * np.maximum(values, 0.0)) @ vectors.T      # rounding may have left it a hair below
        least = self.least(dual, mixture)
        return Support(projected(self.rows, dual) / least, float(np.sum(self.fixed * dual)) / least)

    def least(self, dual: Array, mixture: Array | None) -> float:
        """Smallest tr(M dual) of informations M (p, p) with exp(-loss) of one, or something below it."""
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

    def tangent(self, inverse: Array) -> Tangent:
        loss = float((np.linalg.slogdet(inverse)[1] - self.log_scale) / self.size)

        def curvature(rows: Array) -> Array:
            flat = flattened(rows)
            return summed((flat @ inverse @ flat.T) ** 2, len(rows)) / self.size

        return Tangent(loss, inverse / self.size, curvature)

    def least(self, dual: Array, mixture: Array | None) -> float:
        # Means of eigenvalues: tr(M Y) >= p det(M)^(1/p) det(Y)^(1/p).
        return self.size * float(np.exp((np.linalg.slogdet(dual)[1] - self.log_scale) / self.size))


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

    def tangent(self, inverse: Array) -> Tangent:
        through = self.matrix @ inverse
        trace = float(np.sum(through * self.matrix))
        if not trace > 0.0:      # the inverse is rounding alone
            raise np.linalg.LinAlgError("the information is singular to rounding")
        spread = through.T @ through / trace

        def curvature(rows: Array) -> Array:
            flat = flattened(rows)
            across = flat @ spread @ flat.T
            gain = np.diag(across).reshape(len(rows), -1).sum(axis=1)
            return 2.0 * summed((flat @ inverse @ flat.T) * across, len(rows)) - np.outer(gain, gain)

        return Tangent(float(np.log(trace)), spread, curvature)

    def least(self, dual: Array, mixture: Array | None) -> float:
        return least_of_trace(self.matrix, dual)


def least_of_trace(matrix: Array, dual: Array) -> float:
    """Smallest tr(M Y) of informations M with tr(F M^-1 F') of one, for F (f, p) and Y (p, p): with Y = Z Z' it is the
    square of the sum of the singular values of F Z, because that sum is at most |F M^(-1/2)| |M^(1/2) Z|."""
    values, vectors = np.linalg.eigh(dual)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return float(np.sum(np.linalg.svd(matrix @ root, compute_uv=False))) ** 2


@dataclass(frozen=True, eq=False)
class DeterminantOfSet(OfFunctions):
    """Ds: logarithm of det^(1/s) of S."""

    def of_covariance(self, covariance: Array) -> Array:
        sign, logarithm = np.linalg.slogdet(covariance)
        return np.where(sign > 0, logarithm, -np.inf) / len(self.matrix)

    def tangent(self, inverse: Array) -> Tangent:
        s, through = len(self.matrix), self.matrix @ inverse
        covariance = through @ self.matrix.T
        whole = through.T @ np.linalg.solve(covariance, through)

        def curvature(rows: Array) -> Array:
            flat = flattened(rows)
            across = flat @ whole @ flat.T
            return summed((2.0 * (flat @ inverse @ flat.T) - across) * across, len(rows)) / s

        return Tangent(float(np.linalg.slogdet(covariance)[1] / s), whole / s, curvature)

    def least(self, dual: Array, mixture: Array | None) -> float:
        # F'N F <= M for N = S^-1, so tr(M Y) >= tr(N F Y F') >= s det(N)^(1/s) det(F Y F')^(1/s).
        s = len(self.matrix)
        return s * float(np.exp(np.linalg.slogdet(self.matrix @ dual @ self.matrix.T)[1] / s))
