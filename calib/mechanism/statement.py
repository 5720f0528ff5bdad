"""The smallest set of parameters that readings can know, found by itself and explained in the user's names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib import units
from calib.linearisation import Linearisation
from calib.mechanism.axis import Array
from calib.unknown import Selection

DEPENDENT = 1e-7      # remainder of a column, relative to itself, below which the kept ones explain it
ROUNDING = 1e-12  # length of a column, relative to the longest, that is rounding: cos(90 degrees) and the like
UNSEEN = 1e-6  # change of all readings together, in units of u, by the largest plausible size, that counts as none


@dataclass(frozen=True)
class Confounded:
    """A parameter that these readings cannot tell from kept ones: its label, a sentence, and the selection to hold."""

    label: str
    sentence: str
    selection: Selection


@dataclass(frozen=True)
class Statement:
    """What these poses and this instrument can know.

    kept: labels of the parameters that are estimable together; confounded: those that are not, each with its sentence;
    weak: sentences on kept parameters that the readings know worse than their largest plausible size.
    """

    kept: tuple[str, ...]
    confounded: tuple[Confounded, ...]
    weak: tuple[str, ...]

    @property
    def to_hold(self) -> tuple[Selection, ...]:
        """What to hold so that all that is left free can be known: `problem.hold(*statement.to_hold)`."""
        return tuple(c.selection for c in self.confounded)

    def __str__(self) -> str:
        lines = [f"{len(self.kept)} parameters can be known: {', '.join(self.kept)}."]
        lines += [c.sentence for c in self.confounded] + list(self.weak)
        return "\n".join(lines)


def minimal(fit: Linearisation, prefer: Sequence[Any] = ()) -> Statement:
    """Choose the parameters that the readings can know among those that are free.

    fit: a linearisation with everything free that might be estimated (readings are not needed: it may be a plan, a rank
    defect is expected); prefer: unknowns or effects to keep first, in this order. Unknowns that are no effects (places
    of instruments and targets) are kept before all effects, effects in the order in which they are attached.
    Source: Hollerbach and Wampler, Int. J. Robotics Research 15(6), 1996 (identifiable parameters by orthogonal
    factors), with the order of preference in place of column pivoting.
    """
    layout = fit.layout
    matrix, _ = fit.rows
    columns = np.asarray(matrix.todense())
    order = _order(fit, prefer)
    size = np.linalg.norm(columns, axis=0)
    size[size < ROUNDING * size.max(initial=0.0)] = 0.0
    largest = _largest(fit)
    for place, column in enumerate(layout.free_columns):
        if int(column) in largest and size[place] * largest[int(column)] < UNSEEN:
            size[place] = 0.0
    basis: list[Array] = []
    kept: list[int] = []
    confounded = []
    for place in order:
        remainder = columns[:, place] / size[place] if size[place] > 0 else np.zeros(len(columns))
        if basis:
            frame = np.stack(basis, axis=1)
            for _ in range(2):      # twice is enough (Kahan): the remainder is then orthogonal to rounding
                remainder = remainder - frame @ (frame.T @ remainder)
        length = float(np.linalg.norm(remainder))
        if length > DEPENDENT:
            basis.append(remainder / length)
            kept.append(place)
        else:
            hidden = int(layout.free_columns[place])
            unknown, instance, part = layout.place(hidden)
            confounded.append(Confounded(layout.label(hidden), _sentence(fit, place, kept, columns, size),
                                         Selection(unknown, np.array([instance]), (part,))))
    return Statement(tuple(layout.label(int(layout.free_columns[k])) for k in kept), tuple(confounded),
                     _weak(fit, kept, columns, size))


def _order(fit: Linearisation, prefer: Sequence[Any]) -> list[int]:
    """Places among the free columns: what is preferred, then what is no effect, then effects as attached."""
    layout, order = fit.layout, []
    effects = set(fit.effects.values())
    chosen = [fit.effects.get(what, what) for what in prefer]
    for unknown in [*chosen, *(u for u in layout.unknowns if u not in effects), *fit.effects.values()]:
        places = layout.position[layout.span(unknown)]
        order += [int(p) for p in places if p >= 0 and int(p) not in order]
    return order


def _sentence(fit: Linearisation, place: int, kept: Sequence[int], columns: Array, size: Array) -> str:
    layout = fit.layout

    def unit(p: int) -> str:
        return layout.unit(int(layout.free_columns[p]))

    def label(p: int) -> str:
        return layout.label(int(layout.free_columns[p]))
    if size[place] == 0:
        return f"{label(place)} changes no reading; it is held. Readings that see it would free it."
    frame = columns[:, list(kept)] / size[list(kept)]
    shares = np.linalg.lstsq(frame, columns[:, place] / size[place], rcond=None)[0]
    terms: list[str] = []
    for p, share in sorted(zip(kept, shares, strict=True), key=lambda item: -abs(item[1])):
        if abs(share) > 1e-5 and len(terms) < 5:
            amount = share * size[place] / size[p] * units.factor(unit(place)) / units.factor(unit(p))
            terms.append(f"{amount:+.3g} {unit(p)} {label(p)}".replace(" 1 ", " "))
    return (f"{label(place)} cannot be told from others and is held: 1 {unit(place)} of it changes the readings as "
            f"{', '.join(terms)} would. Hold one of those instead, add a prior, or readings that tell them apart.")


def _weak(fit: Linearisation, kept: Sequence[int], columns: Array, size: Array) -> tuple[str, ...]:
    places = list(kept)
    inverse = np.linalg.inv(np.linalg.qr(columns[:, places] / size[places], mode="r"))
    u = np.linalg.norm(inverse, axis=1) / size[places]
    plausible = _largest(fit)
    sentences = []
    for place, uncertainty in zip(places, u, strict=True):
        column = int(fit.layout.free_columns[place])
        if column in plausible and uncertainty > plausible[column]:
            unit = fit.layout.unit(column)
            sentences.append(f"{fit.layout.label(column)} can be known, but only to u = "
                             f"{uncertainty / units.factor(unit):.3g} {unit}, more than its largest plausible size "
                             f"{plausible[column] / units.factor(unit):.3g} {unit}: hold it, or give it a prior.")
    return tuple(sentences)


def _largest(fit: Linearisation) -> dict[int, float]:
    """Largest plausible size of the parameter in each column of an effect."""
    largest = {}
    for effect, unknown in fit.effects.items():
        for i, column in enumerate(range(*fit.layout.span(unknown).indices(fit.layout.size))):
            largest[column] = effect.parameters[i % unknown.freedom].plausible[1]
    return largest
