"""A mechanism in space: its axes where they stand with all of them at zero, what it carries, who looks at it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib.analyse.shapes import points_of, stations_of
from calib.linearisation import Linearisation
from calib.mechanism.axis import Array
from calib.mechanism.chain import Mechanism
from calib.scene import Axes, Points, Scene, Shape, Sights
from calib.unknown import Unknown

SIGHTS = 200        # lines of sight that can be told apart


def axes_of(mechanism: Mechanism) -> Axes:
    """The axes as designed, with all of them at zero.

    mechanism: of any kind.
    return: the axes, in base coordinates.
    """
    return Axes("axes as designed", [a.through for a in mechanism.axes], [a.direction for a in mechanism.axes],
                [a.name for a in mechanism.axes])


def measured(mechanism: Mechanism, fit: Linearisation, frame: str, positions: ArrayLike, carried: ArrayLike,
             station: Unknown | None = None, points: Unknown | None = None) -> Scene:
    """A mechanism that carries points which somebody measures, in base coordinates.

    mechanism; fit: a linearisation of its problem; frame: that carries the points; positions: (n, axes) [rad or m];
    carried: (n, 3) the measured point of each posture in the frame [m]; station: pose `instrument_from_base` of who
    looks, None for nobody; points: unknown of the carried points, None where there is none.
    return: axes, carried points with their covariance at the zero of all axes, where they were measured, the station.
    """
    rotations, places = mechanism.poses(frame, positions)
    visited = places + np.einsum("nij,nj->ni", rotations, np.broadcast_to(np.asarray(carried, float), places.shape))
    shapes: list[Shape] = [axes_of(mechanism), Points("where they were measured", visited)]
    if points is not None:
        shapes.append(placed(points_of(fit, points), mechanism.home(frame)))
    if station is not None:
        eyes = stations_of(fit, station)
        seen = visited[:: max(1, -(-len(visited) // SIGHTS))]
        shapes += [eyes, Sights("measured", eyes.places[0], seen)]
    return Scene(tuple(shapes))


def placed(points: Points, frame: Any) -> Points:
    """Points of a frame in the frame that it stands in.

    points: with their covariance, in the frame; frame: Transform outer_from_frame.
    return: the same in the outer frame.
    """
    rotation: Array = np.asarray(frame.rotation, float)
    spread = None if points.covariance is None else rotation @ points.covariance @ rotation.T
    return Points(points.name, points.places @ rotation.T + np.ravel(frame.translation), points.keys, spread)
