"""Stated uncertainty of readings: what a person writes, and the row operations that whiten and weigh by it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.blocks import Array, Mixing
from calib.errors import DeclarationError


@dataclass(frozen=True)
class Weighting:
    """Covariance of n readings of dim components, ready for use.

    u: (n, dim) standard uncertainties; whitening: rows of W with W' W = inverse covariance; weights: rows of W' W,
    in blocks that hold whole readings; factors: rows of a square root of the covariance, to draw errors.
    """

    u: Array
    whitening: tuple[Mixing, ...]
    weights: tuple[Mixing, ...]
    factors: tuple[Mixing, ...]

    def scaled(self, factor: float) -> Weighting:
        """The same with every standard uncertainty multiplied by a factor."""

        def times(mixings: tuple[Mixing, ...], by: float) -> tuple[Mixing, ...]:
            return tuple(Mixing(m.rows, m.matrix * by) for m in mixings)

        return Weighting(
            self.u * factor,
            times(self.whitening, 1 / factor),
            times(self.weights, factor**-2),
            times(self.factors, factor),
        )

    def weigh(self, residual: Array) -> Array:
        """Inverse covariance times residuals (n, dim)."""
        weighed = np.empty_like(residual)
        for mixing in self.weights:
            block = mixing.apply(residual, ())
            targets = block.residual.shape[1] // residual.shape[1]
            weighed[block.rows[:, :targets]] = block.residual.reshape(len(block.rows), targets, -1)
        return weighed

    def draw(self, generator: np.random.Generator) -> Array:
        """Errors (n, dim) drawn from this covariance."""
        return self.coloured(generator.standard_normal(self.u.shape))

    def coloured(self, standard: Array) -> Array:
        """Errors (n, dim) of this covariance from independent ones of variance one."""
        errors = np.empty_like(standard)
        for mixing in self.factors:
            block = mixing.apply(standard, ())
            errors[block.rows] = block.residual.reshape(*block.rows.shape, standard.shape[1])
        return errors


class Gaussian:
    """Gaussian errors of readings; use one of the named constructors."""

    @staticmethod
    def standard(u: ArrayLike) -> Gaussian:
        """Independent readings with standard uncertainties u: a number, (dim,), (n,) where dim is 1, or (n, dim);
        SI."""
        return _Independent(np.asarray(u, float))

    @staticmethod
    def matrix(covariance: ArrayLike) -> Gaussian:
        """A covariance matrix for each row, (n, dim, dim), or one for all, (dim, dim); SI squared."""
        return _RowMatrix(np.asarray(covariance, float))

    @staticmethod
    def groups(index: ArrayLike, matrices: Mapping[object, ArrayLike]) -> Gaussian:
        """A full covariance matrix for each group of rows.

        index: (n,) key of each row; matrices: for each key a matrix over its readings, row by row; SI squared.
        """
        return _Grouped(np.asarray(index), {str(k): np.asarray(m, float) for k, m in matrices.items()})

    @staticmethod
    def serial(u: ArrayLike, correlation: float, order: ArrayLike, chain: ArrayLike | None = None) -> Gaussian:
        """First-order serial correlation of scalar readings along a declared order.

        u: number or (n,); correlation: of neighbours, in (-1, 1); order: (n,) sorts each chain; chain: (n,) keys.
        """
        return _Serial(
            np.asarray(u, float), float(correlation), np.asarray(order), None if chain is None else np.asarray(chain)
        )

    @staticmethod
    def depending(function: Callable[..., ArrayLike]) -> Gaussian:
        """Standard uncertainties that depend on row quantities, such as a + b L.

        function: its argument names are `reading` or model arguments, each an (n, k) array in SI; returns (n, dim).
        It is data during a solve and evaluated again at the estimate until it stands still; it is not differentiated.
        """
        return _Depending(function)

    def weighting(self, n: int, dim: int, where: str, quantities: Callable[[str], Array] | None = None) -> Weighting:
        """Row operations for n readings of dim components; where: named in errors."""
        raise NotImplementedError

    def kept(self, keep: NDArray[np.bool_]) -> Gaussian:
        """The uncertainty of the rows where keep (n,) is true."""
        return self

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of row quantities that it depends on."""
        return ()


