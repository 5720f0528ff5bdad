"""Criteria of a choice: what is to be small or large, in which units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from calib.analyse.covariance import refuse_what_cannot_be_known
from calib.analyse.selection.candidates import Candidates
from calib.analyse.selection.terms import Determinant, DeterminantOfSet, Term, Trace
from calib.analyse.selection.worst import Largest, LargestOf
from calib.errors import InputError, RankDefect
from calib.linearisation import Functions, Linearisation


class Criterion(Protocol):
    """A criterion: its name, whether it is a maximum, what it asks to see, and its terms on candidates."""

    name: str
    largest_is_best: bool

    def asked(self, fit: Linearisation) -> Functions | None:
        """The functions it is about, or None for all unknowns."""

    def term(self, candidates: Candidates) -> Term:
        """The criterion as a function of the information."""


@dataclass(frozen=True)
class D:
    """Largest det^(1/p) of the whitened information of the unknowns that candidates share (SI units)."""

    name = "D"
    largest_is_best = True

    def asked(self, fit: Linearisation) -> Functions | None:
        return None

    def term(self, candidates: Candidates) -> Term:
        if candidates.fit.factor.defect:
            from calib.analyse.estimability import estimability

            directions = estimability(candidates.fit).directions
            raise RankDefect(f"no choice has a determinant: {'; '.join(directions)}", directions=directions)
        return Determinant(candidates.rows, candidates.fixed, candidates.log_scale)


@dataclass(frozen=True, init=False)
class _OfQuantities:
    """A criterion of named quantities, in their display units."""

    what: tuple[Any, ...]
    largest_is_best = False

    def __init__(self, *what: Any):
        object.__setattr__(self, "what", what)

    def asked(self, fit: Linearisation) -> Functions | None:
        functions = fit.functions(*self.what)
        refuse_what_cannot_be_known(fit, functions)
        return functions

    def _matrix(self, candidates: Candidates) -> Any:
        functions = self.asked(candidates.fit)
        assert functions is not None
        return candidates.functions(functions)


class _OneUnit(_OfQuantities):
    def asked(self, fit: Linearisation) -> Functions | None:
        functions = super().asked(fit)
        assert functions is not None
        strange = sorted(set(functions.units))
        if len(strange) > 1:
            raise InputError(
                f"criterion {self.name}: {' and '.join(strange)} do not add ({', '.join(functions.labels[:6])}"    # type: ignore[attr-defined]
                f"{', ...' if len(functions.labels) > 6 else ''}); name quantities of one unit, or use D or Ds")
        return functions


class A(_OneUnit):
    """Smallest trace of the covariance of named quantities of one unit (nothing: all quantities of the problem)."""

    name = "A"

    def term(self, candidates: Candidates) -> Term:
        return Trace(candidates.rows, candidates.fixed, self._matrix(candidates))


class C(A):
    """Smallest variance of one derived quantity, all else a nuisance."""

    name = "c"

    def asked(self, fit: Linearisation) -> Functions | None:
        functions = super().asked(fit)
        assert functions is not None
        if len(functions.labels) != 1:
            raise InputError(f"criterion c is of one scalar; this is {', '.join(functions.labels)}: name one of them, "
                             "or use A or Ds for several")
        return functions


class E(_OneUnit):
    """Smallest largest eigenvalue of the covariance of named quantities of one unit."""

    name = "E"

    def term(self, candidates: Candidates) -> Term:
        return Largest(candidates.rows, candidates.fixed, self._matrix(candidates))


class Ds(_OfQuantities):
    """Smallest det^(1/s) of the covariance of s named quantities, all other unknowns a nuisance."""

    name = "Ds"

    def term(self, candidates: Candidates) -> Term:
        matrix = self._matrix(candidates)
        if np.linalg.matrix_rank(matrix) < len(matrix):
            raise InputError("criterion Ds: the named quantities follow from each other; name independent ones")
        return DeterminantOfSet(candidates.rows, candidates.fixed, matrix)


class _OfPredictions(_OneUnit):
    """A criterion of predictions: of named quantities, or where none is named of all whitened candidate readings."""

    def asked(self, fit: Linearisation) -> Functions | None:
        return super().asked(fit) if self.what else None

    def _matrix(self, candidates: Candidates) -> Any:
        if self.what:
            return super()._matrix(candidates)
        flat = candidates.rows.reshape(-1, candidates.rank)
        return flat[np.any(flat != 0, axis=1)]


class G(_OfPredictions):
    """Smallest largest variance of a prediction: of named quantities of one unit, else of all candidate readings in
    units of their own u."""

    name = "G"

    def term(self, candidates: Candidates) -> Term:
        return LargestOf(candidates.rows, candidates.fixed, self._matrix(candidates))


class I(_OfPredictions):    # noqa: E742  the field's own letter
    """Smallest mean variance of a prediction: of named quantities of one unit, else of all candidate readings in units
    of their own u."""

    name = "I"

    def term(self, candidates: Candidates) -> Term:
        matrix = self._matrix(candidates)
        return Trace(candidates.rows, candidates.fixed, matrix / np.sqrt(len(matrix)))


@dataclass(frozen=True, init=False)
class WorstCase:
    """The worst value of a criterion over several configurations of the same candidates.

    criterion: the criterion; others: linearisations of the further configurations (the first is that of `select`),
    each with the same groups and rows.
    """

    criterion: Any
    others: tuple[Linearisation, ...]

    def __init__(self, criterion: Any, others: Sequence[Linearisation]):
        object.__setattr__(self, "criterion", criterion)
        object.__setattr__(self, "others", tuple(others))

    @property
    def name(self) -> str:
        return f"worst {self.criterion.name}"

    @property
    def largest_is_best(self) -> bool:
        return bool(self.criterion.largest_is_best)

    def asked(self, fit: Linearisation) -> Functions | None:
        found: Functions | None = self.criterion.asked(fit)
        return found

    def term(self, candidates: Candidates) -> Term:
        term: Term = self.criterion.term(candidates)
        return term
