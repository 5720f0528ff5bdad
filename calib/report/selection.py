"""selection.json and report.html of a choice: what was chosen, how far from the optimum, what u it promises."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calib import files, units
from calib.analyse.selection.planning import Next, Step
from calib.analyse.selection.select import Choice
from calib.blocks import Array
from calib.linearisation import Group, Linearisation
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
    if all(not np.isfinite(one.value) for one in further):
        return [f"no single one of {len(further)} further measurements is enough: {what}; measure more than one, or "
                "what is not among them"]
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
          path: str | Path, places: Mapping[str, Array] | None = None) -> Path:
    """Write report.html, whole or not at all.

    title; fit: what was chosen from; choice; steps: criterion against number kept; provenance; path; places:
    {group: (n, 3)} of its readings [m], where they are known. Returns the path.
    """
    drawings = []
    if len(steps) > 1:
        drawings.append(Drawing.of(_along(choice, steps), "along", "The criterion against the number kept: the best "
                        "choices found (dots) and what no choice can beat (line)."))
    drawings += _places(fit, choice, places or {})
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


def _places(fit: Linearisation, choice: Choice, given: Mapping[str, Array]) -> list[Drawing]:
    """Where the chosen readings stand among the candidates: in space where places are known, given or as unknowns of
    their own, and over the two covariates that say most, or the row number."""
    drawings = []
    space = [(group, place) for group in fit.groups if group.name in choice.rows and not group.is_prior
             for place in [given.get(group.name, _own_places(fit, group))] if place is not None]
    if space:
        drawings.append(Drawing.of(_in_space(choice, space), "space", "The candidates in space, in metres: chosen "
                                   "(filled, the larger the more readings were chosen there) and not (open)."))
    group = next((g for g in fit.groups if g.name in choice.rows and not g.is_prior), None)
    if group is not None and not space:
        drawings.append(Drawing.of(_over_covariates(group, choice), "places", f"Where the chosen readings of "
                                   f"'{group.name}' stand (filled) among the candidates (open)."))
    return drawings


def _own_places(fit: Linearisation, group: Group) -> Array | None:
    """Places (n, 3) [m] of the readings of a group: of the point or pose, one of several, that each one sees."""
    found: Array | None = None
    for unknown in fit.layout.unknowns:
        lengths = all(units.dimension(unit) == "length" for unit in unknown.units[:3])
        if unknown.count < 2 or unknown.freedom not in (3, 6) or not lengths:
            continue
        begin, step = fit.layout.offset[unknown], unknown.freedom
        for part in group.parts:
            instance = (part.columns[:, 0] - begin) // step
            if part.columns.shape[1] == step and np.all((instance >= 0) & (instance < unknown.count)):
                place = fit.values[unknown][:, :3]      # a pose begins with its translation
                if len(np.unique(instance)) > 1 and (found is None or unknown.kind == "pose"):
                    found = np.asarray(place[instance])
    return found


def _in_space(choice: Choice, groups: Sequence[tuple[Group, Array]]) -> Figure:
    from matplotlib.ticker import MaxNLocator

    figure, flat = plots.canvas(4.2)
    flat.remove()
    axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d")
    axes.patch.set_alpha(0)
    everywhere = np.concatenate([place for _, place in groups])
    taken = np.concatenate([np.isin(g.rows, choice.rows[g.name]) for g, _ in groups])
    spots, which = np.unique(np.round(everywhere, 6), axis=0, return_inverse=True)
    count = np.bincount(which.ravel(), taken, len(spots))
    chosen = count > 0
    if not chosen.all():      # an empty cloud would widen the axes
        axes.scatter(*spots[~chosen].T, s=18, facecolors="none", edgecolors=plots.FAINT, linewidths=0.9,
                     depthshade=False)
    axes.scatter(*spots[chosen].T, s=24 * np.sqrt(count[chosen]), color=plots.ACCENT, linewidths=0, depthshade=False)
    for one in (axes.xaxis, axes.yaxis, axes.zaxis):
        one.pane.set_alpha(0)
        one.label.set_color(plots.INK)
    # The same scale along all axes, except along one in which all lie (nearly) at one height.
    span = np.ptp(spots, axis=0)
    span = np.maximum(span, 0.25 * span.max()) if span.max() > 0 else np.ones(3)
    middle = 0.5 * (spots.min(axis=0) + spots.max(axis=0))
    for k, name in enumerate("xyz"):
        getattr(axes, f"set_{name}lim")(middle[k] - 0.55 * span[k], middle[k] + 0.55 * span[k])
    axes.set_box_aspect(span, zoom=1.1)
    axes.view_init(elev=28, azim=-55)
    for name in "xyz":
        getattr(axes, f"set_{name}label")(f"{name} / m")
        getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(4))
    axes.tick_params(colors=plots.INK, labelcolor=plots.INK, labelsize=8)
    return figure


def _over_covariates(group: Group, choice: Choice) -> Figure:
    names, taken = _axes_of(group.covariates), np.isin(group.rows, choice.rows[group.name])
    figure, axes = plots.canvas(2.8, fitted=True)
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
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.margins(y=0.25)
    axes.tick_params(colors=plots.INK, labelcolor=plots.INK, labelsize=9)
    return figure


def _axes_of(covariates: Any) -> list[str]:
    varied = {name: np.asarray(values) for name, values in covariates.items() if len(np.unique(values)) > 1}
    numeric = sorted((n for n, v in varied.items() if v.dtype.kind == "f"), key=lambda n: -len(np.unique(varied[n])))
    kinds = [n for n, v in varied.items() if v.dtype.kind != "f" and len(np.unique(v)) <= 40]
    return [*numeric[:1], *kinds[:1]] if numeric else ["row", *kinds[:1]]
