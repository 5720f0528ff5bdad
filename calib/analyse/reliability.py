"""Reliability in the sense of Baarda: redundancy numbers, w-tests, minimal detectable biases and their influence."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array, Index
from calib.factor import DenseFactor
from calib.linearisation import Group, Linearisation
from calib.normal import whitened
from calib.pattern import Source, pieces

MANY = 6  # arguments of a row beyond which its derivatives are multiplied as a whole
INVISIBLE = 1e-10  # redundancy number below which a reading is not controlled by any other


@dataclass(frozen=True)
class Reliability:
    """Arrays over all N scalar readings, priors included, group by group and row by row.

    groups: of the linearisation; redundancy: (Q_vv P)_ii in [0, 1]; w: standardised residual; mdb: minimal detectable
    bias, SI, infinite where nothing controls the reading; influence: {result: (N,)} change of the result by a bias of
    size mdb, SI (zero where the mdb is infinite).
    """

    groups: tuple[Group, ...]
    redundancy: Array
    w: Array
    mdb: Array
    influence: Mapping[str, Array]
    level: float
    power: float

    def __len__(self) -> int:
        return len(self.redundancy)

    def _of_each(self, take: Callable[[Group], NDArray]) -> NDArray:
        """What is taken of every group, (n, dim) or what can be repeated to that, reading by reading."""
        return _one_after_another([np.broadcast_to(take(g), g.residual.shape).ravel() for g in self.groups])

    @cached_property
    def group(self) -> NDArray:
        """Name of the group of each reading."""
        return self._of_each(lambda g: np.array(g.name))

    @cached_property
    def row(self) -> NDArray:
        """Row of each reading in the data file."""
        return self._of_each(lambda g: g.rows[:, None])

    @cached_property
    def component(self) -> NDArray:
        """Component of each reading."""
        return self._of_each(lambda g: np.array(g.components))

    @cached_property
    def unit(self) -> NDArray:
        """Display unit of each reading."""
        return self._of_each(lambda g: np.array(g.units))

    @cached_property
    def reading(self) -> Array:
        """Readings, SI; not a number where planned."""
        return self._of_each(lambda g: np.array(np.nan) if g.readings is None else g.readings)

    @cached_property
    def predicted(self) -> Array:
        """Predictions, SI."""
        return self._of_each(lambda g: g.predicted)

    @cached_property
    def residual(self) -> Array:
        """Reading minus prediction, SI."""
        return self._of_each(lambda g: g.residual)

    @cached_property
    def u(self) -> Array:
        """Standard uncertainties, SI."""
        return self._of_each(lambda g: g.weighting.u)

    @cached_property
    def p_value(self) -> Array:
        """Of |w|, two-sided."""
        from scipy.special import erfc

        return np.asarray(erfc(np.abs(self.w) / np.sqrt(2)))

    def of(self, group: str) -> NDArray[np.bool_]:
        """Which readings belong to a group."""
        return self.group == group


def reliability(fit: Linearisation, level: float = 0.001, power: float = 0.8, *of: Any) -> Reliability:
    """Redundancy, test and detectability of every scalar reading.

    fit: a linearisation; level: of the w-test for the minimal detectable bias; power: of detecting it; of: results
    whose influence is wanted (all quantities if not given).
    Returns a Reliability.
    Source: Baarda (1968), A testing procedure for use in geodetic networks; correlated readings: Wang and Chen (1994).
    """
    bias = NormalDist().inv_cdf(1 - level / 2) + NormalDist().inv_cdf(power)
    functions = fit.functions(*of) if of or fit.results else None
    through, labels = None, functions.labels if functions is not None else ()
    if functions is not None and labels:
        through = np.zeros((len(labels), fit.layout.size))
        through[:, fit.layout.free_columns] = fit.factor.solve(fit.free_part(functions.derivatives).T).T
    found = [_group(fit, number, through) for number in range(len(fit.groups))]
    redundancy, weighed, scale, influences = (
        _one_after_another([p.reshape(p.shape[0] * p.shape[1], *p.shape[2:]) for p in parts])
        for parts in zip(*found, strict=True))
    hidden = ~(redundancy > INVISIBLE)
    weighed[hidden], scale[hidden] = 0.0, 1.0  # in place: of a large network every copy counts
    w = np.divide(weighed, scale, out=weighed)
    mdb = np.divide(bias, scale, out=scale)
    influence = {label: np.where(hidden, 0.0, influences[:, k] * mdb) for k, label in enumerate(labels)}
    mdb[hidden] = np.inf
    return Reliability(fit.groups, redundancy, w, mdb, influence, level, power)


def _one_after_another(arrays: Sequence[NDArray]) -> NDArray:
    """Joined arrays; a single one is not copied."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _group(fit: Linearisation, number: int, through: Array | None) -> tuple[Array, Array, Array, Array]:
    """Redundancy, P v and the root of (P - P J C J' P)_ii of a group, all (n, dim), and what a bias of one unit changes
    (n, dim, k)."""
    group = fit.groups[number]
    leverage = fit.leverages(number)
    if leverage is None or through is not None:
        return _piecewise(fit, group, through, leverage)
    weight = group.weighting.weights[0].matrix
    redundancy = np.subtract(1.0, leverage, out=leverage)
    return redundancy, weight * group.residual, np.sqrt(np.maximum(weight * redundancy, 0.0)), np.zeros(
        (*redundancy.shape, 0))


