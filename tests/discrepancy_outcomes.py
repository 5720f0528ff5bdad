"""What became of a hidden case: named or not, alias set complete, parameters against the truth and the informed fit."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from discrepancy_cases import Case
from scipy.special import chndtr
from scipy.stats import chi2

from calib import covariance, linearise, solve, units
from calib.analyse.score import candidates
from calib.workflow.discrepancy.alias import aliases
from calib.workflow.discrepancy.explain import explain
from calib.workflow.discrepancy.heldout import held_out
from calib.workflow.discrepancy.scene import scene_of


@dataclass(frozen=True)
class Outcome:
    """One case judged: all figures are shares or ratios; not a number where they do not apply."""

    verdict: str
    right: bool
    alarmed: bool
    named: bool
    exact: bool
    or_alias: bool
    exact_where_separable: float
    missed_aliases: float
    listed_aliases: int
    spurious_aliases: int
    rows: float
    within: float
    u_ratio: float
    shrink: float
    ideal: float
    seconds: float


def outcome(case: Case, level: float = 0.01, gap: bool = True) -> Outcome:
    """Explain a case and compare with its truth; gap: also judge the held-out rows."""
    begin = time.process_time()
    found = explain(case.problem, level, case.check if gap and case.effects else None)
    seconds = time.process_time() - begin
    mine, true = {(e.name, e.channel): e for e in found.effects}, set(case.effects)
    pairs = [(key if key in true else next(iter(set(one.aliases) & true), None)) for key, one in mine.items()]
    or_alias = len(mine) == len(true) and None not in pairs and set(pairs) == true
    exact = set(mine) == true
    missed = within = ratio = shrink = ideal = separable = np.nan
    listed = spurious = 0
    rows = float(set(found.outlier_rows) == set(case.rows)) if case.rows else np.nan
    if case.effects:
        estimate = solve(case.problem)
        scene = scene_of(case.problem, estimate, ())
        places = {(c.effect.name, c.channel): i for i, c in enumerate(scene.chosen)}
        ideal = _power(scene, case, places, level)
        theirs = _aliases(scene, case, places)
        if not any(theirs.values()):
            separable = float(exact)
        if exact:
            if any(theirs.values()):
                missed = float(any(theirs[key] - set(one.aliases) for key, one in mine.items()))
            listed = sum(len(one.aliases) for one in mine.values())
            spurious = sum(len(set(one.aliases) - theirs[key]) for key, one in mine.items())
            within, ratio = _parameters(case, mine)
            shrink = _shrink(case, found, estimate)
    return Outcome(found.verdict, found.verdict == case.verdict, found.verdict != "consistent", bool(mine), exact,
                   or_alias, separable, missed, listed, spurious, rows, within, ratio, shrink, ideal, seconds)


def _aliases(scene, case: Case, places) -> dict[tuple[str, str], set[tuple[str, str]]]:
    """What each hidden effect has for aliases, from its true size."""
    values = {places[key]: value for key, value in case.effects.items()}
    sets = aliases(scene.field, list(values), values, scene.columns, scene.positive, estimated=False)
    return {(scene.chosen[one].effect.name, scene.chosen[one].channel):
            {(scene.chosen[o].effect.name, scene.chosen[o].channel) for o in others} for one, others in sets.items()}


def _power(scene, case: Case, places, level: float) -> float:
    """Power of the test that knows which effects to look for and looks at nothing else."""
    frame = np.concatenate([scene.field.signals[places[key]] for key in case.effects], axis=1)
    signal = sum(scene.field.signals[places[key]] @ value for key, value in case.effects.items())
    count = int(np.linalg.matrix_rank(frame))
    return float(1 - chndtr(chi2.ppf(1 - level, count), count, float(signal @ signal)))


def _freed(case: Case):
    fit = linearise(solve(case.problem))
    chosen = [c for c in candidates(fit) if (c.effect.name, c.channel) in case.effects]
    return case.problem.free(*[c.selection for c in chosen]), chosen


def _parameters(case: Case, mine) -> tuple[float, float]:
    """Share of parameters within 2u of the truth, and mean of u over that of the fit that knows the truth."""
    freed, chosen = _freed(case)
    oracle = linearise(solve(freed))
    inside, ratios = [], []
    for one in chosen:
        own = covariance(oracle, one.selection).u * case.factor
        true = case.effects[one.effect.name, one.channel]
        for parameter, t, u in zip(one.effect.parameters, true, own, strict=True):
            value, its_u, unit = mine[one.effect.name, one.channel].parameters[parameter.name]
            scale = units.factor(unit)
            inside.append(abs(value * scale - t) <= 2 * its_u * scale)
            ratios.append(its_u * scale / u)
    return float(np.mean(inside)), float(np.mean(ratios))


def _shrink(case: Case, found, estimate) -> float:
    """Fall of the held-out rms over the fall that the fit with the truth gives."""
    if found.heldout_rms is None:
        return np.nan
    freed, _ = _freed(case)
    best = held_out(freed, case.check, solve(freed))
    fall = found.heldout_rms[0] - best.rms if best else 0.0
    return float((found.heldout_rms[0] - found.heldout_rms[1]) / fall) if fall > 0.05 else np.nan
