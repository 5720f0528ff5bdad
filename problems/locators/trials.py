"""The Monte Carlo of section 3: uniform errors through the exact model, and whether the pose errors are nearly normal.

Source: Li Chen, Fang Qiang, Li Jiangxiong 2010, section 3; test of normality: Jarque and Bera 1980.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Transform
from problems.locators.errors import SHIFTS, TURNS
from problems.locators.measured import Setup
from problems.locators.pose_error import SOURCES, Axes, LinearForm, exact_pose_errors


@dataclass(frozen=True)
class Trials:
    """Pose errors of random trials: exact (n, 6) from the exact model, linear (n, 6) from the linear form [mm, deg]."""

    exact: NDArray[np.float64]
    linear: NDArray[np.float64]

    @property
    def means(self) -> NDArray[np.float64]:
        """Expected pose error (6,) [mm, deg]: that of the linear part is zero, so only the rest is averaged."""
        return (self.exact - self.linear).mean(0)

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """Standard deviations (6,) [mm, deg]."""
        return self.exact.std(0, ddof=1)


def draw(mechanism: Setup, part_pose: Transform, driven: Axes, form: LinearForm, half_widths: NDArray[np.float64],
         count: int,
         seed: int) -> Trials:
    """Pose errors of trials with independent errors, uniform within their half widths.

    mechanism, part_pose, driven: as for `pose_error.declare`; form: its linear form; half_widths: (81,) [m or rad] in
    the order of its sources; count: of trials; seed.
    """
    errors = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, len(half_widths))) * half_widths
    by_locator = errors.reshape(count, 3, len(SOURCES))
    shifts, turns, balls = np.split(by_locator, [len(SHIFTS), len(SHIFTS) + len(TURNS)], axis=2)
    return Trials(exact_pose_errors(mechanism, part_pose, driven, shifts, turns, balls), errors @ form.response.T)


@dataclass(frozen=True)
class Normality:
    """Shape of a sample: skewness, excess kurtosis with its u, p-value of Jarque and Bera, share within 3 sigma."""

    skewness: float
    excess_kurtosis: float
    u_kurtosis: float
    p_value: float
    within_three_sigma: float


def normality(sample: NDArray[np.float64]) -> Normality:
    """Test a sample (n,) of any unit for normality."""
    n = len(sample)
    standard = (sample - sample.mean()) / sample.std()
    skewness, kurtosis = float(np.mean(standard ** 3)), float(np.mean(standard ** 4) - 3.0)
    statistic = n / 6.0 * (skewness ** 2 + kurtosis ** 2 / 4.0)
    return Normality(skewness, kurtosis, float(np.sqrt(24.0 / n)), float(np.exp(-statistic / 2.0)),
                     float(np.mean(np.abs(standard) < 3.0)))


def expected_excess_kurtosis(form: LinearForm, half_widths: NDArray[np.float64]) -> NDArray[np.float64]:
    """Excess kurtosis (6,) of sums of independent uniform errors: -6/5 sum v^2/(sum v)^2 over their variances v."""
    variances = (form.response * half_widths) ** 2
    return -1.2 * (variances ** 2).sum(1) / variances.sum(1) ** 2
