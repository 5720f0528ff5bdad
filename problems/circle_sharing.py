"""May both circles of a theodolite, or two theodolites, share the eccentricity of one target? A test before belief."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib import Linearisation, VarianceComponents, covariance


class Agreement(NamedTuple):
    """Whether two circles see one eccentricity: T, its p-value by the stated u and by the scatter found, verdict."""

    target: str
    statistic: float
    p_stated: float
    p_scatter: float
    accepted: bool


def sharing(
    fit: Linearisation, scatter: VarianceComponents, name: str = "circle difference", level: float = 0.01
) -> tuple[Agreement, ...]:
    """Test for each target whether both circles may share r and phase.

    fit: of a problem that does not share them, with the difference (a, b) as the quantity `name`; scatter: its variance
    components; level: of the test. Returns one line for each target: T = d' C^-1 d is chi-squared with 2 degrees of
    freedom where the stated uncertainties hold; T/2 with the estimated components is F(2, dof), and that decides,
    because a scatter above the stated one would refuse what the readings cannot tell.
    Source: Koch, Parameter Estimation and Hypothesis Testing in Linear Models, Springer 1999, section 4.2.
    """
    stated, found = covariance(fit, name), covariance(scatter.rescaled(fit), name)
    lines = []
    for i in range(0, len(stated.names), 2):
        target = stated.names[i].partition("[")[2].partition("]")[0]
        d, pair = stated.values[i : i + 2], slice(i, i + 2)
        t, t_found = (float(d @ np.linalg.solve(c.matrix[pair, pair], d)) for c in (stated, found))
        group = next(g for g in fit.groups if target in g.covariates.get("target", ()))
        dof = float(scatter.dof[scatter.names.index(group.name)])
        p_found = (1.0 + t_found / dof) ** (-dof / 2.0)
        lines.append(Agreement(target, t, float(np.exp(-t / 2.0)), p_found, p_found >= level))
    return tuple(lines)
