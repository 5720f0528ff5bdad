"""Coupling of many small eliminated blocks with the other columns: of each block only with those that it meets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.blocks import Array, Index
from calib.compiled import pays, sparse, sparse_loop

THIN = 0.3  # share of a coupling that is there, below which dense products are more work than those that are there
WORK = 300  # operations for each number in a coupling that a solve and its covariance do
PART = 1 << 19  # numbers of a dense piece, which then stays in the cache


@dataclass(frozen=True)
class Coupling:
    """A matrix (m, f, S) of which every block i is nowhere but in the columns[first[i]:first[i + 1]].

    first (m + 1,); columns (nnz,); values (f, nnz); others: S.
    """

    first: Index
    columns: Index
    values: Array
    others: int

    @property
    def _counts(self) -> Index:
        return np.diff(self.first)

    @property
    def _compiled(self) -> bool:
        return pays(WORK, float(self.values.size))

    def mapped(self, matrices: Array) -> Coupling:
        """Every block (f, S) multiplied from the left by its matrix of (m, f, f)."""
        values, counts = self._empty(), self._counts
        if self._compiled:
            self._run(sparse.mapped, values, half=np.ascontiguousarray(matrices))
            return Coupling(self.first, self.columns, values, self.others)
        for begin, end in self._runs():
            inside = slice(self.first[begin], self.first[end])
            for k, out in enumerate(values):
                total = 0.0
                for j, plane in enumerate(self.values):
                    total = total + np.repeat(matrices[begin:end, k, j], counts[begin:end]) * plane[inside]
                out[inside] = total
        return Coupling(self.first, self.columns, values, self.others)

    def _empty(self) -> Array:
        """Room for other values: rows as far apart as those that rows are accumulated in."""
        return np.empty((len(self.values), len(self.columns) + 1))[:, :-1]

    def _run(self, kind: Callable[[int], str], out: Array, **more: Array) -> None:
        """Run a compiled loop over all blocks."""
        given = self.values
        if given.strides != (8 * len(self.columns) + 8, 8):
            given = self._empty()
            given[:] = self.values
        sparse_loop(kind, 0, len(self.first) - 1, self.others, self.first, self.columns, given, out=out, **more)

    @property
    def _thin(self) -> bool:
        """Whether looking at what is there is less work than dense products."""
        return len(self.columns) < THIN * (len(self.first) - 1) * self.others

    def _runs(self) -> Iterator[tuple[int, int]]:
        """Ranges of blocks whose dense form is a piece that stays in the cache."""
        many = max(1, PART // max(1, self.others * len(self.values)))
        for begin in range(0, len(self.first) - 1, many):
            yield begin, min(begin + many, len(self.first) - 1)

    def dense(self) -> Iterator[tuple[int, int, Array]]:
        """Pieces (begin, end, (f, end - begin, S)) of the whole matrix."""
        for begin, end in self._runs():
            piece = np.zeros((len(self.values), end - begin, self.others))
            inside = slice(self.first[begin], self.first[end])
            for plane, values in zip(piece, self.values, strict=True):
                plane.ravel()[self._places(begin, end)] = values[inside]
            yield begin, end, piece

    def _places(self, begin: int, end: int) -> Index:
        inside = slice(self.first[begin], self.first[end])
        return np.repeat(np.arange(end - begin) * self.others, self._counts[begin:end]) + self.columns[inside]

    def rows(self, blocks: Index) -> Array:
        """The blocks (n,) of the matrix in full: (n, f, S)."""
        result = np.zeros((len(self.values), len(blocks), self.others))
        counts = self._counts[blocks]
        inside = np.repeat(self.first[blocks], counts) + np.arange(counts.sum()) - np.repeat(
            np.cumsum(counts) - counts, counts)
        result[:, np.repeat(np.arange(len(blocks)), counts), self.columns[inside]] = self.values[:, inside]
        return result.transpose(1, 0, 2)

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

    def square(self) -> Array:
        """The matrix times its transpose, over the others: (S, S)."""
        total = np.zeros((self.others, self.others))
        if self._thin and self._compiled:
            self._run(sparse.square, total)
            return total + np.tril(total, -1).T
        for _, _, piece in self.dense():
            flat = piece.reshape(piece.shape[0] * piece.shape[1], self.others)
            total += flat.T @ flat
        return total

    def times(self, right: Array) -> Array:
        """Times (S, k): (m, f, k)."""
        result = np.zeros((len(self.first) - 1, len(self.values), right.shape[1]))
        if right.shape[1] == 1 and len(self.columns):
            picked, filled = right[self.columns, 0], self._counts > 0
            for k, values in enumerate(self.values):
                result[filled, k, 0] = np.add.reduceat(values * picked, self.first[:-1][filled])
            return result
        for begin, end, piece in self.dense():
            result[begin:end] = (piece @ right).transpose(1, 0, 2)
        return result

    def transposed_times(self, left: Array) -> Array:
        """Its transpose times (m, f, k): (S, k)."""
        if left.shape[2] == 1:
            total = np.zeros(len(self.columns))
            for k, values in enumerate(self.values):
                total += values * np.repeat(left[:, k, 0], self._counts)
            return np.bincount(self.columns, total, self.others)[:, None]
        result = np.zeros((self.others, left.shape[2]))
        for begin, end, piece in self.dense():
            flat = piece.reshape(piece.shape[0] * piece.shape[1], self.others)
            result += flat.T @ left[begin:end].transpose(1, 0, 2).reshape(len(flat), -1)
        return result

    def sampled(self, symmetric: Array) -> Coupling:
        """Times a symmetric (S, S), where this matrix itself is not zero."""
        values = self._empty()
        if self._thin and self._compiled:
            self._run(sparse.sampled, values, matrix=np.ascontiguousarray(symmetric))
            return Coupling(self.first, self.columns, values, self.others)
        for begin, end, piece in self.dense():
            inside, places = slice(self.first[begin], self.first[end]), self._places(begin, end)
            for k, plane in enumerate(piece):
                values[k, inside] = (plane @ symmetric).ravel()[places]
        return Coupling(self.first, self.columns, values, self.others)

    def gram(self, other: Coupling) -> Array:
        """Every block times the transpose of the block of another coupling of the same pattern: (m, f, f)."""
        result, filled = np.zeros((len(self.first) - 1, len(self.values), len(other.values))), self._counts > 0
        if len(self.columns):
            for k, mine in enumerate(self.values):
                for j, theirs in enumerate(other.values):
                    result[filled, k, j] = np.add.reduceat(mine * theirs, self.first[:-1][filled])
        return result
