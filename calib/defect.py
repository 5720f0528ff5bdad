"""Rank defects in words: which combination of unknowns changes no reading, and what would cure it."""

from __future__ import annotations

import numpy as np

from calib import units
from calib.blocks import Array
from calib.layout import Layout

SHOWN = 8  # directions that a message lists

def simplest_basis(directions: Array, weights: Array) -> Array:
    """Null-space directions (p, k) recombined so that each involves as few columns as elimination can make it.

    weights: (p,) size of each column, so that directions in different units are comparable.
    """
    basis = (directions * weights[:, None]).T.copy()
    taken: list[int] = []
    for k in range(len(basis)):
        rest = np.abs(basis[k:])
        rest[:, np.array(taken, dtype=int)] = 0.0
        row, column = (int(place) for place in np.unravel_index(int(np.argmax(rest)), rest.shape))
        basis[[k, k + row]] = basis[[k + row, k]]
        basis[k] /= basis[k, column]
        others = np.delete(np.arange(len(basis)), k)
        basis[others] -= np.outer(basis[others, column], basis[k])
        taken.append(column)
    basis[np.abs(basis) < 1e-7] = 0.0
    return basis.T / weights[:, None]


def direction_in_words(layout: Layout, direction: Array) -> str:
    """One direction (p,) over the free columns, largest first, in the display units of the unknowns."""
    shown = [
        (layout.label(c), layout.unit(c), d / units.factor(layout.unit(c)))
        for c, d in zip(layout.free_columns.tolist(), direction, strict=True)
        if d != 0.0
    ]
    largest = max(abs(value) for *_, value in shown)
    shown = sorted(((label, unit, value / largest) for label, unit, value in shown), key=lambda item: -abs(item[2]))
    sign = np.sign(shown[0][2])
    kept = [(label, unit, sign * value) for label, unit, value in shown if abs(value) > 1e-6]
    words = " ".join(
        f"{'-' if value < 0 else '+'} {abs(value):.3g} {'' if unit == '1' else unit + ' '}{label}"
        for label, unit, value in kept[:6]
    )
    more = f" and {len(kept) - 6} more" if len(kept) > 6 else ""
    return words.removeprefix("+ ") + more


def cure(alone: bool) -> str:
    """What to do about a direction that changes no reading; alone: whether it moves a single unknown."""
    return (
        "hold it, add a prior, or add readings that see it"
        if alone
        else "hold one of them, add a prior, or add readings that tell them apart"
    )


def defect_in_words(layout: Layout, null: Array, sizes: Array) -> list[str]:
    """Each direction of a null space (p, k) as a sentence with its cure; sizes: (p,) of the columns."""
    basis = simplest_basis(null, sizes)
    sentences = []
    for k in range(basis.shape[1]):
        words = direction_in_words(layout, basis[:, k])
        sentences.append(f"{words} changes no reading; {cure(np.count_nonzero(basis[:, k]) == 1)}")
    return sentences


def together(sentences: list[str]) -> str:
    """Sentences of directions in one line: the first few, and how many more there are."""
    more = len(sentences) - SHOWN
    return "; ".join(sentences[:SHOWN]) + (f"; and {more} more of this kind" if more > 0 else "")
