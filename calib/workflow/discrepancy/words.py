"""What a person reads about a discrepancy: the sentence on top, the size of an effect, what cannot be judged."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from calib import units
from calib.analyse.score import Candidate
from calib.blocks import Array
from calib.workflow.discrepancy.noise import NoiseTest
from calib.workflow.discrepancy.scene import Scene
from calib.workflow.discrepancy.structure import Place

if TYPE_CHECKING:
    from calib.workflow.discrepancy.conclusion import NamedEffect

LISTED = 6
FEW_SPARE = 5  # degrees of freedom below which hardly anything can be found


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


def sentence(
    verdict: str,
    effects: Sequence[NamedEffect],
    rows: Sequence[int],
    structure: Sequence[Place],
    noise: Sequence[NoiseTest],
    rms: tuple[float, float],
) -> str:
    """The finding in one or two plain sentences."""
    if verdict == "consistent":
        return "Model and stated noise explain the readings; nothing is missing that they could show."
    if verdict == "outliers":
        listed = ", ".join(map(str, rows))
        return f"The model holds and the noise is as stated, but {len(rows)} row(s) are blunders: {listed}."
    if verdict == "noise-misstated":
        kinds = ", ".join(_of_noise(t) for t in noise[:3]) or "more large residuals than normal noise has"
        return f"Nothing systematic is missing, but the noise is not what was stated: {kinds}."
    if verdict == "unknown-structure":
        if structure:
            p = structure[0]
            return (
                "There is systematic structure that no known effect explains, most clearly "
                f"{p.shape} over {p.covariate.replace('_', ' ')} in {p.channel}."
            )
        return "There is systematic structure that no sum of up to three known effects explains."
    names = " and ".join(f"{e.name} ({e.channel})" for e in effects)
    also = f" {len(rows)} row(s) are blunders: {', '.join(map(str, rows))}." if rows else ""
    told = " These readings cannot tell it from another effect; see the aliases." if any(e.aliases for e in effects) \
        else ""
    return (
        f"Missing in the model: {names}; with it the root mean square residual falls from {rms[0]:.3g} to "
        f"{rms[1]:.3g} u.{also}{told}"
    )


def _of_noise(test: NoiseTest) -> str:
    if test.what == "size":
        return f"its size is {test.figure:.2g} times the stated one"
    return f"{test.what} in {test.where}"


def remarks_on(scene: Scene) -> tuple[str, ...]:
    """What these readings cannot judge: too little to spare, influences that never vary, effects that never show."""
    found = []
    if scene.field.dof < FEW_SPARE:
        found.append(f"Only {scene.field.dof} reading(s) more than unknowns: hardly anything could be found. Read "
                     "further positions, or the same ones again.")
    unseen = [c for c, f in zip(scene.chosen, scene.field.frames, strict=True) if not f.shape[1]]
    if scene.chosen and len(unseen) == len(scene.chosen):
        found.append("Not one of the known effects can be told from the unknowns with these readings. Vary what they "
                     "depend on, or hold an unknown that is known from elsewhere.")
    elif unseen:
        listed = ", ".join(c.label for c in unseen[:LISTED]) + (" and others" if len(unseen) > LISTED else "")
        found.append(f"These readings cannot show {listed}: the unknowns absorb them, or what drives them stands "
                     "still.")
    for name in dict.fromkeys(name for channel in scene.channels for name in channel.covariates):
        columns = [c.covariates[name] for c in scene.channels if name in c.covariates]
        users = [c.label for c in scene.chosen if name in c.effect.inputs]
        if users and all(len(np.unique(values)) == 1 for values in columns):
            found.append(f"'{name.replace('_', ' ')}' never varies, so {', '.join(users[:LISTED])} cannot be judged; "
                         "let it vary in further readings.")
    return tuple(found)
