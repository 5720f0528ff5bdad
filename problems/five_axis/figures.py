"""Figures of the five-axis comparison, drawn when asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from calib.units import arcsec, degree

from .results import ITEMS, JOINT, STEP, Fit, Fits


def of(found: Fits, printed: Mapping[str, float]) -> dict[str, Callable[[], Any]]:
    """The figures by title, each a function that draws it.

    found: the fits; printed: the printed numbers by key.
    """
    return {
        "Residuals of the readings, step by step": lambda: residuals(found.step),
        "The twelve results: printed, step by step, jointly": lambda: twelve(found, printed),
    }


def residuals(step: Fit) -> Any:
    """Residuals of tables 1 to 4 against the position of the axis."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots(2, 2)
    for place, observations in zip(axes.ravel(), step.estimate.problem.observations):
        angle = next(a.data[:, 0] for a in observations.arguments if a.name == "angle") / degree
        found = step.estimate.residuals[observations.group] / arcsec
        for component in range(found.shape[1]):
            place.plot(
                ((angle + 180) % 360) - 180, found[:, component], "o", markersize=3,
                label=("horizontal circle", "vertical circle")[component] if found.shape[1] > 1 else None)
        place.axhline(0.0, color="0.6", linewidth=0.8)
        place.set(title=observations.group, xlabel="position / deg", ylabel="residual / arcsec")
        if found.shape[1] > 1:
            place.legend(fontsize=8)
    return figure


def twelve(found: Fits, printed: Mapping[str, float]) -> Any:
    """Printed and joint results as departures from the step-by-step ones, in units of their u by the scatter found."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axis = figure.subplots()
    units = ["arcsec" if key in ("it1", "it2", "it6", "it8a", "it8b") else "mm" for key in ITEMS]
    step = [found.step.at(STEP[key], unit) for key, unit in zip(ITEMS, units)]
    joint = [found.joint.at(JOINT[key], unit) for key, unit in zip(ITEMS, units)]
    x = np.arange(len(ITEMS))
    axis.errorbar(x - 0.15, np.zeros(len(x)), [1.0] * len(x), fmt="s", markersize=4, label="step by step")
    axis.errorbar(
        x + 0.15, [(j[0] - s[0]) / s[2] for j, s in zip(joint, step)], [j[2] / s[2] for j, s in zip(joint, step)],
        fmt="o", markersize=4, label="jointly")
    axis.plot(x, [(printed[key] - s[0]) / s[2] for key, s in zip(ITEMS, step)], "kx", label="printed")
    axis.set_xticks(x, ITEMS)
    axis.set_ylabel("departure / u of the step-by-step result")
    axis.legend()
    return figure
