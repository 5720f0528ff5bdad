"""What is shown of a discovery: the gap group by group, what it does to results, what could have been seen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib import units
from calib.analyse.covariance import covariance
from calib.analyse.score import Candidate, Field, candidates, field_of
from calib.linearisation import Linearisation, linearise
from calib.problem import Problem
from calib.unknown import Unknown
from calib.workflow.discrepancy.conclusion import Explanation
from calib.workflow.discrepancy.power import Detectable, detectable
from calib.workflow.discrepancy.readings import parts

MOST_INSTANCES = 6  # of an unknown nobody asked for; more are poses and foot points, which are no results


@dataclass(frozen=True)
class Gap:
    """The gap of one component of a group of readings, (before, after): root mean square of r/u over its readings,
    variance factor (v'Pv over redundancy), and root mean square on held-out rows, None where there are none."""

    group: str
    readings: int
    rms: tuple[float, float]
    variance_factor: tuple[float, float]
    heldout: tuple[float, float] | None


@dataclass(frozen=True)
class Moved:
    """One result, (value, u) before and after in its display unit, and by how many u of before it moved."""

    name: str
    unit: str
    before: tuple[float, float]
    after: tuple[float, float]

    @property
    def in_u(self) -> float:
        """Change in units of the standard uncertainty before."""
        return (self.after[0] - self.before[0]) / self.before[1]


class Shown:
    """An explanation with what its page and its answer show beside it, each worked out when asked for.

    found: the explanation; level: of any false alarm, for the sizes that could have been seen.
    """

    def __init__(self, found: Explanation, level: float = 0.01):
        self.found, self.level = found, level

    @cached_property
    def fit(self) -> Linearisation:
        """Of the nominal model."""
        return linearise(self.found.before)

    @cached_property
    def chosen(self) -> list[Candidate]:
        """All candidates."""
        return candidates(self.fit)

    @cached_property
    def field(self) -> Field:
        """Residuals of the nominal model with the signals of all candidates."""
        return field_of(self.fit, self.chosen)

    @cached_property
    def detectable(self) -> tuple[Detectable, ...]:
        """The size of every candidate that would be found in four of five such measurements."""
        return detectable(self.field, self.chosen, self.level)

    @cached_property
    def variance_factor(self) -> tuple[float, float]:
        """v'Pv over the degrees of freedom, before and after."""
        before, after = self.found.rms
        return before**2, after**2

    @cached_property
    def gaps(self) -> tuple[Gap, ...]:
        """The gap of every component of every group of readings that both models have."""
        found = self.found
        first = _by_part(self.fit, self.field.redundancy)
        second = first
        if found.after is not found.before:
            after = linearise(found.after)
            second = _by_part(after, field_of(after, ()).redundancy)
        held = [one.parts for one in found.heldout] if found.heldout else [{}, {}]
        return tuple(
            Gap(name, int(first[name][0]), (first[name][1], second[name][1]), (first[name][2], second[name][2]),
                (held[0][name], held[1][name]) if all(name in one for one in held) else None)
            for name in first if name in second)

    @cached_property
    def results(self) -> tuple[Moved, ...]:
        """The derived results, and the unknowns that do not repeat often, before and after; empty where nothing was
        added to the model."""
        found = self.found
        if found.after is found.before:
            return ()
        free = _shared(found.before.problem)
        first, second = (covariance(linearise(one), *found.before.problem.quantities, *free)
                         for one in (found.before, found.after))
        # A rotation is told from the one before: its own numbers are steps from where it stands.
        steps = [u.difference(found.after.values[u], found.before.values[u]).ravel() for u in free]
        asked = len(first.values) - sum(map(len, steps))
        changes = np.concatenate([second.values[:asked] - first.values[:asked], *steps])
        shown = []
        for i, (name, unit) in enumerate(zip(first.names, first.units, strict=True)):
            scale, value = units.factor(unit), first.values[i]
            pair = [(float(v / scale), float(u / scale))
                    for v, u in ((value, first.u[i]), (value + changes[i], second.u[i]))]
            if pair[0][1] > 0:  # what is held moves nowhere
                shown.append(Moved(name, unit, *pair))
        return tuple(shown)


def _shared(problem: Problem) -> list[Unknown]:
    """Free unknowns that do not repeat often."""
    return [u for u in problem.unknowns if not problem.is_held(u).all() and u.count <= MOST_INSTANCES]


def _by_part(fit: Linearisation, redundancy: np.ndarray) -> dict[str, tuple[int, float, float]]:
    """{group and component: (readings, rms, variance factor)}."""
    residual, found = fit.rows[1], {}
    for name, places in parts(fit).items():
        squares, spare = float(np.sum(residual[places] ** 2)), float(np.sum(redundancy[places]))
        found[name] = (len(places), float(np.sqrt(squares / len(places))), squares / spare if spare > 1e-6 else 0.0)
    return found
