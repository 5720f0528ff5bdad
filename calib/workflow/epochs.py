"""Epochs of one network beside each other: which pairs are compared, and what came of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType

from calib import files
from calib.analyse.congruence import Congruence
from calib.blocks import Array
from calib.errors import InputError
from calib.job import Job
from calib.solve.estimate import Estimate


@dataclass(frozen=True)
class Rules:
    """How epochs are compared.

    level: of each test; release: test fixed points too; a_posteriori: multiply uncertainties by the scatter that both
    epochs show, and test with Fisher's F.
    """

    level: float = 0.01
    release: bool = False
    a_posteriori: bool = False


@dataclass(frozen=True)
class EpochComparison:
    """Two epochs beside each other.

    names; estimates: of both, each in a free datum; found: what moved; places: (n, 3) [m] of its points, not a number
    where they have none; mirrored: whether x points up and y to the right; fixed: points taken as still and not tested;
    alone: points that only one epoch has; scatter: factor of all variances, 1 where they are as stated.
    """

    names: tuple[str, str]
    estimates: tuple[Estimate, Estimate]
    found: Congruence
    places: Array
    mirrored: bool
    fixed: tuple[str, ...]
    alone: tuple[str, ...]
    scatter: float


def epochs_of(jobs: Sequence[Job], module: ModuleType) -> list[tuple[str, Job]]:
    """(name, job) of every epoch: the jobs themselves, or those that one job with a column `epoch` holds.

    jobs: as read; module: their problem module.
    Raises InputError where there are fewer than two, a job among others holds several, or it has knowledge that only
    `calib solve` takes.
    """
    for job in jobs:
        if job.priors:
            raise InputError(f"{job.path}: has [[priors]]; epochs are compared by their readings alone. Take them out")
    names = files.distinct_names([job.path.with_suffix("") for job in jobs])
    found = list(zip(names, jobs, strict=True))
    if len(jobs) == 1:
        found = list(module.by_epoch(jobs[0]))
    several = [job for job in jobs if len(jobs) > 1 and len(list(module.by_epoch(job))) > 1]
    if several:
        raise InputError(f"{several[0].path}: holds several epochs in its column 'epoch'; name it alone")
    if len({name for name, _ in found}) < len(found):
        found = [(f"{i} {name}", job) for i, (name, job) in enumerate(found, start=1)]
    if len(found) < 2:
        raise InputError("one epoch alone cannot be compared; name two jobs or more, or one whose tables have a column "
                         "'epoch' with two values or more")
    return found


def compared(
    epochs: Sequence[tuple[str, Job]], module: ModuleType, rules: Rules, previous: bool = False
) -> list[EpochComparison]:
    """Every epoch after the first, beside the first, or beside the one before it.

    epochs: (name, job); module: their problem module; rules: of which the level is shared out among the comparisons
    (Bonferroni); previous: beside the one before it.
    """
    shared = Rules(rules.level / (len(epochs) - 1), rules.release, rules.a_posteriori)
    return [module.compare_epochs(epochs[i if previous else 0], epochs[i + 1], shared)
            for i in range(len(epochs) - 1)]
