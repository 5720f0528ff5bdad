"""Mechanisms: axes that carry each other, their kinematics, their geometric errors by ISO names, and how they are
measured."""

from calib.mechanism import observe
from calib.mechanism.axis import Axis, Frame, Linear, Load, Rotary
from calib.mechanism.chain import Mechanism
from calib.mechanism.drive import (
    backlash,
    bending,
    encoder_harmonic,
    sag,
    sag_by_load,
    scale,
    soft_windup,
    thermal_growth,
    thermal_scale,
    zero_offset,
)
from calib.mechanism.errors import (
    error_motion,
    error_motions,
    location_error,
    location_errors,
    mounting_errors,
    periodic_error_motion,
    polynomial_error_motion,
)

__all__ = [
    "Axis", "Frame", "Linear", "Load", "Mechanism", "Rotary", "backlash", "bending", "encoder_harmonic", "error_motion",
    "error_motions", "location_error", "location_errors", "mounting_errors", "observe", "periodic_error_motion",
    "polynomial_error_motion", "sag", "sag_by_load", "scale", "soft_windup", "thermal_growth", "thermal_scale",
    "zero_offset",
]
