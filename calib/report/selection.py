"""selection.json and report.html of a choice: what was chosen, how far from the optimum, what u it promises."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calib import files, units
from calib.analyse.selection.planning import Next, Step
from calib.analyse.selection.select import Choice
from calib.linearisation import Linearisation
from calib.report import numbers, plots
from calib.report.provenance import Provenance
from calib.report.template import Drawing, Grid, render

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 60      # labels in the page; selection.json has all


def listed(choice: Choice, most: int = SHOWN) -> str:
    """The chosen candidates in words: rows of one group as ranges of numbers, others one by one."""
    single = {f"{group} row {row}" for group, rows in choice.rows.items() for row in rows}
    if set(choice.labels) <= single:
        return "; ".join(f"{group} row{'s' if len(set(rows)) > 1 else ''} {_ranges(rows)}"
                         for group, rows in choice.rows.items())
    more = f" and {len(choice.labels) - most} more" if len(choice.labels) > most else ""
    return "; ".join(choice.labels[:most]) + more


def _ranges(rows: Any) -> str:
    numbers_in_order = sorted({int(r) for r in rows})
    runs: list[list[int]] = []
    for number in numbers_in_order:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(f"{run[0]}" if len(run) == 1 else f"{run[0]}, {run[1]}" if len(run) == 2 else
                     f"{run[0]}-{run[-1]}" for run in runs)


def ranking(problem: str, job: str, what: str, further: Sequence[Next], provenance: Provenance) -> dict[str, Any]:
    """The content of selection.json where single further measurements were asked for.

    problem, job: names; what: they serve, in words; further: best first; provenance: of the run.
    """
    return {"format": 1, "problem": problem, "job": job, "serves": what,
            "next": [{"candidate": one.label, "value": one.value if np.isfinite(one.value) else None,
                      "ratio": one.ratio} for one in further],
            "provenance": provenance.content()}


def ranked(what: str, further: Sequence[Next], most: int) -> list[str]:
    """The first of single further measurements, one line each, best first."""
    if all(one.ratio >= 1.0 for one in further):
        return [f"none of {len(further)} candidates changes it: {what}"]
    lines = [f"best of {len(further)} further measurements: {what}, and its ratio to that without it"]
    width = max(len(one.label) for one in further[:most])
    for one in further[:most]:
        value = numbers.plain(one.value) if np.isfinite(one.value) else "not known"
        ratio = "only with it" if one.ratio == 0.0 else numbers.plain(one.ratio)
        lines.append(f"  {one.label:<{width}}  {value:>12}  {ratio:>12}")
    return lines


def content(problem: str, job: str, choice: Choice, provenance: Provenance) -> dict[str, Any]:
    """The content of selection.json; rows as in the file, group after group.

    problem, job: names; choice; provenance: of the run.
    """
    return {
        "format": 1, "problem": problem, "job": job, "criterion": choice.criterion, "keep": choice.keep,
        "rows": [int(r) for rows in choice.rows.values() for r in rows],
        "groups": {name: [int(r) for r in rows] for name, rows in choice.rows.items()}, "chosen": list(choice.labels),
        "candidates": choice.candidates, "value": choice.value, "unit": choice.unit, "bound": choice.bound,
        "gap": choice.gap, "proven": choice.proven, "method": choice.method, "seconds": choice.seconds,
        "quantities": [
            {"name": p.name, "unit": p.unit, "u_all": p.u_all / units.factor(p.unit),
             "u_selected": p.u_chosen / units.factor(p.unit) if np.isfinite(p.u_chosen) else None}
            for p in choice.promises],
        "remarks": list(choice.remarks), "provenance": provenance.content(),
    }


def sentence(choice: Choice) -> str:
    """The choice in one sentence."""
    way = "the optimum, proven" if choice.proven else f"at most {numbers.plain(100 * choice.gap, 3)} % from the optimum"
    unit = f" {choice.unit}" if choice.unit else ""
    return (f"{len(choice.chosen)} of {choice.candidates} candidates for criterion {choice.criterion}: "
            f"{numbers.plain(choice.value, 6)}{unit}, bound {numbers.plain(choice.bound, 6)}{unit}: {way}.")


def write(title: str, fit: Linearisation, choice: Choice, steps: Sequence[Step], provenance: Provenance,
          path: str | Path) -> Path:
    """Write report.html, whole or not at all.

    title; fit: what was chosen from; choice; steps: criterion against number kept; provenance; path. Returns the path.
    """
    drawings = []
    if len(steps) > 1:
        drawings.append(Drawing.of(_along(choice, steps), "along", "The criterion against the number kept: the best "
                        "choices found (dots) and what no choice can beat (line)."))
    picture = _places(fit, choice)
    if picture is not None:
        drawings.append(Drawing.of(picture, "places", "Where the chosen readings stand (filled) among the candidates "
                                   "(open)."))
    rows = [[p.name, numbers.plain(p.u_all / units.factor(p.unit)),
             numbers.plain(p.u_chosen / units.factor(p.unit)) if np.isfinite(p.u_chosen) else "not known",
             numbers.plain(p.u_chosen / p.u_all, 3) if np.isfinite(p.u_chosen) and p.u_all else "", p.unit]
            for p in choice.promises]
    return files.write_text(path, render(
        "selection.html.j2", title=title, subtitle=f"{fit.name}: which observations to keep, found by {choice.method}",
        sentence=sentence(choice), chosen=listed(choice), remarks=choice.remarks,
        promises=Grid(["quantity", "u, all", "u, chosen", "ratio", "unit"], rows), drawings=drawings,
        provenance=provenance.lines()))


def _along(choice: Choice, steps: Sequence[Step]) -> Figure:
    figure, axes = plots.canvas(2.8, fitted=True)
    # Relative to the largest number tried, so that the axis has no unit that nobody reads.
    whole = max(steps, key=lambda s: s.keep)
    keep = [s.keep for s in steps]
    values, bounds = (np.array([getattr(s, name) for s in steps]) / whole.value for name in ("value", "bound"))
    axes.fill_between(keep, values, bounds, color=plots.FAINT, alpha=0.35, linewidth=0)
    axes.plot(keep, bounds, color=plots.FAINT, linewidth=1.4, label="bound")
    axes.scatter(keep, values, s=18, color=plots.ACCENT, linewidths=0, label="best found", zorder=3)
    axes.scatter([len(choice.chosen)], [choice.value / whole.value], s=70, facecolors="none", edgecolors=plots.WARNING,
                 linewidths=1.6, label="chosen", zorder=4)
    if max(values.max(), bounds.max()) / min(values.min(), bounds.min()) > 20:
        axes.set_yscale("log")
    axes.set_xlabel("candidates kept")
    axes.set_ylabel(f"criterion {choice.criterion}, relative to {whole.keep} kept")
    axes.legend(frameon=False, labelcolor=plots.INK, fontsize=9, ncols=3, loc="lower left", bbox_to_anchor=(0, 1),
                borderaxespad=0)
    return figure


def _places(fit: Linearisation, choice: Choice) -> Figure | None:
    """Chosen readings among the candidates: in space where x, y and z are covariates, else over the two covariates
    that say most, or the row number."""
    group = next((g for g in fit.groups if g.name in choice.rows and not g.is_prior), None)
    if group is None:
        return None
    names, taken = _axes_of(group.covariates), np.isin(group.rows, choice.rows[group.name])
    solid = len(names) == 3
    figure, axes = plots.canvas(4.4 if solid else 2.8, fitted=True)
    if solid:
        axes.remove()
        axes = figure.add_subplot(projection="3d")
        axes.patch.set_alpha(0)
        for one in (axes.xaxis, axes.yaxis, axes.zaxis):
            one.pane.set_alpha(0)
            one.label.set_color(plots.INK)
    columns, labels = [], []
    for name in names or ["row"]:
        values = np.asarray(group.covariates.get(name, group.rows))
        unit = group.covariate_units.get(name, "")
        shown = unit not in ("", "1")
        columns.append(values / units.factor(unit) if shown and values.dtype.kind == "f" else values)
        labels.append(f"{name} / {unit}" if shown else name)
    if len(columns) == 1:
        columns.append(np.where(taken, "chosen", "not chosen"))
        labels.append("")
    axes.scatter(*[c[~taken] for c in columns], s=16, facecolors="none", edgecolors=plots.FAINT, linewidths=0.9)
    axes.scatter(*[c[taken] for c in columns], s=30, color=plots.ACCENT, linewidths=0)
    for set_label, label in zip((axes.set_xlabel, axes.set_ylabel, getattr(axes, "set_zlabel", None)), labels):
        set_label(label)      # type: ignore[misc]
    axes.tick_params(colors=plots.INK, labelcolor=plots.INK, labelsize=9)
    return figure


def _axes_of(covariates: Any) -> list[str]:
    varied = {name: np.asarray(values) for name, values in covariates.items() if len(np.unique(values)) > 1}
    space = [name for axis in ("x", "y", "z") for name in varied if name.lower() == axis
             and varied[name].dtype.kind in "fiu"]
    if len(space) >= 2:
        return space
    numeric = sorted((n for n, v in varied.items() if v.dtype.kind == "f"), key=lambda n: -len(np.unique(varied[n])))
    kinds = [n for n, v in varied.items() if v.dtype.kind != "f" and len(np.unique(v)) <= 40]
    return [*numeric[:1], *kinds[:1]] if numeric else ["row", *kinds[:1]]
