"""Held-out check of an identification: readings of some rows predicted from the identification on all others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.mechanism.axis import Array
from calib.problem import Problem
from calib.solve.estimate import Estimate, predict, solve


def misses(problem: Problem, group: str, blocks: ArrayLike, errors: Sequence[Any], start: Estimate | None = None
           ) -> tuple[Array, Array]:
    """Residuals (n, dim) of every row of a group, predicted from the rows of the other blocks: as designed, identified.

    problem: with readings; group: of the rows held out; blocks: (n,) what is held out together; errors: the unknowns
    (or names) that an identification is about: held where they start for `as designed`, while all else is adjusted;
    start: an estimate of all rows, to start from.
    Raises InputError for a single block.
    """
    of_row = np.asarray(blocks)
    if len(np.unique(of_row)) < 2:
        raise InputError(f"'{group}' cannot be held out: all rows belong together, and nothing would be left to fit.")
    observations = next(o for o in problem.observations if o.group == group)
    found = []
    for variant in (problem.hold(*errors), problem):
        residuals = np.zeros(observations.recorded.shape)
        for block in np.unique(of_row):
            held_out = of_row == block
            estimate = solve(variant.keep({group: ~held_out}), start=start if variant is problem else None)
            seen = predict(variant.keep({group: held_out}), estimate)[group]
            residuals[held_out] = observations.recorded[held_out] - seen
        found.append(residuals)
    return found[0], found[1]


def rms(residuals: Array) -> float:
    """Root mean square of the lengths of residuals (n, dim): of a point, a turn, a reading."""
    return float(np.sqrt(np.mean(np.sum(np.asarray(residuals) ** 2, axis=1))))


def postures(positions: ArrayLike) -> np.ndarray:
    """The posture (n,) of each row of positions (n, axes), numbered from zero as they first appear."""
    _, first, of_row = np.unique(np.asarray(positions, float), axis=0, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[of_row.ravel()]


def in_order(posture: ArrayLike, count: int) -> np.ndarray:
    """Blocks (n,) of rows: postures that follow each other, in `count` parts of equal size."""
    numbers = np.asarray(posture)
    return numbers * count // (numbers.max() + 1)
