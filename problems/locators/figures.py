"""Figures of the locator paper drawn anew: histograms of the pose error (6-11) and the sensitivities (12-13)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from problems.locators.pose_error import COMPONENT_UNITS, COMPONENTS
from problems.locators.sensitivity import Sensitivity
from problems.locators.trials import Trials

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GROUPS = ("linear", "ball", "angular", "squareness")


def of(trials: Trials, found: Sequence[Sensitivity]) -> dict[str, Callable[[], Any]]:
    """The figures by title, each a function that draws it.

    trials: pose errors of the Monte Carlo; found: sensitivities of the sources that move the part.
    """
    return {"Pose error under the first assumption, with the normal curve of its mean and "
            "sigma": lambda: histograms(trials),
            "Sensitivity of position and attitude to each source (length 1 mm, angle 1 mm/stroke)": lambda: bars(found)}


def histograms(trials: Trials) -> Figure:
    """Histogram of each of the six components with the normal density of its mean and standard deviation."""
    from matplotlib.figure import Figure
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    for axes, name, unit, sample in zip(figure.subplots(2, 3).ravel(), COMPONENTS, COMPONENT_UNITS, trials.exact.T,
                                        strict=True):
        axes.hist(sample, bins=50, density=True, color="0.75")
        x = np.linspace(sample.min(), sample.max(), 200)
        sigma = sample.std(ddof=1)
        axes.plot(x, np.exp(-((x - sample.mean()) / sigma) ** 2 / 2) / (sigma * np.sqrt(2 * np.pi)), color="C0")
        axes.set_xlabel(f"{name} [{unit}]")
        axes.set_yticks([])
        axes.locator_params(axis="x", nbins=4)
    return figure


def bars(found: Sequence[Sensitivity]) -> Figure:
    """Sensitivities of all sources on a logarithmic scale, in the groups of section 4."""
    from matplotlib.figure import Figure
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    ordered = [one for group in GROUPS for one in found if one.group == group]
    number = np.arange(1, len(ordered) + 1)
    for axes, label, values in zip(figure.subplots(2, 1, sharex=True), ("s_r [mm]", "s_phi [deg]"),
                                   ([one.position for one in ordered], [one.attitude for one in ordered]), strict=True):
        for group, colour in zip(GROUPS, ("C0", "C1", "C2", "C4"), strict=True):
            chosen = np.array([one.group == group for one in ordered])
            axes.bar(number[chosen], np.array(values)[chosen], color=colour, label=group)
        axes.set_yscale("log")
        axes.set_ylim(bottom=1e-4)
        axes.set_ylabel(label)
    figure.axes[0].legend(ncols=4, fontsize="small")
    figure.axes[1].set_xlabel("source")
    return figure
