"""A survey network in space: points with their uncertainty, stations and what they looked at."""

from __future__ import annotations

from calib import Estimate
from calib.analyse.shapes import places_in, points_of, sights, stations_of
from calib.job import Job
from calib.scene import Scene
from problems.network.gkf import read_gkf
from problems.network.survey import LEFT_HANDED


def scene(job: Job, estimate: Estimate) -> Scene:
    """Points with their uncertainty, stations of trackers, and the lines of sight.

    job: of the network; estimate: of its problem. Returns the scene in the network's own axes.
    """
    fit = estimate.fit
    points = [points_of(fit, one) for one in places_in(fit)]
    points += [stations_of(fit, one) for one in fit.layout.unknowns if one.kind == "pose"]
    # Only a .gkf file may say that its x points north and its y east.
    mirrored = job.path.suffix == ".gkf" and read_gkf(job.path).axes in LEFT_HANDED
    return Scene((*points, *sights(fit, points)), mirrored)
