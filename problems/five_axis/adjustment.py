"""What to adjust on the simulator, from the joint estimate: level readings to set, feet to raise, millimetres to
move.
"""

from __future__ import annotations

from calib import Linearisation, covariance
from calib.analyse.covariance import Covariance
from calib.units import arcsec, mm, um

_TABLES = {"three_axis": "three-axis table", "two_axis": "two-axis table"}
_NEEDED = {"plumb", "level_zero", "yaw_offset", "axis_point", "up"}
# +1: circles that grow to the left and upward, as the paper's frame has it; -1: clockwise and zenith angles.
_MAKE = {
    1: "Left and right, up and down hold for circles that grow to the left and upward, as the paper's frame has it",
    -1: "Left and right, up and down hold for a clockwise circle and zenith angles, the usual make",
}
_SIDES = ("left", "right")
_MOVES = ("raise", "lower")


def advice(fit: Linearisation) -> tuple[str, ...]:
    """Sentences on what to adjust, each with its standard uncertainty u.

    fit: of the joint problem. Returns nothing for a problem of another kind.
    """
    if not {unknown.name for unknown in fit.layout.unknowns} >= _NEEDED:
        return ()
    found = covariance(fit, *fit.results, "plumb", "level_zero")
    up = next(round(float(fit.values[unknown][0, 0])) for unknown in fit.layout.unknowns if unknown.name == "up")
    levels = [sentence for table in _TABLES for sentence in _level(found, table)]
    return (
        *levels, *_feet(found), *_move(found, up), *_axes(found, up),
        f"{_MAKE[up]}; with other circles turn them about.")


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


def _move(found: Covariance, up: int) -> list[str]:
    lines = []
    for name, seen_from in (("yaw offset.y", "T1"), ("yaw offset.x", "T2")):
        value, u = (x / mm for x in found[name])
        side = _SIDES[value * up > 0]
        lines.append(f"two-axis table: move {abs(value):.3f} mm (u = {u:.3f}) to the {side}, seen from {seen_from}.")
    if "pitch over pitch" in found.names:
        value, u = (x / mm for x in found["pitch over pitch"])
        lines.append(f"two-axis table: {_MOVES[value * up > 0]} by {abs(value):.3f} mm (u = {u:.3f}).")
    return lines


def _axes(found: Covariance, up: int) -> list[str]:
    lines = []
    for axis, words in (("pitch", "three-axis pitch axis"), ("two_axis_pitch", "two-axis pitch axis")):
        if f"square[{axis}]" in found.names:
            value, u = (x / arcsec for x in found[f"square[{axis}]"])
            lines.append(
                f"{words}: {_MOVES[value * up > 0]} the end away from T1 by {_per_metre(value):.0f} um "
                f"(u = {_per_metre(u):.0f}) for each metre between the bearings."
            )
    for axis, words in (("pitch", "three-axis pitch axis"), ("roll", "roll axis, yaw turned by 90 degrees")):
        value, u = (x / mm for x in found[f"intersection[{axis}]"])
        side = _SIDES[value * up > 0]
        lines.append(
            f"{words}: move {abs(value):.3f} mm (u = {u:.3f}) to the {side}, seen from T1, to meet the yaw axis."
        )
    return lines
