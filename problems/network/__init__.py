"""Survey networks: points and instruments that see one another, adjusted together, with any datum.

Distances, directions, angles, azimuths, zenith angles, height differences, vectors and coordinates, with full
covariance; laser trackers with six degrees of freedom, and interferometers of unknown base point. Points are fixed,
adjusted, or the constrained ones of a free network. Reads the .gkf files of GNU Gama and tables. Start values, if none
are given, are found from the readings.
"""

from __future__ import annotations

import numpy as np

from calib import Linearisation, Problem
from calib.job import Job
from problems.network.blunders import blunders
from problems.network.checks import checked, started
from problems.network.declare import declare, settle
from problems.network.effects import effects, with_candidates
from problems.network.epochs import by_epoch, compare_epochs
from problems.network.example import example, example_job
from problems.network.figures import result_tables
from problems.network.gkf import read_gkf
from problems.network.measures import fitting_unit
from problems.network.reduction import reduced
from problems.network.scene import scene
from problems.network.start import positions
from problems.network.stations import Ranging, Sightings
from problems.network.survey import Batch, Correlated, Point, Survey
from problems.network.tables import columns, options, read_tables
from problems.network.tolerance import tolerable

accepts = ("problems.network", "network", ".gkf")
named_by_key = ("point",)
source = "GNU Gama manual; Baarda (1968), reliability; Meissl (1962), free networks"


_latest: list[tuple[Job, Survey]] = []     # a network is read once for its problem and for its remarks


def surveyed(job: Job) -> Survey:
    """The survey of a .gkf file or of a job with tables, checked, with a position for every point."""
    if not any(of is job for of, _ in _latest):
        _latest[:] = [(job, _surveyed(job))]
    return _latest[0][1]


def _surveyed(job: Job) -> Survey:
    rest = job.path.suffix != ".gkf" and job.options.flag("leave_out_weak", False)
    file = job.path.name if job.path.suffix == ".gkf" else job.options.text("network", "")
    survey = read_gkf(job.path.parent / file, strict=not rest) if file else read_tables(job)
    placed = reduced(survey) if rest else started(checked(survey))
    return tolerable(placed) if file else placed


def from_job(job: Job) -> Problem:
    """Declare the network of a .gkf file or of a job with tables, with the effects that its instruments may have.

    Raises InputError naming points and what they lack, where the network cannot be adjusted.
    """
    return with_candidates(declare(settle(surveyed(job))))


def remarks(job: Job) -> list[str]:
    """What was left out or taken otherwise than it was written, as sentences."""
    return list(surveyed(job).remarks)


def advice(fit: Linearisation) -> list[str]:
    """What to adjust: readings that do not belong, and a unit that no network fits; the worst first."""
    found = blunders(fit)
    own = [survey for _, survey in _latest if {batch.group or batch.kind for batch in survey.batches}
           <= {group.name for group in fit.groups}]      # a problem need not come from a job
    unit = fitting_unit(own[0], fit.objective, fit.dof) if found and own else None
    return [f"{unit[0].upper()}{unit[1:]}."] if unit else found


def absent(job: Job) -> set[str]:
    """Labels of the coordinates that points of the network do not have: no reading depends on them."""
    survey = surveyed(job)
    return {f"point[{key}].{part}" for key, point in survey.points.items() for part in survey.parts
            if not point.role(part) and np.isnan(point.position["xyz".index(part)])}


__all__ = [
    "Batch",
    "Correlated",
    "Point",
    "Ranging",
    "Sightings",
    "Survey",
    "absent",
    "advice",
    "by_epoch",
    "checked",
    "columns",
    "compare_epochs",
    "declare",
    "effects",
    "example",
    "example_job",
    "from_job",
    "options",
    "positions",
    "read_gkf",
    "read_tables",
    "reduced",
    "remarks",
    "result_tables",
    "scene",
    "settle",
    "started",
    "surveyed",
    "tolerable",
    "with_candidates",
]
