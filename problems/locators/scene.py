"""The part on its locators in space, in the hall: locators, targets in every pose, and the tracker."""

from __future__ import annotations

import numpy as np

from calib import Estimate
from calib.analyse.shapes import stations_of
from calib.job import Job
from calib.scene import Points, Scene, Shape, Sights, Track
from problems.locators.case import setup_of


def scene(job: Job, estimate: Estimate) -> Scene:
    """Locators at their base, balls and targets of the part in its first pose, the way of the part, the tracker.

    job: of the campaign; estimate: of its problem. Returns the scene in the frame of the hall.
    """
    setup, unknowns = setup_of(job), {one.name: one for one in estimate.problem.unknowns}
    poses = estimate[unknowns["part"]]
    first = poses[0] if unknowns["part"].count > 1 else poses
    base = [np.ravel(np.asarray(one.frames.x_in_base, float)) for one in setup.locators]
    balls = [np.ravel(first @ np.asarray(one.ball_in_part, float)) for one in setup.locators]
    keys = [one.key for one in setup.locators]
    shapes: list[Shape] = [Points("locators", base, keys), Points("balls, first pose", balls, keys),
                           Track("part, first pose", balls, closed=True)]
    if unknowns["part"].count > 1:
        shapes.append(Points("part in every pose", [np.ravel(pose.translation) for pose in poses]))
    if "tracker" in unknowns and setup.targets:
        targets = [np.ravel(first @ np.asarray(place, float)) for place in setup.targets.values()]
        eye = stations_of(estimate.fit, unknowns["tracker"])
        shapes += [Points("targets, first pose", targets, list(setup.targets)), eye,
                   Sights("tracker", eye.places[0], targets)]
    return Scene(tuple(shapes))
