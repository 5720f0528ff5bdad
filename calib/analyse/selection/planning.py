"""Planning: settings over their ranges as candidates, criterion against number kept, and the next best measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib.analyse.selection.criterion import C, Ds
from calib.analyse.selection.limits import Limits
from calib.analyse.selection.relaxation import relax
from calib.analyse.selection.request import requested
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
    """One further measurement: label, criterion with it, and ratio to the criterion without it (1 where it makes no
    difference, 0 where only it lets the criterion be known, infinite value where even it does not)."""

    label: str
    value: float
    ratio: float


def next_best(fit: Linearisation, criterion: Any, *, made: Any, by: Any = None) -> tuple[Next, ...]:
    """Which single further observation serves a criterion most, best first.

    fit: a linearisation of what is made and what could be made; criterion: any; made: groups, or {group: row numbers},
    that are there; by: as for `select`.
    Returns every candidate; infinite value where what is asked for still cannot be known.
    """
    request = requested(fit, 1, criterion, by=by, always=made, complete=False)
    n = len(request.candidates)
    before = float(request.objective.losses(np.zeros((1, 0), dtype=np.int64))[0])
    losses = request.objective.losses(np.arange(n)[:, None])
    if request.criterion.largest_is_best:      # a ratio below one is better everywhere
        return tuple(Next(request.candidates.labels[i], request.value(losses[i]) if np.isfinite(losses[i]) else 0.0,
                          _ratio(losses[i], before)) for i in np.argsort(losses, kind="stable"))
    return tuple(Next(request.candidates.labels[i], request.value(losses[i]), _ratio(losses[i], before))
                 for i in np.argsort(losses, kind="stable"))


def lowers_most(fit: Linearisation, quantity: Any, *, made: Any, by: Any = None) -> tuple[Next, ...]:
    """Which single further observation lowers the u of a quantity most; values are variances in its display unit.

    fit, made, by: as for `next_best`; quantity: one scalar, by name or itself.
    """
    return next_best(fit, C(quantity), made=made, by=by)


def separates_most(fit: Linearisation, first: Any, second: Any, *, made: Any, by: Any = None) -> tuple[Next, ...]:
    """Which single further observation tells two effects apart best that the present data cannot tell apart.

    fit: with both effects free; first, second: the effects, or their names; made, by: as for `next_best`.
    """
    return next_best(fit, Ds(first, second), made=made, by=by)


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


def along(fit: Linearisation, criterion: Any, numbers: Sequence[int], *, by: Any = None, always: Any = (),
          patience: float = np.inf) -> tuple[Step, ...]:
    """The criterion and its bound against the number kept, with nothing but the number limited.

    fit, criterion, by, always: as for `select`; numbers: to try; those that cannot determine what is asked for are
    left out; patience: seconds after which no further number is begun.
    """
    begin = perf_counter()
    request = requested(fit, None, criterion, by=by, always=always, budget=np.inf)
    n, steps = len(request.candidates), []
    for keep in numbers:
        if perf_counter() - begin > patience:
            break
        limits = Limits(np.ones((1, n)), np.array([float(keep)]), (f"keep {keep}",), int(keep))
        found = exchanged(request.objective, limits, first_choice(request.objective, limits))
        if not np.isfinite(request.objective.loss(found)):
            continue
        relaxed = relax(request.objective, limits, request.candidates.indicator(found), tolerance=1e-5)
        best = better(request.objective, limits, found, rounded(request.objective, limits, relaxed.weights))
        loss = request.objective.loss(best)
        steps.append(Step(int(keep), request.value(loss), request.value(min(relaxed.bound, loss))))
    return tuple(steps)
