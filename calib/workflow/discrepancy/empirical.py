"""Structure without a name kept as an empirical term, because somebody asked for it: fitted, with its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.analyse.covariance import covariance
from calib.analyse.score import field_of
from calib.errors import CalibrationError
from calib.linearisation import Linearisation, linearise
from calib.problem import Problem
from calib.solve.estimate import Estimate, solve
from calib.unknown import Unknown
from calib.workflow.discrepancy.conclusion import Explanation
from calib.workflow.discrepancy.heldout import held_out
from calib.workflow.discrepancy.readings import channels
from calib.workflow.discrepancy.structure import Pattern, patterns

VISIBLE = 1e-6  # share of a direction of a pattern that the unknowns leave over


@dataclass(frozen=True)
class Empirical:
    """A model with empirical terms: the problem, its estimate, the terms as unknowns, root mean square of r/u with them
    (all readings; held-out ones before and after, None where there are none)."""

    problem: Problem
    estimate: Estimate
    terms: tuple[Unknown, ...]
    rms: float
    heldout_rms: tuple[float, float] | None

    def content(self) -> dict[str, Any]:
        """As JSON knows it."""
        known = covariance(linearise(self.estimate), *self.terms)
        held = self.heldout_rms
        return {
            "parameters": [{"name": name, "value": float(v), "u": float(u), "unit": unit}
                           for name, v, u, unit in known.displayed],
            "rms": self.rms,
            "heldout_rms": None if held is None else {"before": held[0], "after": held[1]},
        }


def kept(found: Explanation, check: Mapping[str, NDArray[np.bool_]] | None = None) -> Empirical:
    """The model with the structure that an explanation describes, as a sum of its shapes on the readings concerned.

    found: with the verdict unknown-structure; check: held-out rows, as for `explain`.
    Raises CalibrationError where nothing was described, or the model with it cannot be solved.
    """
    fit, problem = linearise(found.before), found.before.problem
    offered = {(p.channel, p.covariate, p.kind): p for p in patterns(channels(fit, problem))}
    field, places, terms = field_of(fit, ()), _Places.of(fit), []
    for place in found.structure:
        pattern = offered.get((place.channel, place.covariate, place.shape))
        if pattern is None:
            continue
        signal = field.outside(pattern.whole(len(field.residual)))
        left, values, right = np.linalg.svd(signal, full_matrices=False)
        seen = values > VISIBLE * max(float(values[0]), 1e-300)
        field = field.taking(left[:, seen])
        columns = pattern.columns if seen.all() else pattern.columns @ right[seen].T
        problem, term = places.added(problem, pattern, columns)
        terms.append(term)
    if not terms:
        raise CalibrationError("no structure was described that could be kept; look at the residuals against what was "
                               "recorded, and record more with each reading")
    estimate = solve(problem)
    if not estimate.converged:
        raise CalibrationError(f"the model with the structure kept does not converge: {estimate.message}")
    heldout = None
    if check and found.heldout_rms is not None:
        after = held_out(problem, check, estimate)
        heldout = None if after is None else (found.heldout_rms[0], after.rms)
    return Empirical(problem, estimate, tuple(terms), float(np.sqrt(estimate.variance_factor)), heldout)


@dataclass(frozen=True)
class _Places:
    """For every whitened row: group, row and component of the reading, and its u [SI]; -1 where several mix."""

    groups: Sequence[str]
    group: NDArray[np.int64]
    row: NDArray[np.int64]
    component: NDArray[np.int64]
    u: NDArray[np.float64]
    units: Mapping[str, Sequence[str]]

    @staticmethod
    def of(fit: Linearisation) -> _Places:
        columns: list[list[NDArray[Any]]] = [[], [], [], []]
        for number, group in enumerate(fit.groups):
            for block in group.whitened:
                m, d = block.residual.shape
                alone = block.rows.shape[1] == 1
                row = np.repeat(block.rows[:, 0], d) if alone else np.full(m * d, -1)
                part = np.tile(np.arange(d), m) if alone else np.full(m * d, -1)
                u = group.weighting.u[row, part] if alone else np.ones(m * d)
                for column, values in zip(columns, (np.full(m * d, number), row, part, u), strict=True):
                    column.append(values)
        group_of, row, part, u = (np.concatenate(column) for column in columns)
        return _Places([g.name for g in fit.groups], group_of, row, part, u, {g.name: g.units for g in fit.groups})

    def added(self, problem: Problem, pattern: Pattern, columns: NDArray[np.float64]) -> tuple[Problem, Unknown]:
        """The problem with one pattern added to the readings that it describes, in their unit."""
        name = self.groups[int(self.group[pattern.places[0]])]
        component = int(self.component[pattern.places[0]])
        observed = next(o for o in problem.observations if o.group == name)
        dim = len(self.units[name])
        u = self.u[pattern.places]
        whole = np.zeros((observed.n, dim, columns.shape[1]))
        whole[self.row[pattern.places], component] = columns * (u / u.mean())[:, None]
        harmonic = pattern.kind.startswith("harmonic") and columns.shape[1] == 2
        parts = ("c", "s") if harmonic else tuple(f"p{i + 1}" for i in range(columns.shape[1]))
        label = f"{pattern.kind} over {pattern.covariate} in {pattern.channel}"
        term = Unknown(label, np.zeros((1, len(parts))), self.units[name][component], parts)
        return problem.with_addition(name, term, whole), term