def _checked(u: Array, n: int, dim: int, where: str) -> Array:
    if u.ndim == 1 and dim == 1 and u.shape == (n,):
        u = u[:, None]
    try:
        full = np.array(np.broadcast_to(u, (n, dim)))
    except ValueError:
        raise DeclarationError(
            f"{where}: the uncertainties have shape {u.shape}, the readings ({n}, {dim}); give a "
            "number, one per component, or one per reading."
        ) from None
    wrong = np.argwhere(~(np.isfinite(full) & (full > 0)))
    if len(wrong):
        raise DeclarationError(
            f"{where}: the standard uncertainty of row {wrong[0][0] + 1} is {full[tuple(wrong[0])]:g}; "
            "it must be a positive number (hold an unknown to say that something is exact)."
        )
    return full


def _root(matrices: Array, where: str) -> Array:
    try:
        return np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        raise DeclarationError(
            f"{where}: a covariance matrix is not positive definite; a zero variance means 'exact' "
            "(hold the unknown instead), a negative eigenvalue means a wrong correlation."
        ) from None


def _whole_rows(n: int) -> NDArray[np.int64]:
    return np.arange(n)[:, None]


def _full(rows: NDArray[np.int64], covariance: Array, where: str) -> tuple[Mixing, Mixing, Mixing]:
    root = _root(covariance, where)
    whitening = np.linalg.inv(root)
    return (Mixing(rows, whitening), Mixing(rows, whitening.transpose(0, 2, 1) @ whitening), Mixing(rows, root))


@dataclass(frozen=True)
class _Independent(Gaussian):
    u: Array

    def kept(self, keep: NDArray[np.bool_]) -> Gaussian:
        return _Independent(self.u[keep]) if self.u.ndim and len(self.u) == len(keep) else self

    def weighting(self, n, dim, where, quantities=None):  # type: ignore[no-untyped-def]
        u, rows = _checked(self.u, n, dim, where), _whole_rows(n)
        inverse = 1 / u
        return Weighting(u, (Mixing(rows, inverse),), (Mixing(rows, inverse * inverse),), (Mixing(rows, u),))


@dataclass(frozen=True)
class _RowMatrix(Gaussian):
    covariance: Array

    def kept(self, keep: NDArray[np.bool_]) -> Gaussian:
        return _RowMatrix(self.covariance[keep]) if self.covariance.ndim == 3 else self

    def weighting(self, n, dim, where, quantities=None):  # type: ignore[no-untyped-def]
        try:
            full = np.broadcast_to(self.covariance, (n, dim, dim))
        except ValueError:
            raise DeclarationError(
                f"{where}: the covariance has shape {self.covariance.shape}; for {n} rows of {dim} "
                f"components give ({dim}, {dim}) or ({n}, {dim}, {dim})."
            ) from None
        whitening, weights, factor = _full(_whole_rows(n), full, where)
        return Weighting(np.sqrt(np.einsum("nii->ni", full)), (whitening,), (weights,), (factor,))


