"""Survey networks: points and instruments that see one another, adjusted together, with any datum.

Distances, directions, angles, azimuths, zenith angles, height differences, vectors and coordinates, with full
covariance; points fixed, adjusted, or the constrained ones of a free network. Reads the .gkf files of GNU Gama.
Source: GNU Gama manual; Baarda (1968); Meissl (1962).
"""

from __future__ import annotations

from calib import Problem
from calib.job import Job
from problems.network.declare import declare, settle
from problems.network.gkf import read_gkf
from problems.network.start import positions
from problems.network.survey import Batch, Point, Survey

accepts = ("problems.network", "network", ".gkf")
named_by_key = ("point",)


def from_job(job: Job) -> Problem:
    """Declare the network of a .gkf file."""
    return declare(settle(positions(read_gkf(job.path))))


__all__ = ["Batch", "Point", "Survey", "declare", "from_job", "positions", "read_gkf", "settle"]
