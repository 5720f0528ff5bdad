"""The objective of a choice: the worst of one or several terms over the same candidates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.analyse.selection.terms import Term, Trace, projected
from calib.blocks import Array


@dataclass(frozen=True, eq=False)
class Objective:
    """The largest loss of several terms (usually one) over the same n candidates."""

    terms: tuple[Term, ...]

    @property
    def count(self) -> int:
        """Number of candidates."""
        return len(self.terms[0].rows)

    @property
    def single(self) -> bool:
        """Whether it is one smooth term."""
        return len(self.terms) == 1 and self.terms[0].smooth

    @cached_property
    def stand_in(self) -> Objective:
        """What a search begins with: the trace in place of the largest of several values, which every row helps."""
        if self.single or len(self.terms) > 1:
            return self
        term = self.terms[0]
        return Objective((Trace(term.rows, term.fixed, term.functions),))

    def loss(self, chosen: Sequence[int]) -> float:
        """Loss of a choice, infinite where something asked for cannot be known."""
        return float(self.losses(np.asarray([list(chosen)], dtype=np.int64))[0])

    def losses(self, choices: Array) -> Array:
        """Losses (b,) of choices (b, k) of candidates."""
        worst = np.full(len(choices), -np.inf)
        for term, products in zip(self.terms, self._products, strict=True):
            if products is None:
                information = np.array([term.information(np.bincount(c, minlength=self.count) * 1.0) for c in choices])
            else:
                information = term.fixed + products[choices].sum(axis=1)
            worst = np.maximum(worst, term.loss(information))
        return worst

    @cached_property
    def _products(self) -> tuple[Array | None, ...]:
        """A'A of each candidate, where that is small enough to keep."""
        return tuple(
            np.einsum("nmi,nmj->nij", term.rows, term.rows) if len(term.rows) * term.rows.shape[2] ** 2 < 4e6 else None
            for term in self.terms)

    def after(self, inverses: Sequence[Array], among: Array) -> Array:
        """Losses after each candidate of `among` is added to what has these inverse informations, one a term."""
        losses = [t.after(c, t.rows[among]) for t, c in zip(self.terms, inverses, strict=True)]
        return np.asarray(np.max(losses, axis=0))

    def pull(self, inverses: Sequence[Array], among: Array) -> Array:
        """How much each of some candidates helps to first order, where the terms have these inverse informations."""
        return np.asarray(np.max([projected(t.rows[among], t.pull(c))
                                  for t, c in zip(self.terms, inverses, strict=True)], axis=0))
