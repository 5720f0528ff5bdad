"""Unknowns on which predictions depend affinely, set to their best values for given others (variable projection).

Source: Golub and Pereyra (1973), SIAM Journal on Numerical Analysis 10(2); Ruhe and Wedin (1980), SIAM Review 22(3).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array
from calib.layout import Layout
from calib.system import System
from calib.uncertainty import Weighting
from calib.unknown import Unknown


def affine_columns(system: System) -> NDArray[np.bool_]:
    """Free columns (p,) in which every prediction is affine while the others stand still; none where there are
    conditions. Columns with a bound are left out."""
    layout, position = system.layout, system.layout.position
    size = len(layout.free_columns)
    bent = np.zeros((size + 1, size + 1), dtype=bool)  # the last place takes what is held
    for term in system.terms:
        if not term.traced.affine and any(term.any_free):
            columns = np.concatenate([c for c, want in zip(term.columns, term.any_free, strict=True) if want], axis=1)
            first, second = term.traced.bent_pairs(term.any_free)
            bent[position[columns[:, first]], position[columns[:, second]]] = True
    bent = bent[:-1, :-1] | bent[:-1, :-1].T
    lower, upper = (room[layout.free_columns] for room in layout.bounds(layout.start()))
    good: NDArray[np.bool_] = ~np.diag(bent) & np.isinf(lower) & np.isinf(upper) & (not system.conditions)
    for unknown in layout.unknowns:
        if unknown.kind != "vector":
            places = position[layout.span(unknown)]
            good[places[places >= 0]] = False
    while True:  # what multiplies most others stays a parameter of the bent part
        conflicts = (bent[good][:, good]).sum(axis=1)
        if not len(conflicts) or not conflicts.max():
            return good
        good[np.flatnonzero(good)[np.argmax(conflicts)]] = False


def projected(
    system: System, values: dict[Unknown, Array], weightings: Sequence[Weighting], columns: NDArray[np.bool_]
) -> dict[Unknown, Array]:
    """Values with the affine free columns (p,) at their best.

    Raises ModelBreakdown where the model gives no number at the values.
    """
    layout: Layout = system.layout
    chosen = layout.free_columns[columns]
    place = np.full(layout.size, -1)
    place[chosen] = np.arange(len(chosen))
    blocks = system.blocks(values, weightings)
    derivatives = np.concatenate([b.dense(place, len(chosen)) for b in blocks])
    residual = np.concatenate([b.residual.ravel() for b in blocks])
    scale = np.linalg.norm(derivatives, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    if not np.isfinite(derivatives).all():
        return values
    step = np.zeros(layout.size)
    step[chosen] = np.linalg.lstsq(derivatives / scale, residual, rcond=1e-12)[0] / scale
    return layout.move(values, step)
