"""Survey networks: points and instruments that see one another, adjusted together, with any datum.

Distances, directions, angles, azimuths, zenith angles, height differences, vectors and coordinates, with full
covariance; laser trackers with six degrees of freedom, and interferometers of unknown base point. Points are fixed,
adjusted, or the constrained ones of a free network. Reads the .gkf files of GNU Gama and tables. Start values, if none
are given, are found from the readings.
"""

from __future__ import annotations

from calib import Problem
from calib.job import Job
from problems.network.blunders import advice
from problems.network.checks import checked, started
from problems.network.declare import declare, settle
from problems.network.effects import effects, with_candidates
from problems.network.example import example, example_job
from problems.network.gkf import read_gkf
from problems.network.reduction import reduced
from problems.network.scene import scene
from problems.network.start import positions
from problems.network.stations import Ranging, Sightings
from problems.network.survey import Batch, Correlated, Point, Survey
from problems.network.tables import columns, options, read_tables

accepts = ("problems.network", "network", ".gkf")
named_by_key = ("point",)
source = "GNU Gama manual; Baarda (1968), reliability; Meissl (1962), free networks"


def surveyed(job: Job) -> Survey:
    """The survey of a .gkf file or of a job with tables, checked, with a position for every point."""
    if job.path.suffix == ".gkf":
        return started(checked(read_gkf(job.path)))
    survey = read_tables(job)
    return reduced(survey) if job.options.flag("leave_out_weak", False) else started(checked(survey))


def from_job(job: Job) -> Problem:
    """Declare the network of a .gkf file or of a job with tables, with the effects that its instruments may have.

    Raises InputError naming points and what they lack, where the network cannot be adjusted.
    """
    return with_candidates(declare(settle(surveyed(job))))


def remarks(job: Job) -> list[str]:
    """What was left out or taken otherwise than it was written, as sentences."""
    return list(surveyed(job).remarks)


__all__ = [
    "Batch",
    "Correlated",
    "Point",
    "Ranging",
    "Sightings",
    "Survey",
    "advice",
    "checked",
    "columns",
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
    "scene",
    "settle",
    "started",
    "surveyed",
    "with_candidates",
]
