"""The scalar readings of candidates in the coordinates of a choice: what their reliability follows from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.analyse.selection.candidates import Candidates
from calib.blocks import Array, Mixing
from calib.linearisation import Group

UNCHECKED = 1e-12


@dataclass(frozen=True)
class Readings:
    """N scalar readings: group, label, display unit and candidate of each (-1 where it is always kept).

    left, right: (N, p) derivatives of the readings and of P times the readings, free of what each candidate spends on
    unknowns of its own; base: (N,) redundancy, and weight: (N,) of P Q_vv P, before anything is spent on what
    candidates share; independent: whether right is left times the weight everywhere.
    """

    groups: tuple[str, ...]
    labels: tuple[str, ...]
    units: tuple[str, ...]
    owner: NDArray[np.int64]
    left: Array
    right: Array
    base: Array
    weight: Array
    independent: bool

    def redundancy(self, kept: NDArray[np.bool_], root: Array) -> Array:
        """Redundancy numbers of the kept readings, for the inverse information root root'."""
        spent = np.sum((self.left[kept] @ root) * (self.right[kept] @ root), axis=1)
        return np.asarray(np.maximum(self.base[kept] - spent, 0.0) if self.independent else self.base[kept] - spent)

    def control(self, kept: NDArray[np.bool_], root: Array) -> Array:
        """Square root of (P Q_vv P)_ii of the kept readings: bias over it is the minimal detectable one."""
        weight = self.weight[kept]
        left = weight - np.sum((self.right[kept] @ root) ** 2, axis=1)
        return np.sqrt(np.maximum(left, UNCHECKED * weight))


def readings_of(candidates: Candidates) -> Readings:
    """The readings of all groups but priors."""
    fit = candidates.fit
    groups: list[str] = []
    labels: list[str] = []
    units: list[str] = []
    owners, plains, weighteds, weights, independent = [], [], [], [], True
    for group in fit.groups:
        if group.is_prior:
            continue
        plain, weighted, own, alone = _derivatives(candidates, group)
        independent &= alone
        dim = group.residual.shape[1]
        groups += [group.name] * (len(group.rows) * dim)
        labels += [f"{group.name} row {r}{' ' + c if c else ''}" for r in group.rows for c in group.components]
        units += list(group.units) * len(group.rows)
        owners.append(np.repeat(candidates.members[group.name], dim))
        plains.append(plain)
        weighteds.append(weighted)
        weights.append(own)
    owner, left, right, weight = (np.concatenate(each) for each in (owners, plains, weighteds, weights))
    base = np.ones(len(owner))
    if not candidates.shared.all():
        left, right, base, weight = _without_own_unknowns(candidates, owner, left, right, weight)
    return Readings(tuple(groups), tuple(labels), tuple(units), owner, left @ candidates.root,
                    right @ candidates.root, base, weight, independent)


def _derivatives(candidates: Candidates, group: Group) -> tuple[Array, Array, Array, bool]:
    """Derivatives of the readings, of P times the readings, and the diagonal of P, reading by reading."""
    position, size = candidates.fit.layout.position, len(candidates.fit.layout.free_columns)
    n, dim = group.residual.shape
    whole = Mixing(np.arange(n)[:, None], np.ones((n, dim))).apply(group.residual, group.parts)
    plain = whole.dense(position, size)
    weighted, own, alone = np.zeros((n, dim, size)), np.zeros((n, dim)), True
    for mixing in group.weighting.weights:
        block = mixing.apply(group.residual, group.parts)
        count = block.residual.shape[1]
        rows = mixing.rows[:, : count // dim]
        weighted[rows] = block.dense(position, size).reshape(len(rows), -1, dim, size)
        diagonal = mixing.matrix.ndim == 2
        alone &= diagonal or (count == dim == 1 and mixing.rows.shape[1] == 1)
        own[rows] = (mixing.matrix if diagonal else np.einsum("mdd->md", mixing.matrix[:, :, :count])
                     ).reshape(len(rows), -1, dim)
    return plain, weighted.reshape(n * dim, size), own.ravel(), alone


def _without_own_unknowns(candidates: Candidates, owner: NDArray[np.int64], left: Array, right: Array, weight: Array
                          ) -> tuple[Array, Array, Array, Array]:
    """Each candidate first determines the unknowns that only it sees, from its own readings."""
    left, right, base, weight = left.copy(), right.copy(), np.ones(len(owner)), weight.copy()
    private = np.flatnonzero(~candidates.shared)
    for candidate in np.unique(owner[owner >= 0]):
        mine = np.flatnonzero(owner == candidate)
        columns = private[np.any(left[np.ix_(mine, private)] != 0, axis=0)]
        if not columns.size:
            continue
        a, pa = left[np.ix_(mine, columns)], right[np.ix_(mine, columns)]
        normal = a.T @ pa
        scale = 1.0 / np.sqrt(np.diag(normal))
        inverse = scale[:, None] * np.linalg.pinv(normal * np.outer(scale, scale), 1e-12, True) * scale
        through = inverse @ (pa.T @ left[mine])      # how the own unknowns follow the shared ones
        base[mine] -= np.einsum("ij,jk,ik->i", a, inverse, pa)
        weight[mine] -= np.einsum("ij,jk,ik->i", pa, inverse, pa)
        left[mine] -= a @ through
        right[mine] -= pa @ through
    return left, right, base, weight
