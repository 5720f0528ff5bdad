"""Stated uncertainties: the shared formulas that turn statements about an instrument into standard uncertainties.

`Lines` keeps the components of one standard uncertainty apart, so that a budget can list resolution, repeats and
limits of error line by line. Formulas: JCGM 100:2008 (GUM), 4.2 (Type A), 4.3 (Type B), F.2.2.1 (resolution).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from calib import Budget
from calib.errors import InputError


def _not_negative(value: ArrayLike, what: str) -> np.ndarray:
    value = np.asarray(value, dtype=float)
    if not np.all(np.isfinite(value)) or np.any(value < 0.0):
        raise InputError(f"{what} must be finite and not negative; it is {value}. State its magnitude in SI units.")
    return value


def rectangular(half_width: ArrayLike) -> np.ndarray:
    """Standard uncertainty of a quantity known only to lie within +- half_width: half_width/sqrt(3).

    half_width: any shape, SI. Returns the same shape and unit. Raises InputError where it is negative or not finite.
    Source: JCGM 100:2008, 4.3.7.
    """
    return _not_negative(half_width, "The half-width of a rectangular distribution") / np.sqrt(3.0)


def triangular(half_width: ArrayLike) -> np.ndarray:
    """Standard uncertainty of a symmetric triangular distribution: half_width/sqrt(6).

    half_width: any shape, SI. Returns the same shape and unit. Raises InputError where it is negative or not finite.
    Source: JCGM 100:2008, 4.3.9.
    """
    return _not_negative(half_width, "The half-width of a triangular distribution") / np.sqrt(6.0)


def arcsine(amplitude: ArrayLike) -> np.ndarray:
    """Standard uncertainty of a sinusoidal influence met at an unknown phase: amplitude/sqrt(2).

    amplitude: any shape, SI. Returns the same shape and unit. Raises InputError where it is negative or not finite.
    Source: JCGM 101:2008, 6.4.6.
    """
    return _not_negative(amplitude, "The amplitude of a sinusoidal influence") / np.sqrt(2.0)


def resolution(last_digit: ArrayLike) -> np.ndarray:
    """Standard uncertainty of reading to the nearest multiple of the last digit: last_digit/sqrt(12).

    last_digit: any shape, SI. Returns the same shape and unit. Raises InputError where it is negative or not finite.
    Source: JCGM 100:2008, F.2.2.1.
    """
    return _not_negative(last_digit, "The resolution") / np.sqrt(12.0)


def from_expanded(expanded: ArrayLike, coverage_factor: float = 2.0) -> np.ndarray:
    """Standard uncertainty from an expanded one: U/k.

    expanded: any shape, SI; coverage_factor: the k stated with it. Returns the shape and unit of `expanded`.
    Raises InputError where U is negative or k not positive. Source: JCGM 100:2008, 6.2.1.
    """
    if not coverage_factor > 0.0:
        raise InputError(f"The coverage factor must be positive; it is {coverage_factor}. Take the k stated with U.")
    return _not_negative(expanded, "The expanded uncertainty U") / coverage_factor


class TypeA(NamedTuple):
    """Mean of repeated readings, its standard uncertainty and degrees of freedom."""

    mean: np.ndarray
    u: np.ndarray
    dof: int


def repeats(readings: ArrayLike) -> TypeA:
    """Mean of n independent repeated readings and its Type A standard uncertainty s/sqrt(n).

    readings: (n,) or (n, dim), SI. Returns mean and u, () or (dim,), and n - 1 degrees of freedom.
    Raises InputError for fewer than two readings or a reading that is not finite. Source: JCGM 100:2008, 4.2.1 to
    4.2.3.
    """
    readings = np.asarray(readings, dtype=float)
    if readings.ndim == 0 or len(readings) < 2:
        raise InputError("One reading has no scatter: a Type A evaluation needs two or more. State its uncertainty "
                         "(Type B) instead.")
    if not np.all(np.isfinite(readings)):
        raise InputError("A repeated reading is not a finite number. Leave it out by name, with the reason.")
    count = len(readings)
    return TypeA(readings.mean(axis=0), readings.std(axis=0, ddof=1) / np.sqrt(count), count - 1)


def of_mean(u_single: ArrayLike, count: ArrayLike) -> np.ndarray:
    """Standard uncertainty of the mean of `count` independent readings of known repeatability: u/sqrt(count).

    u_single: repeatability of one reading, SI; count: number of readings averaged. Returns the broadcast shape, unit
    of u_single.
    Raises InputError where count is below 1. Source: JCGM 100:2008, 4.2.3 and 4.2.4 (pooled estimate).
    """
    if np.any(np.asarray(count) < 1):
        raise InputError(f"The mean of {np.asarray(count)} readings does not exist; the count must be 1 or more.")
    return _not_negative(u_single, "The repeatability") / np.sqrt(count)


@dataclass(frozen=True)
class Lines:
    """A standard uncertainty kept as named, independent lines.

    lines: name -> standard uncertainty in SI, shapes that broadcast together, such as {"repeats": ..., "resolution":
    ...}.
    """

    lines: Mapping[str, ArrayLike]

    @property
    def u(self) -> np.ndarray:
        """The combined standard uncertainty, root of the sum of squares (JCGM 100:2008, 5.1.2), broadcast shape, SI."""
        return np.sqrt(sum(np.square(_not_negative(u, name)) for name, u in self.lines.items()))

    def shares(self) -> dict[str, float]:
        """Share of each line in the variance, averaged over the readings; the shares sum to one.

        Returns name -> share. Raises InputError where the combined uncertainty of a reading is zero.
        """
        combined = self.u
        if np.any(combined == 0.0):
            raise InputError("A combined uncertainty is zero; every reading has an uncertainty: add the missing line.")
        return {name: float(np.mean(np.square(u) / np.square(combined))) for name, u in self.lines.items()}

    def split(self, contribution: float) -> dict[str, float]:
        """Split what one observation group contributes to the u of a result into these lines.

        contribution: u of the result that a budget shows for the group, SI. Returns name -> u of the result in the
        unit of `contribution`; exact where the lines are in the same proportion for all readings of the group, else
        by the average share.
        """
        return {name: float(contribution * np.sqrt(share)) for name, share in self.shares().items()}


def itemised(budget: Budget, lines: Mapping[str, Lines]) -> Budget:
    """A budget in which the contribution of an observation group is replaced by the lines of its stated uncertainty.

    budget: of one result; lines: group -> its lines. Each new label is `group: line`; the total does not change, but
    for a group whose readings do not have the lines in the same proportion the split is by the average share.
    Returns the budget, largest contribution first. Raises InputError for a group that the budget does not hold.
    """
    missing = sorted(set(lines) - {one.label for one in budget.contributions})
    if missing:
        raise InputError(f"The budget of {budget.name} has no line '{missing[0]}'; it has "
                         f"{', '.join(one.label for one in budget.contributions)}.")
    items = []
    for one in budget.contributions:
        shares = lines[one.label].shares() if one.label in lines else {"": 1.0}
        items += [replace(one, label=f"{one.label}: {name}" if name else one.label, u=one.u * np.sqrt(share),
                          share=one.share * share) for name, share in shares.items()]
    return replace(budget, contributions=tuple(sorted(items, key=lambda item: -item.u)))
