"""report.html of a discovery: the sentence first, then where the model disagrees, what explains it, and the proof."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib import files, units
from calib.report import numbers, plots
from calib.report.provenance import Provenance
from calib.report.template import Drawing, Grid, render
from calib.workflow.discrepancy.answer import in_case_units
from calib.workflow.discrepancy.conclusion import Explanation
from calib.workflow.discrepancy.picture import Picture, Separation, pictures, separation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RANKED = 14  # candidates in the ranking
DRAWN = 2  # channels whose residuals are drawn


def write(case: str, found: Explanation, provenance: Provenance, path: str | Path) -> Path:
    """Write report.html, whole or not at all.

    case: its name; found: the explanation; provenance: of the run; path: of the file. Returns the path.
    """
    return files.write_text(path, html(case, found, provenance))


def html(case: str, found: Explanation, provenance: Provenance) -> str:
    """The page as text; arguments as for `write`."""
    return render(
        "discovery.html.j2",
        title=case,
        subtitle=f"{found.before.problem.name}: what the model lacks",
        sentence=found.sentence,
        verdict=found.verdict.replace("-", " "),
        good=found.verdict == "consistent",
        next_measurement=found.next_measurement,
        effects=_effects(found),
        gap=_gap(found),
        results=_results(found),
        drawings=[Drawing.of(_before_and_after(one), f"gap {i}", one.caption)
                  for i, one in enumerate(pictures(found, DRAWN))],
        ranking=_ranking(found),
        alias_map=_alias_map(separation(found)),
        where=_places(found.where),
        structure=_places(found.structure),
        noise=Grid(["look", "where", "figure", "p"], [[t.what, t.where, numbers.plain(t.figure, 3),
                   numbers.probability(t.p_value)] for t in found.noise]) if found.noise else None,
        hidden=_hidden(found),
        remarks=found.remarks,
        provenance=provenance.lines(),
    )


def _effects(found: Explanation) -> Grid | None:
    rows = []
    for one in found.effects:
        alias = ", ".join(f"{name} ({channel})" for name, channel in one.aliases) or "none"
        for name, (value, u, unit) in in_case_units(one).items():
            shown, its_u = numbers.with_uncertainty(value, u)
            rows.append([f"{one.name} ({one.channel})", name, shown, its_u, unit, numbers.probability(one.p_value),
                         alias, one.plausibility])
    header = ["effect", "parameter", "value", "u", "unit", "p(absent)", "cannot be told from", "size"]
    return Grid(header, rows).without_empty() if rows else None


def _gap(found: Explanation) -> Grid:
    rows = [["all rows", numbers.plain(found.rms[0], 4), numbers.plain(found.rms[1], 4)]]
    if found.heldout_rms is not None:
        rows.append(["held-out rows", *(numbers.plain(r, 4) for r in found.heldout_rms)])
    for name in found.before.residuals:
        pair = [_group_rms(estimate, name) for estimate in (found.before, found.after)]
        if len(found.before.residuals) > 1 and None not in pair:
            rows.append([name, *(numbers.plain(p, 4) for p in pair if p is not None)])
    return Grid(["root mean square of residual/u", "before", "after"], rows)


def _group_rms(estimate: object, name: str) -> float | None:
    from calib.linearisation import linearise

    groups = {g.name: g for g in linearise(estimate).groups}
    if name not in groups or not groups[name].size:
        return None
    return float(np.sqrt(groups[name].objective / groups[name].size))


def _results(found: Explanation) -> Grid | None:
    """What the discovery does to the results: value and u before and after."""
    if found.after is found.before:
        return None
    from calib.analyse.covariance import covariance
    from calib.linearisation import linearise

    free = [u for u in found.before.problem.unknowns if not found.before.problem.is_held(u).all() and u.count <= 6]
    first = covariance(linearise(found.before), *found.before.problem.quantities, *free)
    second = covariance(linearise(found.after), *found.before.problem.quantities, *free)
    rows = []
    for i, (name, unit) in enumerate(zip(first.names, first.units, strict=True)):
        scale = units.factor(unit)
        pair = [numbers.with_uncertainty(c.values[i] / scale, c.u[i] / scale) for c in (first, second)]
        moved = (second.values[i] - first.values[i]) / first.u[i] if first.u[i] > 0 else 0.0
        rows.append([name, *pair[0], *pair[1], "" if unit == "1" else unit, numbers.plain(moved, 2)])
    header = ["result", "before", "u", "after", "u", "unit", "moved by, in u"]
    return Grid(header, rows) if rows else None


def _before_and_after(one: Picture) -> Figure:
    figure, whole = plots.canvas(2.9)
    whole.remove()
    axes = figure.subplots(1, 2, sharey=True)
    for ax, residual, title in zip(axes, (one.before, one.after), ("before", "after"), strict=True):
        plots.style(ax)
        ax.axhspan(-1.96, 1.96, color=plots.FAINT, alpha=0.25, linewidth=0)
        for number, key in enumerate(dict.fromkeys(one.keys)):
            chosen = one.keys == key
            ax.scatter(one.x[chosen], residual[chosen], s=14, linewidths=0, alpha=0.85,
                       color=plots.SERIES[number % len(plots.SERIES)],
                       label=f"{one.key_label.replace('_', ' ')} {key}")
        ax.set_title(title, loc="left")
        ax.set_xlabel(one.label)
    axes[0].set_ylabel("residual / u")
    reach = 1.08 * max(3.0, float(np.max(np.abs(one.before))))
    for ax in axes:
        ax.set_ylim(-reach, reach)
    if 1 < len(set(one.keys.tolist())) <= 4:
        axes[1].legend(frameon=False, labelcolor=plots.INK, fontsize=8, ncols=4, loc="lower right",
                       bbox_to_anchor=(1, 1), borderaxespad=0, columnspacing=0.7, handletextpad=0.1)
    return figure


def _ranking(found: Explanation) -> Drawing | None:
    shown = [r for r in found.ranking if r.dof][:RANKED]
    if not shown:
        return None
    named = {f"{e.name} ({e.channel})" for e in found.effects}
    figure, axes = plots.canvas(0.8 + 0.24 * len(shown), fitted=True)
    colours = [plots.WARNING if r.label in named else plots.ACCENT for r in shown]
    axes.barh(range(len(shown)), [max(r.drop, 1e-2) for r in shown], color=colours, height=0.62)
    axes.set_yticks(range(len(shown)), [f"{r.label}, {r.dof} parameter(s)" for r in shown])
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlabel("drop of v′Pv that this candidate alone would give")
    unseen = sum(1 for r in found.ranking if not r.dof)
    caption = "Ranking of the candidates; what was named is marked."
    if unseen:
        caption += f" {unseen} further candidate(s) cannot be seen in these readings."
    return Drawing.of(figure, "ranking", caption)


def _alias_map(one: Separation | None) -> Drawing | None:
    if one is None:
        return None
    return Drawing.of(plots.correlation(one.labels, one.matrix), "alias map",
                      "Alias map: how much of one candidate's signal, after the unknowns took their part, another can "
                      "imitate. At 1.00 these readings cannot tell the two apart.")


def _places(places: tuple) -> Grid | None:  # type: ignore[type-arg]
    rows = [[p.channel, p.covariate.replace("_", " "), p.shape,
             ", ".join(f"{k.replace('_', ' ')} {numbers.plain(v, 3)}" for k, v in p.figures.items()),
             numbers.probability(p.p_value)] for p in places]
    return Grid(["channel", "against", "shape", "figures", "p"], rows).without_empty() if rows else None


def _hidden(found: Explanation) -> Grid | None:
    rows = []
    for h in found.hidden[:30]:
        rows.append([h.effect, h.quantity, numbers.plain(h.u_added / units.factor(h.unit), 3), h.unit])
    return Grid(["effect", "result", "u it could add", "unit"], rows) if rows else None
