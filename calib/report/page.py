"""report.html of a solved job: the answer first, then everything that supports it or limits it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from calib import files, units
from calib.report import numbers, plots
from calib.report.provenance import Provenance
from calib.report.result import unknown_entries
from calib.report.template import Cell, Drawing, Grid, render
from calib.workflow.conformity import PASS, UNDECIDED
from calib.workflow.solution import Solution

ANSWERS = 12            # results in the answer; the table below holds all
DRAWN_BUDGETS = 6
CORRELATED = 16         # results up to which a correlation map can be read
SUSPECTS = 8
ROUND = 1.96


def write(solution: Solution, provenance: Provenance, path: str | Path) -> Path:
    """Write report.html, whole or not at all.

    solution: a solved job; provenance: of the run; path: of the file.
    return: the path.
    raises InputError where it cannot be written.
    """
    return files.write_text(path, html(solution, provenance))


def html(solution: Solution, provenance: Provenance) -> str:
    """The page as text: self-contained, nothing is loaded from elsewhere.

    solution: a solved job; provenance: of the run.
    return: the HTML document.
    """
    certificate = solution.estimate.certificate
    job = solution.job
    return render(
        "solution.html.j2",
        title=f"{solution.problem.name}",
        subtitle=f"{job.path.name} of {job.path.resolve().parent.name}, solved by {solution.estimate.method}",
        passed=certificate.passed and solution.estimate.converged,
        why=certificate.why if solution.estimate.converged else solution.estimate.message,
        answers=list(_answers(solution)),
        coverage=_coverage(solution),
        agreement=agreement(solution),
        advice=solution.advice,
        results=_results(solution),
        tolerances=_tolerances(solution),
        excluded=[f"Table {one.table}, row {', '.join(map(str, one.rows))}: {one.reason}" for one in job.exclude],
        including=_including(solution),
        including_refused=solution.including_refused,
        limits=[*solution.estimability.directions, *solution.remarks, *solution.weak, *_unchecked(solution)],
        residual_groups=list(_residual_groups(solution)),
        suspects=_suspects(solution),
        level=numbers.plain(solution.reliability.level),
        power=numbers.plain(solution.reliability.power),
        redundancy=_redundancy(solution),
        reliability=_reliability(solution),
        budgets=list(_budgets(solution)),
        components=_components(solution),
        components_refused=solution.components_refused,
        correlation=_correlation(solution),
        unknowns=_unknowns(solution, held=False),
        held=_unknowns(solution, held=True),
        provenance=_provenance(provenance, solution),
    )


def _answers(solution: Solution) -> Iterator[dict[str, str]]:
    verdicts = {one.quantity: one for one in solution.conformities}
    for name, value, u, unit in told(solution)[:ANSWERS]:
        shown, expanded = numbers.with_uncertainty(value, 2.0 * u)
        text = f"{shown} ± {expanded} {unit}" if expanded else f"{shown} {unit} (fixed)"
        judged = verdicts.get(name)
        style = "" if judged is None else "good" if judged.verdict == PASS else "warning"
        verdict = judged.verdict if judged else ""
        yield {"name": name, "value": text.removesuffix(" 1"), "verdict": verdict, "style": style}


def told(solution: Solution) -> list[tuple[str, float, float, str]]:
    """(name, value, u, unit) of the results a person is told: not what is held, nor the small angles of a direction."""
    return [(name, value, u, unit) for name, value, u, unit in solution.displayed if value is not None and u > 0]


def _coverage(solution: Solution) -> str:
    left = len(told(solution)) - ANSWERS
    more = f" {left} more results stand in the table below." if left > 0 else ""
    return f"Expanded uncertainty, k = 2 (about 95 %), from the stated uncertainties of readings and priors.{more}"


def agreement(solution: Solution) -> str:
    """Whether the readings agree with the model and the stated uncertainties, in one sentence.

    solution: a solved job.
    return: the sentence.
    """
    estimate = solution.estimate
    if estimate.dof <= 0:
        return "There are no more readings than unknowns: nothing checks the model or the stated uncertainties."
    probability = estimate.p_value or 0.0
    facts = (f"v′Pv = {numbers.plain(estimate.objective)} for {estimate.dof} degrees of freedom, "
             f"p = {numbers.probability(estimate.p_value)}")
    if probability < 0.01:
        return (f"The readings scatter more than the model and the stated uncertainties explain ({facts}): the "
                "model lacks something, or an uncertainty was stated too small, which the results above do not cover.")
    if probability > 0.99:
        return (f"The readings scatter less than stated ({facts}): an uncertainty was stated too large, or readings "
                "are not independent.")
    return f"The readings agree with the model and the stated uncertainties ({facts})."


def _results(solution: Solution) -> Grid:
    found = solution.results_vc
    header = ["result", "value", "u", "U (k = 2)", "unit"]
    if found is not None:
        header[4:4] = ["u(vc)", "k(vc)"]
    rows = []
    for index, (name, value, u, unit) in enumerate(solution.displayed):
        shown, its_u = numbers.with_uncertainty(value, u)
        row: list[str | Cell] = [name, shown, its_u or "–", numbers.with_uncertainty(0.0, 2.0 * u)[1] or "–", unit]
        if found is not None:
            k = numbers.plain(solution.coverage[index].k, 3) if index < len(solution.coverage) else "–"
            u_vc = found.u[index] / units.factor(unit)
            row[4:4] = [numbers.with_uncertainty(0.0, u_vc)[1] or "–", k]
        rows.append(row)
    return Grid(header, rows)


def _tolerances(solution: Solution) -> Grid | None:
    rows: list[list[str | Cell]] = []
    for one in solution.conformities:
        scale = units.factor(one.unit)
        shown, u = numbers.with_uncertainty(one.value / scale, one.u / scale)
        style = "good" if one.verdict == PASS else "warning"
        limits = [numbers.plain(one.lower / scale, 6), numbers.plain(one.upper / scale, 6)]
        note = " (a smaller u would decide)" if one.verdict == UNDECIDED else ""
        rows.append([one.quantity, *limits, shown, u, one.unit, numbers.probability(one.probability),
                     Cell(one.verdict + note, style)])
    return Grid(["result", "lower", "upper", "value", "u", "unit", "p(conform)", "verdict"], rows) if rows else None


def _including(solution: Solution) -> Grid | None:
    if solution.including is None:
        return None
    rows = []
    for (name, value, u, unit), (_, whole, whole_u, _) in zip(solution.displayed, solution.including.displayed):
        rows.append([name, *numbers.with_uncertainty(value, u), *numbers.with_uncertainty(whole, whole_u), unit])
    return Grid(["result", "without them", "u", "with them", "u", "unit"], rows)


def _unchecked(solution: Solution) -> Iterator[str]:
    """Readings that no other controls, in words."""
    reliability = solution.reliability
    priors = {group.name for group in solution.fit.groups if group.is_prior}
    for group in dict.fromkeys(reliability.group):
        alone = np.flatnonzero(reliability.of(group) & np.isinf(reliability.mdb))
        if len(alone) and group not in priors:
            rows = ", ".join(str(row) for row in dict.fromkeys(reliability.row[alone[:10]]))
            rows += " …" if len(alone) > 10 else ""
            yield f"No other reading checks row {rows} of {group}: an error there goes into the results unseen."


def _residual_groups(solution: Solution) -> Iterator[dict[str, Any]]:
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
        others = []
        for name, values in group.covariates.items():
            if values.dtype.kind not in "iuf" or values.ndim != 1 or len(np.unique(values)) < 3:
                continue
            unit = group.covariate_units.get(name, "1")
            shown = np.repeat(np.asarray(values, float) / units.factor(_display(unit)), len(group.components))
            label = name if unit == "1" else f"{name} / {_display(unit)}"
            figure = plots.residuals(shown, w, component, label)
            others.append(Drawing.of(figure, f"{group.name} {name}", f"{group.name} against {name}"))
        first = plots.residuals(reliability.row[chosen], w, component, "row of the data file")
        yield {"title": group.name, "first": Drawing.of(first, f"w {group.name}", caption), "others": others,
               "names": ", ".join(name for name in group.covariates if any(name in one.caption for one in others))}


def _display(unit: str) -> str:
    """The unit a person plots in, for a unit that the engine computes in."""
    return {"rad": "deg", "m": "mm", "s": "min"}.get(unit, unit)


def _suspects(solution: Solution) -> Grid | None:
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


def _redundancy(solution: Solution) -> Drawing:
    reliability = solution.reliability
    figure = plots.redundancy(reliability.redundancy, [str(group) for group in reliability.group])
    total = numbers.plain(float(np.sum(reliability.redundancy)), 5)
    caption = (f"Redundancy numbers; they add up to the degrees of freedom, {total}. Below the dashed "
               "line a reading is weakly checked.")
    return Drawing.of(figure, "redundancy", caption)


def _reliability(solution: Solution) -> Grid:
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


def _budgets(solution: Solution) -> Iterator[dict[str, Any]]:
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
        listed = ", ".join(names[:ANSWERS]) + (" …" if len(names) > ANSWERS else "")
        yield {"title": "", "figure": None, "sentence": f"All of the uncertainty of {listed} comes from {source}."}
    if drawn > DRAWN_BUDGETS:
        yield {"title": "", "figure": None, "sentence": f"{drawn - DRAWN_BUDGETS} more budgets stand in result.json."}


def _components(solution: Solution) -> Grid | None:
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


def _correlation(solution: Solution) -> Drawing | None:
    results = solution.results
    if not 2 <= len(results.names) <= CORRELATED:
        return None
    return Drawing.of(plots.correlation(results.names, results.correlation), "correlation", "Correlation coefficients")


def _unknowns(solution: Solution, held: bool) -> Grid:
    rows = []
    for entry in unknown_entries(solution):
        if entry["held"] != held:
            continue
        shown, u = numbers.with_uncertainty(entry["value"], entry["u"])
        part = "" if entry["part"] is None else entry["part"]
        rows.append([entry["name"], entry["instance"] or "", part, shown, u or "–", entry["unit"]])
    return Grid(["unknown", "instance", "part", "value", "u", "unit"], rows).without_empty()


def _provenance(provenance: Provenance, solution: Solution) -> list[tuple[str, str]]:
    estimate, certificate = solution.estimate, solution.estimate.certificate
    stationarity = "–" if certificate.stationarity is None else f"{certificate.stationarity:.1e} of u"
    lines = [
        ("command", provenance.command),
        ("version", provenance.version),
        ("method", f"{estimate.method}: {estimate.message}; {estimate.iterations} iterations"),
        ("certificate", f"{certificate.why}; remaining step {stationarity}"),
        ("python", provenance.python),
        ("libraries", ", ".join(f"{name} {version}" for name, version in provenance.libraries.items())),
        *((f"sha256 of {name}", digest) for name, digest in provenance.data.items()),
        ("seed", "none" if provenance.seed is None else str(provenance.seed)),
    ]
    lines += [(f"{key} (of the job)", str(value)) for key, value in solution.job.certificate.items()]
    return lines
