"""A linearisation of which only some rows are kept, so that every analysis can be asked of a choice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Mixing, Part
from calib.linearisation import Group, Linearisation
from calib.uncertainty import Weighting


def reduced(fit: Linearisation, masks: Mapping[str, NDArray[np.bool_]]) -> Linearisation:
    """The same linearisation with only some rows: {group: (n,) true where a row stays}; other groups stay whole.

    Rows whose errors are correlated stay or go together. A group of which nothing stays is left out.
    """
    groups = [_kept(g, masks[g.name]) if g.name in masks else g for g in fit.groups]
    return replace(fit, groups=tuple(g for g in groups if len(g.rows)))


def _kept(group: Group, mask: NDArray[np.bool_]) -> Group:
    if mask.all():
        return group
    place = np.cumsum(mask) - 1

    def still(mixings: tuple[Mixing, ...]) -> tuple[Mixing, ...]:
        chosen = [(m, mask[m.rows].all(axis=1)) for m in mixings]
        return tuple(Mixing(place[m.rows[c]], m.matrix[c]) for m, c in chosen if c.any())

    weighting = group.weighting
    return replace(
        group,
        rows=group.rows[mask],
        readings=None if group.readings is None else group.readings[mask],
        predicted=group.predicted[mask],
        residual=group.residual[mask],
        weighting=Weighting(weighting.u[mask], still(weighting.whitening), still(weighting.weights),
                            still(weighting.factors)),
        parts=tuple(Part(p.columns[mask], p.jacobian[mask]) for p in group.parts),
        covariates={name: np.asarray(values)[mask] for name, values in group.covariates.items()},
        counted=group.counted[mask],
    )
