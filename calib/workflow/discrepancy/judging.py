"""Rival accounts of the readings, by effects, blunders, structure and kinds of noise, weighed on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.analyse.score import Field, orthonormal
from calib.workflow.discrepancy.noise import FEWEST, NoiseTest, noise_tests, upper_tail
from calib.workflow.discrepancy.rivals import HEAVY, LARGE, SCALED, SERIAL, STATED, UNEVEN, Noise, accounts, running
from calib.workflow.discrepancy.scene import Scene
from calib.workflow.discrepancy.search import Finding, Shares, noise_scale, search
from calib.workflow.discrepancy.structure import MOST, RUN, Place, Screen, described
from calib.workflow.discrepancy.subsets import BLUNDER

ADVANTAGE = 6.0  # by which peculiar noise must beat plain noise, and a structure without a name a named effect
GROSS = 6.0  # in u: from where on a reading is called a blunder; tails that are merely heavy reach so far rarely
PULSE = 3  # neighbours wrong to the same side: of 3 blunders among 30 readings, one time in 600
ODD = 8.0  # what it costs to assume noise that is not as stated beside something else: two causes where one may do


@dataclass(frozen=True)
class Account:
    """One way to see the readings: a finding, patterns beside it, the noise that goes best with both, the score."""

    finding: Finding
    structure: tuple[Place, ...]
    noise: Noise
    score: float


def best_account(
    nominal: Scene, scene: Scene, finding: Finding, screen: Screen, level: float, seed: int, shares: Shares
) -> Account:
    """The account of the readings with the best score, among effects, blunders, structure and kinds of noise.

    nominal: nothing added; scene: where the model stands with the finding; screen: of the nominal residuals.
    """
    none = nothing(nominal)
    beside = _with_structure(scene, finding, screen, level * shares.structure, seed, None) if finding.effects else None
    described_ones = [beside] if beside else []
    # One or two effects that leave nothing but the stated noise have one pattern for a rival: it costs next to nothing.
    clean = not beside and len(finding.effects) in (1, 2) and finding.scale == 1.0
    most = 1 if clean else MOST
    instead = _with_structure(nominal, none, screen, level * shares.structure, seed, screen, most)
    described_ones += [instead] if instead else []
    if not (finding.effects or finding.blunders or described_ones):
        # Nothing is significant: what the noise is, is for its own tests.
        return Account(none, (), Noise(STATED, 0.0, np.ones(len(scene.residual))), 0.0)
    plain, mine = accounts(none.left, nominal.channels), accounts(finding.left, scene.channels)
    # Nothing but the stated noise is refuted already; another size is a rival only where the stated one was given up.
    refuted = (STATED, SCALED) if none.scale == 1.0 else (STATED,)
    pool = [Account(none, (), one, one.score) for one in plain if one.kind not in refuted] + described_ones
    if finding.effects or finding.blunders:
        cost = price_of(scene, finding)
        pool += [Account(finding, (), one, one.score + cost + (ODD if one.kind == SCALED else 0.0))
                 for one in mine if one.kind in (STATED, SCALED)]
    for source in (plain, mine):
        for noise in source:
            if noise.kind in (STATED, SCALED) or noise.score > _plainest(source).score - ADVANTAGE:
                continue
            if scene.derivatives.size > LARGE:
                break
            again = _search_again(scene, noise, level, seed, shares)
            if again.effects:
                score = _score_through(scene, again, noise) + price_of(scene, again) + ODD
                pool.append(Account(again, (), noise, score))
            break  # the best account of peculiar noise is enough to judge by
    best = min(pool, key=lambda a: a.score)
    with_same = [a for a in pool if a.structure and a.finding is best.finding]
    if best.finding.effects and with_same and best.noise.kind in (STATED, SCALED):
        # Structure that stays beside effects is judged on its own evidence: an effect is no answer while it stays.
        return with_same[0]
    return best


def _plainest(source: Sequence[Noise]) -> Noise:
    """The better of noise as stated and noise of another size."""
    return min((one for one in source if one.kind in (STATED, SCALED)), key=lambda one: one.score)


def nothing(scene: Scene) -> Finding:
    """The finding that nothing is missing."""
    field = scene.field
    return Finding((), (), (), (), noise_scale(field.squares, field.dof), replace(field, signals=(), sizes=()))


def price_of(scene: Scene, finding: Finding) -> float:
    """What the parameters and choices of a finding cost."""
    taken = finding.left.basis.shape[1] - scene.field.basis.shape[1]
    log_dof = np.log(max(finding.left.dof, 2))
    candidates = max(len(scene.chosen), 1)
    both = ADVANTAGE if finding.effects and finding.blunders else 0.0
    return float(taken * log_dof + 2 * len(finding.effects) * np.log(candidates) + both + _smallness(scene, finding)
                 + 2 * _ways(len(scene.readings), len(finding.blunders)) + len(finding.blunders) * (BLUNDER - log_dof))


def _smallness(scene: Scene, finding: Finding) -> float:
    """What it costs that blunders are small: a reading that went wrong is wrong by GROSS or more before its noise."""
    from scipy.special import log_ndtr

    if not finding.blunders:
        return 0.0
    beside = _left(scene, replace(finding, blunders=()))
    sizes = np.linalg.lstsq(beside.alone(finding.blunders), beside.residual, rcond=None)[0]
    return float(-2 * np.sum(log_ndtr(np.abs(sizes) - GROSS)))


def _ways(n: int, k: int) -> float:
    """Logarithm of the number of ways to choose k of n."""
    from scipy.special import gammaln

    return float(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1))


def _search_again(scene: Scene, noise: Noise, level: float, seed: int, shares: Shares) -> Finding:
    """The search in rows that the account of the noise makes alike and independent."""
    field = scene.serial(noise.correlation, noise.way) if noise.kind == SERIAL else scene.seen_through(noise.rows)
    return search(field, scene.readings, level, seed, shares, 0, scene.positive)


def _score_through(scene: Scene, finding: Finding, noise: Noise) -> float:
    """Score of the noise that is left when the effects of a finding are taken from the readings as they are."""
    return next(one.score for one in accounts(_left(scene, finding), scene.channels) if one.kind == noise.kind)


def _left(scene: Scene, finding: Finding) -> Field:
    """What a finding leaves of the readings as they are, whatever noise it was found through."""
    bare = replace(scene.field, signals=(), sizes=())
    if not finding.effects:
        return finding.left if finding.blunders else bare
    columns = np.concatenate([scene.field.signals[e] for e in finding.effects], axis=1)
    sizes = np.concatenate([scene.field.sizes[e] for e in finding.effects])
    kept = bare.without(finding.blunders)
    return kept.taking(orthonormal(kept.outside(columns), sizes))


def _with_structure(
    scene: Scene, base: Finding, screen: Screen, level: float, seed: int, first: Screen | None, most: int = MOST
) -> Account | None:
    bare: Field = replace(base.left, signals=(), sizes=())
    found, left, choices = described(bare, screen.nameless, level, seed, first, screen.looks, most)
    if not found:
        return None
    noise = _plainest(accounts(left, scene.channels))
    taken = left.basis.shape[1] - bare.basis.shape[1]
    price = taken * np.log(max(left.dof, 2)) + choices
    if noise.kind == SCALED and left.squares < left.dof:
        price += ODD  # noise that is larger may be more of the structure; smaller it cannot
    return Account(base, tuple(found), noise, noise.score + price + price_of(scene, base) + ADVANTAGE)


def failed_looks(scene: Scene, best: Account, level: float, seed: int) -> tuple[NoiseTest, ...]:
    """Looks at the noise that failed at a level."""
    left, scale = best.finding.left, best.finding.scale
    if best.noise.kind in (UNEVEN, HEAVY, SERIAL):
        left = replace(scene.field, signals=(), sizes=()) if not best.finding.effects else left
    failed = [one for one, p in noise_tests(left, scene.channels, scale, seed) if p <= level]
    return tuple(sorted(failed, key=lambda t: t.p_value))


def shapeless(scene: Scene, best: Account) -> tuple[Place, ...]:
    """Structure that no pattern describes: what runs on beside the stated noise, where that accounts for what is left
    better than any kind of noise does, or for what was there better than blunders do."""
    left = _left(scene, best.finding)
    if left.dof < FEWEST or left.basis.size >= LARGE:
        return ()
    if pulse := _neighbours(scene, best.finding.blunders):
        return (pulse,)
    rivals = [(left, accounts(left, scene.channels)[0].score)]
    if best.finding.blunders:
        rivals.append((_left(scene, replace(best.finding, blunders=())), best.score))
    for one, score in rivals:
        own, size = running(one, scene.channels)
        if own < score:
            return (Place("all readings", "time", RUN, upper_tail(one), {"rms_over_u": size}),)
    return ()


def _neighbours(scene: Scene, blunders: Sequence[int]) -> Place | None:
    """A pulse: readings one after another that are wrong to the same side, which blunders hardly ever are."""
    wrong = np.zeros(len(scene.field.residual))
    wrong[list(blunders)] = np.sign(scene.field.residual[list(blunders)])
    for channel in scene.channels:
        along = wrong[channel.places[channel.order]]
        runs = np.lib.stride_tricks.sliding_window_view(along, PULSE) if len(along) >= PULSE else np.zeros((0, PULSE))
        if np.any(np.abs(runs.sum(axis=1)) == PULSE):
            size = float(np.sqrt(np.mean(scene.field.residual[channel.places[channel.order][along != 0]] ** 2)))
            return Place(channel.name, "time", "pulse", upper_tail(scene.field), {"rms_over_u": size})
    return None
