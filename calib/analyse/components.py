"""Variance components: by how much the scatter of each group departs from its stated uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.analyse.scatter import scatter
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
    found = scatter(fit, list(chosen.values()))
    sizes = np.array(found.sizes[: len(chosen)])
    variance = np.ones(len(chosen))
    for _ in range(iterations):
        redundancy, left = found.at(variance)
        if np.any(redundancy < 1e-6):
            name = list(chosen)[int(np.argmin(redundancy))]
            raise CalibrationError(
                f"variance component '{name}' cannot be estimated: its readings have no redundancy; "
                "leave it out, or join it with another group."
            )
        updated = np.maximum(left / redundancy, 1e-12)
        still = np.max(np.abs(updated / variance - 1))
        if still < found.still:
            break
        variance = updated
    else:
        if still > 1e-4:
            raise CalibrationError(
                f"variance components do not stand still after {iterations} steps (last change "
                f"{still:.1e}); join groups that the data cannot tell apart."
            )
    fisher = found.taken(variance) + np.diag(2 * redundancy - sizes)
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
