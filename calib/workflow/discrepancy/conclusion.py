"""What is reported of a discrepancy: verdict, effects with uncertainty and aliases, the gap before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib import units
from calib.analyse.score import Candidate
from calib.blocks import Array
from calib.errors import CalibrationError
from calib.problem import Problem
from calib.solve.estimate import Estimate
from calib.workflow.discrepancy.alias import RAISES, Hidden, aliases, hidden, proportional, what_would_tell
from calib.workflow.discrepancy.heldout import HeldOut, held_out
from calib.workflow.discrepancy.looks import corrected
from calib.workflow.discrepancy.noise import BARELY, NoiseTest, size_test
from calib.workflow.discrepancy.readings import Reading, readings_at, without
from calib.workflow.discrepancy.rivals import Noise
from calib.workflow.discrepancy.scene import Scene
from calib.workflow.discrepancy.search import Finding, noise_scale
from calib.workflow.discrepancy.structure import Place, Screen
from calib.workflow.discrepancy.words import (
    half_told,
    in_words,
    next_measurement,
    plausibility,
    remarks_on,
    sentence,
    standing_still,
)

LOOKED_AT = 3  # kinds of look at the nominal model: the size of its residuals, places, effects
MANY = 8  # places named under `where`


@dataclass(frozen=True)
class NamedEffect:
    """One effect that explains the readings: parameters {name: (value, u, unit)} in display units, corrected p-value
    of its absence, aliases that these readings cannot tell from it, and a word on its size where that is unusual."""

    name: str
    channel: str
    parameters: Mapping[str, tuple[float, float, str]]
    p_value: float
    aliases: tuple[tuple[str, str], ...]
    plausibility: str


@dataclass(frozen=True)
class Ranked:
    """A candidate with the drop of v'Pv it alone would give, its degrees of freedom and how much of it can be seen."""

    label: str
    drop: float
    dof: int
    seen: float


@dataclass(frozen=True)
class Explanation:
    """What was found; sentence says it in plain words.

    verdict: consistent, effects, unknown-structure, noise-misstated or outliers; p_value: of nominal model and stated
    noise; effects; outliers: the readings that are; noise_factor: actual over stated standard deviation after the
    effects; rms, heldout_rms: (before, after), the latter None where no rows are held out; where; structure; noise:
    looks at the noise that failed; hidden; next_measurement; ranking: of all candidates; remarks; before, after: the
    estimates; heldout: on held-out rows without and with what was found, None where no rows are held out.
    """

    verdict: str
    sentence: str
    p_value: float
    effects: tuple[NamedEffect, ...]
    outliers: tuple[Reading, ...]
    noise_factor: float
    rms: tuple[float, float]
    heldout_rms: tuple[float, float] | None
    where: tuple[Place, ...]
    structure: tuple[Place, ...]
    noise: tuple[NoiseTest, ...]
    hidden: tuple[Hidden, ...]
    next_measurement: str
    ranking: tuple[Ranked, ...]
    remarks: tuple[str, ...]
    before: Estimate
    after: Estimate
    heldout: tuple[HeldOut, HeldOut] | None

    @property
    def outlier_rows(self) -> tuple[int, ...]:
        """Rows of the data file of the blunders."""
        return tuple(one.row for one in self.outliers)


@dataclass(frozen=True)
class Judgement:
    """What the judging of one problem ended in."""

    verdict: str
    finding: Finding
    named: tuple[Candidate, ...]
    outliers: tuple[Reading, ...]
    structure: tuple[Place, ...]
    noise: tuple[NoiseTest, ...]
    account: Noise


def conclude(
    problem: Problem,
    before: Estimate,
    estimate: Estimate,
    nominal: Scene,
    scene: Scene,
    judged: Judgement,
    check: Mapping[str, NDArray[np.bool_]] | None,
    remarks: tuple[str, ...],
    screen: Screen,
) -> Explanation:
    """Put a judgement into an Explanation.

    problem; before, estimate: solved without and with what was named; nominal, scene: linearised there; check: held-out
    rows; remarks: to pass on; screen: of the nominal model's residuals for patterns.
    """
    verdict = judged.verdict
    after = estimate if verdict in ("effects", "outliers") else before
    effects: tuple[NamedEffect, ...] = ()
    advice = ""
    if verdict == "effects":
        effects, advice = _named(scene, judged.finding, judged.named, after)
        remarks = (*remarks, *(half_told(c) for c in judged.named if c.parts is not None))
    rows = judged.outliers if verdict in ("effects", "outliers") else ()
    remarks = (*remarks, *_or_else(problem, nominal, judged))
    listed = in_words(problem, rows)
    where = tuple(p for p in screen.places()[:MANY] if p.p_value < 0.01)
    looks = [size_test(nominal.field).p_value, *(p.p_value for p in where[:1]), *(e.p_value for e in effects)]
    p_value = corrected(min(looks), LOOKED_AT)  # each is corrected within its kind already
    rms = (_spread(before), _spread(after))
    held = None
    if check:
        try:
            held = _held(problem, check, before, after, judged.named if verdict == "effects" else (), rows)
        except CalibrationError as error:
            remarks = (*remarks, f"The gap on held-out rows cannot be judged: without them, {error.sentence}")
    return Explanation(
        verdict,
        sentence(verdict, effects, listed, judged.structure, judged.noise, rms,
                 (held[0].rms, held[1].rms) if held else None),
        p_value,
        effects,
        rows,
        rms[1],
        rms,
        (held[0].rms, held[1].rms) if held else None,
        where,
        judged.structure,
        judged.noise,
        tuple(hidden(nominal.fit, nominal.field, nominal.chosen)),
        next_measurement(verdict, advice, listed, judged.structure, judged.noise, standing_still(nominal)),
        _ranking(nominal),
        (*remarks, *remarks_on(nominal)),
        before,
        after,
        held,
    )


