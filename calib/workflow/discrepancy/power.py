"""Power: how large an effect would have to be for these readings to show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib import units
from calib.analyse.score import Candidate, Field
from calib.workflow.discrepancy.search import Shares


@dataclass(frozen=True)
class Detectable:
    """The size of one parameter of a candidate that would be found with a given probability, and what is usual
    (low, high), in its display unit; size is infinite where the unknowns hide it."""

    effect: str
    parameter: str
    size: float
    usual: tuple[float, float]
    unit: str


def detectable(
    field: Field, candidates: Sequence[Candidate], level: float, power: float = 0.8
) -> tuple[Detectable, ...]:
    """What each parameter of each candidate would have to be, alone, for a score test at a level shared among all.

    field: with the signals of the candidates; level: of any false alarm; power: probability of being found.
    Source: Baarda (1968), minimal detectable bias; noncentral chi-squared distribution.
    """
    from scipy.special import chdtri, chndtrinc

    seen = [frame.shape[1] for frame in field.frames]
    looks = max(sum(1 for k in seen if k), 1)
    needed = {k: float(chndtrinc(chdtri(k, level * Shares().effects / looks), k, 1.0 - power)) for k in set(seen) if k}
    found = []
    for one, k, signal, own in zip(candidates, seen, field.signals, field.sizes, strict=True):
        for j, parameter in enumerate(one.effect.parameters):
            norm, factor = float(np.linalg.norm(signal[:, j])), units.factor(parameter.unit)
            shown = k > 0 and norm > 1e-7 * own[j]
            size = float(np.sqrt(needed[k])) / norm / factor if shown else np.inf
            low, high = parameter.plausible
            found.append(Detectable(one.label, parameter.name, size, (low / factor, high / factor), parameter.unit))
    return tuple(found)
