"""Covariance of unknowns and derived results, with the considered uncertainty of what is held."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib import units as unit_table
from calib.blocks import Array
from calib.defect import defect_in_words, together
from calib.errors import RankDefect
from calib.linearisation import Functions, Linearisation
from calib.unknown import Unknown


@dataclass(frozen=True)
class Covariance:
    """Values with their joint covariance; names, display units, values (k,), matrix (k, k), all numbers in SI."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    matrix: Array

    @property
    def u(self) -> Array:
        """Standard uncertainties (k,) in SI."""
        return np.sqrt(np.diag(self.matrix))

    @property
    def correlation(self) -> Array:
        """Correlation coefficients (k, k); zero where a standard uncertainty is zero."""
        u = self.u
        scale = np.where(u > 0, u, 1.0)
        # A result without a finite uncertainty has no correlation either: not a number, quietly.
        with np.errstate(invalid="ignore"):
            return self.matrix / np.outer(scale, scale)

    @property
    def displayed(self) -> list[tuple[str, float, float, str]]:
        """(name, value, u, unit) in display units."""
        return [
            (n, v / unit_table.factor(unit), u / unit_table.factor(unit), unit)
            for n, v, u, unit in zip(self.names, self.values, self.u, self.units, strict=True)
        ]

    def __getitem__(self, name: str) -> tuple[float, float]:
        """Value and standard uncertainty in SI of one name."""
        place = self.names.index(name)
        return float(self.values[place]), float(self.u[place])


@dataclass(frozen=True)
class Considered:
    """Held columns with a prior: labels, columns, their covariance (h, h), and how the free columns follow (p, h)."""

    labels: tuple[str, ...]
    columns: tuple[int, ...]
    covariance: Array
    response: Array


def considered(fit: Linearisation) -> Considered:
    """The held quantities with a prior, and the sensitivity of the estimate to them."""
    free = fit.layout.free
    position: dict[int, int] = {}
    for group in fit.groups:
        if group.is_prior and not group.counted.all():
            for part in group.parts:
                for column in part.columns[~group.counted].ravel():
                    if not free[column]:
                        position.setdefault(int(column), len(position))
    columns = tuple(position)
    if not columns:
        return Considered((), (), np.zeros((0, 0)), np.zeros((len(fit.layout.free_columns), 0)))
    place = np.full(fit.layout.size, -1)
    place[list(columns)] = np.arange(len(columns))
    information = np.zeros((len(columns), len(columns)))
    for group in fit.groups:
        if group.is_prior:
            for block in group.whitened:
                rows = block.dense(place, len(columns)).reshape(*block.residual.shape, -1)[
                    ~group.counted[block.rows[:, 0]]
                ]
                information += np.einsum("mda,mdb->ab", rows, rows)
    seen = np.diag(information) > 0
    columns = tuple(c for c, s in zip(columns, seen, strict=True) if s)
    covariance = np.linalg.inv(information[np.ix_(seen, seen)])
    derivatives, _ = fit.rows
    response = -fit.factor.solve(np.asarray(derivatives.T @ fit.held_columns(columns)))
    return Considered(tuple(fit.layout.label(c) for c in columns), columns, covariance, response)


def refuse_what_cannot_be_known(fit: Linearisation, functions: Functions) -> None:
    """Raise RankDefect where a function changes along a direction that no reading sees."""
    if not fit.factor.defect:
        return
    derivatives, null = fit.free_part(functions.derivatives), fit.factor.null
    size = fit.sizes      # without it the rounding in a null direction would count as much as the direction itself
    share = np.outer(np.linalg.norm(derivatives / size, axis=1), np.linalg.norm(null * size[:, None], axis=0))
    hidden = np.flatnonzero(np.any(np.abs(derivatives @ null) > 1e-7 * share, axis=1))
    if len(hidden):
        sentences = defect_in_words(fit.layout, null, size)
        raise RankDefect(
            f"'{functions.labels[hidden[0]]}' cannot be known from these readings: {together(sentences)}.",
            directions=sentences,
        )


def of_instances(fit: Linearisation, unknown: Unknown) -> Array:
    """Covariance of every instance of an unknown by itself, considered quantities included.

    fit: a linearisation; unknown: of any number of instances.
    Returns (count, freedom, freedom), in SI; zero where a part is held.
    """
    columns = fit.layout.position[fit.layout.span(unknown)].reshape(unknown.count, -1)
    held, moving = considered(fit), (columns >= 0).any(axis=1)
    free = columns[moving]
    response = np.where((free >= 0)[:, :, None], held.response[np.maximum(free, 0)], 0.0)
    found = np.zeros((*columns.shape, columns.shape[1]))
    found[moving] = fit.factor.between(free, free) + response @ held.covariance @ response.transpose(0, 2, 1)
    return found


def covariance(fit: Linearisation, *what: Any) -> Covariance:
    """Joint covariance of estimable functions: F (J'J)^-1 F', constraints and considered quantities included.

    fit: a linearisation; what: unknowns, selections, effects, quantities or their names (nothing: all quantities, else
    all free unknowns). Stated uncertainties are used as stated; nothing is scaled.
    Raises RankDefect where something asked for changes along a direction that no reading sees.
    """
    functions = fit.functions(*what)
    refuse_what_cannot_be_known(fit, functions)
    free = fit.free_part(functions.derivatives)
    matrix = fit.factor.covariance(free)
    held = considered(fit)
    if held.columns:
        sensitivity = functions.derivatives[:, list(held.columns)] + free @ held.response
        matrix = matrix + sensitivity @ held.covariance @ sensitivity.T
    return Covariance(functions.labels, functions.units, functions.values, matrix)
