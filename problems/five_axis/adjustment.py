"""What to adjust on the simulator, from the joint estimate: level readings to set, feet to raise, millimetres to
move.
"""

from __future__ import annotations

from calib import Linearisation, covariance
from calib.analyse.covariance import Covariance
from calib.units import arcsec, mm, um

_NAMES = {"three_axis": "three-axis table", "two_axis": "two-axis table"}
_CIRCLES = "for circles of the usual make (clockwise, zenith angles); turn left and right, up and down about otherwise"


def advice(fit: Linearisation) -> tuple[str, ...]:
    """Sentences on what to adjust, each with its standard uncertainty u.

    fit: of the joint problem. Returns nothing for a problem of another kind.
    """
    names = {unknown.name for unknown in fit.layout.unknowns}
    if not {"plumb", "level_zero", "yaw_offset"} <= names:
        return ()
    found = covariance(fit, *fit.results, "plumb", "level_zero")
    tables = [key for key in _NAMES if f"plumb[{key}].x" in found.names]
    lines = [sentence for table in tables for sentence in _level(found, table)]
    lines += _feet(found)
    lines += _move(found)
    return tuple(lines)


def _level(found: Covariance, table: str) -> list[str]:
    zero, u_zero = (x / arcsec for x in found[f"level_zero[{table}]"])
    x, u_x = (value / arcsec for value in found[f"plumb[{table}].x"])
    y, u_y = (value / arcsec for value in found[f"plumb[{table}].y"])
    # the axis leans toward X by theta_y and toward -Y by theta_x (right-handed rotations, Z up)
    return [
       
       
       
       
        f"{_NAMES[table]}: set the level to {zero:.1f} arcsec (u = {u_zero:.1f}) at
        every yaw position; there the yaw axis is plumb.", f"{_NAMES[table]}: the yaw axis leans {abs(y):.1f} arcsec (u = {u_y:.1f}) to the {_side('X', y)} side and {abs(x):.1f} arcsec " f"(u = {u_x:.1f}) to the {_side('Y', -x)} side of the level's frame: raise the feet there by {_per_metre(y):.1f} um " f"(u = {_per_metre(u_y):.1f}) and {_per_metre(x):.1f} um (u = {_per_metre(u_x):.1f}) for each metre between the feet.",
    ]


def _side(axis: str, value: float) -> str:
    return f"{'+' if value >= 0 else '-'}{axis}"


def _per_metre(angle: float) -> float:
    return abs(angle) * arcsec / um


def _feet(found: Covariance) -> list[str]:
    """How much to raise each foot whose place is known, over the lowest."""
    feet = [name for name in found.names if name.startswith("foot[")]
    return [f"foot {name[5:-1]}: {'raise' if found[name][0] >= 0 else 'lower'} by {abs(found[name][0]) / um:.1f} um "
            f"(u = {found[name][1] / um:.1f}) against the point under the yaw axis." for name in feet]


def _move(found: Covariance) -> list[str]:
    lines = []
    for name, seen_from in (("yaw offset.y", "T1"), ("yaw offset.x", "T2")):
        if name in found.names:
            value, u = (x / mm for x in found[name])
            lines.append(f"two-axis table: move {abs(value):.3f} mm (u = {u:.3f}) to the {'right' if value < 0 else 'left'} seen from "
                         f"{seen_from}, {_CIRCLES}.")
    if "pitch over pitch" in found.names:
        value, u = (x / mm for x in found["pitch over pitch"])
        lines.append(f"two-axis table: {'raise' if value > 0 else 'lower'} by {abs(value):.3f} mm (u = {u:.3f}), {_CIRCLES}.")
    for axis, words in (("pitch", "three-axis pitch axis"), ("two_axis_pitch", "two-axis pitch axis")):
        if f"square[{axis}]" in found.names:
            value, u = (x / arcsec for x in found[f"square[{axis}]"])
            lines.append(f"{words}: {'raise' if value > 0 else 'lower'} its end away from T1 by {_per_metre(value):.0f} um "
                         f"(u = {_per_metre(u):.0f}) for each metre between the bearings, {_CIRCLES}.")
    for axis, words in (("pitch", "three-axis pitch axis"), ("roll", "roll axis, yaw turned by 90 degrees")):
        if f"intersection[{axis}]" in found.names:
            value, u = (x / mm for x in found[f"intersection[{axis}]"])
            lines.append(f"{words}: move {abs(value):.3f} mm (u = {u:.3f}) to the {'right' if value < 0 else 'left'} seen from T1, to meet the "
                         f"yaw axis, {_CIRCLES}.")
    return lines
