"""Criteria of a choice: what is to be small or large, in which units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from calib import units
from calib.analyse.covariance import refuse_what_cannot_be_known
from calib.analyse.selection.candidates import Candidates
from calib.analyse.selection.terms import Determinant, DeterminantOfSet, Term, Trace
from calib.analyse.selection.worst import Largest, LargestOf
from calib.errors import DeclarationError, InputError, RankDefect
from calib.linearisation import Functions, Linearisation


class Criterion(Protocol):
    """A criterion: its name, whether it is a maximum, what it asks to see, and its terms on candidates."""

    name: str
    largest_is_best: bool

    def asked(self, fit: Linearisation) -> Functions | None:
        """The functions it is about, or None for all unknowns."""

    def term(self, candidates: Candidates) -> Term:
        """The criterion as a function of the information."""

    def unit(self, fit: Linearisation) -> str:
        """Its unit, empty where it has none that has a name."""


@dataclass(frozen=True)
class D:
    """Largest det^(1/p) of the whitened information of the unknowns that candidates share (SI units)."""

    name = "D"
    largest_is_best = True

    def asked(self, fit: Linearisation) -> Functions | None:
        return None

    def unit(self, fit: Linearisation) -> str:
        return ""

    def term(self, candidates: Candidates) -> Term:
        if candidates.fit.factor.defect:
            from calib.analyse.estimability import estimability

            directions = estimability(candidates.fit).directions
            raise RankDefect(f"no choice has a determinant: {'; '.join(directions)}", directions=directions)
        return Determinant(candidates.rows, candidates.fixed, candidates.log_scale)


def functions_of(fit: Linearisation, *what: Any) -> Functions:
    """Functions of a linearisation; a text may also name one part or instance of a quantity, such as "gap[A].x".

    Raises InputError with near names where there is none of that name.
    """
    return fit.functions(*(_named(fit, one) if isinstance(one, str) else one for one in what))


def _named(fit: Linearisation, name: str) -> Any:
    try:
        return fit.functions(name)
    except DeclarationError:
        names: list[str] = []
        for quantity, functions in fit.results.items():
            mine = [k for k, label in enumerate(functions.labels) if label == name or label.startswith(f"{name}.")]
            if mine:
                return part_of(functions, mine)
            names += [quantity.name, *functions.labels]
        for unknown in fit.layout.unknowns:
            mine = [k for k, label in enumerate(unknown.labels) if label.startswith(f"{name}.")]
            if mine:
                return part_of(fit.functions(unknown), mine)
            names += [unknown.name, *unknown.labels]
        near = units.near_matches(name, names)
        hint = f"did you mean '{near[0]}'? " if near else ""
        short = [q.name for q in fit.results] + [u.name for u in fit.layout.unknowns]
        raise InputError(f"{fit.name} has no quantity or unknown '{name}'; {hint}There are: {', '.join(short)}"
                         ) from None


def part_of(functions: Functions, which: Sequence[int]) -> Functions:
    """Some of several functions."""
    return Functions(tuple(functions.labels[k] for k in which), tuple(functions.units[k] for k in which),
                     functions.values[list(which)], functions.derivatives[list(which)])


def by_unit(functions: Functions) -> str:
    """Which functions have which unit, in words."""
    kinds: dict[str, list[str]] = {}
    for label, unit in zip(functions.labels, functions.units, strict=True):
        kinds.setdefault(unit, []).append(label)
    return "; ".join(f"{unit}: {', '.join(names[:3])}{', ...' if len(names) > 3 else ''}"
                     for unit, names in kinds.items())


@dataclass(frozen=True, init=False)
class _OfQuantities:
    """A criterion of named quantities, in their display units."""

    what: tuple[Any, ...]
    largest_is_best = False

    def __init__(self, *what: Any):
        object.__setattr__(self, "what", what)

    def asked(self, fit: Linearisation) -> Functions | None:
        functions = functions_of(fit, *self.what)
        refuse_what_cannot_be_known(fit, functions)
        # What depends on nothing that is free has no uncertainty that a choice could change.
        moves = np.flatnonzero(np.any(fit.free_part(functions.derivatives) != 0, axis=1))
        if not moves.size:
            raise InputError(f"criterion {self.name}: {', '.join(functions.labels[:3])}"     # type: ignore[attr-defined]
                             f"{', ...' if len(functions.labels) > 3 else ''} depends on nothing that is free: every "
                             "choice leaves it as it is; name another quantity, or free what it depends on")
        return functions if len(moves) == len(functions.labels) else part_of(functions, moves.tolist())

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
            raise InputError(f"criterion {self.name}: {' and '.join(strange)} do not add; "    # type: ignore[attr-defined]
                             f"name quantities of one unit ({by_unit(functions)}), or use D or Ds")
        return functions

    def unit(self, fit: Linearisation) -> str:
        functions = self.asked(fit)
        one = functions.units[0] if functions is not None else "1"
        return "" if one == "1" else f"{one}^2"


class A(_OneUnit):
    """Smallest trace of the covariance of named quantities of one unit (nothing: all quantities of the problem)."""

    name = "A"

    def term(self, candidates: Candidates) -> Term:
        return Trace(candidates.rows, candidates.fixed, self._matrix(candidates))


class C(A):
    """Smallest variance of one derived quantity, all else a nuisance."""

    name = "c"

    def asked(self, fit: Linearisation) -> Functions | None:
        functions = _OfQuantities.asked(self, fit)
        assert functions is not None
        if len(functions.labels) != 1:
            raise InputError(f"criterion c is of one scalar; this is {', '.join(functions.labels[:12])}"
                             f"{', ...' if len(functions.labels) > 12 else ''}: name one of them, or use A or Ds for "
                             "several")
        return functions


class E(_OneUnit):
    """Smallest largest eigenvalue of the covariance of named quantities of one unit."""

    name = "E"

    def term(self, candidates: Candidates) -> Term:
        return Largest(candidates.rows, candidates.fixed, self._matrix(candidates))


class Ds(_OfQuantities):
    """Smallest det^(1/s) of the covariance of s named quantities, all other unknowns a nuisance."""

    name = "Ds"

    def unit(self, fit: Linearisation) -> str:
        functions = self.asked(fit)
        assert functions is not None
        kinds = set(functions.units)
        return f"{functions.units[0]}^2" if len(kinds) == 1 and kinds != {"1"} else ""

    def term(self, candidates: Candidates) -> Term:
        matrix = self._matrix(candidates)
        if np.linalg.matrix_rank(matrix) < len(matrix):
            raise InputError(f"criterion Ds: the {len(matrix)} named quantities follow from each other (only "
                             f"{np.linalg.matrix_rank(matrix)} are independent); name independent ones")
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

    def unit(self, fit: Linearisation) -> str:
        return str(self.criterion.unit(fit))

    def term(self, candidates: Candidates) -> Term:
        term: Term = self.criterion.term(candidates)
        return term
