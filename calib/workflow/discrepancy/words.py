"""What a person reads about a discrepancy: the sentence on top, the size of an effect, what cannot be judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from calib import units
from calib.analyse.score import Candidate
from calib.blocks import Array
from calib.problem import Problem
from calib.workflow.discrepancy.noise import NoiseTest
from calib.workflow.discrepancy.readings import Reading
from calib.workflow.discrepancy.scene import Scene
from calib.workflow.discrepancy.structure import RUN, Place

if TYPE_CHECKING:
    from calib.workflow.discrepancy.conclusion import NamedEffect

LISTED = 6
LEVEL = "level"  # the shape of a disagreement that is constant for each value of a covariate
SHAPES = {LEVEL: "a constant for each", "trend": "a trend over", "curve": "a curve over", "cubic": "a cubic over",
          "smooth": "a smooth function of", "fine": "a fine function of", "pieces": "steps over",
          "pulse": "a pulse over", RUN: "something without a simple shape that runs on over"}
INFLUENCES = {"time": "time (drifts)", "temperature_difference": "temperature (thermal effects)",
              "block": "block (steps between set-ups)"}  # what any reading may be recorded with, and what it shows
FEW_SPARE = 5  # degrees of freedom below which hardly anything can be found
GROSS = 1000.0  # u from which on a misfit is a wrong column rather than a missing effect


def plausibility(one: Candidate, values: Array) -> str:
    """A word on the size of an effect where that is unusual; empty otherwise. values (k,) SI."""
    words = []
    for parameter, value in zip(one.effect.parameters, values, strict=True):
        high = parameter.plausible[1]
        if abs(value) > 3 * high:
            factor = units.factor(parameter.unit)
            words.append(
                f"{parameter.name} = {value / factor:.3g} {parameter.unit} is implausible: up to {high / factor:.3g} "
                f"{parameter.unit} is usual"
            )
    return "; ".join(words)


def half_told(one: Candidate) -> str:
    """That some parameters of an effect cannot be told from these readings."""
    names = [p.name for i, p in enumerate(one.effect.parameters) if i not in (one.parts or ())]
    return (f"These readings cannot tell {' and '.join(names)} of {one.label}: held at zero, with the largest usual "
            "size for its u.")


def sentence(
    verdict: str,
    effects: Sequence[NamedEffect],
    rows: Sequence[str],
    structure: Sequence[Place],
    noise: Sequence[NoiseTest],
    rms: tuple[float, float],
    heldout_rms: tuple[float, float] | None = None,
) -> str:
    """The finding in one to three plain sentences."""
    if verdict == "consistent":
        return "Model and stated noise explain the readings; nothing is missing that they could show."
    if verdict == "outliers":
        return f"The model holds and the noise is as stated, but {_blunders(rows)}."
    if verdict == "noise-misstated":
        kinds = ", ".join(_of_noise(t) for t in noise[:3]) or "more large residuals than normal noise has"
        return f"Nothing systematic is missing, but the noise is not what was stated: {kinds}."
    if verdict == "unknown-structure":
        if structure:
            return ("There is systematic structure that no known effect explains, most clearly "
                    f"{_of_structure(structure[0])}.")
        return "There is systematic structure that no sum of up to three known effects explains."
    several = len(effects) > 1
    names = " and ".join(f"{e.name} ({e.channel})" for e in effects)
    also = f" Beside that, {_blunders(rows)}." if rows else ""
    unseen = "" if heldout_rms is None else \
        f", on readings that took no part from {heldout_rms[0]:.3g} to {heldout_rms[1]:.3g} u"
    doubtful = [f"{e.name} ({e.channel})" for e in effects if e.aliases]
    told = f" These readings cannot tell {' and '.join(doubtful)} from other effects; see the aliases."
    return (f"Missing in the model: {names}; with {'them' if several else 'it'} the root mean square residual falls "
            f"from {rms[0]:.3g} to {rms[1]:.3g} u{unseen}.{also}{told if doubtful else ''}")


def in_words(problem: Problem, readings: Sequence[Reading]) -> tuple[str, ...]:
    """Readings by their rows, and by their groups where several groups have such a row."""
    rows = np.concatenate([o.rows for o in problem.observations if not o.is_prior])
    return tuple(str(one.row) if np.sum(rows == one.row) == 1 else f"{one.row} of {one.group.replace('_', ' ')}"
                 for one in readings)


def _blunders(rows: Sequence[str]) -> str:
    listed = ", ".join(rows)
    return f"row {listed} is a blunder" if len(rows) == 1 else f"{len(rows)} rows are blunders: {listed}"


def _of_structure(place: Place) -> str:
    """A description such as "harmonic 4 over angle in level (2.1 u at 34 deg)"."""
    figures = place.figures
    size = ""
    if "amplitude_over_u" in figures:
        size = f" ({figures['amplitude_over_u']:.2g} u at {figures['phase_deg']:.0f} deg)"
    elif "rms_over_u" in figures:
        size = f" ({figures['rms_over_u']:.2g} u, root mean square)"
    shape = SHAPES.get(place.shape, place.shape + (" of" if "range" in place.shape else " over"))
    return f"{shape} {place.covariate.replace('_', ' ')} in {place.channel}{size}"


def next_measurement(
    verdict: str, advice: str, rows: Sequence[str], structure: Sequence[Place], noise: Sequence[NoiseTest],
    standing: Mapping[str, Sequence[str]],
) -> str:
    """What to measure next, in a sentence without its full stop; empty where nothing would decide more.

    advice: what tells named effects from their aliases; standing: {covariate that never varies: effects it drives}.
    """
    if advice:
        return advice
    if verdict == "unknown-structure" and structure:
        over, where = structure[0].covariate.replace("_", " "), structure[0].channel
        if structure[0].shape == LEVEL:
            return (f"read {where} again for every {over}, in another order: what stays with a {over} belongs to the "
                    "model, what does not to the time")
        return (f"read {where} again in finer steps of {over}, there and back, and once more on another day: what "
                f"repeats with {over} belongs to the model, what comes with the time does not")
    if verdict in ("unknown-structure", "noise-misstated"):
        if any(t.what == "serial correlation" for t in noise):
            return "repeat some positions later and in another order, to tell what drifts in between from what repeats"
        if any(t.what == "uneven size" for t in noise):
            return f"repeat readings without moving anything where the scatter differs ({noise[0].where})"
        return "repeat some readings without moving anything, to tell larger noise from something that is missing"
    if verdict == "outliers":
        return f"read row {', '.join(rows)} again"
    shows = [f"{name.replace('_', ' ')} vary to show {', '.join(labels[:LISTED])}" for name, labels in standing.items()]
    return f"let {'; let '.join(shows[:LISTED])}" if shows else ""


def _of_noise(test: NoiseTest) -> str:
    if test.what == "size":
        return f"its size is {test.figure:.2g} times the stated one"
    return f"{test.what} in {test.where}"


def unseen(scene: Scene) -> list[Candidate]:
    """Candidates that no reading shows."""
    return [c for c, f in zip(scene.chosen, scene.field.frames, strict=True) if not f.shape[1]]


def remarks_on(scene: Scene) -> tuple[str, ...]:
    """What these readings cannot judge: too little to spare, influences that never vary, effects that never show."""
    found = []
    misfit = float(np.sqrt(scene.field.squares / max(scene.field.dof, 1)))
    if misfit > GROSS:
        found.append(f"The readings lie {misfit:.2g} times their uncertainty off the model (root mean square), more "
                     "than any effect does: check units, signs and order of the columns first.")
    if scene.field.dof < FEW_SPARE:
        found.append(f"Only {scene.field.dof} reading(s) more than unknowns: hardly anything could be found. Read "
                     "further positions, or the same ones again.")
    hiding = unseen(scene)
    if scene.chosen and len(hiding) == len(scene.chosen):
        found.append("Not one of the known effects can be told from the unknowns with these readings. Vary what they "
                     "depend on, or hold an unknown that is known from elsewhere.")
    elif hiding:
        listed = ", ".join(c.label for c in hiding[:LISTED]) + (" and others" if len(hiding) > LISTED else "")
        found.append(f"These readings cannot show {listed}: the unknowns absorb them, or what drives them stands "
                     "still.")
    recorded = {name for channel in scene.channels for name in channel.covariates}
    if missing := [words for name, words in INFLUENCES.items() if name not in recorded]:
        found.append(f"Not recorded with the readings, so that nothing could be looked for over it: "
                     f"{', '.join(missing)}.")
    for name, labels in standing_still(scene).items():
        found.append(f"'{name.replace('_', ' ')}' never varies, so {', '.join(labels[:LISTED])} cannot be judged; "
                     "let it vary in further readings.")
    return tuple(found)


def standing_still(scene: Scene) -> dict[str, list[str]]:
    """{covariate that never varies: labels of the candidates that it drives}."""
    found = {}
    for name in dict.fromkeys(name for channel in scene.channels for name in channel.covariates):
        columns = [c.covariates[name] for c in scene.channels if name in c.covariates]
        users = [c.label for c in scene.chosen if name in c.effect.inputs]
        if users and len(np.unique(np.concatenate(columns))) == 1:
            found[name] = users
    return found