@dataclass(frozen=True)
class _Grouped(Gaussian):
    index: NDArray
    matrices: Mapping[str, Array]

    def kept(self, keep: NDArray[np.bool_]) -> Gaussian:
        keys, matrices = np.array([str(k) for k in self.index]), {}
        for key, matrix in self.matrices.items():
            stays = keep[keys == key]
            if stays.any():
                inside = np.repeat(stays, len(matrix) // len(stays))
                matrices[key] = matrix[np.ix_(inside, inside)]
        return _Grouped(keys[keep], matrices)

    def weighting(self, n, dim, where, quantities=None):  # type: ignore[no-untyped-def]
        if len(self.index) != n:
            raise DeclarationError(f"{where}: {len(self.index)} group keys for {n} rows; give one key a row.")
        u = np.empty((n, dim))
        by_size: dict[int, list[tuple[NDArray, Array]]] = {}
        keys = np.array([str(k) for k in self.index])
        for key in dict.fromkeys(keys.tolist()):
            rows = np.flatnonzero(keys == key)
            size = len(rows) * dim
            covariance = self.matrices.get(key)
            if covariance is None or covariance.shape != (size, size):
                found = "missing" if covariance is None else f"of shape {covariance.shape}"
                raise DeclarationError(
                    f"{where}: the covariance matrix of group '{key}' is {found}; it must be ({size}, {size})."
                )
            u[rows] = np.sqrt(np.diag(covariance)).reshape(-1, dim)
            by_size.setdefault(len(rows), []).append((rows, covariance))
        triples = [
            _full(np.stack([r for r, _ in members]), np.stack([c for _, c in members]), where)
            for members in by_size.values()
        ]
        whitening, weights, factors = zip(*triples, strict=True)
        return Weighting(u, whitening, weights, factors)


@dataclass(frozen=True)
class _Serial(Gaussian):
    u: Array
    correlation: float
    order: NDArray
    chain: NDArray | None

    def kept(self, keep: NDArray[np.bool_]) -> Gaussian:
        return _Serial(
            self.u[keep] if self.u.ndim else self.u,
            self.correlation,
            self.order[keep],
            None if self.chain is None else self.chain[keep],
        )

    def weighting(self, n, dim, where, quantities=None):  # type: ignore[no-untyped-def]
        if dim != 1:
            raise DeclarationError(
                f"{where}: serial correlation is declared for scalar readings; these have {dim} "
                "components; declare one group for each component."
            )
        if not -1.0 < self.correlation < 1.0:
            raise DeclarationError(f"{where}: a serial correlation of {self.correlation:g} is not between -1 and 1.")
        u = _checked(self.u, n, 1, where)[:, 0]
        chains = np.zeros(n, dtype=int) if self.chain is None else np.unique(self.chain, return_inverse=True)[1]
        sequence = np.lexsort((self.order, chains))
        first = np.ones(n, dtype=bool)
        first[1:] = chains[sequence][1:] != chains[sequence][:-1]
        last = np.append(first[1:], True)
        rho, scale = self.correlation, 1 / np.sqrt(1 - self.correlation**2)
        here, before = sequence, np.roll(sequence, 1)
        after = np.roll(sequence, -1)

        head = Mixing(here[first][:, None], (1 / u[here[first]])[:, None])
        tail = ~first
        pair = np.stack([before[tail], here[tail]], axis=1)
        whitening = (head, Mixing(pair, scale * (np.array([-rho, 1.0]) / u[pair])[:, None, :]))

        lone, inner = first & last, ~first & ~last
        weights = []
        for select, sources, band in (
            (lone, (here,), (1.0,)),
            (first & ~last, (here, after), (scale**2, -rho * scale**2)),
            (last & ~first, (here, before), (scale**2, -rho * scale**2)),
            (inner, (here, before, after), ((1 + rho**2) * scale**2, -rho * scale**2, -rho * scale**2)),
        ):
            rows = np.stack([s[select] for s in sources], axis=1)
            if len(rows):
                weights.append(Mixing(rows, (np.array(band) / (u[rows] * u[rows[:, :1]]))[:, None, :]))
        return Weighting(
            u[:, None], tuple(w for w in whitening if len(w.rows)), tuple(weights), self._factors(u, sequence, first)
        )

    def _factors(self, u: Array, sequence: NDArray, first: NDArray) -> tuple[Mixing, ...]:
        mixings = []
        for chain in np.split(sequence, np.flatnonzero(first)[1:]):
            lag = np.abs(np.subtract.outer(np.arange(len(chain)), np.arange(len(chain))))
            root = np.linalg.cholesky(self.correlation**lag) if self.correlation else np.eye(len(chain))
            mixings.append(Mixing(chain[None, :], (u[chain][:, None] * root)[None]))
        return tuple(mixings)


@dataclass(frozen=True)
class _Depending(Gaussian):
    function: Callable[..., ArrayLike]
    keep: NDArray[np.bool_] | None = None  # which of the rows that the function was written for are still there

    def kept(self, keep: NDArray[np.bool_]) -> Gaussian:
        if self.keep is None:
            return _Depending(self.function, keep)
        whole = self.keep.copy()
        whole[self.keep] = keep
        return _Depending(self.function, whole)

    @property
    def needs(self) -> tuple[str, ...]:
        return tuple(inspect.signature(self.function).parameters)

    def weighting(self, n, dim, where, quantities=None):  # type: ignore[no-untyped-def]
        arrays = [quantities(name) for name in self.needs]  # type: ignore[misc]
        if self.keep is not None:
            place = np.maximum(np.cumsum(self.keep) - 1, 0)
            arrays = [a[place] for a in arrays]
        u = np.asarray(self.function(*arrays), float)
        if self.keep is not None and u.ndim and len(u) == len(self.keep):
            u = u[self.keep]
        return _Independent(u.reshape(n, -1) if u.ndim else u).weighting(n, dim, where)