def _piecewise(fit: Linearisation, group: Group, through: Array | None, known: Array | None
               ) -> tuple[Array, Array, Array, Array]:
    """The same by derivatives of some rows at a time; known: (J C J' P)_ii of readings (n, dim), where it is."""
    n, dim = group.residual.shape
    redundancy, weighed, scale = np.empty((n, dim)), np.empty((n, dim)), np.empty((n, dim))
    influence = np.zeros((n, dim, 0 if through is None else len(through)))
    source = group.source(fit.layout.free)
    for mixing in group.weighting.weights:
        for blocks in pieces(len(mixing.rows), mixing.rows.shape[1]):
            residual, derivatives = whitened(source, mixing, blocks)  # rows of P J and P v
            pull = _joined((source.columns[a][mixing.rows[blocks, j]], one) for (j, a), one in derivatives.items())
            targets = len(residual) // dim  # blocks list their own rows first
            rows = mixing.rows[blocks, :targets]
            own = mixing.matrix[blocks].T if mixing.matrix.ndim == 2 else np.einsum(
                "mdd->dm", mixing.matrix[blocks, :, : len(residual)])
            if known is not None:
                hat = known[rows[:, 0]].T
                leverage = hat * own
            else:
                leverage = _variance(fit, pull, pull)  # (P J C J' P)_ii
                # (J C J' P)_ii is the same over P_ii where readings are independent
                hat = leverage / own if mixing.matrix.ndim == 2 else _variance(fit, _plain(source, rows), pull)

            def placed(numbers: Array, rows: Index = rows, targets: int = targets) -> Array:
                return np.reshape(numbers.T, (len(rows), targets, dim, *numbers.shape[:-2]))

            redundancy[rows] = placed(1.0 - hat)
            weighed[rows] = placed(residual)
            scale[rows] = placed(np.sqrt(np.maximum(own - leverage, 0.0)))
            if through is not None:
                influence[rows] = placed(sum(
                    np.einsum("fdm,kmf->kdm", one, through[:, columns]) for columns, one in pull))
    return redundancy, weighed, scale, influence


Derived = list[tuple[Index, Array]]  # columns (m, f) and derivatives (f, d, m) of the same d numbers in m blocks


def _joined(derived: Iterable[tuple[Index, Array]]) -> Derived:
    """The same with those of equal columns added: rows of a block mostly share their unknowns."""
    found: dict[bytes, tuple[Index, Array]] = {}
    for columns, one in derived:
        key = np.ascontiguousarray(columns).tobytes()
        found[key] = (columns, found[key][1] + one if key in found else one)
    return list(found.values())


def _plain(source: Source, rows: Index) -> Derived:
    """Derivatives of the readings of rows (m, k) themselves, row after row in blocks of k."""
    k = rows.shape[1]
    residual, derivatives = source.evaluate(rows.ravel())
    dim, found = len(residual), []
    for columns, one in zip(source.columns, derivatives, strict=True):
        for j in range(k):
            whole = np.zeros((len(one), k * dim, len(rows)))
            whole[:, j * dim : (j + 1) * dim] = one[:, :, j::k]
            found.append((columns[rows[:, j]], whole))
    return _joined(found)


def _variance(fit: Linearisation, first: Derived, second: Derived) -> Array:
    """Diagonal (d, m) of first C second' of the same blocks; each pair once where both are the same."""
    if isinstance(fit.factor, DenseFactor) and len(first) > MANY:
        left = _through(fit, first, fit.factor.root)
        right = left if first is second else _through(fit, second, fit.factor.root)
        return np.asarray(np.einsum("dmk,dmk->dm", left, right))
    position, total = fit.layout.position, np.zeros(1)
    for i, (a, left) in enumerate(first):
        for k, (b, right) in enumerate(second):
            if first is second and k < i:
                continue
            between = np.ascontiguousarray(fit.factor.between(position[a], position[b]).transpose(1, 2, 0))
            both = np.einsum("gdm,gdm->dm", np.einsum("fdm,fgm->gdm", left, between), right)
            total = total + (2 * both if first is second and k > i else both)
    return total


def _through(fit: Linearisation, derived: Derived, root: Array) -> Array:
    """Derivatives of the same d numbers in m blocks times a root (p, rank) of the covariance: (d, m, rank)."""
    _, d, m = derived[0][1].shape
    whole = np.zeros((d, m, len(root) + 1))  # the last place takes what is held
    for columns, one in derived:
        for place, column in zip(fit.layout.position[columns].T, one, strict=True):
            whole[:, np.arange(m), place] += column
    return np.asarray(whole[:, :, :-1] @ root)
