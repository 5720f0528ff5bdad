"""Choose observations: the best ones found, how far they can be from the optimum, and what u they promise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib.analyse.covariance import covariance
from calib.analyse.selection.candidates import Candidates, repeated
from calib.analyse.selection.criterion import functions_of, part_of
from calib.analyse.selection.exact import branch_and_bound, enumerated, exhaustive, subsets
from calib.analyse.selection.floored import refusal, with_floors
from calib.analyse.selection.floors import Checked, Floors
from calib.analyse.selection.method import BranchAndBound, Conic, Exchange, Exhaustive, Method, Relaxation
from calib.analyse.selection.reduced import reduced
from calib.analyse.selection.relaxation import Relaxed, relax
from calib.analyse.selection.request import Request, requested, unknowable
from calib.analyse.selection.starts import better, exchanged, first_choice, rounded
from calib.blocks import Array
from calib.errors import InputError, RankDefect
from calib.linearisation import Linearisation

LOST = 1e5        # times the u of all candidates, from which on a quantity counts as not known
FEW = 20_000      # subsets up to which all are looked at where no method was named


@dataclass(frozen=True)
class Promise:
    """Standard uncertainty (SI) of one quantity with all candidates and with the chosen ones; unit is for display."""

    name: str
    unit: str
    u_all: float
    u_chosen: float


@dataclass(frozen=True)
class Choice:
    """Chosen observations.

    criterion, method: names; unit: of the criterion, empty where it has none; keep: number asked for, or None; chosen:
    numbers of the candidates, ascending; labels: theirs; rows: {group: row numbers of the data file}; masks: for
    `Problem.keep`; value, bound: of the criterion and what no choice can beat; gap: 1 - value/bound for a maximum,
    value/bound - 1 for a minimum; proven: whether it is the optimum; promises: u of each quantity; seconds: of the
    search; remarks: sentences.
    """

    criterion: str
    method: str
    keep: int | None
    chosen: tuple[int, ...]
    labels: tuple[str, ...]
    rows: Mapping[str, Any]
    masks: Mapping[str, Any]
    value: float
    bound: float
    gap: float
    proven: bool
    promises: tuple[Promise, ...]
    seconds: float
    candidates: int
    unit: str = ""
    remarks: tuple[str, ...] = ()

    def u(self, name: str) -> float:
        """The promised standard uncertainty (SI) of a quantity."""
        for promise in self.promises:
            if promise.name == name:
                return promise.u_chosen
        raise InputError(f"nothing was promised for '{name}'; there are {', '.join(p.name for p in self.promises)}")


def select(fit: Linearisation, keep: int | None = None, criterion: Any = None, *, by: Any = None, always: Any = (),
           costs: Mapping[str, float] | ArrayLike | None = None, budget: float | None = None,
           at_most: Mapping[Any, int] | None = None, exclusive: Sequence[Sequence[Any]] = (),
           floors: Floors | None = None, method: Method | None = None, report: Sequence[Any] = ()) -> Choice:
    """Choose the observations that serve a criterion best, with a bound that no choice can beat.

    fit: a linearisation (of a plan without readings, too); keep: how many candidates; criterion: D(), A(...), E(...),
    G(...), I(...), C(...), Ds(...) or WorstCase(...) (D() if none); by: what makes a candidate: a row, a covariate
    name (or names), "group", or {group: keys}; always: groups, or {group: rows}, kept in any case, as priors are;
    costs, budget: of candidates {label: cost} or (n,); at_most: {covariate: k}; exclusive: sets of labels of which one
    at most; floors: of reliability, which the bound leaves out; method: how to search; report: whose u is promised (the
    criterion's own quantities, else those of the problem).
    Uncertainty of held quantities is not part of a criterion, but of every promised u.
    Raises InputError where the request cannot be met, with the nearest that can; RankDefect where nothing can be known.
    """
    request = requested(fit, keep, criterion, by=by, always=always, costs=costs, budget=budget, at_most=at_most,
                        exclusive=exclusive, floors=floors)
    begin = perf_counter()
    if method is None:
        method = Exhaustive() if subsets(request.limits, len(request.candidates)) <= FEW else Exchange()
    chosen, bound, name = _searched(request, method)
    loss = request.objective.loss(chosen) if chosen else np.inf
    if not np.isfinite(loss):
        raise unknowable(request, chosen)
    seconds = perf_counter() - begin
    value, limit = request.value(loss), request.value(min(bound, loss))
    gap = 1.0 - value / limit if request.criterion.largest_is_best else value / limit - 1.0
    asked = request.criterion.asked(fit)
    # The analysis of the kept rows has the last word on what can be known: its rank decision is the sharper one.
    if asked is not None:
        promised = _promises(fit, request.candidates, chosen, asked)
        if any(p.u_chosen > LOST * p.u_all for p in promised if p.u_all > 0):
            raise unknowable(request, chosen)
    functions = functions_of(fit, *report) if report else asked or fit.functions()
    return Choice(
        criterion=request.criterion.name, method=name, keep=request.limits.keep, chosen=tuple(sorted(chosen)),
        labels=tuple(request.candidates.labels[i] for i in sorted(chosen)), rows=request.candidates.rows_of(chosen),
        masks=request.candidates.masks(chosen), value=value, bound=limit, gap=max(gap, 0.0),
        proven=gap < 1e-6, promises=_promises(fit, request.candidates, chosen, functions), seconds=seconds,
        candidates=len(request.candidates), unit=request.criterion.unit(fit), remarks=tuple(_remarks(request)))


def _searched(request: Request, method: Method) -> tuple[list[int], float, str]:
    """A choice, a loss that bounds every choice, and the words for how it was found."""
    objective, limits, checked = request.objective, request.limits, request.checked
    n = len(request.candidates)
    if isinstance(method, Exhaustive):
        count = subsets(limits, n)
        if count > method.most:
            raise InputError(f"{count:.3g} subsets are too many to look at each; use BranchAndBound() or Exchange()")
        if checked is not None:
            return _exhaustive_with_floors(request, checked)
        found = exhaustive(objective, limits)
        return found, objective.loss(found) if found else np.inf, method.name
    first = first_choice(objective, limits)
    if isinstance(method, BranchAndBound):
        return _branched(request, method, first)
    if not limits.meets(first) or not np.isfinite(objective.loss(first)):
        return first, -np.inf, method.name
    # The relaxation starts from the better of the two; where it starts changes its time, not its bound.
    better_one = exchanged(objective, limits, first)
    relaxed = _conic(request) if isinstance(method, Conic) else relax(objective, limits,
                                                                      request.candidates.indicator(better_one))
    chosen, name = first, method.name
    if isinstance(method, Exchange):
        chosen = better(objective, limits, better_one, rounded(objective, limits, relaxed.weights))
    elif isinstance(method, (Relaxation, Conic)):
        # What rounding hides is no choice: the exchange then has the last word.
        chosen = rounded(objective, limits, relaxed.weights)
        if not limits.meets(chosen) or not np.isfinite(objective.loss(chosen)):
            chosen = better_one
    if checked is not None and checked.margin(chosen).excess > 0.0:
        met = with_floors(objective, limits, checked, chosen)
        if met is None:
            raise refusal(objective, limits, checked, chosen, False)
        chosen, name = met, name + ", floors by exchange"
    return chosen, relaxed.bound, name


def _branched(request: Request, method: BranchAndBound, first: list[int]) -> tuple[list[int], float, str]:
    objective, limits, checked = request.objective, request.limits, request.checked
    begin: list[int] | None = exchanged(objective, limits, first) if np.isfinite(objective.loss(first)) else None
    if begin is not None and not limits.meets(begin):
        begin = None
    without = begin or []
    if checked is not None and (begin is None or checked.margin(begin).excess > 0.0):
        begin = None if begin is None else with_floors(objective, limits, checked, begin, method.seconds / 6)
    searched = branch_and_bound(objective, limits, begin, method.nodes, method.seconds, method.tolerance, checked)
    name = f"{method.name}, {searched.nodes} nodes"
    if searched.chosen is None and checked is not None and without:
        raise refusal(objective, limits, checked, without, np.isinf(searched.bound))
    return searched.chosen or [], searched.bound, name


def _conic(request: Request) -> Relaxed:
    from calib.analyse.selection.conic import conic

    return conic(request.objective, request.limits)


def _exhaustive_with_floors(request: Request, checked: Checked) -> tuple[list[int], float, str]:
    blocks = list(enumerated(request.objective, request.limits))
    closest: tuple[float, list[int]] = (np.inf, [])
    ranked = sorted(((float(loss), block, row) for block, (_, losses) in enumerate(blocks)
                     for row, loss in enumerate(losses) if np.isfinite(loss)))
    for loss, block, row in ranked:
        chosen = blocks[block][0][row].tolist()
        excess = checked.margin(chosen).excess
        if excess <= 0.0:
            return chosen, loss, "exhaustive, with floors"
        closest = min(closest, (excess, chosen))
    if closest[1]:
        raise refusal(request.objective, request.limits, checked, closest[1], True)
    return [], np.inf, "exhaustive"


def _promises(fit: Linearisation, candidates: Candidates, chosen: Sequence[int], functions: Any
              ) -> tuple[Promise, ...]:
    whole, some = covariance(fit, functions), reduced(fit, candidates.masks(chosen))
    try:
        u: Array = covariance(some, functions).u
    except RankDefect:      # an unknown of a candidate that was not chosen
        u = np.full(len(functions.labels), np.inf)
        for k in range(len(u)):
            try:
                u[k] = covariance(some, part_of(functions, [k])).u[0]
            except RankDefect:
                continue
    return tuple(Promise(*each) for each in zip(functions.labels, functions.units, whole.u.tolist(), u.tolist(),
                                                strict=True))


def _remarks(request: Request) -> list[str]:
    remarks = []
    pairs = repeated(request.candidates)
    if pairs:
        first, second = (request.candidates.labels[i] for i in pairs[0])
        remarks.append(f"{len(pairs)} candidates repeat others exactly ('{second}' repeats '{first}'): choosing both "
                       "is measuring twice; name them in `exclusive` if that is not meant")
    if request.checked is not None:
        remarks.append("The bound leaves the floors out: it holds for every choice, also for those that break them.")
    if not request.candidates.shared.all():
        remarks.append(f"{int(np.sum(~request.candidates.shared))} unknowns belong to one candidate each and come and "
                       "go with it; the criterion is about the others.")
    return remarks
