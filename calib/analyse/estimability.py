"""Estimability: which combinations of unknowns no reading sees, in the user's words, and what would cure it."""

from __future__ import annotations

from dataclasses import dataclass

from calib.defect import defect_in_words
from calib.linearisation import Linearisation


@dataclass(frozen=True)
class Estimability:
    """defect: number of directions that change no reading; directions: each as a sentence with its cure;
    condition: of the column-scaled whitened derivatives (infinite with a defect)."""

    defect: int
    directions: tuple[str, ...]
    condition: float


def estimability(fit: Linearisation) -> Estimability:
    """Name the directions of the free unknowns that cannot be known.

    fit: a linearisation. Returns the rank defect, its directions in words, and the condition number.
    """
    directions = defect_in_words(fit.layout, fit.factor.null, fit.sizes) if fit.factor.defect else []
    return Estimability(fit.factor.defect, tuple(directions), fit.factor.condition)
