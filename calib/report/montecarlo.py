"""report.html of a Monte Carlo run: does the linear result hold, and the distribution of every result beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calib import files, units
from calib.report import numbers, plots
from calib.report.provenance import Provenance
from calib.report.template import Cell, Drawing, Grid, render
from calib.workflow.montecarlo import MonteCarlo
from calib.workflow.solution import Solution

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DRAWN = 12      # distributions on the page; montecarlo.json and samples.npz have all
BINS = 60
VALID = "valid"


def write(solution: Solution, found: MonteCarlo, entries: Sequence[Mapping[str, Any]], provenance: Provenance,
          path: str | Path) -> Path:
    """Write report.html, whole or not at all.

    solution: the solved job, whose estimate was taken as the truth; found: the samples; entries: those of
    montecarlo.json, one a result; provenance: of the run; path: of the file.
    return: the path.
    raises InputError where it cannot be written.
    """
    return files.write_text(path, html(solution, found, entries, provenance))


def html(solution: Solution, found: MonteCarlo, entries: Sequence[Mapping[str, Any]], provenance: Provenance) -> str:
    """The page as text; arguments as for `write`."""
    estimate = solution.estimate
    certified = estimate.certificate.passed and estimate.converged
    return render(
        "montecarlo.html.j2",
        title=f"{solution.problem.name}: propagation of distributions",
        subtitle=f"{solution.job.path.name}, {len(found.samples)} trials",
        passed=certified and not found.failures,
        failure="" if certified else estimate.certificate.why if estimate.converged else estimate.message,
        failures=found.failures,
        trials=len(found.samples) + found.failures,
        sentence=sentence(entries),
        results=_results(entries),
        drawings=[Drawing.of(_distribution(found, i), f"distribution {i}", _caption(entries[i]))
                  for i in range(min(DRAWN, len(found.names))) if found.u[i] > 0],
        left=max(0, len(found.names) - DRAWN),
        provenance=provenance.lines(),
    )


def sentence(entries: Sequence[Mapping[str, Any]]) -> str:
    """Whether the linear uncertainties hold, in one sentence.

    entries: those of montecarlo.json.
    return: the sentence.
    """
    good = [one for one in entries if str(one["verdict"]).startswith(VALID)]
    if len(good) == len(entries):
        count = "The result" if len(entries) == 1 else f"All {len(entries)} results"
        return f"{count} of linear propagation {'holds' if len(entries) == 1 else 'hold'} under the full distributions."
    rest = ", ".join(str(one["name"]) for one in entries if one not in good)
    return (f"{len(good)} of {len(entries)} results of linear propagation hold; not or not yet shown for: {rest}. "
            "There, use the interval of the samples.")


def _results(entries: Sequence[Mapping[str, Any]]) -> Grid:
    rows: list[list[str | Cell]] = []
    for one in entries:
        mean, u = numbers.with_uncertainty(one["mean"], one["u"])
        linear, linear_u = numbers.with_uncertainty(one["linear"], one["linear_u"])
        # An end of an interval means nothing beyond the digits of u.
        intervals = ["[" + ", ".join(numbers.with_uncertainty(end, one["u"])[0] for end in one[key]) + "]"
                     for key in ("interval_shortest", "interval_symmetric")]
        style = "good" if str(one["verdict"]).startswith(VALID) else "warning"
        rows.append([one["name"], mean, u or "–", linear, linear_u or "–", *intervals,
                     "" if one["unit"] == "1" else one["unit"], Cell(one["verdict"], f"{style} prose")])
    header = ["result", "mean", "u", "linear", "u linear", "shortest 95 %", "symmetric 95 %", "unit", "linear result"]
    return Grid(header, rows).without_empty()


def _caption(one: Mapping[str, Any]) -> str:
    return (f"{one['name']}: samples, and the normal distribution of the linear result (line); linear result "
            f"{one['verdict']}.")


def _distribution(found: MonteCarlo, index: int) -> Figure:
    """Histogram of one result with the normal density of the linear one and the shortest 95% interval."""
    scale = units.factor(found.units[index])
    samples = found.samples[:, index] / scale
    centre, u = found.linear[index] / scale, found.linear_u[index] / scale
    figure, axes = plots.canvas(2.2)
    low, high = np.quantile(samples, [0.0005, 0.9995])
    axes.hist(samples, bins=BINS, range=(low, high), density=True, color=plots.SERIES[0], alpha=0.45, linewidth=0)
    if u > 0:
        x = np.linspace(low, high, 200)
        axes.plot(x, np.exp(-0.5 * ((x - centre) / u) ** 2) / (u * np.sqrt(2 * np.pi)), color=plots.SERIES[1])
    for end in found.interval_shortest()[index] / scale:
        axes.axvline(end, color=plots.FAINT, linewidth=1.0, linestyle="--")
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    unit = found.units[index]
    axes.set_xlabel(found.names[index] if unit == "1" else f"{found.names[index]} / {unit}")
    return figure
