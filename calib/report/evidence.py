"""What supports a result on its page: residuals, reliability, budgets, variance components, correlations."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from calib import units
from calib.report import numbers, plots
from calib.report.template import Drawing, Grid
from calib.workflow.solution import Solution

LISTED = 12             # names in a sentence
DRAWN_BUDGETS = 6
CORRELATED = 60         # results up to which a correlation map can be read
SUSPECTS = 8
ROUND = 1.96


def residual_groups(solution: Solution) -> Iterator[dict[str, Any]]:
    """Drawings of the residuals of each group: against the row, and against each covariate that varies."""
    reliability = solution.reliability
    for group in solution.fit.groups:
        chosen = reliability.of(group.name)
        if group.is_prior or not chosen.any():
            continue
        w, component = reliability.w[chosen], [str(name) for name in reliability.component[chosen]]
        rms = float(np.sqrt(np.mean((reliability.residual[chosen] / reliability.u[chosen]) ** 2)))
        caption = f"{group.name}: {chosen.sum()} scalar readings, rms of residual/u = {numbers.plain(rms, 3)}"
        if chosen.sum() > plots.DRAWN:
            caption += f"; one in {-(-len(w) // plots.DRAWN)} is drawn"
        others, drawn = [], []
        for name, values in group.covariates.items():
            if values.ndim != 1 or len(np.unique(values)) < 2:
                continue
            unit = group.covariate_units.get(name, "1")
            if values.dtype.kind in "iuf":
                values = np.asarray(values, float) / units.factor(_display(unit))
            label = name if unit == "1" else f"{name} / {_display(unit)}"
            figure = plots.residuals(np.repeat(values, len(group.components)), w, component, label)
            others.append(Drawing.of(figure, f"{group.name} {name}", f"{group.name} against {name}"))
            drawn.append(name)
        first = plots.residuals(reliability.row[chosen], w, component, "row of the data file")
        yield {"title": group.name, "first": Drawing.of(first, f"w {group.name}", caption), "others": others,
               "names": ", ".join(drawn)}


def _display(unit: str) -> str:
    """The unit a person plots in, for a unit that the engine computes in."""
    return {"rad": "deg", "m": "mm", "s": "min"}.get(unit, unit)


def suspects(solution: Solution) -> Grid | None:
    """The largest residuals that a careful person would look at; None where there is none."""
    reliability = solution.reliability
    order = np.argsort(-np.abs(reliability.w))[:SUSPECTS]
    rows = []
    for i in order:
        if abs(reliability.w[i]) < ROUND:
            break
        scale = units.factor(str(reliability.unit[i]))
        residual, u = numbers.with_uncertainty(reliability.residual[i] / scale, reliability.u[i] / scale)
        where = [str(reliability.group[i]), str(reliability.row[i]), str(reliability.component[i])]
        test = [numbers.plain(reliability.w[i], 3), numbers.probability(reliability.p_value[i])]
        rows.append([*where, residual, u, str(reliability.unit[i]), *test])
    header = ["group", "row", "component", "residual", "u", "unit", "w", "p"]
    return Grid(header, rows).without_empty() if rows else None


def redundancy(solution: Solution) -> Drawing:
    """Redundancy numbers of all readings."""
    reliability = solution.reliability
    figure = plots.redundancy(reliability.redundancy, [str(group) for group in reliability.group])
    total = numbers.plain(float(np.sum(reliability.redundancy)), 5)
    caption = (f"Redundancy numbers; they add up to the degrees of freedom, {total}. Below the dashed "
               "line a reading is weakly checked.")
    return Drawing.of(figure, "redundancy", caption)


def reliability_table(solution: Solution) -> Grid:
    """Redundancy and detectability by group and component."""
    reliability = solution.reliability
    rows = []
    for group in dict.fromkeys(reliability.group):
        for component in dict.fromkeys(reliability.component[reliability.of(group)]):
            chosen = reliability.of(group) & (reliability.component == component)
            unit = str(reliability.unit[chosen][0])
            mdb = reliability.mdb[chosen] / units.factor(unit)
            r = reliability.redundancy[chosen]
            rows.append([str(group), str(component), str(chosen.sum()), numbers.plain(float(r.mean()), 2),
                         numbers.plain(float(r.min()), 2), numbers.plain(float(np.median(mdb)), 3),
                         numbers.plain(float(mdb.max()), 3), unit])
    header = ["group", "component", "readings", "mean redundancy", "smallest", "median mdb", "largest mdb", "unit"]
    return Grid(header, rows).without_empty()


def budgets(solution: Solution) -> Iterator[dict[str, Any]]:
    """Drawings of the budgets that have more than one source; the rest share a sentence."""
    alone: dict[str, list[str]] = {}
    drawn = 0
    for one in solution.budgets:
        sources = one.contributions
        if len(sources) < 2:
            alone.setdefault(sources[0].label if sources else "nothing (it is fixed)", []).append(one.name)
            continue
        drawn += 1
        if drawn > DRAWN_BUDGETS:
            continue
        scale = units.factor(one.unit)
        shown = sources[:12]
        figure = plots.budget([line.label for line in shown], [line.u / scale for line in shown], one.unit)
        shares = ", ".join(f"{line.label} {100 * line.share:.0f} %" for line in shown[:4])
        yield {"title": f"{one.name}: u = {numbers.with_uncertainty(0.0, one.u / scale)[1]} {one.unit}", "sentence": "",
               "figure": Drawing.of(figure, f"budget {one.name}", f"Shares of the variance: {shares}")}
    for source, names in alone.items():
        listed = ", ".join(names[:LISTED]) + (" …" if len(names) > LISTED else "")
        yield {"title": "", "figure": None, "sentence": f"All of the uncertainty of {listed} comes from {source}."}
    if drawn > DRAWN_BUDGETS:
        yield {"title": "", "figure": None, "sentence": f"{drawn - DRAWN_BUDGETS} more budgets stand in result.json."}


def components(solution: Solution) -> Grid | None:
    """Variance components; None where they could not be estimated."""
    found = solution.components
    if found is None:
        return None
    rows = []
    for i, name in enumerate(found.names):
        scale = units.factor(found.unit[i])
        factor, u = numbers.with_uncertainty(float(found.factor[i]), float(found.u_factor[i]))
        rows.append([name, numbers.plain(found.stated_u[i] / scale, 3), found.unit[i], factor, u,
                     numbers.plain(float(found.dof[i]), 3)])
    return Grid(["group", "stated u", "unit", "factor", "u of factor", "degrees of freedom"], rows)


def correlation(solution: Solution) -> Drawing | None:
    """The correlation map; None for one result or too many."""
    results = solution.results
    if not 2 <= len(results.names) <= CORRELATED:
        return None
    return Drawing.of(plots.correlation(results.names, results.correlation), "correlation",
                      "Correlation coefficients: blue positive, orange negative, the deeper the nearer to one.")
