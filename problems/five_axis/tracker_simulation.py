"""Section 7: the same perpendicularity and intersection by laser tracker, from circles of reflectors at both axis ends.

Printed: the two lines (16), 19 points on each of four circles, 5 um/m, arcs of 360 and 90 degrees, 15 trials. Not
printed: the radii, how far apart the reflectors of one axis sit, and how far the tracker stands; `Assumed` names them.
The paper fits every circle by itself and draws the axis through two centres; so does `declare`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from casadi import asin

from calib import (
    Direction,
    Observations,
    Problem,
    Quantity,
    Unknown,
    covariance,
    linearise,
    montecarlo,
    simulate,
    solve,
)
from calib.geometry import dot, signed_line_distance, unit
from calib.units import arcsec, degree, metre, mm, ppm, um
from problems.circle import point_on_circle

AXES = ("roll", "pitch")
# Lines (16) as printed, the point in mm: with metres the intersection would be 294 mm, not the printed 0.294 mm.
POINT = {"roll": np.array([0.01, 1.0, 0.01]) * mm, "pitch": np.array([0.01, 1.0, 0.310]) * mm}
ALONG = {"roll": np.array([0.99, 0.01, 0.1407125]), "pitch": np.array([-0.029334, 0.990205, 0.1365214])}
ARC = {"roll": 360 * degree, "pitch": 90 * degree}
ARC_90 = {"roll": 90 * degree, "pitch": 90 * degree}
POINTS, TRIALS, U_PER_METRE = 19, 15, 5 * ppm
PRINTED = ("tr_s_int", "tr_s_perp", "tr_s_int90", "tr_s_perp90")
# A standard deviation of 15 trials lies within these factors of the true one with 95 % probability: roots of the 2.5 %
# and 97.5 % quantiles of chi-squared with 14 degrees of freedom, 5.629 and 26.119, over 14.
SAMPLING = (float(np.sqrt(5.629 / (TRIALS - 1))), float(np.sqrt(26.119 / (TRIALS - 1))))
NOT_PRINTED = (
    "the distance of the tracker, the spacing of the reflectors of an axis, and where the arcs of 90 degrees begin are "
    "not printed, and they decide it (the radii, not printed either, do not: u of a centre does not depend on them)"
)


@dataclass(frozen=True)
class Assumed:
    """What the paper does not print.

    distance: from the tracker to the reflectors, so that each coordinate has u = 5 um/m distance [m]; spacing: between
    the two reflectors of an axis, the crossing half-way [m]; radius: of the circles [m]; begin: direction in which the
    arcs begin, counted from the horizontal about the axis [rad].
    """

    distance: float = 1.5 * metre
    spacing: float = 1.0 * metre
    radius: float = 150 * mm
    begin: float = 0.0

    def __str__(self) -> str:
        return (
            f"tracker {self.distance:g} m away (u = {U_PER_METRE * self.distance / um:g} um for each coordinate), "
            f"reflectors of an axis {self.spacing:g} m apart, the crossing half-way, radius {self.radius / mm:g} mm, "
            f"arcs from {self.begin / degree:g} deg against the horizontal"
        )


def perpendicularity(near: Any, far: Any, other_near: Any, other_far: Any) -> Any:
    """Departure of two axes, each through two centres (3,), from a right angle [rad]."""
    return asin(dot(unit(far - near), unit(other_far - other_near)))


def intersection(near: Any, far: Any, other_near: Any, other_far: Any) -> Any:
    """Distance between two axes, each through two centres (3,) [m]."""
    return signed_line_distance(near, far - near, other_near, other_far - other_near)


def printed_lines() -> tuple[float, float]:
    """Perpendicularity [rad] and intersection [m] of the lines (16) as printed."""
    ends = [end for axis in AXES for end in (POINT[axis], POINT[axis] + unit(ALONG[axis]))]
    return float(perpendicularity(*ends)), float(intersection(*ends))


def declare(arc: Mapping[str, float], assumed: Assumed = Assumed()) -> Problem:
    """Four circles, two for each axis, without readings; perpendicularity and intersection as quantities.

    arc: of each axis [rad]; assumed: what the paper does not print. Start values are the true ones.
    """
    circles = [(axis, end) for axis in AXES for end in (-0.5, 0.5)]
    keys = [f"{axis} {'near' if end < 0 else 'far'}" for axis, end in circles]
    along = np.array([unit(ALONG[axis]) for axis, _ in circles])
    ends = np.array([[end * assumed.spacing] for _, end in circles])
    level = np.cross(along, [0.0, 0.0, 1.0])
    centre = Unknown("centre", np.array([POINT[axis] for axis, _ in circles]) + along * ends, "mm", keys=keys)
    normal = Direction("normal", along, keys=keys)
    radius = Unknown("radius", np.full((4, 1), assumed.radius), "mm", keys=keys)
    sweep = [assumed.begin + np.linspace(0.0, arc[axis], POINTS) for axis, _ in circles]
    foot = Unknown("foot", np.concatenate(sweep)[:, None], "deg")
    circle = np.repeat(np.arange(4), POINTS)
    points = Observations(
        point_on_circle, foot.each, centre[circle], normal[circle], radius[circle], level[circle],
        u=U_PER_METRE * assumed.distance, group="points", unit="mm", components=("x", "y", "z"))
    centres = [centre[i] for i in range(4)]
    return Problem(
        [points],
        name="tracker on two axes",
        quantities=[
            Quantity("perpendicularity", perpendicularity, *centres, unit="arcsec"),
            Quantity("intersection", intersection, *centres, unit="um"),
        ],
    )


def predicted(arc: Mapping[str, float], assumed: Assumed = Assumed()) -> tuple[float, float]:
    """Standard uncertainties of perpendicularity [rad] and intersection [m] before anything is measured."""
    u = covariance(linearise(declare(arc, assumed))).u
    return float(u[0]), float(u[1])


def scatter(assumed: Assumed) -> dict[str, float]:
    """The four standard deviations of section 7 under an assumption, by key, in um and arcsec."""
    (square, apart), (square_90, apart_90) = predicted(ARC, assumed), predicted(ARC_90, assumed)
    return dict(zip(PRINTED, (apart / um, square / arcsec, apart_90 / um, square_90 / arcsec)))


def simulated(assumed: Assumed, seed: int) -> dict[str, float]:
    """The four standard deviations of 15 simulated trials, as the paper ran them, by key, in um and arcsec."""
    found = []
    for arc in (ARC, ARC_90):
        exact = simulate(declare(arc, assumed), {}, seed, noise=False)
        square, apart = montecarlo(solve(exact), TRIALS, seed).samples.std(axis=0, ddof=1)
        found += [apart / um, square / arcsec]
    return dict(zip(PRINTED, map(float, found)))


def sweep(printed: Mapping[str, float]) -> list[dict[str, float | bool]]:
    """Which assumptions give the printed scatter of section 7.

    printed: the four printed standard deviations by key, in um and arcsec. Returns one line for each assumption: the
    four predicted ones, and whether all printed ones lie in the 95 % sampling interval of 15 trials.
    """
    places = (
        (1.0, 1.0, 0.15), (1.5, 1.0, 0.05), (1.5, 1.0, 0.15), (1.5, 1.0, 0.3), (1.5, 2.0, 0.15), (2.0, 1.0, 0.15),
        (3.0, 2.0, 0.15))
    lines: list[dict[str, float | bool]] = []
    for begin in (0.0, 45.0, 90.0, 135.0):
        for distance, spacing, radius in places:
            values = scatter(Assumed(distance, spacing, radius, begin * degree))
            inside = all(SAMPLING[0] <= printed[key] / values[key] <= SAMPLING[1] for key in PRINTED)
            lines.append(
                {
                    "tracker_distance_m": distance,
                    "spacing_m": spacing,
                    "radius_mm": radius / mm,
                    "arc_begins_deg": begin,
                    **values,
                    "gives_the_printed_numbers": inside,
                }
            )
    return lines
