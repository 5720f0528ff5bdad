"""Explain a disagreement: where it is, which effect or which kind of noise makes it, and how far the gap shrinks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Candidate, Field
from calib.errors import CalibrationError
from calib.problem import Problem
from calib.solve.estimate import Estimate, solve
from calib.workflow.discrepancy.conclusion import Explanation, Judgement, conclude
from calib.workflow.discrepancy.noise import NoiseTest, noise_tests, size_test
from calib.workflow.discrepancy.readings import row_numbers
from calib.workflow.discrepancy.rivals import HEAVY, SCALED, SERIAL, STATED, UNEVEN, Noise, accounts
from calib.workflow.discrepancy.scene import Scene, scene_of
from calib.workflow.discrepancy.search import Finding, Shares, corrected, search
from calib.workflow.discrepancy.structure import Place, Screen, described, patterns

ROUNDS = 4  # of naming and refitting, so that a curved model is judged where it is
MOST_NAMED = 3  # effects up to which a sum of them is an answer; more is structure without a name
RARE = 4.0  # what a blunder costs beside its choice: readings go wrong less often than noise is misjudged
ADVANTAGE = 6.0  # by which peculiar noise must beat plain noise, and a structure without a name a named effect


@dataclass(frozen=True)
class _Account:
    """One way to see the readings: a finding, patterns beside it, the noise that goes best with both, the score."""

    finding: Finding
    structure: tuple[Place, ...]
    noise: Noise
    score: float


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
    shares = Shares()
    before = solve(problem)
    if not before.converged:
        raise CalibrationError(
            f"{problem.name}: the nominal model does not converge ({before.message}), so nothing can be said about "
            "what it lacks. Give start values nearer to the truth, or look for gross errors in rows and units."
        )
    nominal = scene_of(problem, before, ())
    screen = Screen(nominal.field, patterns(nominal.channels), seed)
    scene, finding, named, outliers, estimate = _settled(problem, before, nominal, level, seed, shares)
    best = _best_account(scene, finding, screen, level, seed, shares, scene is nominal)
    chosen, rows = _names(scene, best.finding)
    if [c.label for c in chosen] != [c.label for c in named] or rows != outliers:
        refit = _refit(problem, chosen, rows, before)
        if refit is not None:
            named, outliers, estimate = chosen, rows, refit
            scene = scene_of(problem, estimate, named)
        else:
            listed = ", ".join(c.label for c in chosen)
            remarks = (*remarks, f"The fit with {listed} freed cannot be solved, so they are not named although the "
                       "residuals point at them; read positions in which they differ.")
            best = replace(best, finding=replace(_nothing(scene), scale=best.finding.scale))
            named, outliers, estimate = (), (), before
    noise = _noise(scene, best, level * shares.noise, seed)
    if best.noise.kind not in (STATED, SCALED) and best.finding is not finding and not noise:
        # Something was significant, and this noise accounts for it better than any effect.
        noise = (NoiseTest(best.noise.kind, best.noise.where, best.noise.correlation, level),)
    verdict = _verdict(best, named, outliers, noise)
    judged = Judgement(verdict, best.finding, named, outliers, best.structure, noise, best.noise)
    return conclude(problem, before, estimate, nominal, scene, judged, check, tuple(remarks), screen)


def _settled(
    problem: Problem, before: Estimate, scene: Scene, level: float, seed: int, shares: Shares
) -> tuple[Scene, Finding, tuple[Candidate, ...], tuple[int, ...], Estimate]:
    """Name effects and blunders, refit, and look again until the same are named where the model then is."""
    named: tuple[Candidate, ...] = ()
    outliers: tuple[int, ...] = ()
    estimate, finding = before, search(scene.field, scene.readings, level, seed, shares)
    for _ in range(ROUNDS):
        chosen, rows = _names(scene, finding)
        if [c.label for c in chosen] == [c.label for c in named] and rows == outliers:
            break
        refit = _refit(problem, chosen, rows, before)
        if refit is None:  # the linear picture promised more than the model keeps: stay where it holds
            break
        named, outliers, estimate = chosen, rows, refit
        scene = scene_of(problem, estimate, named)
        finding = search(scene.field, scene.readings, level, seed, shares)
    return scene, finding, named, outliers, estimate


def _names(scene: Scene, finding: Finding) -> tuple[tuple[Candidate, ...], tuple[int, ...]]:
    rows = {int(row_numbers(scene.fit)[b]) for b in finding.blunders} if finding.blunders else ()
    return tuple(scene.chosen[e] for e in finding.effects), tuple(sorted(rows))


def _refit(problem: Problem, named: Sequence[Candidate], outliers: Sequence[int], start: Estimate) -> Estimate | None:
    """Solve with the named effects freed and the outlying rows left out; None where that cannot be solved."""
    freed = problem.free(*[c.selection for c in named]) if named else problem
    if outliers:
        freed = freed.keep({o.group: ~np.isin(o.rows, outliers) for o in freed.observations if not o.is_prior})
    try:
        estimate = solve(freed, start=start)
    except CalibrationError:
        return None
    return estimate if estimate.converged else None


def _best_account(
    scene: Scene, finding: Finding, screen: Screen, level: float, seed: int, shares: Shares, at_nominal: bool
) -> _Account:
    """The account of the readings with the best score, among effects, blunders, structure and kinds of noise."""
    nothing = _nothing(scene)
    described_ones = []
    for base in (finding, nothing) if finding.effects else (nothing,):
        first = screen if at_nominal and base is nothing else None
        whole = _with_structure(scene, base, screen, level * shares.structure, seed, first)
        if whole is not None:
            described_ones.append(whole)
    if not (finding.effects or finding.blunders or described_ones):
        # Nothing is significant: what the noise is, is for its own tests.
        return _Account(nothing, (), Noise(STATED, 0.0, np.ones(len(scene.residual))), 0.0)
    plain, mine = accounts(nothing.left, scene.channels), accounts(finding.left, scene.channels)
    pool = [_Account(nothing, (), one, one.score) for one in plain] + described_ones
    if finding.effects or finding.blunders:
        cost = _price(scene, finding)
        pool += [_Account(finding, (), one, one.score + cost) for one in mine if one.kind in (STATED, SCALED)]
    for source in (plain, mine):
        for noise in source:
            if noise.kind in (STATED, SCALED) or noise.score > _white(source) - ADVANTAGE:
                continue
            again = _search_again(scene, noise, level, seed, shares)
            if again.effects:
                score = _score_through(scene, again, noise) + _price(scene, again) + ADVANTAGE
                pool.append(_Account(again, (), noise, score))
            break  # the best account of peculiar noise is enough to judge by
    best = min(pool, key=lambda a: a.score)
    with_same = [a for a in pool if a.structure and a.finding is best.finding]
    if best.finding.effects and with_same and best.noise.kind in (STATED, SCALED):
        # Structure that stays beside effects is judged on its own evidence: an effect is no answer while it stays.
        return with_same[0]
    return best


def _white(source: Sequence[Noise]) -> float:
    return min(one.score for one in source if one.kind in (STATED, SCALED))


def _nothing(scene: Scene) -> Finding:
    from calib.workflow.discrepancy.search import noise_scale

    return Finding((), (), (), (), noise_scale(scene.field), replace(scene.field, signals=(), sizes=()))


def _price(scene: Scene, finding: Finding) -> float:
    """What the parameters and choices of a finding cost."""
    taken = finding.left.basis.shape[1] - scene.field.basis.shape[1]
    log_dof = np.log(max(finding.left.dof, 2))
    candidates = max(len(scene.chosen), 1)
    return float(taken * log_dof + 2 * len(finding.effects) * np.log(candidates)
                 + len(finding.blunders) * (2 * np.log(len(scene.readings)) + RARE - log_dof))


def _search_again(scene: Scene, noise: Noise, level: float, seed: int, shares: Shares) -> Finding:
    """The search in rows that the account of the noise makes alike and independent."""
    field = scene.serial(noise.correlation) if noise.kind == SERIAL else scene.seen_through(noise.rows)
    return search(field, scene.readings, level, seed, shares, 0)


def _score_through(scene: Scene, finding: Finding, noise: Noise) -> float:
    """Score of the noise that is left when the effects of a finding are taken from the readings as they are."""
    columns = np.concatenate([scene.field.signals[e] for e in finding.effects], axis=1)
    sizes = np.concatenate([scene.field.sizes[e] for e in finding.effects])
    from calib.analyse.score import orthonormal

    left = replace(scene.field, signals=(), sizes=()).taking(orthonormal(columns, sizes))
    return next(one.score for one in accounts(left, scene.channels) if one.kind == noise.kind)


def _with_structure(
    scene: Scene, base: Finding, screen: Screen, level: float, seed: int, first: Screen | None
) -> _Account | None:
    bare: Field = replace(base.left, signals=(), sizes=())
    found, left, looks = described(bare, screen.shapes, level, seed, first, screen.looks)
    if not found:
        return None
    noise = min((a for a in accounts(left, scene.channels) if a.kind in (STATED, SCALED)), key=lambda a: a.score)
    taken = left.basis.shape[1] - bare.basis.shape[1]
    price = taken * np.log(max(left.dof, 2)) + 2 * len(found) * np.log(max(looks, 2))
    return _Account(base, tuple(found), noise, noise.score + price + _price(scene, base) + ADVANTAGE)


def _noise(scene: Scene, best: _Account, level: float, seed: int) -> tuple[NoiseTest, ...]:
    """Looks at the noise that failed at a level."""
    left, scale = best.finding.left, best.finding.scale
    if best.noise.kind in (UNEVEN, HEAVY, SERIAL):
        left = replace(scene.field, signals=(), sizes=()) if not best.finding.effects else left
    tests = [size_test(left), *noise_tests(left, scene.channels, scale, seed)]
    failed = [t for t in tests if corrected(t.p_value, 2 if t.what == "size" else 2 * (len(tests) - 1)) <= level]
    return tuple(sorted(failed, key=lambda t: t.p_value))


def _verdict(
    best: _Account, named: Sequence[Candidate], outliers: Sequence[int], noise: Sequence[NoiseTest]
) -> str:
    if best.structure or len(named) > MOST_NAMED:
        return "unknown-structure"
    if named:
        return "effects"
    if noise and not (outliers and best.noise.kind == STATED):
        return "noise-misstated"
    return "outliers" if outliers else "consistent"
