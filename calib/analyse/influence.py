"""External reliability: what an error that no test finds does to points and results (Baarda)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.analyse.reliability import Reliability, reliability
from calib.analyse.shapes import places_in
from calib.blocks import Array
from calib.linearisation import Linearisation

MOST = 4_000_000     # readings times coordinates up to which the influence on every point is looked at


@dataclass(frozen=True)
class Influence:
    """What the minimal detectable bias of each of N scalar readings does, in the order of Reliability.

    point (N,): label of the point that it moves most, shift (N,) [m]: by how much; empty where there are no points or
    too many; results: {label: (N,)} SI; not a number where nothing controls the reading.
    """

    point: NDArray
    shift: Array
    results: Mapping[str, Array]


def influence(fit: Linearisation, tests: Reliability) -> Influence:
    """What errors that no test finds do to points and derived results.

    fit: a linearisation; tests: its reliability, which says how large these errors are.
    Source: Baarda (1968), A testing procedure for use in geodetic networks.
    """
    seen = np.isfinite(tests.mdb)
    results = {name: np.where(seen, values, np.nan) for name, values in tests.influence.items()}
    moved: list[tuple[str, Array]] = []
    for unknown in places_in(fit):
        if len(tests) * unknown.count * unknown.freedom > MOST:
            continue
        along = list(reliability(fit, tests.level, tests.power, unknown).influence.values())
        labels = unknown.keys if unknown.count > 1 or unknown.named_keys else (unknown.name,)
        moved += [(str(labels[i]), np.sqrt(sum(one**2 for one in along[i * unknown.freedom:(i + 1) * unknown.freedom])))
                  for i in range(unknown.count)]
    if not moved:
        return Influence(np.zeros(0, str), np.zeros(0), results)
    shifts = np.array([shift for _, shift in moved])
    most = shifts.argmax(axis=0)
    names = np.array([name for name, _ in moved])
    return Influence(np.where(seen, names[most], ""), np.where(seen, shifts.max(axis=0), np.nan), results)
