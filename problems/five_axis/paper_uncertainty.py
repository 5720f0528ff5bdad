"""The paper's own uncertainties of section 6: its sigmas through its formulas (14) and (15), and what it leaves out.

The printed numbers come back if (15) is propagated as p (L - L_A) + L_A theta_A with p and theta_A taken as
independent, although p of (14) is made of theta_A; if the 1 arcsec of the index enters every angle by itself,
although it is common; and if the yaw reading, common to all y, is left out of items 3 and 5. `alone` is that
propagation, `partial` the one by the partial derivatives of (15).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib import Problem, Quantity, Unknown, covariance, linearise, prior
from calib.units import arcsec

from .formulas import intersection, mean_slope
from .readings import NEAR_AND_FAR, Readings

# A fitted centre and the index, 2.1 and 1 arcsec: printed as 2.3 arcsec = 1.15e-5 rad, which is 2.37 arcsec.
U_CENTRE = 2.3 * arcsec
U_CENTRE_PRINTED = 1.15e-5
U_ROLL_CENTRE = float(np.hypot(0.5, 1.0)) * arcsec


@dataclass(frozen=True)
class Propagated:
    """Standard uncertainties by axis and circle ("pitch H", "pitch V", ...): of p [rad] and of I [m], both ways."""

    p: dict[str, float]
    alone: dict[str, float]
    partial: dict[str, float]


def with_slope_apart(slope: Any, near: Any, near_distance: Any, crossing: Any) -> Any:
    """Eq (15) with the slope p as a quantity of its own."""
    return slope * (crossing - near_distance) + near_distance * near


def propagate(readings: Readings, angles: Mapping[str, Sequence[float]], u_centre: float = U_CENTRE) -> Propagated:
    """Propagate the paper's sigmas through (14) and (15).

    readings: distances and their u; angles: {"pitch H": (theta_A, theta_B), ...} [rad]; u_centre: of the angles of both
    pitch axes [rad].
    """
    keys = list(angles)
    axes = [key.split()[0] for key in keys]
    pairs = [[readings.distance[t] for t in NEAR_AND_FAR[axis]] for axis in axes]
    u_angle = [[U_ROLL_CENTRE if axis == "roll" else u_centre] for axis in axes]
    near, far = (
        Unknown(name, [[angles[k][i]] for k in keys], "arcsec", keys=keys) for i, name in enumerate(("near", "far"))
    )
    lengths = [
        Unknown(f"{name}_distance", [[pair[i][0]] for pair in pairs], "mm", keys=keys)
        for i, name in enumerate(("near", "far"))
    ]
    crossing = Unknown("crossing", readings.distance["T1"][0], "mm")
    given = [
        prior(near, near.ambient, u_angle), prior(far, far.ambient, u_angle),
        *(prior(length, length.ambient, [[pair[i][1]] for pair in pairs]) for i, length in enumerate(lengths)),
        prior(crossing, crossing.ambient[0], readings.distance["T1"][1])]
    first = Problem(
        given,
        name="eq (14), (15)",
        quantities=[
            Quantity("p", mean_slope, near.each, far.each, lengths[0].each, lengths[1].each, keys=keys, unit="arcsec"),
            Quantity(
                "I", intersection, near.each, far.each, lengths[0].each, lengths[1].each, crossing, keys=keys, unit="mm"
            ),
        ],
    )
    found = covariance(linearise(first))
    p, u_p = found.values[: len(keys)], found.u[: len(keys)]
    slope = Unknown("slope", p[:, None], "arcsec", keys=keys)
    second = Problem(
        [*given, prior(slope, p[:, None], u_p[:, None])],
        name="eq (15), p apart",
        quantities=[
            Quantity("I", with_slope_apart, slope.each, near.each, lengths[0].each, crossing, keys=keys, unit="mm")
        ],
    )
    alone = covariance(linearise(second)).u
    return Propagated(*(dict(zip(keys, map(float, u))) for u in (u_p, alone, found.u[len(keys) :])))


def printed_sigmas(
    found: Propagated, u_yaw: dict[str, float], distance: dict[str, float], u_yaw_shared: float = arcsec
) -> dict[str, float]:
    """The sigmas of the twelve results the way the paper finds them.

    found: of `propagate`; u_yaw: of the four fitted filament readings [rad]; distance: of T1 and T2 to the yaw axis
    [m]; u_yaw_shared: the third term that the printed 34 and 36 um need beside the two filaments [rad].
    Returns {"s1": ..., "s10": ...} in SI, s8 left to eq (13).
    """
    p, i = found.p, found.alone
    return {
        "s1": p["pitch V"],
        "s2": float(np.hypot(p["pitch H"], p["roll H"])),
        "s3": i["pitch H"],
        "s4": float(np.hypot(i["pitch V"], i["roll V"])),
        "s5": i["roll H"],
        "s6": p["two_axis_pitch V"],
        # 31 um needs the 3.9 arcsec of S3, which cancels, in place of the 2.9 arcsec of S2
        "s7": float(np.hypot(i["two_axis_pitch H"], distance["T1"] * u_yaw["T1 S3"])),
        "s9a": distance["T1"] * float(np.sqrt(u_yaw["T1 S3"] ** 2 + u_yaw["T1 S2"] ** 2 + u_yaw_shared**2)),
        "s9b": distance["T2"] * float(np.sqrt(u_yaw["T2 S3"] ** 2 + u_yaw["T2 S2"] ** 2 + u_yaw_shared**2)),
        "s10": float(np.hypot(i["pitch V"], i["two_axis_pitch V"])),
    }
