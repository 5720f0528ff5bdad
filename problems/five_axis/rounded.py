"""Every printed result once more along the paper's own printed intermediates, in millimetres and arcseconds."""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot

from calib.units import arcsec, mm

from .formulas import Line, axis_point, line_through, off_the_sight, out_of_square, out_of_square_in_plan
from .readings import HORIZONTAL, VERTICAL, Readings


def along_printed(printed: Mapping[str, float], readings: Readings) -> dict[str, float]:
    """Results recomputed from the nearest printed intermediates.

    printed: {key: printed number} of claims.csv, in its units; readings: for distances, index and printed centres.
    Returns {key: number} in the same units, for the keys that have a printed intermediate.
    """
    length = {target: value / mm for target, (value, _) in readings.distance.items()}
    p, index = dict(printed), (readings.index[0] - VERTICAL) / arcsec
    for target, (h, v, _) in readings.centre.items():
        p |= {f"{target}_hz": (h - HORIZONTAL) / arcsec, f"{target}_v": (v - VERTICAL) / arcsec}
    found = {
        "lev_dx": p["lev2_thx"] - p["lev3_thx"],
        "lev_dy": p["lev2_thy"] - p["lev3_thy"],
        "lev_par": hypot(p["lev_dx"], p["lev_dy"]),
        "dX_ang": p["T1_S2_hz"] - p["T1_S3_hz"],
        "dY_ang": p["T2_S2_hz"] - p["T2_S3_hz"],
    }
    found |= {
        "dX": off_the_sight(length["T1"], p["dX_ang"] * arcsec, 0.0),
        "dY": off_the_sight(length["T2"], p["dY_ang"] * arcsec, 0.0),
    }
    found |= {"it8a": p["lev_dx"], "it8b": p["lev_dy"], "it9a": p["dX"], "it9b": p["dY"]}
    for target in "ABCDEF":
        reading = (p[f"{target}_hz"] * arcsec, p[f"{target}_v"] * arcsec)
        _, found[f"{target}_y"], found[f"{target}_z"] = axis_point(
            length[target], *reading, p["T1_S3_hz"] * arcsec, index * arcsec
        )
    pitch, roll, two = (
        _line(p, length, near, far, key) for near, far, key in (("A", "B", "l8"), ("C", "D", "l9"), ("E", "F", "l10"))
    )
    for (near, far), key in ((("A", "B"), "l8"), (("C", "D"), "l9"), (("E", "F"), "l10")):
        points = [(length[t], p[f"{t}_y"], p[f"{t}_z"]) for t in (near, far)]
        through = line_through(*points)
        found |= {f"{key}_dx": through.dx, f"{key}_dy": through.dy, f"{key}_dz": through.dz}
    found["l9_y0"] = p["C_y"]
    crossing = length["T1"]
    (found["y1"], found["z1"]), (found["y2"], found["z2"]) = pitch.at(crossing), roll.at(crossing)
    found["y3"], z3 = two.at(crossing)
    found["yaw2_y"] = off_the_sight(crossing, found["dX_ang"] * arcsec, 0.0)
    found |= {
        "it1": out_of_square(pitch) / arcsec,
        "it2": out_of_square_in_plan(roll, pitch) / arcsec,
        "it3": p["y1"],
        "it4": p["z2"] - p["z1"],
        "it5": p["y2"],
        "it6": out_of_square(two) / arcsec,
        "it7": p["yaw2_y"] - p["y3"],
        "it10": z3 - p["z1"],
    }
    found |= {
        "ex_thA": (p["A_v"] - index) * arcsec,
        "ex_thB": (p["B_v"] - index) * arcsec,
        "ex_sigrad": 2.3 * arcsec,
        "ex_prad": hypot(length["A"], length["B"]) / (length["B"] - length["A"]) * p["ex_sigrad"],
    }
    return found


def _line(p: Mapping[str, float], length: Mapping[str, float], near: str, far: str, key: str) -> Line:
    """A line as eq (8)-(10) print it, the base point taken from the text where the equation has another sign."""
    return Line(length[near], p[f"{near}_y"], p[f"{near}_z"], p[f"{key}_dx"], p[f"{key}_dy"], p[f"{key}_dz"])
