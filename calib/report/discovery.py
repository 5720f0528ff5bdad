"""report.html of a discovery: the sentence first, then where the model disagrees, what explains it, and the proof."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calib import files, units
from calib.report import numbers, plots
from calib.report.provenance import Provenance
from calib.report.template import Cell, Drawing, Grid, render
from calib.workflow.discrepancy.answer import in_case_units
from calib.workflow.discrepancy.conclusion import Explanation
from calib.workflow.discrepancy.picture import Picture, Separation, pictures, separation
from calib.workflow.discrepancy.shown import Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RANKED = 14  # candidates in the ranking
DRAWN = 2  # channels whose residuals are drawn, or as many as effects were named
FEW = 6  # values of a covariate that are marked one by one
LISTED = 30  # rows of a table that somebody reads


def write(
    case: str, shown: Shown, provenance: Provenance, path: str | Path, more: Mapping[str, Any] | None = None
) -> Path:
    """Write report.html, whole or not at all.

    case: its name; shown: the explanation with what is shown of it; provenance: of the run; path: of the file; more:
    what was added beforehand or kept afterwards, as in answer.json (`added`, `heldout`, `empirical`).
    Returns the path.
    """
    return files.write_text(path, html(case, shown, provenance, more or {}))


def html(case: str, shown: Shown, provenance: Provenance, more: Mapping[str, Any]) -> str:
    """The page as text; arguments as for `write`."""
    found = shown.found
    added, kept = more.get("added"), more.get("empirical")
    return render(
        "discovery.html.j2",
        title=case,
        subtitle=f"{found.before.problem.name}: what the model lacks",
        sentence=found.sentence,
        verdict=found.verdict.replace("-", " "),
        good=found.verdict == "consistent",
        next_measurement=found.next_measurement,
        effects=_effects(found),
        added=added and _values(added["values"]),
        steps=added and Grid(["added", "rms of r/u on blocks left out"],
                             [[one["name"], numbers.plain(one["rms"], 4)] for one in added["steps"]]),
        left_out=added and Grid(["blocks left out", "before", "after", "unit"],
                                [[one["quantity"], numbers.plain(one["before"], 4), numbers.plain(one["after"], 4),
                                  one["unit"]] for one in more["heldout"]]),
        kept=kept and _values(kept["parameters"]),
        kept_gap=kept and f"With it: {_rms(kept)}.",
        held_out=found.heldout_rms is not None,
        gap=_gap(shown),
        results=_results(shown),
        drawings=[Drawing.of(_before_and_after(one), f"gap {i}", one.caption)
                  for i, one in enumerate(pictures(shown, max(DRAWN, len(found.effects))))],
        ranking=_ranking(found),
        alias_map=_alias_map(separation(shown)),
        detectable=_detectable(shown),
        where=_places(found.where),
        structure=_places(found.structure),
        noise=Grid(["look", "where", "figure", "p"], [[t.what, t.where, numbers.plain(t.figure, 3),
                   numbers.probability(t.p_value)] for t in found.noise]) if found.noise else None,
        hidden=_hidden(found),
        remarks=found.remarks,
        provenance=provenance.lines(),
    )


def _effects(found: Explanation) -> Grid | None:
    rows: list[list[str | Cell]] = []
    for one in found.effects:
        alias = ", ".join(f"{name} ({channel})" for name, channel in one.aliases) or "none"
        for name, (value, u, unit) in in_case_units(one).items():
            shown, its_u = numbers.with_uncertainty(value, u)
            rows.append([f"{one.name} ({one.channel})", name, shown, its_u, unit, numbers.probability(one.p_value),
                         alias, Cell(one.plausibility, "prose") if one.plausibility else ""])
    header = ["effect", "parameter", "value", "u", "unit", "p(absent)", "cannot be told from", "size"]
    return Grid(header, rows).without_empty() if rows else None


def _values(parameters: Sequence[Mapping[str, Any]]) -> Grid:
    """Parameters as they stand in answer.json."""
    return Grid(["parameter", "value", "u", "unit"], [[one["name"], *numbers.with_uncertainty(one["value"], one["u"]),
                                                       one["unit"]] for one in parameters])


def _rms(kept: Mapping[str, Any]) -> str:
    held = kept["heldout_rms"]
    text = f"rms of r/u {numbers.plain(kept['rms'], 4)}"
    return text if held is None else f"{text}, on held-out readings {numbers.plain(held['after'], 4)}"


def _gap(shown: Shown) -> Grid:
    """The gap of all readings, then of every part: root mean square, variance factor, held-out readings."""
    found = shown.found
    rows = [_gap_row("all readings", sum(g.readings for g in shown.gaps), found.rms, shown.variance_factor,
                     found.heldout_rms)]
    if len(shown.gaps) > 1:
        rows += [_gap_row(g.group, g.readings, g.rms, g.variance_factor, g.heldout) for g in shown.gaps[:LISTED]]
    names = ("rms of r/u", "variance factor", "rms on held-out readings")
    if found.after is found.before:
        return Grid(["", "readings", *names], [row[:3] + row[4:5] + row[6:7] for row in rows]).without_empty()
    return Grid(["", "readings", *(text for name in names for text in (f"{name} before", "after"))],
                rows).without_empty()


def _gap_row(name: str, readings: int, *pairs: tuple[float, float] | None) -> list[str]:
    return [name, str(readings), *("" if one is None else numbers.plain(one, 4)
                                   for pair in pairs for one in pair or (None, None))]


def _results(shown: Shown) -> Grid | None:
    """What the discovery does to the results: value and u before and after."""
    rows = []
    for one in shown.results[:LISTED]:
        pair = [numbers.with_uncertainty(*both) for both in (one.before, one.after)]
        moved = f"{one.in_u:+.2f}".replace("-", numbers.MINUS)
        rows.append([one.name, *pair[0], *pair[1], "" if one.unit == "1" else one.unit, moved])
    header = ["result", "before", "u", "after", "u", "unit", "moved by, in u"]
    return Grid(header, rows) if rows else None


def _detectable(shown: Shown) -> Grid | None:
    """How large each effect would have to be to show, those first that could hide at a usual size."""
    rows: list[list[str | Cell]] = []
    order = sorted(shown.detectable, key=lambda one: one.size / one.usual[1], reverse=True)
    for one in order[:LISTED]:
        verdict = Cell("never", "warning") if not np.isfinite(one.size) else \
            Cell("only where larger than usual", "warning") if one.size > one.usual[1] else Cell("yes", "good")
        rows.append([one.effect, one.parameter, numbers.plain(one.size, 2),
                     f"{numbers.plain(one.usual[0], 2)} to {numbers.plain(one.usual[1], 2)}", one.unit, verdict])
    return Grid(["effect", "parameter", "shows from", "usual", "unit", "would be found"], rows) if rows else None


def _before_and_after(one: Picture) -> Figure:
    from matplotlib.figure import Figure

    height = 2.9
    figure = Figure(figsize=(plots.WIDTH, height))
    figure.subplots_adjust(left=0.74 / plots.WIDTH, right=1 - 0.08 / plots.WIDTH, bottom=0.48 / height,
                           top=1 - 0.26 / height)
    panels = [(one.before, "before"), (one.after, "after")]
    if np.array_equal(one.before, one.after):
        panels = [(one.before, "as the nominal model leaves them")]
    axes = np.atleast_1d(figure.subplots(1, len(panels), sharey=True))
    for ax, (residual, title) in zip(axes, panels, strict=True):
        plots.style(ax)
        ax.axhspan(-1.96, 1.96, color=plots.FAINT, alpha=0.25, linewidth=0)
        step = max(1, -(-len(one.x) // plots.DRAWN))
        for number, key in enumerate(dict.fromkeys(one.keys)):
            chosen = np.flatnonzero(one.keys == key)[::step]
            ax.scatter(one.x[chosen], residual[chosen], s=14, linewidths=0, alpha=0.85,
                       color=plots.SERIES[number % len(plots.SERIES)],
                       label=plots.worded(f"{one.key_label.replace('_', ' ')} {key}"))
        ax.set_title(title, loc="left")
        ax.set_xlabel(plots.worded(one.label))
        levels = np.unique(one.x)
        if len(levels) <= FEW:
            ax.set_xticks(levels)
            ax.set_xlim(levels[0] - 0.25 * np.ptp(levels), levels[-1] + 0.25 * np.ptp(levels))
    axes[0].set_ylabel("residual / u")
    reach = 1.08 * max(3.0, float(np.max(np.abs(one.before))))
    for ax in axes:
        ax.set_ylim(-reach, reach)
    if 1 < len(set(one.keys.tolist())) <= 4:
        axes[-1].legend(frameon=False, labelcolor=plots.INK, fontsize=8, ncols=4, loc="lower right",
                       bbox_to_anchor=(1, 1), borderaxespad=0, columnspacing=0.7, handletextpad=0.1)
    return figure


def _ranking(found: Explanation) -> Drawing | None:
    shown = [r for r in found.ranking if r.dof][:RANKED]
    if not shown:
        return None
    named = {f"{e.name} ({e.channel})" for e in found.effects}
    figure, axes = plots.canvas(0.8 + 0.24 * len(shown))
    labels = [plots.worded(f"{r.label}, {r.dof} parameter{'s' if r.dof > 1 else ''}") for r in shown]
    # Margins from the longest label: a fitted canvas lays everything out twice, which is most of the page's time.
    figure.subplots_adjust(left=min(0.6, (0.25 + 0.077 * max(map(len, labels))) / plots.WIDTH),
                           right=1 - 0.25 / plots.WIDTH)
    colours = [plots.WARNING if r.label in named else plots.ACCENT for r in shown]
    drops = [max(r.drop, 1e-2) for r in shown]
    axes.barh(range(len(shown)), drops, color=colours, height=0.62)
    axes.set_yticks(range(len(shown)), labels)
    axes.invert_yaxis()
    axes.set_xscale("log")
    low, high = int(np.floor(np.log10(min(drops)))), int(np.ceil(np.log10(max(drops)) + 1e-9))
    axes.set_xlim(10.0**low, 10.0**max(high, low + 1))
    powers = range(low, max(high, low + 1) + 1)
    axes.set_xticks([10.0**k for k in powers], [numbers.ten_to(k) for k in powers])  # as text: formulas are slow
    axes.minorticks_off()
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
    for h in found.hidden[:LISTED]:
        rows.append([h.effect, h.quantity, numbers.plain(h.u_added / units.factor(h.unit), 3), h.unit])
    return Grid(["effect", "result", "u it could add", "unit"], rows) if rows else None
