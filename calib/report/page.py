"""report.html of a solved job: the answer first, then everything that supports it or limits it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calib import files, units
from calib.report import evidence, numbers, robust
from calib.report import space as drawing
from calib.report.provenance import Provenance
from calib.report.result import unknown_entries
from calib.report.template import Cell, Grid, render
from calib.workflow.conformity import PASS, UNDECIDED
from calib.workflow.solution import Solution

ANSWERS = 12            # results in the answer; the table below holds all


def write(solution: Solution, provenance: Provenance, path: str | Path, compatibility: Grid | None = None,
          remark: str = "") -> Path:
    """Write report.html, whole or not at all.

    solution: a solved job; provenance: of the run; path: of the file; compatibility: with another result, and a remark.
    return: the path.
    raises InputError where it cannot be written.
    """
    return files.write_text(path, html(solution, provenance, compatibility, remark))


def html(solution: Solution, provenance: Provenance, compatibility: Grid | None = None, remark: str = "") -> str:
    """The page as text: self-contained, nothing is loaded from elsewhere.

    solution: a solved job; provenance: of the run; compatibility, remark: as for `write`.
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
        unstated=unstated(solution),
        advice=solution.advice,
        wild=robust.wild(solution),
        results=_results(solution),
        tolerances=_tolerances(solution),
        compatibility=compatibility if compatibility is not None and compatibility.rows else None,
        compatibility_remark=remark,
        excluded=[f"Table {one.table}, row {', '.join(map(str, one.rows))}: {one.reason}" for one in job.exclude],
        including=_including(solution),
        including_refused=solution.including_refused,
        heldout=_heldout(solution),
        space=drawing.space(solution.scene),
        script=drawing.marked(drawing.script()),
        script_hash=drawing.script_hash(),
        limits=[*solution.estimability.directions, *solution.remarks, *solution.weak, *_unchecked(solution)],
        residual_groups=list(evidence.residual_groups(solution)),
        suspects=evidence.suspects(solution),
        level=numbers.plain(solution.reliability.level),
        power=numbers.plain(solution.reliability.power),
        redundancy=evidence.redundancy(solution),
        reliability=evidence.reliability_table(solution),
        budgets=list(evidence.budgets(solution)),
        components=evidence.components(solution),
        components_refused=solution.components_refused,
        correlation=evidence.correlation(solution),
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
    return [(name, value, u, unit) for name, value, u, unit in solution.displayed
            if value is not None and u > 0 and np.isfinite(u)]


def unstated(solution: Solution) -> str:
    """The results that have no uncertainty, in a sentence; empty where every result has one.

    solution: a solved job.
    return: the sentence: without an uncertainty no value is stated.
    """
    names = [name for name, value, u, _ in solution.displayed if value is not None and not np.isfinite(u)]
    if not names:
        return ""
    return (f"Not stated, because no uncertainty follows for it: {', '.join(names)}. The result does not change "
            "smoothly with the readings here.")


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
    if solution.robust is not None:
        return robust.sentence(solution, solution.robust)
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
        fixed = value is not None and u == 0.0
        expanded = numbers.with_uncertainty(0.0, 2.0 * u)[1] or "–"
        row: list[str | Cell] = [name, shown, its_u or ("fixed" if fixed else "–"), expanded, unit]
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


def _heldout(solution: Solution) -> Grid | None:
    rows = [[one.quantity, numbers.plain(one.before), numbers.plain(one.after), one.unit] for one in solution.heldout]
    return Grid(["gap", "before", "after", "unit"], rows) if rows else None


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
    lines = provenance.lines(
        ("method", f"{estimate.method}: {estimate.message}; {estimate.iterations} iterations"),
        ("certificate", f"{certificate.why}; remaining step {stationarity}"),
    )
    lines += [(f"{key} (of the job)", str(value)) for key, value in solution.job.certificate.items()]
    return lines
