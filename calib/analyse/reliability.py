"""Reliability in the sense of Baarda: redundancy numbers, w-tests, minimal detectable biases and their influence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from statistics import NormalDist

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

    group, row, component: where each stands; unit: display unit; reading, predicted, residual, u: SI (reading is not a
    number where planned); redundancy: (Q_vv P)_ii in [0, 1]; w: standardised residual; p_value: of |w|, two-sided;
    mdb: minimal detectable bias, SI, infinite where nothing controls the reading;
    influence: {result: (N,)} change of the result by a bias of size mdb, SI (zero where the mdb is infinite).
    """

    group: NDArray
    row: NDArray
    component: NDArray
    unit: NDArray
    reading: Array
    predicted: Array
    residual: Array
    u: Array
    redundancy: Array
    w: Array
    p_value: Array
    mdb: Array
    influence: Mapping[str, Array]
    level: float
    power: float

    def __len__(self) -> int:
        return len(self.row)

    def of(self, group: str) -> NDArray[np.bool_]:
        """Which readings belong to a group."""
        return self.group == group


def reliability(fit: Linearisation, level: float = 0.001, power: float = 0.8) -> Reliability:
    """Redundancy, test and detectability of every scalar reading.

    fit: a linearisation; level: of the w-test for the minimal detectable bias; power: of detecting it.
    Returns a Reliability.
    Source: Baarda (1968), A testing procedure for use in geodetic networks; correlated readings: Wang and Chen (1994).
    """
    bias = NormalDist().inv_cdf(1 - level / 2) + NormalDist().inv_cdf(power)
    functions = fit.functions() if fit.results else None
    through = None
    if functions is not None and len(functions.labels):
        through = np.zeros((len(functions.labels), fit.layout.size))
        through[:, fit.layout.free_columns] = fit.factor.solve(fit.free_part(functions.derivatives).T).T
    found = [_group(fit, group, through) for group in fit.groups]
    columns = {name: np.concatenate([one[name] for one in found]) for name in found[0]} if len(found) > 1 else found[0]
    influences = columns.pop("influence")
    from scipy.special import erfc

    scale, redundancy = columns.pop("scale"), columns["redundancy"]
    controlled = redundancy > INVISIBLE
    safe = np.where(controlled, scale, 1.0)
    w = np.where(controlled, columns.pop("weighed") / safe, 0.0)
    mdb = np.where(controlled, bias / safe, np.inf)
    influence = (
        {}
        if functions is None
        else {
            label: np.where(controlled, influences[:, k] * np.where(controlled, mdb, 0.0), 0.0)
            for k, label in enumerate(functions.labels)
        }
    )
    return Reliability(
        **columns, w=w, p_value=erfc(np.abs(w) / np.sqrt(2)), mdb=mdb, influence=influence, level=level, power=power
    )


def _group(fit: Linearisation, group: Group, through: Array | None) -> dict[str, NDArray]:
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
            if mixing.matrix.ndim == 2:
                leverage = _variance(fit, pull, pull)  # (P J C J' P)_ii
                hat = leverage / own  # (J C J' P)_ii of independent readings
            else:
                leverage, hat = _variance(fit, pull, pull), _variance(fit, _plain(source, rows), pull)

            def placed(numbers: Array, rows: Index = rows, targets: int = targets) -> Array:
                return np.reshape(numbers.T, (len(rows), targets, dim, *numbers.shape[:-2]))

            redundancy[rows] = placed(1.0 - hat)
            weighed[rows] = placed(residual)
            scale[rows] = placed(np.sqrt(np.maximum(own - leverage, 0.0)))
            if through is not None:
                influence[rows] = placed(sum(
                    np.einsum("fdm,kmf->kdm", one, through[:, columns]) for columns, one in pull))
    readings = np.full((n, dim), np.nan) if group.readings is None else group.readings
    return {
        "group": np.full(n * dim, group.name),
        "row": np.repeat(group.rows, dim),
        "component": np.tile(np.array(group.components), n),
        "unit": np.tile(np.array(group.units), n),
        "reading": readings.ravel(),
        "predicted": group.predicted.ravel(),
        "residual": group.residual.ravel(),
        "u": group.weighting.u.ravel(),
        "redundancy": redundancy.ravel(),
        "weighed": weighed.ravel(),
        "scale": scale.ravel(),
        "influence": influence.reshape(n * dim, -1),
    }


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
