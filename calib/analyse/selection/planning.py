"""Planning: settings over their ranges as candidates, criterion against number kept, and the next best measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib.analyse.selection.limits import Limits
from calib.analyse.selection.relaxation import relax
from calib.analyse.selection.select import Request, requested
from calib.analyse.selection.starts import better, exchanged, first_choice, rounded
from calib.blocks import Array
from calib.linearisation import Linearisation


def over(**ranges: ArrayLike) -> dict[str, Array]:
    """Every combination of settings over their ranges, as arrays (n,) to declare candidate observations with.

    ranges: values of each setting (angles of a turntable, coordinates of targets or stations, travel of axes).
    """
    values = [np.asarray(each) for each in ranges.values()]
    mesh = np.meshgrid(*values, indexing="ij")
    return {name: grid.ravel() for name, grid in zip(ranges, mesh, strict=True)}


@dataclass(frozen=True)
class Next:
    """One further measurement: label, criterion with it, and ratio to the criterion without it (0 where only it makes
    the criterion finite)."""

    label: str
    value: float
    ratio: float


def next_best(fit: Linearisation, criterion: Any, *, made: Any, by: Any = None) -> tuple[Next, ...]:
    """Which single further observation serves a criterion most, best first.

    fit: a linearisation of what is made and what could be made; criterion: C(quantity) to lower the u of a quantity;
    Ds(effect, effect) with both freed, to separate two effects that the present data cannot tell apart; made: groups,
    or {group: row numbers}, that are there; by: as for `select`.
    Returns every candidate; infinite value where what is asked for still cannot be known.
    """
    request = requested(fit, 1, criterion, by=by, always=made)
    n = len(request.candidates)
    before = request.objective.losses(np.zeros((1, 0), dtype=np.int64))[0]
    losses = request.objective.losses(np.arange(n)[:, None])
    found = [Next(request.candidates.labels[i], request.value(losses[i]), _ratio(losses[i], before))
             for i in np.argsort(losses, kind="stable")]
    return tuple(found)


def _ratio(after: float, before: float) -> float:
    if np.isinf(before):
        return 1.0 if np.isinf(after) else 0.0
    return float(np.exp(after - before))


@dataclass(frozen=True)
class Step:
    """Criterion and its bound for one number kept."""

    keep: int
    value: float
    bound: float


def along(fit: Linearisation, criterion: Any, numbers: Sequence[int], *, by: Any = None, always: Any = ()
          ) -> tuple[Step, ...]:
    """The criterion and its bound against the number kept, with nothing but the number limited.

    fit, criterion, by, always: as for `select`; numbers: to try; those that cannot determine what is asked for are
    left out.
    """
    request = requested(fit, len(_all(fit, criterion, by, always).candidates), criterion, by=by, always=always)
    n, steps = len(request.candidates), []
    for keep in numbers:
        limits = Limits(np.ones((1, n)), np.array([float(keep)]), (f"keep {keep}",), int(keep))
        found = exchanged(request.objective, limits, first_choice(request.objective, limits))
        if not np.isfinite(request.objective.loss(found)):
            continue
        relaxed = relax(request.objective, limits, request.candidates.indicator(found), tolerance=1e-5)
        best = better(request.objective, limits, found, rounded(request.objective, limits, relaxed.weights))
        loss = request.objective.loss(best)
        steps.append(Step(int(keep), request.value(loss), request.value(min(relaxed.bound, loss))))
    return tuple(steps)


def _all(fit: Linearisation, criterion: Any, by: Any, always: Any) -> Request:
    return requested(fit, None, criterion, by=by, always=always, budget=np.inf)
