"""A model grown from its nominal state: effects are added one after another as long as blocks left out are predicted
better.

Where readings of a real machine disagree with its nominal model in many small ways at once, no single effect and no
test against the stated noise decides: what decides is whether the next effect helps where it was not fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Candidate, candidates, field_of, orthonormal
from calib.blocks import Array
from calib.errors import CalibrationError
from calib.linearisation import Linearisation
from calib.problem import Problem
from calib.solve.estimate import Estimate, solve

GAIN = 0.005         # relative improvement of the held-out rms below which adding stops
PARTS = 5            # of a file whose problem module names no blocks
HIDDEN = 1e-8        # share of a direction that other blocks must see to predict it


@dataclass(frozen=True)
class Step:
    """What was added: an effect, or what is left of a family that has a common tolerance; the labels of its effects;
    v'Pv it took, and the rms of residual / u of blocks left out afterwards."""

    name: str
    effects: tuple[str, ...]
    drop: float
    rms: float


@dataclass(frozen=True)
class Growth:
    """A grown model: problem with the effects freed and its estimate; before: rms of blocks left out at the nominal
    state; steps in order; refused: the best of the others, which did not help, with the rms that they gave."""

    problem: Problem
    estimate: Estimate
    before: float
    steps: tuple[Step, ...]
    refused: tuple[tuple[str, float], ...]

    @property
    def after(self) -> float:
        """Rms of residual / u of blocks left out, of the grown model."""
        return self.steps[-1].rms if self.steps else self.before

    @property
    def sentence(self) -> str:
        """What was added and what it brought, in words."""
        if not self.steps:
            return (f"No effect predicts blocks left out better than the nominal model (rms of residual/u "
                    f"{self.before:.3g}).")
        listed = ", ".join(f"{s.name} ({s.rms:.3g})" for s in self.steps)
        others = ", ".join(f"{name} ({rms:.3g})" for name, rms in self.refused[:2])
        return (f"From the nominal model, whose rms of residual/u on blocks left out is {self.before:.3g}, "
                f"{sum(len(s.effects) for s in self.steps)} effects were added in this order (rms afterwards): "
                f"{listed}. " + (f"The next best, {others}, would not help." if others else "No other is left."))


def blocks_of(problem: Problem, module: ModuleType) -> Mapping[str, NDArray[np.int64]]:
    """Blocks of neighbouring rows: those that a problem module names, else parts of the file that follow each other."""
    if hasattr(module, "blocks"):
        return dict(module.blocks(problem))
    return {o.group: np.arange(o.n) * PARTS // o.n for o in problem.observations if not o.is_prior and o.n >= PARTS}


def grow(problem: Problem, blocks: Mapping[str, NDArray[np.int64]], most: int = 60,
         progress: Callable[[], None] = lambda: None) -> Growth:
    """Free candidates one after another as long as blocks left out are predicted better.

    problem: with its effects held; blocks: {group: (n,) block of each row}, neighbours in one block; most: steps;
    progress: called after each step. Each candidate, and each family with one prior, is judged by the residuals of
    blocks left out in the linear picture; the best is freed and the model adjusted and linearised again.
    Raises what `solve` raises at the nominal state, and CalibrationError where there are fewer than two blocks.
    Source: predicted residuals, Allen, Technometrics 16(1), 1974; for blocks, Cook and Weisberg 1982, section 3.5.
    """
    if len({int(b) for index in blocks.values() for b in index}) < 2:
        raise CalibrationError(f"{problem.name}: all rows are in one block, so none can be left out; read positions "
                               "further apart.")
    estimate = solve(problem)
    before, offers = _left_out(estimate.fit, blocks)
    best, steps = before, list[Step]()
    while len(steps) < most and offers and offers[0].rms < (1.0 - GAIN) * best:
        offer, *others = offers
        longer = problem.free(*(candidate.selection for candidate in offer.candidates))
        try:
            fitted = solve(longer, start=estimate)
            reached, following = _left_out(fitted.fit, blocks)
        except CalibrationError:
            offers = others
            continue
        if not reached < best:          # the linear picture promised more than the model keeps
            offers = others
            continue
        problem, estimate, best, offers = longer, fitted, reached, following
        steps.append(Step(offer.name, tuple(c.label for c in offer.candidates), offer.drop, best))
        progress()
    return Growth(problem, estimate, before, tuple(steps), tuple((o.name, o.rms) for o in offers[:5]))


@dataclass(frozen=True)
class _Offer:
    """Candidates that may be freed together, the rms on blocks left out that they promise, and their drop of v'Pv."""

    name: str
    candidates: tuple[Candidate, ...]
    rms: float
    drop: float

    @property
    def parameters(self) -> int:
        return sum(len(one.columns) for one in self.candidates)


def _left_out(fit: Linearisation, blocks: Mapping[str, NDArray[np.int64]]) -> tuple[float, list[_Offer]]:
    """Rms of residual / u over all rows, each predicted from the other blocks: of the model as it is, and with each
    candidate or family freed, best first."""
    labels = np.concatenate([
        np.repeat(blocks[group.name][block.rows[:, 0]] if group.name in blocks else np.full(len(block.rows), -1),
                  block.residual.shape[1]) for group in fit.groups for block in group.whitened])
    rows = [np.flatnonzero(labels == block) for block in np.unique(labels[labels >= 0])]
    chosen = candidates(fit)
    field = field_of(fit, chosen)
    offers = []
    for name, members in _offered(fit, chosen):
        frame = orthonormal(np.concatenate([field.signals[k] for k in members], axis=1),
                            np.concatenate([field.sizes[k] for k in members]))
        if frame.shape[1]:
            along = frame.T @ field.residual
            rms = _predicted(field.residual - frame @ along, np.concatenate([field.basis, frame], axis=1), rows)
            offers.append(_Offer(name, tuple(chosen[k] for k in members), rms, float(along @ along)))
    least = (1.0 + GAIN) * min((one.rms for one in offers), default=0.0)     # as good as the best: the simplest first
    offers.sort(key=lambda one: (one.rms > least, one.parameters if one.rms <= least else 0, one.rms))
    return _predicted(field.residual, field.basis, rows), offers


def _offered(fit: Linearisation, chosen: Sequence[Candidate]) -> list[tuple[str, list[int]]]:
    """Each candidate by itself, and those together that one prior speaks of."""
    offered = [(one.label, [k]) for k, one in enumerate(chosen)]
    for group in fit.groups:
        if group.is_prior:
            columns = {int(c) for part in group.parts for c in np.ravel(part.columns)}
            members = [k for k, one in enumerate(chosen) if columns.issuperset(one.columns)]
            if len(members) > 1:
                offered.append((group.name, members))
    return offered


def _predicted(residual: Array, basis: Array, rows: list[NDArray[np.int64]]) -> float:
    """Rms of the residuals of blocks of rows, each predicted without it: (I - Q Q')^-1 v with Q its part of the
    basis."""
    squares = 0.0
    for block in rows:
        part, own = basis[block], residual[block]
        known = np.eye(basis.shape[1]) - part.T @ part
        away = own + part @ np.linalg.lstsq(known, part.T @ own, rcond=HIDDEN)[0]
        squares += float(away @ away)
    return float(np.sqrt(squares / sum(map(len, rows))))
