"""Rows held out: adjust on the others, then judge how well the model predicts these."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.linearisation import Linearisation, linearise
from calib.problem import Problem
from calib.solve.estimate import Estimate, solve
from calib.unknown import Selection, Unknown
from calib.workflow.discrepancy.readings import parts


@dataclass(frozen=True)
class HeldOut:
    """Root mean square of whitened residuals of rows that took no part in the fit, how many scalar readings they are,
    and the root mean square of each component of each group."""

    rms: float
    readings: int
    parts: Mapping[str, float]


def held_out(problem: Problem, check: Mapping[str, NDArray[np.bool_]], start: Estimate | None = None) -> HeldOut | None:
    """Adjust on the rows that are not checked and judge the rest; None where nothing or everything is checked.

    problem: with all rows; check: {group: (n,) true where a row is held out}. Unknowns that only checked rows see (the
    pose of a checked position) are adjusted to those rows afterwards, everything else held, and cost a reading each.
    """
    masks = {o.group: check.get(o.group, np.zeros(o.n, bool)) for o in problem.observations if not o.is_prior}
    if not any(m.any() for m in masks.values()) or all(m.all() for m in masks.values()):
        return None
    fitting = problem.keep({g: ~m for g, m in masks.items()})
    unseen = _unseen(fitting, problem)
    estimate = solve(fitting.hold(*[s for s in unseen if s.unknown in fitting.unknowns]), start=start)
    judged = problem.keep(masks).without(*[o.group for o in problem.observations if o.is_prior])
    judged = judged.hold(*judged.unknowns)
    own = [s for s in unseen if s.unknown in judged.unknowns]
    known = dict(start.values) if start is not None else {}
    known.update(estimate.values)
    values = {u: u.show(known.get(u, u.ambient)) for u in judged.unknowns}
    if own:
        judged = judged.free(*own)
        solved = solve(judged, start=values)
        fit = linearise(solved)
        spared = solved.dof / max(sum(g.size for g in fit.groups), 1)  # the rows' own unknowns cost readings
        return HeldOut(float(np.sqrt(solved.objective / max(solved.dof, 1))), sum(g.size for g in fit.groups),
                       _by_part(fit, max(spared, 1e-300)))
    fit = linearise(judged, values)
    size = sum(g.size for g in fit.groups)
    return HeldOut(float(np.sqrt(fit.objective / size)), size, _by_part(fit, 1.0))


def _by_part(fit: Linearisation, share: float) -> dict[str, float]:
    """Root mean square of each part, of whose readings a share is left over."""
    residual = fit.rows[1]
    return {name: float(np.sqrt(np.mean(residual[places] ** 2) / share)) for name, places in parts(fit).items()}


def _unseen(fitting: Problem, problem: Problem) -> list[Selection]:
    """Instances of unknowns that the rows of the fit do not see."""
    seen: dict[Unknown, set[int]] = {}
    for o in fitting.observations:
        for a in o.arguments:
            if a.unknown is not None:
                seen.setdefault(a.unknown, set()).update(np.unique(a.index).tolist())
    found = []
    for unknown in problem.unknowns:
        missing = sorted(set(range(unknown.count)) - seen.get(unknown, set()))
        if missing and unknown not in [a.unknown for a in problem.attached]:
            found.append(Selection(unknown, np.array(missing)))
    return found
