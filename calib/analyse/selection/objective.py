"""The objective of a choice: the worst of one or several terms over the same candidates, and a bound at any weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.analyse.selection.limits import Limits
from calib.analyse.selection.terms import Tangent, Term
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
    def sharp(self) -> bool:
        """Whether a smooth form with a sharpness stands in for it."""
        return len(self.terms) > 1 or any(term.sharp for term in self.terms)

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

    def near(self, weights: Array, sharpness: float) -> Nearby:
        """The objective near weights (n,). Raises LinAlgError where the information is singular."""
        inverses = [_inverse(t.information(weights)) for t in self.terms]
        tangents = [t.tangent(c, sharpness) for t, c in zip(self.terms, inverses, strict=True)]
        losses = np.array([t.loss for t in tangents])
        share = np.exp(sharpness * (losses - losses.max()))
        return Nearby(self, tuple(tangents), share / share.sum(), losses, sharpness)


def _inverse(information: Array) -> Array:
    root = np.linalg.inv(np.linalg.cholesky(information))
    return np.asarray(root.T @ root)


@dataclass(frozen=True, eq=False)
class Nearby:
    """The objective near some weights: tangents of its terms, their shares and smooth losses."""

    objective: Objective
    tangents: tuple[Tangent, ...]
    share: Array
    losses: Array
    sharpness: float

    @property
    def loss(self) -> float:
        """Smooth loss."""
        if len(self.losses) == 1:
            return float(self.losses[0])
        top = self.losses.max()
        return float(top + np.log(np.sum(np.exp(self.sharpness * (self.losses - top)))) / self.sharpness)

    @cached_property
    def gains(self) -> list[Array]:
        """Decrease of each term's loss (n,) by each candidate."""
        return [t.gain(term.rows) for t, term in zip(self.tangents, self.objective.terms, strict=True)]

    @cached_property
    def gain(self) -> Array:
        """Decrease of the loss (n,) by each candidate, per unit of weight."""
        return np.asarray(np.tensordot(self.share, np.array(self.gains), axes=1))

    def curvature(self, among: Array) -> Array:
        """Hessian (u, u) for some candidates."""
        parts = [t.curvature(term.rows[among]) for t, term in zip(self.tangents, self.objective.terms, strict=True)]
        total = np.tensordot(self.share, np.array(parts), axes=1) if len(parts) > 1 else parts[0]
        if len(parts) > 1:
            gains = np.array([g[among] for g in self.gains])
            centred = gains - self.gain[among]
            total = total + self.sharpness * centred.T @ (centred * self.share[:, None])
        return np.asarray(total)

    def bound(self, weights: Array, limits: Limits, lower: Array, upper: Array) -> float:
        """A loss that no choice within the limits and lower <= w <= upper can fall below; `weights` are those of here.

        exp(-loss) is concave in the weights, so its tangent lies above it: with g the relative gains here,
        loss(w') >= level - log(1 + max g.(w' - w)). Holds at any weights, whoever found them.
        """
        level = float(np.log(np.sum(self.share * np.exp([t.level for t in self.tangents]))))
        ahead = limits.largest(self.gain, lower, upper) - float(self.gain @ weights)
        return level - float(np.log1p(max(ahead, -0.999)))