def _or_else(problem: Problem, nominal: Scene, judged: Judgement) -> tuple[str, ...]:
    """That one effect would do where blunders were found, or one blunder where effects were, in a sentence."""
    field, enough = nominal.field, judged.finding.left.squares + RAISES
    if judged.verdict == "outliers":
        alike = [c.label for c, drop in zip(nominal.chosen, field.statistics[0], strict=True)
                 if field.squares - drop <= enough]
        found = f"a blunder in row {', '.join(in_words(problem, judged.outliers))}"
    elif judged.verdict == "effects" and not judged.outliers:
        shown = np.where(field.redundancy > BARELY, field.residual**2 / np.maximum(field.redundancy, BARELY), 0.0)
        places = [p for p in nominal.readings if field.squares - shown[p] <= enough]
        alike = [f"a blunder in row {row}" for row in in_words(problem, readings_at(nominal.fit, places))]
        found = " and ".join(c.label for c in judged.named)
    else:
        return ()
    return (f"These readings cannot tell {found} from {' or '.join(alike)}: what is read again there decides.",
            ) if alike else ()


def _spread(estimate: Estimate) -> float:
    return float(np.sqrt(estimate.objective / estimate.dof)) if estimate.dof > 0 else 0.0


def _ranking(nominal: Scene) -> tuple[Ranked, ...]:
    """All candidates by the drop of v'Pv that each alone would give."""
    drops, dofs = nominal.field.statistics
    found = []
    for one, drop, dof, signal, size in zip(nominal.chosen, drops, dofs, nominal.field.signals, nominal.field.sizes,
                                            strict=True):
        seen = float(np.linalg.norm(signal) / max(float(np.linalg.norm(size)), 1e-300))
        found.append(Ranked(one.label, float(drop), int(dof), seen))
    return tuple(sorted(found, key=lambda r: -r.drop))


def _held(
    problem: Problem,
    check: Mapping[str, NDArray[np.bool_]],
    before: Estimate,
    after: Estimate,
    named: Sequence[Candidate],
    rows: Sequence[Reading],
) -> tuple[HeldOut, HeldOut] | None:
    """The gap on held-out rows of the nominal model and of the one with what was found."""
    first = held_out(problem, check, before)
    if first is None:
        return None
    if not named and not rows:
        return first, first
    better = problem.free(*[c.selection for c in named]) if named else problem
    masks = dict(check)
    if rows:
        kept = {group: mask | check.get(group, np.zeros(len(mask), bool))
                for group, mask in without(problem, rows).items()}
        better = better.keep(kept)
        masks = {group: mask[kept[group]] for group, mask in check.items() if kept[group].any()}
    second = held_out(better, masks, after)
    return (first, second) if second else None


def _named(
    scene: Scene, finding: Finding, named: Sequence[Candidate], after: Estimate
) -> tuple[tuple[NamedEffect, ...], str]:
    from calib.analyse.covariance import covariance
    from calib.linearisation import linearise

    fit = linearise(after)
    values: dict[int, Array] = {
        place: after.values[scene.chosen[place].unknown][scene.chosen[place].instance] for place in finding.effects
    }
    field = scene.field.without(finding.blunders)
    standing_in = aliases(field, finding.effects, values, scene.columns, scene.positive)
    effects, advice = [], []
    widened = np.sqrt(noise_scale(after.objective, after.dof))  # by the readings as they are
    for place, p in zip(finding.effects, finding.p_effects, strict=True):
        one = scene.chosen[place]
        u = np.array([p.plausible[1] for p in one.effect.parameters])  # of a part that cannot be told: what is usual
        u[slice(None) if one.parts is None else list(one.parts)] = covariance(fit, one.selection).u * widened
        parameters = {
            q.name: (float(v / units.factor(q.unit)), float(s / units.factor(q.unit)), q.unit)
            for q, v, s in zip(one.effect.parameters, values[place], u, strict=True)
        }
        others = [scene.chosen[o] for o in standing_in[place]]
        same = tuple((o.effect.name, o.channel) for o in others)
        effects.append(NamedEffect(one.effect.name, one.channel, parameters, p, same, plausibility(one, values[place])))
        if others:
            alike = [proportional(scene.columns[place], scene.columns[o]) for o in standing_in[place]]
            advice.append(what_would_tell(one, others, alike))
    return tuple(effects), "; ".join(advice)
