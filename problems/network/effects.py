"""Instrument constants of surveying as effects: zero and held until somebody frees them or asks whether they are there.

Source: Rueger (1996), Electronic Distance Measurement; ISO 17123.
"""

from __future__ import annotations

from calib import Effect, Parameter
from calib.units import arcsec, mm, ppm

EARTH = 6_371_000.0     # mean radius [m]; a curvature of the sight is stated as a part of that of the earth
SOURCE = "Rueger, Electronic Distance Measurement, 4th edition (1996); ISO 17123-3, -4"


def effects() -> tuple[Effect, ...]:
    """Zero offset and scale of distances, index and refraction of zenith angles, scale of levelling staffs."""
    return (
        Effect("zero_offset", "distance", lambda value, p: p.a, (Parameter("a", "mm", (0.1 * mm, 20 * mm)),),
               "distance", source=SOURCE),
        Effect("scale", "distance", lambda value, p, length: p.s * length,
               (Parameter("s", "ppm", (1 * ppm, 200 * ppm)),), "distance", source=SOURCE),
        Effect("index", "zenith", lambda value, p: p.i, (Parameter("i", "arcsec", (1 * arcsec, 60 * arcsec)),),
               "vertical circle", source=SOURCE),
        Effect("refraction", "zenith", lambda value, p, length: -p.k * length / (2.0 * EARTH),
               (Parameter("k", "1", (0.05, 0.5)),), "vertical circle", source=SOURCE),
        Effect("staff_scale", "height", lambda value, p, rise: p.s * rise,
               (Parameter("s", "ppm", (5 * ppm, 500 * ppm)),), "level", source=SOURCE),
    )
