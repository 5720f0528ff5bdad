"""What a job states about points given by coordinates: one u, or the uncertainty of the laser tracker that saw them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import Gaussian
from instruments import laser_tracker

if TYPE_CHECKING:
    from calib.settings import Settings

KINDS = ("coordinates", "laser_tracker")


def stated(instrument: Settings, points: ArrayLike) -> float | Gaussian:
    """Uncertainty of points (n, 3) [m] in the frame of the instrument, from its settings in a job.

    instrument: kind = "coordinates" with one u for all coordinates, or kind = "laser_tracker" with what
    `stated_polar` takes, which gives each point a covariance of its own.
    """
    if instrument.text("kind", among=KINDS) == "coordinates":
        return instrument.quantity("u", "length")
    return Gaussian.matrix(covariance(instrument, points))


def covariance(instrument: Settings, points: ArrayLike) -> NDArray[np.float64]:
    """Covariance (n, 3, 3) [m^2] of points (n, 3) [m]; arguments as for `stated`."""
    if instrument.text("kind", among=KINDS) == "coordinates":
        return np.broadcast_to(instrument.quantity("u", "length")**2 * np.eye(3), (len(np.asarray(points)), 3, 3))
    polar = laser_tracker.polar_readings(points)
    return laser_tracker.cartesian_covariance(polar, stated_polar(instrument, polar))


def stated_polar(instrument: Settings, polar: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard uncertainties (n, 3) of polar readings (n, 3) [m, rad, rad] from the settings of a laser tracker.

    instrument: with sigma_range, sigma_azimuth, sigma_zenith, or u = "a + b L" for each coordinate at distance L.
    """
    if "u" in instrument:
        fixed, rate = instrument.uncertainty("u", "length")
        return laser_tracker.from_coordinate_statement(fixed, rate, coverage_factor=1.0).at(polar)
    sigma = [instrument.quantity("sigma_range", "length"), instrument.quantity("sigma_azimuth", "angle"),
             instrument.quantity("sigma_zenith", "angle")]
    return np.broadcast_to(sigma, polar.shape)
