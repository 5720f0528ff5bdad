"""What the residuals of each set of groups scatter, and how much of that scatter the estimate takes away.

Two ways to the same numbers: from the normal matrix of each set where the unknowns are few, and by passes over the rows
where they are many and no such matrix is wanted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from calib.analyse.reliability import reliability
from calib.blocks import Array, Block
from calib.elimination import DENSE_SIZE
from calib.linearisation import Group, Linearisation, pulled

PROBES = 64     # for a trace of a set with more readings: its relative error is about 0.2/sqrt(readings)
SEED = 71       # of the probes, so that a result repeats


class ByMatrices:
    """The scatter of sets of groups from the normal matrix of each.

    fit: a linearisation; sets: names of groups; what is in none keeps its stated uncertainty.
    """

    still = 1e-9    # change of a variance from one step to the next at which an iteration is done

    def __init__(self, fit: Linearisation, sets: Sequence[Sequence[str]]) -> None:
        named = {name for groups in sets for name in groups}
        rest = tuple(g.name for g in fit.groups if g.name not in named)
        sums = [_sums(fit, groups) for groups in (*sets, rest)]
        self.normals, self.pulls, self.squares, self.sizes = zip(*sums, strict=True)

    def _inverse(self, variance: Array) -> tuple[Array, Array]:
        """Weights of all sets and the covariance at variances (sets,)."""
        weights = np.append(1 / variance, 1.0)
        return weights, _pseudo_inverse(sum(w * n for w, n in zip(weights, self.normals, strict=True)))

    def at(self, variance: Array) -> tuple[Array, Array]:
        """Redundancy of each set, and its sum of squares in stated uncertainties, at variances (sets,) of them."""
        weights, inverse = self._inverse(variance)
        shift = inverse @ sum(w * p for w, p in zip(weights, self.pulls, strict=True))
        shares = [w * np.sum(inverse * n) for w, n in zip(weights, self.normals, strict=True)]
        redundancy = np.array(self.sizes)[:-1] - shares[:-1]
        left = [s - 2 * shift @ p + shift @ n @ shift
                for s, p, n in zip(self.squares, self.pulls, self.normals, strict=True)]
        return redundancy, np.array(left[:-1])

    def taken(self, variance: Array) -> Array:
        """tr(C N_a C N_b) of the normal matrices N of each two sets, C the covariance at variances (sets,)."""
        weights, inverse = self._inverse(variance)
        shares = [w * inverse @ n for w, n in zip(weights, self.normals, strict=True)][:-1]
        return np.array([[np.sum(a * b.T) for b in shares] for a in shares])


class ByPasses:
    """The same by passes over the rows."""

    still = 1e-6    # a pass costs as much as an adjustment; the variances themselves are known to a per cent at best

    def __init__(self, fit: Linearisation, sets: Sequence[Sequence[str]]) -> None:
        self.fit = replace(fit, results={})
        self.sets = [[g for g in fit.groups if g.name in groups] for groups in sets]
        self.sizes = [sum(g.size for g in groups) for groups in self.sets]

    def _scaled(self, variance: Array) -> Linearisation:
        return self.fit.scaled({g.name: float(np.sqrt(v)) for v, groups in zip(variance, self.sets, strict=True)
                                for g in groups})

    def at(self, variance: Array) -> tuple[Array, Array]:
        """As of `ByMatrices`."""
        fit = self._scaled(variance)
        checked = reliability(fit)
        of_group = {g.name: float(checked.redundancy[checked.of(g.name)].reshape(len(g.counted), -1)[g.counted].sum())
                    for g in fit.groups}
        (shift,) = _over_all(fit, fit.factor.solve(fit.pull[:, None]))
        left = [sum(float(np.sum((_counted(g, b.residual, b) - _counted(g, b.times(shift), b)) ** 2))
                    for g in groups for b in g.whitened) for groups in self.sets]
        return np.array([sum(of_group[g.name] for g in groups) for groups in self.sets]), np.array(left)

    def taken(self, variance: Array) -> Array:
        """As of `ByMatrices`, as the mean of |J_a C J_b' z|^2 over random signs z (Hutchinson 1990); of few readings,
        over each of them."""
        fit = self._scaled(variance)
        sets = [[b for g in fit.groups if g.name in {one.name for one in groups} for b in g.whitened]
                for groups in self.sets]
        found = np.zeros((len(sets), len(sets)))
        for b, blocks in enumerate(sets):
            probes = _probes([block.residual.shape for block in blocks])
            pulls = np.array([pulled(blocks, signs, fit.layout) for signs in probes])
            for step in _over_all(fit, fit.factor.solve(pulls.T)):
                found[:, b] += [sum(float(np.sum(one.times(step) ** 2)) for one in other) for other in sets]
        return (found + found.T) / 2


def _probes(shapes: Sequence[tuple[int, ...]]) -> Iterator[list[Array]]:
    """Arrays of some shapes, of which the sum of outer products is the unit matrix, or is so on average."""
    sizes = [int(np.prod(shape)) for shape in shapes]
    if sum(sizes) <= PROBES:
        rows: Array = np.eye(sum(sizes))
    else:
        rows = np.random.default_rng(SEED).choice([-1.0, 1.0], (PROBES, sum(sizes))) / np.sqrt(PROBES)
    for row in rows:
        parts = np.split(row, np.cumsum(sizes)[:-1])
        yield [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


def scatter(fit: Linearisation, sets: Sequence[Sequence[str]]) -> ByMatrices | ByPasses:
    """The scatter of sets of groups, in the way that the number of unknowns asks for."""
    return ByMatrices(fit, sets) if len(fit.layout.free_columns) <= DENSE_SIZE else ByPasses(fit, sets)


def _sums(fit: Linearisation, groups: Sequence[str]) -> tuple[Array, Array, float, int]:
    """Normal matrix, pull, sum of squares and number of scalar readings of some groups."""
    size, basis = len(fit.layout.free_columns), fit.conditions.basis
    normal, pull, square, count = np.zeros((size, size)), np.zeros(size), 0.0, 0
    for group in fit.groups:
        if group.name in groups:
            for block in group.whitened:
                rows = block.dense(fit.layout.position, size)
                normal += rows.T @ rows
                pull += rows.T @ block.residual.ravel()
            square += group.objective
            count += group.size
    return basis.T @ normal @ basis, basis.T @ pull, square, count


def _pseudo_inverse(matrix: Array) -> Array:
    scale = np.sqrt(np.diag(matrix))
    scale = np.where(scale > 0, scale, 1.0)
    return np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-13, hermitian=True) / np.outer(scale, scale)


def _over_all(fit: Linearisation, steps: Array) -> Array:
    """Steps (p, k) of the free columns as steps (k, size) of all columns."""
    found = np.zeros((steps.shape[1], fit.layout.size))
    found[:, fit.layout.free_columns] = steps.T
    return found


def _counted(group: Group, numbers: Array, block: Block) -> Array:
    return numbers[group.counted[block.rows[:, 0]]]
