"""Single records of a file, gathered into columns: what is correlated stays together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib import Gaussian
from problems.network.models import KINDS
from problems.network.survey import Array, Batch, Correlated


@dataclass(frozen=True)
class Record:
    """One reading as it stands in a file: ends (station, target, backsight), values and u in SI (u None where only a
    matrix states it), scale: SI of the unit of uncertainty of each value, heights of instrument and target [m]."""

    kind: str
    ends: tuple[str, str, str]
    values: tuple[float, ...]
    u: tuple[float | None, ...]
    scale: tuple[float, ...]
    unit: str
    heights: tuple[float, float]
    setting: str
    row: int
    line: int


def batches(clusters: Sequence[tuple[list[Record], Array | None]]) -> tuple[list[Batch], list[Correlated]]:
    """Columns of readings, kind by kind, and the clusters in which different kinds are correlated.

    clusters: records with their covariance matrix [SI], or None where each has its own u.
    """
    loose: dict[tuple[str, str], list[tuple[Record, Array]]] = {}
    bound: dict[tuple[str, str], list[tuple[list[Record], Array]]] = {}
    mixed: list[Correlated] = []
    for records, covariance in clusters:
        if covariance is None:
            for record in records:
                loose.setdefault((record.kind, record.unit), []).append((record, np.array(record.u, float)))
            continue
        for members, matrix in _connected(records, covariance):
            first = members[0]
            if np.count_nonzero(matrix - np.diag(np.diag(matrix))) == 0:
                spread = np.sqrt(np.diag(matrix))
                for record in members:
                    own, spread = spread[: len(record.values)], spread[len(record.values) :]
                    loose.setdefault((record.kind, record.unit), []).append((record, own))
            elif all((r.kind, r.unit) == (first.kind, first.unit) for r in members):
                bound.setdefault((first.kind, first.unit), []).append((members, matrix))
            else:
                singles = tuple(_batch([r], np.ones(len(r.values)), "") for r in members)
                mixed.append(Correlated(singles, matrix, f"cluster of row {first.row}", first.row))
    found = []
    for (kind, unit), pairs in loose.items():
        name = kind if sum(k == kind for k, _ in loose) == 1 else f"{kind} ({unit})"
        found.append(_batch([r for r, _ in pairs], np.array([u for _, u in pairs]), name))
    for (kind, unit), sets in bound.items():
        index = [i for i, (members, _) in enumerate(sets) for _ in members]
        u = Gaussian.groups(index, {i: matrix for i, (_, matrix) in enumerate(sets)})
        several = sum(k == kind for k, _ in (*loose, *bound)) > 1
        note = "" if sum(k == kind for k, _ in bound) == 1 else f", {unit}"
        name = f"{kind} (correlated{note})" if several else kind
        found.append(_batch([r for members, _ in sets for r in members], u, name))
    return found, mixed


def _connected(records: list[Record], covariance: Array) -> list[tuple[list[Record], Array]]:
    """The records that hang together by correlations, each set with its matrix."""
    from scipy.sparse.csgraph import connected_components

    of_value = np.repeat(np.arange(len(records)), [len(r.values) for r in records])
    linked = np.zeros((len(records), len(records)), dtype=bool)
    rows, columns = np.nonzero(covariance)
    linked[of_value[rows], of_value[columns]] = True
    count, label = connected_components(linked, directed=False)
    sets = []
    for k in range(count):
        inside = label[of_value] == k
        members = [r for r, own in zip(records, label, strict=True) if own == k]
        sets.append((members, covariance[np.ix_(inside, inside)]))
    return sets


def _batch(records: list[Record], u: Array | Gaussian, group: str) -> Batch:
    kind = records[0].kind
    return Batch(
        kind=kind,
        station=[r.ends[0] for r in records],
        target=[r.ends[1] for r in records],
        readings=np.array([r.values for r in records]),
        u=u,
        back=[r.ends[2] for r in records] if KINDS[kind].points == 3 else None,
        orientation=[r.setting for r in records] if kind == "direction" else None,
        station_height=np.array([r.heights[0] for r in records]),
        target_height=np.array([r.heights[1] for r in records]),
        group=group,
        unit=records[0].unit,
        rows=[r.row for r in records],
    )
