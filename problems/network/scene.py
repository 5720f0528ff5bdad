"""A survey network in space: points with their uncertainty, stations and what they looked at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib import Estimate, Linearisation
from calib.analyse.shapes import places_in, points_of, sights, stations_of
from calib.job import Job
from calib.scene import Points, Scene
from problems.network.gkf import read_gkf
from problems.network.survey import LEFT_HANDED


def scene(job: Job, estimate: Estimate) -> Scene:
    """Points with their uncertainty, stations of trackers, and the lines of sight.

    job: of the network; estimate: of its problem. Returns the scene in the network's own axes.
    """
    fit = estimate.fit
    points = _in_the_network(fit, [points_of(fit, one) for one in places_in(fit)])
    points += [stations_of(fit, one) for one in fit.layout.unknowns if one.kind == "pose"]
    # Only a .gkf file may say that its x points north and its y east.
    mirrored = job.path.suffix == ".gkf" and read_gkf(job.path).axes in LEFT_HANDED
    return Scene((*points, *sights(fit, points)), mirrored)


def _in_the_network(fit: Linearisation, points: Sequence[Points]) -> list[Points]:
    """Points, those of frames where they stood in each epoch instead of where they are in their frame."""
    moved = [(one, functions) for one, functions in fit.results.items() if one.name.startswith("position")]
    carried = {key.rsplit(" in ", 1)[0] for quantity, _ in moved for key in quantity.keys or ()}
    found = []
    for one in points:
        stay = [i for i, key in enumerate(one.keys) if one.name != "point" or key not in carried]
        if one.name != "frame" and stay:
            found.append(Points(one.name, one.places[stay], [one.keys[i] for i in stay],
                                None if one.covariance is None else one.covariance[stay]))
    for quantity, functions in moved:
        places = functions.values.reshape(quantity.n, -1)
        whole = np.pad(places, ((0, 0), (0, 3 - places.shape[1])))
        found.append(Points(quantity.name, whole, quantity.keys))
    return found
