"""Variance components: by how much the scatter of each group departs from its stated uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.blocks import Array
from calib.errors import CalibrationError
from calib.linearisation import Linearisation


@dataclass(frozen=True)
class VarianceComponents:
    """Restricted maximum likelihood factors of the standard uncertainties, one for each set of groups.

    names; groups: of each set; stated_u: mean stated standard uncertainty (SI) and unit of each set;
    factor, u_factor: of the standard uncertainty; dof: effective degrees of freedom; redundancy: of each set.
    """

    names: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    stated_u: Array
    unit: tuple[str, ...]
    factor: Array
    u_factor: Array
    dof: Array
    redundancy: Array

    @property
    def factors(self) -> Mapping[str, float]:
        """{group: factor of its standard uncertainties}."""
        return {g: float(f) for groups, f in zip(self.groups, self.factor, strict=True) for g in groups}

    def rescaled(self, fit: Linearisation) -> Linearisation:
        """The linearisation with every standard uncertainty multiplied by its factor (the caller's visible act)."""
        return fit.scaled(self.factors)


def variance_components(
    fit: Linearisation, sets: Mapping[str, Sequence[str]] | Sequence[str] | None = None, iterations: int = 500
) -> VarianceComponents:
    """Estimate one variance component for each set of groups from the residuals at a linearisation.

    fit: a linearisation with readings; sets: {name: groups} or names of groups (default: every group that is no prior);
    iterations: at most. Returns factors of the stated standard uncertainties with their own uncertainty.
    Raises CalibrationError where a set has no redundancy or the iteration does not stand still.
    Source: Helmert's estimator iterated (Foerstner 1979), which is restricted maximum likelihood; its Fisher matrix
    gives u.
    """
    if sets is None:
        sets = [g.name for g in fit.groups if not g.is_prior]
    chosen = (
        {name: tuple(groups) for name, groups in sets.items()} if isinstance(sets, Mapping) else {n: (n,) for n in sets}
    )
    basis = fit.conditions.basis
    rest = [g.name for g in fit.groups if g.name not in {x for groups in chosen.values() for x in groups}]
    normals, pulls, squares, sizes = [], [], [], []
    for groups in [*chosen.values(), tuple(rest)]:
        normal, pull, square, size = _sums(fit, groups, basis)
        normals.append(normal)
        pulls.append(pull)
        squares.append(square)
        sizes.append(size)
    variance = np.ones(len(chosen))
    for _ in range(iterations):
        weights = np.append(1 / variance, 1.0)
        inverse = _pseudo_inverse(sum(w * n for w, n in zip(weights, normals, strict=True)))
        shift = inverse @ sum(w * p for w, p in zip(weights, pulls, strict=True))
        shares = [w * inverse @ n for w, n in zip(weights, normals, strict=True)]
        redundancy = np.array([size - np.trace(s) for size, s in zip(sizes, shares, strict=True)])[:-1]
        if np.any(redundancy < 1e-6):
            name = list(chosen)[int(np.argmin(redundancy))]
            raise CalibrationError(
                f"variance component '{name}' cannot be estimated: its readings have no redundancy; "
                "leave it out, or join it with another group."
            )
        left = np.array(
            [s - 2 * shift @ p + shift @ n @ shift for s, p, n in zip(squares, pulls, normals, strict=True)]
        )[:-1]
        updated = np.maximum(left / redundancy, 1e-12)
        still = np.max(np.abs(updated / variance - 1))
        variance = updated
        if still < 1e-9:
            break
    else:
        if still > 1e-4:
            raise CalibrationError(
                f"variance components do not stand still after {iterations} steps (last change "
                f"{still:.1e}); join groups that the data cannot tell apart."
            )
    fisher = np.array([[np.trace(a @ b) for b in shares[:-1]] for a in shares[:-1]])
    fisher += np.diag([size - 2 * np.trace(s) for size, s in zip(sizes[:-1], shares[:-1], strict=True)])
    spread = np.diag(np.linalg.inv(fisher))  # variance of each component = 2 spread component^2
    factor = np.sqrt(variance)
    first = [fit.group(groups[0]) for groups in chosen.values()]
    return VarianceComponents(
        tuple(chosen),
        tuple(chosen.values()),
        np.array([float(np.sqrt(np.mean(g.weighting.u[:, 0] ** 2))) for g in first]),
        tuple(g.units[0] for g in first),
        factor,
        factor * np.sqrt(spread / 2),
        1 / spread,
        redundancy,
    )


def _sums(fit: Linearisation, groups: Sequence[str], basis: Array) -> tuple[Array, Array, float, int]:
    """Normal matrix, pull, sum of squares and number of scalar readings of some groups."""
    size = len(fit.layout.free_columns)
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
