"""The linear picture in which a disagreement is judged: nominal unknowns free, every effect a candidate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Candidate, Field, candidates, columns_of, field_of
from calib.blocks import Array
from calib.linearisation import Linearisation, linearise_system
from calib.problem import Problem
from calib.solve.estimate import Estimate
from calib.system import System
from calib.workflow.discrepancy.noise import lagged
from calib.workflow.discrepancy.readings import Channel, channels, row_numbers


@dataclass(frozen=True)
class Scene:
    """One linearisation with its candidates, what the free unknowns can do (n, p), residual (n,) and channels."""

    fit: Linearisation
    chosen: tuple[Candidate, ...]
    columns: tuple[Array, ...]
    derivatives: Array
    residual: Array
    channels: tuple[Channel, ...]
    field: Field

    @cached_property
    def readings(self) -> NDArray[np.int64]:
        """Places of the scalar readings that may be blunders."""
        return np.flatnonzero(row_numbers(self.fit) > 0)

    @cached_property
    def positive(self) -> frozenset[int]:
        """Places of the candidates whose one parameter cannot be negative."""
        return frozenset(i for i, one in enumerate(self.chosen)
                         if len(one.effect.parameters) == 1 and one.effect.parameters[0].lower == 0.0)

    def seen_through(self, rows: Array) -> Field:
        """The field with every row divided by a scale (n,)."""
        return _field(self.derivatives / rows[:, None], self.residual / rows, [c / rows[:, None] for c in self.columns])

    def serial(self, correlation: float, way: Sequence[NDArray[np.int64]]) -> Field:
        """The field with rows whitened for serial correlation along sequences of places."""
        return _field(
            lagged(self.derivatives, way, correlation),
            lagged(self.residual[:, None], way, correlation)[:, 0],
            [lagged(c, way, correlation) for c in self.columns],
        )


def _field(derivatives: Array, residual: Array, columns: Sequence[Array]) -> Field:
    basis = np.linalg.qr(derivatives)[0]
    left = residual - basis @ (basis.T @ residual)
    return Field(left, np.maximum(1 - np.sum(basis**2, axis=1), 0), basis, (), ()).with_signals(columns)


def scene_of(problem: Problem, at: Estimate, named: Sequence[Candidate]) -> Scene:
    """Linearise with the named effects held at their estimates and put back what they explain."""
    held = problem.hold(*[c.selection for c in named]) if named else problem
    fit = linearise_system(System(held), at.values)
    chosen = candidates(fit)
    columns = columns_of(fit, chosen)
    _, residual = fit.rows
    residual = residual.copy()
    labels = {c.label for c in named}
    for one, column in zip(chosen, columns, strict=True):
        if one.label in labels:
            residual += column @ at.values[one.unknown][one.instance]
    bare = field_of(fit, ())
    field = replace(bare, residual=bare.outside(residual[:, None])[:, 0]).with_signals(columns)
    chosen = [one.told_by(signal, frame.shape[1])
              for one, signal, frame in zip(chosen, field.signals, field.frames, strict=True)]
    return Scene(fit, tuple(chosen), tuple(columns), bare.basis, residual, tuple(channels(fit, problem)), field)
