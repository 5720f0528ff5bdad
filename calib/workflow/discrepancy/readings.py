"""The scalar readings of a linearisation with all that is recorded about them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.linearisation import Group, Linearisation


@dataclass(frozen=True)
class Channel:
    """The scalar readings of one component of one group: where they stand among all, their rows and covariates.

    name: group and component; places (m,): among all whitened scalar rows; rows (m,): of the data file;
    covariates, units: recorded with each reading; order (m,): sorts them in time (or as they stand in the file).
    """

    name: str
    places: NDArray[np.int64]
    rows: NDArray
    covariates: dict[str, NDArray]
    units: dict[str, str]
    order: NDArray[np.int64]


def channels(fit: Linearisation) -> list[Channel]:
    """One channel for each component of each group of observations that is no prior."""
    found, begin = [], 0
    for group in fit.groups:
        for block in group.whitened:
            m, d = block.residual.shape
            if not group.is_prior and block.rows.shape[1] == 1:
                found += [_channel(group, block.rows[:, 0], begin + np.arange(m) * d + k, k) for k in range(d)]
            begin += m * d
    return found


def _channel(group: Group, inside: NDArray[np.int64], places: NDArray[np.int64], component: int) -> Channel:
    covariates = {name: np.asarray(values)[inside] for name, values in group.covariates.items()}
    name = " ".join(part for part in (group.name, group.components[component]) if part)
    time = covariates.get("time")
    order = np.arange(len(inside)) if time is None or time.dtype.kind not in "fiu" else np.argsort(time, kind="stable")
    return Channel(name, places, group.rows[inside], covariates, dict(group.covariate_units), order)


def row_numbers(fit: Linearisation) -> NDArray:
    """Row of the data file of every whitened scalar row; 0 for priors and for rows that mix several readings."""
    numbers = []
    for group in fit.groups:
        for block in group.whitened:
            alone = not group.is_prior and block.rows.shape[1] == 1
            numbers.append(
                np.repeat(
                    group.rows[block.rows[:, 0]] if alone else np.zeros(len(block.rows), dtype=int),
                    block.residual.shape[1],
                )
            )
    return np.concatenate(numbers)
