"""Reliability in the sense of Baarda: redundancy numbers, w-tests, minimal detectable biases and their influence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array, Block, Mixing
from calib.linearisation import Group, Linearisation

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
    pieces = [_group(fit, group, through) for group in fit.groups]
    columns = {name: np.concatenate([p[name] for p in pieces]) for name in pieces[0]}
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
    for mixing in group.weighting.weights:
        block = mixing.apply(group.residual, group.parts)  # rows of P J and P v
        targets = block.residual.shape[1] // dim
        rows = mixing.rows[:, :targets]
        plain = _plain(group, rows)
        own = _own_weight(mixing, block.residual.shape[1])
        if mixing.matrix.ndim == 2:
            hat = own * _variance(fit, plain)  # (J C J' P)_ii of independent readings
            leverage = own * hat
        else:
            hat = _rowwise(fit, plain, block)  # (J C J' P)_ii
            leverage = _variance(fit, block)  # (P J C J' P)_ii
        redundancy[rows] = (1.0 - hat).reshape(len(rows), targets, dim)
        weighed[rows] = block.residual.reshape(len(rows), targets, dim)
        scale[rows] = np.sqrt(np.maximum(own - leverage, 0.0)).reshape(len(rows), targets, dim)
        if through is not None:
            change = np.zeros((*block.residual.shape, len(through)))
            for part in block.parts:
                change += np.einsum("mdf,kmf->mdk", part.jacobian, through[:, part.columns])
            influence[rows] = change.reshape(len(rows), targets, dim, -1)
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


def _plain(group: Group, rows: NDArray[np.int64]) -> Block:
    """Derivatives of the readings themselves, in the same blocks."""
    size = rows.shape[1] * group.residual.shape[1]
    identity = np.broadcast_to(np.eye(size), (len(rows), size, size))
    return Mixing(rows, np.ones((len(rows), size)) if rows.shape[1] == 1 else identity).apply(
        group.residual, group.parts
    )


def _own_weight(mixing: Mixing, size: int) -> Array:
    """Diagonal of P in each block (m, d); blocks list their own rows first."""
    return mixing.matrix if mixing.matrix.ndim == 2 else np.einsum("mdd->md", mixing.matrix[:, :, :size])


def _variance(fit: Linearisation, block: Block) -> Array:
    """Diagonal (m, d) of J C J' of a block: each pair of parts once."""
    position, total = fit.layout.position, np.zeros(block.residual.shape)
    parts = [p for p in block.parts if (position[p.columns] >= 0).any()]
    for i, a in enumerate(parts):
        for b in parts[i:]:
            between = fit.factor.between(position[a.columns], position[b.columns])
            both = np.einsum("mdf,mdf->md", a.jacobian @ between, b.jacobian)
            total += both if a is b else 2 * both
    return total


def _rowwise(fit: Linearisation, first: Block, second: Block) -> Array:
    """Diagonal (m, d) of first C second' for blocks over the same readings."""
    position, total = fit.layout.position, np.zeros(first.residual.shape)
    for a in first.parts:
        left = position[a.columns]
        if not (left >= 0).any():
            continue
        for b in second.parts:
            right = position[b.columns]
            if (right >= 0).any():
                total += np.einsum(
                    "mdf,mfg,mdg->md", a.jacobian, fit.factor.between(left, right), b.jacobian, optimize=True
                )
    return total
