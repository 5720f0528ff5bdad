"""What a turntable and the tracker before it can show beyond the nominal model of `problems.turntable`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

from calib import Effect, Parameter
from calib.geometry import cross
from calib.units import arcsec, ppm, um
from instruments import encoder, laser_tracker

AXIS = "ISO 230-7:2015, error motions of an axis of rotation"
TRACKER = ("range_offset", "transit_tilt", "drift", "step")


def table_effects() -> tuple[Effect, ...]:
    """Effects of the encoder (channel theta), of the axis (axis) and of the table's temperature (radius)."""
    runout = (0.5 * um, 100.0 * um)
    tilt = (0.2 * arcsec, 60.0 * arcsec)

    def tilted(value: Any, p: Any, command: Any, toward: Any, across: Any, centre: Any) -> Any:
        c, s = ca.cos(2.0 * command), ca.sin(2.0 * command)
        return cross((p.a * c + p.b * s) * toward + (p.b * c - p.a * s) * across, value - centre)

    def displaced(value: Any, p: Any, command: Any, toward: Any, across: Any) -> Any:
        c, s = ca.cos(2.0 * command), ca.sin(2.0 * command)
        return (p.xc * c + p.xs * s) * toward + (p.yc * c + p.ys * s) * across

    return (
        *encoder.axis_angle_effects("theta"),
        Effect("radial_runout_2x", "motion", displaced,
               tuple(Parameter(name, "um", runout) for name in ("xc", "xs", "yc", "ys")), "axis", source=AXIS),
        Effect("axial_runout_2x", "motion",
               lambda value, p, command, axis: (p.c * ca.cos(2.0 * command) + p.s * ca.sin(2.0 * command)) * axis,
               (Parameter("c", "um", runout), Parameter("s", "um", runout)), "axis", source=AXIS),
        Effect("tilt_motion_2x", "motion", tilted, (Parameter("a", "arcsec", tilt), Parameter("b", "arcsec", tilt)),
               "axis", source=AXIS),
        Effect("thermal", "arm", lambda value, p, temperature_difference: p.coef * temperature_difference * value,
               (Parameter("coef", "ppm/K", (1.0 * ppm, 30.0 * ppm)),), "radius",
               source="linear expansion of metals"),
    )


def tracker_effects(blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """Those effects of `instruments.laser_tracker` that act on one standing before a table.

    blocks: values of covariate `block` at which a reading may have jumped.
    """
    return tuple(e for e in laser_tracker.reading_effects(blocks) if e.name in TRACKER or e.label == "thermal (range)")
