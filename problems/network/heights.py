"""Approximate heights: carried from point to point by height differences, zenith angles, vectors and slopes."""

from __future__ import annotations

import numpy as np

from problems.network.survey import Survey


def zenith_angles(survey: Survey) -> dict[tuple[str, str], float]:
    """{(station, target): zenith angle [rad]}, both ways."""
    found: dict[tuple[str, str], float] = {}
    for batch in survey.every_batch:
        if batch.kind in ("zenith angle", "inclination") and batch.values is not None:
            values = batch.values[:, 0] if batch.kind == "zenith angle" else np.pi / 2.0 - batch.values[:, 0]
            for a, b, value in zip(*(keys.tolist() for keys in batch.ends), values, strict=True):
                found[a, b] = float(value)
                found.setdefault((b, a), float(np.pi - value))
    return found


def level(survey: Survey, known: dict[str, np.ndarray]) -> None:
    """Carry heights from points that have one to those that have none; the first point starts at zero where no height
    is known and none is observed."""
    differences = _differences(survey, known)
    wanted = [k for k, p in survey.points.items() if p.height and any(k in pair for pair in differences)]
    if wanted and not any(np.isfinite(known[k][2]) for k in wanted):
        known[wanted[0]][2] = 0.0
    while True:
        carried = False
        for (a, b), rise in differences.items():
            for here, there, step in ((a, b, rise), (b, a, -rise)):
                if np.isfinite(known[here][2]) and np.isnan(known[there][2]):
                    known[there][2] = known[here][2] + step
                    carried = True
        if not carried:
            return


def _differences(survey: Survey, known: dict[str, np.ndarray]) -> dict[tuple[str, str], float]:
    """{(a, b): height of b above a [m]}, levelled ones first."""
    levelled: dict[tuple[str, str], float] = {}
    slopes: dict[tuple[str, str], float] = {}
    zenith = zenith_angles(survey)
    for batch in survey.every_batch:
        if batch.values is None or batch.model.points != 2:
            continue
        station, target = (keys.tolist() for keys in batch.ends)
        up = batch.heights("station_height") - batch.heights("target_height")
        for i, (a, b) in enumerate(zip(station, target, strict=True)):
            value = batch.values[i]
            if batch.kind == "height difference":
                levelled[a, b] = float(value[0])
            elif batch.kind == "vector":
                levelled[a, b] = float(value[2] + up[i])
            elif batch.kind in ("slope distance", "scale bar") and (a, b) in zenith:
                slopes[a, b] = float(value[0] * np.cos(zenith[a, b]) + up[i])
            elif batch.kind in ("zenith angle", "inclination"):
                across = float(np.hypot(*(known[b][:2] - known[a][:2])))
                if np.isfinite(across):
                    slopes.setdefault((a, b), float(across / np.tan(zenith[a, b]) + up[i]))
    return {**slopes, **levelled}
