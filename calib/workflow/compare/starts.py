"""How far from the answer one may start: a method from many random starts in a declared region."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.analyse.covariance import covariance
from calib.blocks import Array
from calib.errors import CalibrationError, InputError
from calib.linearisation import linearise
from calib.problem import Problem
from calib.solve.estimate import Estimate, solve
from calib.solve.method import Method
from calib.system import System

NEAREST, FARTHEST = 0.01, 10.0  # reach of the starts, in half-widths of the region, spread evenly in its logarithm
SAME = 1e-6                     # of v'Pv: an answer this near the least is that answer
ELSEWHERE = 1.0                 # in units of u: the same v'Pv farther away is a mirror image or a whole turn


@dataclass(frozen=True)
class Region:
    """Half-width of each local coordinate (size,) [SI] in which to start, and what it is, in words."""

    half_width: Array
    words: str


@dataclass(frozen=True)
class Starts:
    """What became of the starts: reach (k,) in half-widths, whether each found the least v'Pv, and how many found it
    at another place. sought: how many were wanted; fewer are there where time ran out."""

    reach: Array
    found: Array
    elsewhere: int
    sought: int
    seed: int
    region: str

    @property
    def successes(self) -> int:
        """How many found the least v'Pv."""
        return int(self.found.sum())

    @property
    def safe(self) -> float:
        """Reach up to which every start succeeded; zero where the nearest failed."""
        failed = np.flatnonzero(~self.found)
        return float(self.reach[-1] if not len(failed) else self.reach[failed[0] - 1] if failed[0] else 0.0)


def region(estimate: Estimate, declared: Mapping[str, float] | None = None) -> Region:
    """The region around an estimate: half-widths that a problem declares, else the sizes of what is unknown.

    declared: {name of an unknown: half-width, SI}; None: the largest magnitude among unknowns of one unit, half a turn
    for rotations and directions, what is still plausible for parameters of an effect. Raises InputError where a name is
    no unknown.
    """
    layout = linearise(estimate).layout
    of_effect = {one.unknown: [p.plausible[1] for p in one.effect.parameters] for one in estimate.problem.attached}
    half = np.zeros(layout.size)
    largest: dict[str, float] = {}
    for unknown in layout.unknowns:
        if unknown.kind == "vector" and unknown not in of_effect:
            for part, unit in enumerate(unknown.units):
                size = float(np.abs(estimate.values[unknown][:, part]).max())
                largest[unit] = max(largest.get(unit, 0.0), size)
    for unknown in layout.unknowns:
        width = np.full((unknown.count, unknown.freedom), np.pi)
        if unknown in of_effect:
            width[:] = of_effect[unknown]
        elif unknown.kind == "vector":
            width[:] = [largest[unit] or 1.0 for unit in unknown.units]
        elif unknown.kind == "pose":
            width[:, :3] = max(float(np.abs(estimate.values[unknown][:, :3]).max()), 1.0)
        if declared and unknown.name in declared:
            width[:] = declared[unknown.name]
        half[layout.span(unknown)] = width.ravel()
    names = [unknown.name for unknown in layout.unknowns]
    wrong = [name for name in declared or {} if name not in names]
    if wrong:
        raise InputError(f"the start region names '{wrong[0]}', which is no unknown; there are: {', '.join(names)}")
    words = ("the half-widths that the problem declares" if declared else
             "as half-width the largest value among unknowns of the same unit, half a turn for rotations, what is "
             "still plausible for effects")
    return Region(half, words)


def starts(problem: Problem, method: Method, best: Estimate, where: Region, count: int, seed: int,
           seconds: float) -> Starts:
    """Solve from random starts around the best known estimate.

    count: starts; seed: of them; seconds: of the processor, after which no further start is begun; their order mixes
    near and far. best: the estimate with the least v'Pv. Returns the starts by growing reach.
    """
    system = System(problem)
    layout, free = system.layout, system.layout.free_columns
    reach = np.geomspace(NEAREST, FARTHEST, count)
    directions = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, len(free)))
    turning = np.concatenate([np.repeat([[u.kind != "vector"] * u.freedom], u.count, axis=0).ravel() if u.kind != "pose"
                              else np.tile([False] * 3 + [True] * 3, u.count) for u in layout.unknowns])
    u = np.maximum(covariance(linearise(best), *layout.unknowns).u, 1e-300)
    found, elsewhere, done, begun = np.zeros(count, bool), 0, [], time.process_time()
    for k in np.random.default_rng(0).permutation(count):
        if time.process_time() - begun > seconds:
            break
        step = np.zeros(layout.size)
        step[free] = reach[k] * where.half_width[free] * directions[k]
        step = np.where(turning, np.clip(step, -np.pi, np.pi), step)
        done.append(int(k))
        values = _arrived(system, method, layout.move(best.values, step))
        if values is None:
            continue
        residual = system.whitened(values, system.weightings(values))
        found[k] = float(residual @ residual) <= best.objective + SAME * max(best.objective, 1.0)
        if found[k]:
            away = np.concatenate([w.difference(values[w], best.values[w]).ravel() for w in layout.unknowns])
            elsewhere += bool(np.any(np.abs(away[free] / u[free]) > ELSEWHERE))
    kept = np.array(sorted(done), dtype=int)
    return Starts(reach[kept], found[kept], elsewhere, count, seed, where.words)


def _arrived(system: System, method: Method, values):  # type: ignore[no-untyped-def]
    """Stored values where a method stops by itself, None where it does not."""
    try:
        with np.errstate(all="ignore"):
            if system.depends:
                shown = {unknown: unknown.show(v) for unknown, v in values.items()}
                estimate = solve(system.problem, method, shown)
                return estimate.values if estimate.converged else None
            outcome = method.minimise(system, values)
        _, _, excess = system.active_conditions(outcome.values)
        return outcome.values if outcome.converged and excess <= 1.0 else None
    except (CalibrationError, np.linalg.LinAlgError, FloatingPointError):
        return None
