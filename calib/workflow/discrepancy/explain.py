"""Explain a disagreement: where it is, which effect or which kind of noise makes it, and how far the gap shrinks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Candidate, orthonormal
from calib.blocks import Array
from calib.errors import CalibrationError
from calib.problem import Problem
from calib.solve.estimate import Estimate, solve
from calib.workflow.discrepancy.alias import proportional
from calib.workflow.discrepancy.conclusion import Explanation, Judgement, conclude
from calib.workflow.discrepancy.judging import Account, best_account, failed_looks, nothing, shapeless
from calib.workflow.discrepancy.noise import NoiseTest
from calib.workflow.discrepancy.readings import Reading, readings_at, without
from calib.workflow.discrepancy.rivals import SCALED, SERIAL, STATED
from calib.workflow.discrepancy.scene import Scene, scene_of
from calib.workflow.discrepancy.search import Finding, Shares, search
from calib.workflow.discrepancy.structure import Screen, patterns
from calib.workflow.discrepancy.words import in_words, plausibility

ROUNDS = 4  # of naming and refitting, so that a curved model is judged where it is
MOST_NAMED = 3  # effects up to which a sum of them is an answer; more is structure without a name


def explain(
    problem: Problem,
    level: float = 0.01,
    check: Mapping[str, NDArray[np.bool_]] | None = None,
    seed: int = 20,
    remarks: Sequence[str] = (),
) -> Explanation:
    """Find out why model and readings disagree, or that they do not.

    problem: with its effects attached as held candidates; level: probability of a false alarm; check: {group: (n,)
    true where a row is held out} to judge the gap on; seed: of the simulated looks; remarks: to pass on.
    Returns the Explanation. Raises what `solve` raises where the nominal model cannot be estimated, and
    CalibrationError where it does not converge.
    """
    before = solve(problem)
    if not before.converged:
        raise CalibrationError(
            f"{problem.name}: the nominal model does not converge ({before.message}), so nothing can be said about "
            "what it lacks. Give start values nearer to the truth, or look for gross errors in rows and units."
        )
    nominal = scene_of(problem, before, ())
    screen = Screen(nominal.field, patterns(nominal.channels), seed, None, _families(nominal))
    scene, judged, estimate, words = _judged(problem, before, nominal, screen, level, seed, Shares())
    if judged.verdict == "noise-misstated" and _could_be_more(nominal, judged):
        # The alarm is raised whatever is found now: what remains is to say why, so each look may use the whole level.
        again = _judged(problem, before, nominal, screen, level, seed, Shares(1.0, 1.0, 1.0, Shares.noise))
        if again[1].verdict in ("effects", "unknown-structure"):
            scene, judged, estimate, words = again
    doubts = (f"The certificate of the {which} fit failed ({one.certificate.why}), so what is said of it may not hold."
              for which, one in {"nominal": before, "final": estimate}.items()
              if not one.certificate.passed)
    return conclude(problem, before, estimate, nominal, scene, judged, check, (*remarks, *words, *doubts), screen)


def _families(scene: Scene) -> list[Array]:
    """Orthonormal directions of the candidates of each kind: one of them, or the steps of one channel."""
    found: dict[tuple[str, str], list[int]] = {}
    for place, one in enumerate(scene.chosen):
        found.setdefault((one.effect.name, one.channel.partition("@")[0]), []).append(place)
    return [orthonormal(np.concatenate([scene.field.signals[place] for place in places], axis=1),
                        np.concatenate([scene.field.sizes[place] for place in places])) for places in found.values()]


def _could_be_more(nominal: Scene, judged: Judgement) -> bool:
    """Whether noise that is larger than stated, or remembers, may be something systematic."""
    return judged.account.kind in (STATED, SCALED, SERIAL) and nominal.field.squares > nominal.field.dof


def _judged(
    problem: Problem, before: Estimate, nominal: Scene, screen: Screen, level: float, seed: int, shares: Shares
) -> tuple[Scene, Judgement, Estimate, tuple[str, ...]]:
    """Search, weigh the rival accounts, and refit with what the best one names; remarks on what could not be."""
    words: tuple[str, ...] = ()
    scene, finding, named, outliers, estimate = _settled(problem, before, nominal, level, seed, shares)
    best = best_account(nominal, scene, finding, screen, level, seed, shares)
    chosen, rows = _names(scene, best.finding)
    if [c.label for c in chosen] != [c.label for c in named] or rows != outliers:
        refit = _refit(problem, chosen, rows, before)
        if refit is not None:
            named, outliers, estimate = chosen, rows, refit
            scene = scene_of(problem, estimate, named)
        else:
            listed = ", ".join(c.label for c in chosen)
            words = (f"The fit with {listed} freed cannot be solved, so they are not named although the "
                     "residuals point at them; read positions in which they differ." if chosen else
                     f"Row {', '.join(in_words(problem, rows))} looks like a blunder, but without it the unknowns "
                     "cannot be known; read it again.",)
            best = replace(best, finding=replace(nothing(nominal), scale=best.finding.scale))
            named, outliers, estimate = (), (), before
    noise = failed_looks(scene, best, level * shares.noise, seed)
    if best.noise.kind != STATED and best.finding is not finding and not noise:
        # Something was significant, and this noise accounts for it better than any effect.
        noise = (NoiseTest(best.noise.kind, best.noise.where, best.noise.correlation, level),)
    if noise or best.noise.kind != STATED or len(best.finding.blunders) > 1:
        best = replace(best, structure=best.structure or shapeless(scene, best))
    verdict = _verdict(best, named, outliers, noise)
    judged = Judgement(verdict, best.finding, named, outliers, best.structure, noise, best.noise)
    return scene, judged, estimate, words


def _settled(
    problem: Problem, before: Estimate, scene: Scene, level: float, seed: int, shares: Shares
) -> tuple[Scene, Finding, tuple[Candidate, ...], tuple[Reading, ...], Estimate]:
    """Name effects and blunders, refit, and look again until the same are named where the model then is."""
    named: tuple[Candidate, ...] = ()
    outliers: tuple[Reading, ...] = ()
    estimate, finding = before, search(scene.field, scene.readings, level, seed, shares, None, scene.positive)
    for _ in range(ROUNDS):
        finding = _likelier(scene, finding)
        chosen, rows = _names(scene, finding)
        if [c.label for c in chosen] == [c.label for c in named] and rows == outliers:
            break
        refit = _refit(problem, chosen, rows, before)
        if refit is None and rows:  # a gross blunder bends the linear picture: without it the model is seen where it is
            chosen, rows = _names(scene, replace(finding, effects=(), blunders=finding.blunders[:1]))
            refit = _refit(problem, chosen, rows, before)
        if refit is None:  # the linear picture promised more than the model keeps: stay where it holds
            break
        named, outliers, estimate = chosen, rows, refit
        scene = scene_of(problem, estimate, named)
        finding = search(scene.field, scene.readings, level, seed, shares, None, scene.positive, _moved(scene, finding))
    return scene, _likelier(scene, finding), named, outliers, estimate


def _moved(scene: Scene, finding: Finding) -> Finding:
    """A finding less what cannot be seen where the model now stands."""
    return replace(finding, effects=tuple(e for e in finding.effects if scene.field.frames[e].shape[1]))


def _likelier(scene: Scene, finding: Finding) -> Finding:
    """Of candidates that explain the readings exactly alike, those of usual size rather than implausible ones."""
    effects = list(finding.effects)
    for k, one in enumerate(effects):
        if not _implausible(scene, effects, one):
            continue
        for other in range(len(scene.chosen)):
            swapped = [*effects[:k], other, *effects[k + 1:]]
            if other not in effects and proportional(scene.field.signals[one], scene.field.signals[other]) and not (
                    _implausible(scene, swapped, other)):
                effects = swapped
                break
    return replace(finding, effects=tuple(effects))


def _implausible(scene: Scene, effects: Sequence[int], one: int) -> bool:
    """Whether a candidate comes out larger than is usual, or with a sign that cannot be, beside others."""
    together = np.concatenate([scene.field.signals[e] for e in effects], axis=1)
    begin = sum(scene.field.signals[e].shape[1] for e in effects[: list(effects).index(one)])
    step = np.linalg.lstsq(together, scene.field.residual, rcond=None)[0]
    values = step[begin : begin + scene.field.signals[one].shape[1]]
    return bool(plausibility(scene.chosen[one], values)) or (one in scene.positive and values[0] <= 0)


def _names(scene: Scene, finding: Finding) -> tuple[tuple[Candidate, ...], tuple[Reading, ...]]:
    return tuple(scene.chosen[e] for e in finding.effects), readings_at(scene.fit, finding.blunders)


def _refit(
    problem: Problem, named: Sequence[Candidate], outliers: Sequence[Reading], start: Estimate
) -> Estimate | None:
    """Solve with the named effects freed and the outlying rows left out; None where that cannot be solved."""
    freed = problem.free(*[c.selection for c in named]) if named else problem
    if outliers:
        freed = freed.keep(without(freed, outliers))
    try:
        estimate = solve(freed, start=start)
    except CalibrationError:
        return None
    return estimate if estimate.converged else None


def _verdict(
    best: Account, named: Sequence[Candidate], outliers: Sequence[Reading], noise: Sequence[NoiseTest]
) -> str:
    if best.structure or len(named) > MOST_NAMED:
        return "unknown-structure"
    if named:
        return "effects"
    if noise and not (outliers and best.noise.kind == STATED):
        return "noise-misstated"
    return "outliers" if outliers else "consistent"
