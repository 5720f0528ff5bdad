"""Points of an adjusted network as a table: coordinates, uncertainties before and after scaling, ellipses, ellipsoids.

Source: Ghilani, Adjustment Computations, 5th edition (2010), chapter 19; JCGM 102:2011, 7.7, for the factors of 95 %.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from calib import Linearisation
from calib.analyse.covariance import of_instances
from calib.analyse.ellipse import PLANE_95, SPACE_95, ellipse
from calib.units import gon, mm

MOST = 2000                              # points whose ellipses are computed


def result_tables(fit: Linearisation) -> dict[str, list[dict[str, Any]]]:
    """One line a point.

    fit: of a network. Coordinates in m; u as stated, and u_aposteriori, multiplied by the root of the variance factor,
    in mm; semi-axes of the standard ellipse (k = 1) and of the ellipse that holds the point with 95 %, and the bearing
    of the longer one from the axis x towards y; in space the semi-axes of the standard ellipsoid and of that of 95 %.
    """
    point = next(unknown for unknown in fit.layout.unknowns if unknown.name == "point")
    free = fit.layout.free[fit.layout.span(point)].reshape(point.count, point.freedom)
    values = np.reshape(fit.values[point], (point.count, point.freedom))
    factor = float(np.sqrt(fit.objective / fit.dof)) if fit.dof > 0 else float("nan")
    matrices, lines = of_instances(fit, point), []
    for i in range(min(point.count, MOST)):
        line: dict[str, Any] = {"point": point.keys[i]}
        line |= {f"{part}_m": float(value) for part, value in zip(point.parts, values[i])}
        if free[i].any():
            matrix = matrices[i] / mm**2
            u = np.sqrt(np.diag(matrix))
            line |= {f"u_{part}_mm": float(one) for part, one, there in zip(point.parts, u, free[i]) if there}
            line |= {f"u_aposteriori_{part}_mm": float(factor * one)
                     for part, one, there in zip(point.parts, u, free[i]) if there}
            line |= _figures(matrix, "".join(part for part, there in zip(point.parts, free[i]) if there), point.parts)
        lines.append(line)
    columns = list(dict.fromkeys(name for line in lines for name in line))
    return {"points": [{name: line.get(name) for name in columns} for line in lines]}


def _figures(matrix: np.ndarray, free: str, parts: tuple[str, ...]) -> dict[str, float]:
    found: dict[str, float] = {}
    if "x" in free and "y" in free:
        plan = [parts.index("x"), parts.index("y")]
        own = ellipse(matrix[np.ix_(plan, plan)])
        found |= {"ellipse_a_mm": own.major, "ellipse_b_mm": own.minor, "ellipse_bearing_gon": own.bearing / gon,
                  "ellipse95_a_mm": PLANE_95 * own.major, "ellipse95_b_mm": PLANE_95 * own.minor}
    if free == "xyz":
        semi = np.sqrt(np.maximum(np.linalg.eigvalsh(matrix), 0.0))[::-1]
        found |= {f"ellipsoid_{name}_mm": one for name, one in zip("abc", semi)}
        found |= {f"ellipsoid95_{name}_mm": SPACE_95 * one for name, one in zip("abc", semi)}
    return {name: float(value) for name, value in found.items()}
