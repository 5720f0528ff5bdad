"""What a choice must respect: how many, at what cost, how many of a kind, what excludes each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.analyse.selection.candidates import Candidates, weights_of
from calib.blocks import Array
from calib.errors import InputError

ROUNDING = 1e-9
PATIENCE = 10.0      # seconds for a choice that only has to be within the limits


@dataclass(frozen=True)
class Limits:
    """Linear limits matrix w <= most on weights w (n,) in [0, 1]; words: (r,) each limit in the user's words.

    keep: number to keep where that is one of the limits (then it is the first).
    """

    matrix: Array
    most: Array
    words: tuple[str, ...]
    keep: int | None

    @property
    def only_keep(self) -> bool:
        """Whether nothing but the number is limited."""
        return self.keep is not None and len(self.most) == 1

    def allow(self, weights: Array) -> bool:
        """Whether weights (n,) respect the limits."""
        return bool(np.all(self.matrix @ weights <= self.most + ROUNDING))

    def room(self, used: Array) -> NDArray[np.bool_]:
        """Which candidates (n,) can still be added when `used` (r,) of each limit is taken."""
        return np.asarray(np.all(self.matrix <= (self.most - used)[:, None] + ROUNDING, axis=0))

    @property
    def exactly(self) -> float:
        """The smallest number of candidates that meets the request: the number to keep, where that is one."""
        return 0.0 if self.keep is None else float(self.keep)

    def meets(self, chosen: Sequence[int]) -> bool:
        """Whether a choice is as large as asked for and within the limits."""
        weights = np.bincount(np.asarray(chosen, dtype=np.int64), minlength=self.matrix.shape[1]).astype(float)
        return self.allow(weights) and len(chosen) >= self.exactly

    def largest(self, gain: Array, lower: Array, upper: Array) -> float | None:
        """Maximum of gain.w over the limits with lower <= w <= upper (n,), None where there are no such weights.

        A sort where only the number is limited, else a linear program, of which the dual value counts.
        """
        if self.only_keep:
            left = round(float(self.most[0] - lower.sum()))
            free = np.sort(gain[upper > lower])[::-1]
            if not 0 <= left <= len(free):
                return None
            return float(gain @ lower + free[:left].sum())
        from scipy.optimize import linprog

        whole = {} if self.keep is None else {"A_eq": np.ones((1, len(gain))), "b_eq": [self.exactly]}
        found = linprog(-gain, A_ub=self.matrix, b_ub=self.most, bounds=np.column_stack([lower, upper]),
                        method="highs", **whole)
        if found.status == 2:
            return None
        # The dual of the program bounds it from above whatever the solver's tolerance on the primal side is.
        price = np.maximum(-found.ineqlin.marginals, 0.0)
        each = 0.0 if self.keep is None else -float(found.eqlin.marginals[0])
        reduced = gain - self.matrix.T @ price - each
        return float(price @ self.most + each * self.exactly
                     + np.sum(np.where(reduced > 0, reduced * upper, reduced * lower)))

    def nearest(self, wish: Array) -> list[int] | None:
        """The choice that meets the request and has the largest sum of wishes (n,); None where there is none."""
        from scipy.optimize import Bounds, LinearConstraint, milp

        n = len(wish)
        conditions = [LinearConstraint(self.matrix, ub=self.most)]
        if self.keep is not None:
            conditions.append(LinearConstraint(np.ones(n), lb=self.exactly, ub=self.exactly))
        found = milp(-wish, integrality=np.ones(n), bounds=Bounds(0, 1), constraints=conditions,
                     options={"time_limit": PATIENCE})
        return None if found.x is None else np.flatnonzero(found.x > 0.5).tolist()


def limits_of(candidates: Candidates, keep: int | None, costs: Mapping[str, float] | ArrayLike | None,
              budget: float | None, at_most: Mapping[Any, int] | None, exclusive: Sequence[Sequence[Any]]) -> Limits:
    """The limits of a request.

    keep: how many; costs, budget: of the candidates and in all; at_most: {covariate: k} or {(labels...): k}, at most k
    candidates of each value; exclusive: sets of labels of which at most one may be chosen.
    Raises InputError where they contradict each other, with the nearest request that can be met.
    """
    n = len(candidates)
    rows, most, words = [], [], []
    if keep is None and budget is None:
        raise InputError("say how many candidates to keep, or give costs and a budget")
    if keep is not None:
        if keep != int(keep) or not 1 <= keep <= n:
            there = f"there are {n} candidates; ask for 1 to {n}" if n > 1 else \
                f"there is one candidate, '{candidates.labels[0]}': nothing is left to choose; ask for 1"
            raise InputError(f"keep = {keep}: {there}")
        rows.append(np.ones(n))
        most.append(float(keep))
        words.append(f"keep {keep}")
    if budget is None and costs is not None:
        raise InputError("costs without a budget limit nothing; give the budget")
    if budget is not None:
        cost = weights_of(candidates, costs, 1.0)
        if not np.all(np.isfinite(cost)) or np.any(cost < 0):
            worst = int(np.argmin(np.where(np.isfinite(cost), cost, -np.inf)))
            raise InputError(f"costs: '{candidates.labels[worst]}' costs {cost[worst]}; costs are finite and not "
                             "negative")
        if cost.min() > budget:
            raise InputError(f"budget {budget:g}: the cheapest candidate, '{candidates.labels[int(np.argmin(cost))]}', "
                             f"costs {cost.min():g}; raise the budget to that at least")
        rows.append(cost)
        most.append(float(budget))
        words.append(f"the budget of {budget:g}")
    for key, count in (at_most or {}).items():
        for value, mine in _kinds(candidates, key):
            if mine.sum() > count:
                rows.append(mine.astype(float))
                most.append(float(count))
                words.append(f"at most {count} of {value}")
    for group in exclusive:
        rows.append(np.isin(np.arange(n), [_number(candidates, label) for label in group]).astype(float))
        most.append(1.0)
        words.append("one of " + ", ".join(str(label) for label in group))
    limits = Limits(np.array(rows), np.array(most), tuple(words), None if keep is None else int(keep))
    _refuse_contradictions(limits)
    return limits


def _kinds(candidates: Candidates, key: Any) -> list[tuple[str, NDArray[np.bool_]]]:
    """The kinds that a covariate, or an explicit list of labels, makes among the candidates."""
    n = len(candidates)
    if not isinstance(key, str):
        listed = [_number(candidates, label) for label in key]
        return [(f"{key[0]}, ...", np.isin(np.arange(n), listed))]
    kinds: dict[str, NDArray[np.bool_]] = {}
    for name, numbers in candidates.members.items():
        covariates = candidates.fit.group(name).covariates
        if key in covariates:
            for number, value in zip(numbers, np.asarray(covariates[key]).tolist(), strict=True):
                if number >= 0:
                    kinds.setdefault(f"{key} {value}", np.zeros(n, dtype=bool))[number] = True
    if not kinds:
        there = sorted({c for name in candidates.members for c in candidates.fit.group(name).covariates})
        raise InputError(f"at_most: no candidate has a covariate '{key}'; there are: {', '.join(there) or 'none'}")
    return list(kinds.items())


def _number(candidates: Candidates, label: Any) -> int:
    if isinstance(label, (int, np.integer)) and 0 <= label < len(candidates):
        return int(label)
    if str(label) not in candidates.labels:
        from calib.units import near_matches

        near = near_matches(str(label), list(candidates.labels))
        hint = f"did you mean '{near[0]}'?" if near else f"the first is '{candidates.labels[0]}'"
        raise InputError(f"there is no candidate '{label}'; {hint}")
    return candidates.labels.index(str(label))


def _refuse_contradictions(limits: Limits) -> None:
    if limits.keep is None or len(limits.most) == 1:
        return
    from scipy.optimize import Bounds, LinearConstraint, milp

    n = limits.matrix.shape[1]
    others = LinearConstraint(limits.matrix[1:], ub=limits.most[1:])
    found = milp(-np.ones(n), integrality=np.ones(n), bounds=Bounds(0, 1), constraints=others)
    most = round(float(-found.fun)) if found.success else 0
    if most < limits.keep:
        listed = "; ".join(limits.words[1:4]) + (f" and {len(limits.words) - 4} more" if len(limits.words) > 4 else "")
        raise InputError(f"keep = {limits.keep} contradicts the other limits ({listed}), which leave room for {most}; "
                         f"ask for {most} or loosen them")
