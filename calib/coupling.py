"""Coupling of many small eliminated blocks with the other columns: of each block only with those that it meets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array, Index
from calib.compiled import pays, sparse, sparse_loop

THIN = 0.3  # share of a coupling that is there, below which dense products are more work than those that are there
WORK = 300  # operations for each number in a coupling that a solve and its covariance do
PART = 1 << 17  # numbers of a dense piece, which then stays in the cache


@dataclass(frozen=True)
class Coupling:
    """A matrix (m, f, S) of which every block i is nowhere but in the columns[first[i]:first[i + 1]].

    first (m + 1,); columns (nnz,); values (f, nnz + 1), of which the last place is that of what is held; others: S;
    left: (m, f, f), by which every block is multiplied from the left whenever it is looked at, so that it is not stored
    twice; None for as it is.
    """

    first: Index
    columns: NDArray[np.int32]
    values: Array
    others: int
    left: Array | None = None

    def mapped(self, matrices: Array) -> Coupling:
        """Every block (f, S) multiplied from the left by its matrix of (m, f, f)."""
        return replace(self, left=np.ascontiguousarray(matrices if self.left is None else matrices @ self.left))

    @property
    def _counts(self) -> Index:
        return np.diff(self.first)

    @property
    def _compiled(self) -> bool:
        return pays(WORK, float(self.values.size))

    @property
    def _thin(self) -> bool:
        """Whether looking at what is there is less work than dense products."""
        return len(self.columns) < THIN * (len(self.first) - 1) * self.others

    @property
    def _whole(self) -> bool:
        """Whether every block meets all columns."""
        return len(self.columns) == (len(self.first) - 1) * self.others

    @property
    def _matrices(self) -> Array:
        """By what every block is multiplied: (m, f, f)."""
        if self.left is not None:
            return self.left
        many, f = len(self.first) - 1, len(self.values)
        return np.ascontiguousarray(np.broadcast_to(np.eye(f), (many, f, f)))

    def _run(self, kind: Callable[[int], str], begin: int, end: int, apart: int = 0, **arrays: Array) -> None:
        """Run a compiled loop over the blocks from begin to end; apart: distance of the rows of what it writes."""
        sparse_loop(kind, (begin, end, self.values.shape[1], self.others, apart),
                    {"first": self.first, "columns": self.columns, "values": self.values, **arrays}, len(self.values))

    def pieces(self) -> Iterator[tuple[int, int, Array]]:
        """Pieces (begin, end, (f, end - begin, S)) of the whole matrix, each in the place of the one before."""
        m, f, matrices, compiled = len(self.first) - 1, len(self.values), self._matrices, self._compiled
        many = max(1, PART // max(1, self.others * f))
        room = np.zeros(f * min(many, m) * self.others)
        for begin in range(0, m, many):
            end = min(begin + many, m)
            piece = room[: f * (end - begin) * self.others].reshape(f, end - begin, self.others)
            if not self._whole:
                piece[:] = 0.0
            if compiled:
                self._run(sparse.spread, begin, end, piece[0].size, matrix=matrices, out=piece)
            else:
                self._spread(begin, end, matrices[begin:end], piece)
            yield begin, end, piece

    def _spread(self, begin: int, end: int, matrices: Array, piece: Array) -> None:
        inside, counts, places = slice(self.first[begin], self.first[end]), self._counts[begin:end], self._places(
            begin, end)
        for k, plane in enumerate(piece):
            plane.ravel()[places] = sum(np.repeat(matrices[:, k, j], counts) * row[inside]
                                        for j, row in enumerate(self.values))

    def _places(self, begin: int, end: int) -> Index | slice:
        """Where the values of some blocks stand in their dense form."""
        if self._whole:
            return slice(None)
        inside = slice(self.first[begin], self.first[end])
        return np.repeat(np.arange(end - begin) * self.others, self._counts[begin:end]) + self.columns[inside]

    def rows(self, blocks: Index) -> Array:
        """The blocks (n,) of the matrix in full: (n, f, S)."""
        result = np.zeros((len(self.values), len(blocks), self.others))
        counts = self._counts[blocks]
        inside = np.repeat(self.first[blocks], counts) + np.arange(counts.sum()) - np.repeat(
            np.cumsum(counts) - counts, counts)
        result[:, np.repeat(np.arange(len(blocks)), counts), self.columns[inside]] = self.values[:, inside]
        return self._through(blocks, result.transpose(1, 0, 2))

    def at(self, blocks: Index, places: Index) -> Array:
        """What stands of blocks (n,) at places (n, g) among the values: (n, f, g)."""
        return self._through(blocks, self.values[:, places.T].transpose(2, 0, 1))

    def _through(self, blocks: Index, given: Array) -> Array:
        return given if self.left is None else self.left[blocks] @ given

    @cached_property
    def _keys(self) -> Index:
        return np.repeat(np.arange(len(self.first) - 1) * self.others, self._counts) + self.columns

    def places(self, blocks: Index, columns: Index) -> Index:
        """Where the columns (n, g) of blocks (n,) stand among the values, -1 where they do not meet."""
        wanted = (blocks * self.others)[:, None] + columns
        if not len(self.columns):
            return np.full(columns.shape, -1)
        found = np.minimum(np.searchsorted(self._keys, wanted[:, 0]), len(self._keys) - 1)[:, None]
        found = np.minimum(found + columns - columns[:, :1], len(self._keys) - 1)  # a run, nearly always
        wrong = np.flatnonzero((self._keys[found] != wanted).any(axis=1))
        found[wrong] = np.minimum(np.searchsorted(self._keys, wanted[wrong]), len(self._keys) - 1)
        return np.where(self._keys[found] == wanted, found, -1)

    def squared(self, left: Array) -> tuple[Array, Array]:
        """Its transpose times the matrix (S, S), and times (m, f): (S,)."""
        total, right = np.zeros((self.others, self.others)), np.zeros(self.others)
        if self._thin and self._compiled:
            self._run(sparse.square, 0, len(self.first) - 1, self.others, matrix=self._matrices, out=total,
                      room=np.empty((len(self.values), self.others)))
            return total + np.tril(total, -1).T, self.transposed_times(left[:, :, None])[:, 0]
        for begin, end, piece in self.pieces():
            flat = piece.reshape(len(piece) * piece.shape[1], self.others)
            total += flat.T @ flat
            right += flat.T @ left[begin:end].T.ravel()
        return total, right

    def times(self, right: Array) -> Array:
        """Times (S, k): (m, f, k)."""
        result = np.zeros((len(self.first) - 1, len(self.values), right.shape[1]))
        if right.shape[1] > 1:
            for begin, end, piece in self.pieces():
                result[begin:end] = (piece @ right).transpose(1, 0, 2)
            return result
        if self._compiled:
            self._run(sparse.times, 0, len(result), matrix=np.ascontiguousarray(right[:, 0]), out=result)
        elif len(self.columns):
            picked, filled = right[self.columns, 0], self._counts > 0
            for k, values in enumerate(self.values):
                result[filled, k, 0] = np.add.reduceat(values[:-1] * picked, self.first[:-1][filled])
        return result if self.left is None else self.left @ result

    def transposed_times(self, left: Array) -> Array:
        """Its transpose times (m, f, k): (S, k)."""
        result = np.zeros((self.others, left.shape[2]))
        if left.shape[2] > 1:
            for begin, end, piece in self.pieces():
                result += np.tensordot(piece, left[begin:end], ([0, 1], [1, 0]))
            return result
        given = left if self.left is None else np.einsum("mgf,mgk->mfk", self.left, left)
        if self._compiled:
            self._run(sparse.transposed, 0, len(given), matrix=np.ascontiguousarray(given), out=result)
            return result
        total = np.zeros(len(self.columns))
        for k, values in enumerate(self.values):
            total += values[:-1] * np.repeat(given[:, k, 0], self._counts)
        return np.bincount(self.columns, total, self.others)[:, None]

    def within(self, symmetric: Array) -> tuple[Coupling, Array]:
        """Times a symmetric (S, S), where this matrix itself is not zero; and that times the transpose of every block:
        (m, f, f)."""
        m, f = len(self.first) - 1, len(self.values)
        values, squares = np.empty((f, len(self.columns) + 1)), np.zeros((m, f, f))
        values[:, -1] = 0.0
        if self._thin and self._compiled:
            self._run(sparse.within, 0, m, values.shape[1], matrix=self._matrices, out=values, more=squares,
                      symmetric=np.ascontiguousarray(symmetric), room=np.empty((f, self.others)))
            return Coupling(self.first, self.columns, values, self.others), squares
        for begin, end, piece in self.pieces():
            inside, places = slice(self.first[begin], self.first[end]), self._places(begin, end)
            for k, plane in enumerate(piece):
                product = plane @ symmetric
                values[k, inside] = product.ravel()[places]
                for j, other in enumerate(piece):
                    squares[begin:end, k, j] = np.einsum("ns,ns->n", product, other)
        return Coupling(self.first, self.columns, values, self.others), squares
