"""A request to choose, ready to be searched, and what is said where it cannot be met."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.analyse.selection.candidates import Candidates, candidates_of
from calib.analyse.selection.criterion import D, WorstCase, functions_of
from calib.analyse.selection.floors import Checked, Floors
from calib.analyse.selection.greedy import greedy
from calib.analyse.selection.limits import Limits, limits_of
from calib.analyse.selection.objective import Objective
from calib.analyse.selection.starts import first_choice
from calib.errors import InputError, RankDefect
from calib.linearisation import Functions, Linearisation


@dataclass(frozen=True)
class Request:
    """A request to choose, ready to be searched: candidates (one for each configuration), objective, limits."""

    criterion: Any
    configurations: tuple[Candidates, ...]
    objective: Objective
    limits: Limits
    checked: Checked | None

    @property
    def candidates(self) -> Candidates:
        """The candidates of the first configuration."""
        return self.configurations[0]

    def value(self, loss: float) -> float:
        """The criterion itself from its loss."""
        return float(np.exp(-loss if self.criterion.largest_is_best else loss))


def requested(fit: Linearisation, keep: int | None, criterion: Any, *, by: Any = None, always: Any = (),
              costs: Any = None, budget: float | None = None, at_most: Mapping[Any, int] | None = None,
              exclusive: Sequence[Sequence[Any]] = (), floors: Floors | None = None, complete: bool = True) -> Request:
    """A request ready to be searched; arguments and errors as for `select`.

    complete: whether a number too small for the unknowns is refused.
    """
    criterion = D() if criterion is None else criterion
    fits = (fit, *criterion.others) if isinstance(criterion, WorstCase) else (fit,)
    configurations = tuple(candidates_of(one, by, always, _visible(one, criterion, floors)) for one in fits)
    first = configurations[0]
    for other in configurations[1:]:
        if other.labels != first.labels:
            raise InputError(f"{criterion.name}: the configurations have different candidates ({len(first)} and "
                             f"{len(other)}); declare the same groups and rows in each")
    terms = []
    for one in configurations:
        term = criterion.term(one)
        terms.append(term)
    limits = limits_of(first, keep, costs, budget, at_most, exclusive)
    if complete:
        _refuse_too_few(criterion, configurations, limits)
    checked = None if floors is None else Checked(first, floors)
    return Request(criterion, configurations, Objective(tuple(terms)), limits, checked)


def _visible(fit: Linearisation, criterion: Any, floors: Floors | None) -> Functions | None:
    """What must not be eliminated with a candidate: the quantities of the criterion and those whose influences are
    limited."""
    asked: Functions | None = criterion.asked(fit)
    if floors is None or not floors.influence:
        return asked
    return functions_of(fit, *([] if asked is None else [asked]), *floors.influence)


def _refuse_too_few(criterion: Any, configurations: Sequence[Candidates], limits: Limits) -> None:
    if criterion.asked(configurations[0].fit) is not None or limits.keep is None:
        return
    for candidates in configurations:
        known = int(np.sum(np.linalg.eigvalsh(candidates.fixed) > 1e-9))
        sees = np.sort(np.minimum(candidates.readings, candidates.rows.shape[1]))[::-1]
        needed = int(np.searchsorted(np.cumsum(sees), candidates.rank - known) + 1) if candidates.rank > known else 0
        if limits.keep < needed:
            raise InputError(
                f"keep = {limits.keep} candidates give {int(sees[: limits.keep].sum()) + known} readings and priors "
                f"for {candidates.rank} unknowns; keep at least {needed}, hold unknowns or add priors")


def unknowable(request: Request, chosen: Sequence[int]) -> RankDefect:
    """The refusal where what is asked for cannot be known from any choice that was found."""
    candidates, objective = request.candidates, request.objective
    keep = request.limits.keep
    chosen = list(chosen) or first_choice(objective, request.limits)
    directions = candidates.unseen(chosen)
    alone = _asked_of_one_candidate(request, chosen)
    words = alone or "; ".join(directions[:3]) or "what is asked for is not seen"
    needed = _enough(objective)
    if keep is not None and needed > keep:
        nearest = f"; keep {needed} or more"
    elif keep is None:
        nearest = "; raise the budget or loosen the limits"
    else:
        nearest = "; loosen the limits that keep the candidates apart" if not request.limits.only_keep else \
            f"; keep {len(candidates)}" if keep < len(candidates) else ""
    return RankDefect(f"no choice of {keep or 'these'} of {len(candidates)} candidates was found that determines "
                      f"everything asked for: {words}{nearest}", directions=directions)


def _asked_of_one_candidate(request: Request, chosen: Sequence[int]) -> str:
    """What is asked for and belongs to one candidate that was not chosen, in words."""
    candidates, asked = request.candidates, request.criterion.asked(request.candidates.fit)
    if asked is None:
        return ""
    free = candidates.fit.free_part(asked.derivatives)
    seen = np.any(np.abs(candidates.rows.reshape(-1, candidates.rank) @ np.linalg.pinv(candidates.root))
                  .reshape(len(candidates), -1, free.shape[1]) > 1e-9 * candidates.fit.sizes, axis=1)
    for label, needs in zip(asked.labels, free != 0, strict=True):
        for column in np.flatnonzero(needs):
            owners = np.flatnonzero(seen[:, column])
            if len(owners) == 1 and owners[0] not in chosen:
                return f"'{label}' is seen by '{candidates.labels[owners[0]]}' alone: keep that in any case, or name " \
                       "quantities that several candidates see"
    return ""


def _enough(objective: Objective) -> int:
    """How many candidates were found to determine everything asked for, with none of them to spare."""
    n = objective.count
    everything = Limits(np.ones((1, n)), np.array([float(n)]), ("all",), n)
    order = greedy(objective.stand_in, everything)
    needed = next((k for k in range(1, n + 1) if np.isfinite(objective.loss(order[:k]))), n)
    kept = order[:needed]
    for one in list(kept):
        fewer = [i for i in kept if i != one]
        if fewer and np.isfinite(objective.loss(fewer)):
            kept = fewer
    return len(kept)
