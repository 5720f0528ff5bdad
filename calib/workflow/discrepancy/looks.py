"""Significance among many looks: tail probabilities, their correction, and how many independent looks there were."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array


def tail(drop: float, dof: int, scale: float, left_dof: int) -> float:
    """Probability of a larger drop: chi-squared where the noise is as stated (scale 1), else F."""
    return float(tails(np.array([drop]), np.array([dof]), np.array([scale]), np.array([left_dof]))[0])


def tails(drops: Array, dofs: NDArray[np.int64], scales: Array, left_dofs: NDArray[np.int64]) -> Array:
    """The same for many drops at once, (m,) each."""
    from scipy.special import fdtrc, gammaincc

    some = np.maximum(dofs, 1)
    chi = gammaincc(some / 2, drops / 2)
    p = np.where(scales == 1.0, chi, fdtrc(some, np.maximum(left_dofs, 1), drops / some / scales))
    return np.where(dofs == 0, 1.0, p)


def corrected(p: float, looks: float) -> float:
    """Probability of so small a p-value among a number of looks (Sidak)."""
    return float(corrected_each(np.array([p]), looks)[0])


def corrected_each(p: Array, looks: float | Array) -> Array:
    """The same for many p-values at once."""
    return -np.expm1(looks * np.log1p(-np.minimum(p, 1 - 1e-16)))


def smallest_tails(drops: Array, dofs: NDArray[np.int64]) -> Array:
    """Smallest chi-squared tail probability in each column of drops (m, draws) with degrees of freedom (m,)."""
    from scipy.special import gammaincc

    kinds = np.unique(dofs)  # of one number of degrees of freedom the largest drop is the rarest
    largest = np.array([drops[dofs == kind].max(axis=0) for kind in kinds])
    return np.min(gammaincc(kinds[:, None] / 2, largest / 2), axis=0)


def effective_looks(smallest: Array, at_most: int) -> float:
    """Number of independent looks whose smallest p-value would be as often as small as the simulated ones (draws,)."""
    middle = 1 / float(np.mean(-np.log1p(-np.minimum(smallest, 1 - 1e-12))))
    rare = np.log(0.95) / np.log1p(-float(np.clip(np.quantile(smallest, 0.05), 1e-12, 1 - 1e-12)))
    return float(np.clip(max(middle, rare), 1.0, max(at_most, 1)))
