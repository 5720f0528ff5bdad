"""What to adjust on the simulator, from the joint estimate: level readings to set, feet to raise, millimetres to
move.
"""

from __future__ import annotations

from calib import Linearisation, covariance
from calib.analyse.covariance import Covariance
from calib.units import arcsec, mm, um

_TABLES = {"three_axis": "three-axis table", "two_axis": "two-axis table"}
_NEEDED = {"plumb", "level_zero", "yaw_offset", "axis_point"}
_CIRCLES = (
    "Left and right, up and down hold for theodolites of the usual make (clockwise circle, zenith angles), which the "
    "readings cannot tell; with other circles turn them about."
)


def advice(fit: Linearisation) -> tuple[str, ...]:
    """Sentences on what to adjust, each with its standard uncertainty u.

    fit: of the joint problem. Returns nothing for a problem of another kind.
    """
    if not {unknown.name for unknown in fit.layout.unknowns} >= _NEEDED:
        return ()
    found = covariance(fit, *fit.results, "plumb", "level_zero")
    levels = [sentence for table in _TABLES for sentence in _level(found, table)]
    return (*levels, *_feet(found), *_move(found), *_axes(found), _CIRCLES)


def _level(found: Covariance, table: str) -> tuple[str, str]:
    zero, u_zero = (x / arcsec for x in found[f"level_zero[{table}]"])
    x, u_x = (value / arcsec for value in found[f"plumb[{table}].x"])
    y, u_y = (value / arcsec for value in found[f"plumb[{table}].y"])
    # right-handed rotations with Z up: the axis leans toward X by theta_y and toward -Y by theta_x
    return (
        f"{_TABLES[table]}: set the level to {zero:.1f} arcsec (u = {u_zero:.1f}) at every yaw position by the feet; "
        "there the yaw axis is plumb.",
        f"{_TABLES[table]}: the yaw axis leans {abs(y):.1f} arcsec (u = {u_y:.1f}) to {_side('X', y)} and {abs(x):.1f} "
        f"arcsec (u = {u_x:.1f}) to {_side('Y', -x)} of the level's frame (X along the level at position 0, Y at 90 "
        f"degrees): raise the feet on those sides by {_per_metre(y):.1f} um (u = {_per_metre(u_y):.1f}) and "
        f"{_per_metre(x):.1f} um (u = {_per_metre(u_x):.1f}) for each metre between the feet.",
    )


def _side(axis: str, value: float) -> str:
    return f"{'+' if value >= 0 else '-'}{axis}"


def _per_metre(angle: float) -> float:
    """Micrometres for each metre of an angle in arcseconds."""
    return abs(angle) * arcsec / um


def _feet(found: Covariance) -> list[str]:
    feet = [name for name in found.names if name.startswith("foot[")]
    return [
        f"foot {name[5:-1]}: {'raise' if found[name][0] >= 0 else 'lower'} by {abs(found[name][0]) / um:.1f} um "
        f"(u = {found[name][1] / um:.1f})."
        for name in feet
    ]


def _move(found: Covariance) -> list[str]:
    lines = []
    for name, seen_from in (("yaw offset.y", "T1"), ("yaw offset.x", "T2")):
        value, u = (x / mm for x in found[name])
        side = "right" if value < 0 else "left"
        lines.append(f"two-axis table: move {abs(value):.3f} mm (u = {u:.3f}) to the {side}, seen from {seen_from}.")
    if "pitch over pitch" in found.names:
        value, u = (x / mm for x in found["pitch over pitch"])
        lines.append(f"two-axis table: {'raise' if value > 0 else 'lower'} by {abs(value):.3f} mm (u = {u:.3f}).")
    return lines


def _axes(found: Covariance) -> list[str]:
    lines = []
    for axis, words in (("pitch", "three-axis pitch axis"), ("two_axis_pitch", "two-axis pitch axis")):
        if f"square[{axis}]" in found.names:
            value, u = (x / arcsec for x in found[f"square[{axis}]"])
            lines.append(
                f"{words}: {'raise' if value > 0 else 'lower'} the end away from T1 by {_per_metre(value):.0f} um "
                f"(u = {_per_metre(u):.0f}) for each metre between the bearings."
            )
    for axis, words in (("pitch", "three-axis pitch axis"), ("roll", "roll axis, yaw turned by 90 degrees")):
        value, u = (x / mm for x in found[f"intersection[{axis}]"])
        side = "right" if value < 0 else "left"
        lines.append(
            f"{words}: move {abs(value):.3f} mm (u = {u:.3f}) to the {side}, seen from T1, to meet the yaw axis."
        )
    return lines
