"""result.json: a solved job as numbers in the units named beside them, in full double precision."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from calib import files, units
from calib.analyse.covariance import Covariance
from calib.analyse.multiplicity import holm
from calib.analyse.reliability import Reliability
from calib.report import robust
from calib.report.provenance import Provenance
from calib.workflow.shown import parts_of, shown
from calib.workflow.solution import Solution

FORMAT = 1


def content(solution: Solution, provenance: Provenance) -> dict[str, Any]:
    """The content of result.json.

    solution: a solved job; provenance: of the run.
    return: a dictionary ready for JSON.
    """
    estimate = solution.estimate
    return {
        "format": FORMAT,
        "problem": solution.job.problem,
        "job": solution.job.path.name,
        "method": estimate.method,
        "converged": estimate.converged,
        "iterations": estimate.iterations,
        "message": estimate.message,
        "certificate": files.plain(estimate.certificate),
        "vtpv": estimate.objective,
        "dof": estimate.dof,
        # The squares that a robust loss leaves are no chi-squared number.
        "p_value": estimate.p_value if solution.robust is None else None,
        "variance_factor": estimate.variance_factor,
        **robust.content(solution),
        "unknowns": list(unknown_entries(solution)),
        "derived": list(_derived(solution)),
        "covariance": _covariance(solution.results),
        "variance_components": _components(solution),
        "estimability": {"defect": solution.estimability.defect, "directions": list(solution.estimability.directions),
                         "condition": solution.estimability.condition},
        "budgets": [_budget(one) for one in solution.budgets],
        "tolerances": [_conformity(one) for one in solution.conformities],
        "excluded": _excluded(solution),
        "heldout": files.plain(solution.heldout),
        "remarks": [*solution.remarks, *solution.weak],
        "advice": list(solution.advice),
        "tables": solution.tables,
        "certificate_data": dict(_dated(solution)),
        "provenance": provenance.content(),
    }


def reliability_rows(reliability: Reliability) -> Iterator[dict[str, Any]]:
    """Every scalar reading with its test, in the display unit of the reading.

    reliability: of a linearisation.
    return: dictionaries with the columns of observations.csv.
    """
    of_all = holm(reliability.p_value)
    for i in range(len(reliability)):
        unit = str(reliability.unit[i])
        scale = units.factor(unit)
        yield {
            "row": int(reliability.row[i]), "group": str(reliability.group[i]),
            "component": str(reliability.component[i]),
            "reading": reliability.reading[i] / scale, "predicted": reliability.predicted[i] / scale,
            "residual": reliability.residual[i] / scale, "unit": unit, "u": reliability.u[i] / scale,
            "w": reliability.w[i], "redundancy": reliability.redundancy[i], "mdb": reliability.mdb[i] / scale,
            "p_value": reliability.p_value[i], "p_value_of_all": of_all[i],
        }


def unknown_entries(solution: Solution) -> Iterator[dict[str, Any]]:
    for unknown in solution.problem.unknowns:
        values, u = shown(solution.fit, unknown, solution.u_of[unknown])
        held = solution.problem.is_held(unknown)
        for instance in range(unknown.count):
            repeats = unknown.count > 1 or unknown.named_keys
            key = unknown.keys[instance] if repeats else None
            name = key if unknown.name in solution.named_by_key else unknown.name
            for part in range(values.shape[1]):
                # A direction has two small angles and three components: it is held where both angles are.
                is_held = bool(held[instance].all() if values.shape[1] != unknown.freedom else held[instance, part])
                unit = "1" if unknown.kind == "direction" else unknown.units[part]
                scale = units.factor(unit)
                yield {
                    "name": name, "instance": None if name == key else key,
                    # The height of a point is its z, also where the points of a network have nothing else.
                    "part": None if values.shape[1] == 1 and name != key else parts_of(unknown)[part],
                    "value": None if is_held and unknown.label(instance, part) in solution.absent
                    else values[instance, part] / scale, "u": None if is_held else u[instance, part] / scale,
                    "unit": unit, "held": is_held,
                    **(_with_components(solution, unknown.label(instance, part)) if unknown.kind == "vector" else {}),
                }


def _derived(solution: Solution) -> Iterator[dict[str, Any]]:
    own = {label for unknown in solution.problem.unknowns for label in unknown.labels}
    for name, value, u, unit in solution.displayed:
        if name not in own:
            yield {"name": name, "value": value, "u": u, "unit": unit, **_with_components(solution, name)}


def _with_components(solution: Solution, name: str) -> dict[str, Any]:
    """The uncertainty by estimated variance components of one result, where there is one."""
    found = solution.results_vc
    if found is None or name not in found.names:
        return {}
    index = found.names.index(name)
    u_vc = found.u[index] / units.factor(found.units[index])
    if index >= len(solution.coverage):
        return {"u_vc": u_vc}
    return {"u_vc": u_vc, "dof_vc": solution.coverage[index].dof, "k_vc": solution.coverage[index].k}


def _covariance(results: Covariance) -> dict[str, Any]:
    scale = np.array([units.factor(unit) for unit in results.units])
    matrix = results.matrix / np.outer(scale, scale)
    return {"names": list(results.names), "units": list(results.units), "matrix": matrix}


def _components(solution: Solution) -> list[dict[str, Any]]:
    found = solution.components
    if found is None:
        return []
    return [
        {"group": found.names[i], "stated_u": found.stated_u[i] / units.factor(found.unit[i]), "unit": found.unit[i],
         "factor_of_u": found.factor[i], "u_of_factor": found.u_factor[i], "dof": found.dof[i],
         "redundancy": found.redundancy[i]}
        for i in range(len(found.names))
    ]


def _budget(one: Any) -> dict[str, Any]:
    scale = units.factor(one.unit)
    lines = [{"label": line.label, "u": line.u / scale, "share": line.share} for line in one.contributions]
    return {"quantity": one.name, "unit": one.unit, "u": one.u / scale, "contributions": lines}


def _conformity(one: Any) -> dict[str, Any]:
    scale = units.factor(one.unit)
    return {"quantity": one.quantity, "unit": one.unit, "value": one.value / scale, "u": one.u / scale,
            "lower": one.lower / scale, "upper": one.upper / scale, "probability": one.probability,
            "verdict": one.verdict}


def _excluded(solution: Solution) -> list[dict[str, Any]]:
    including: list[dict[str, Any]] = []
    if solution.including is not None:
        including = [{"name": name, "value": value, "u": u, "unit": unit}
                     for name, value, u, unit in solution.including.displayed]
    return [
        {"table": one.table, "rows": list(one.rows), "reason": one.reason, "including_them": including,
         "including_refused": solution.including_refused or None}
        for one in solution.job.exclude
    ]


def _dated(solution: Solution) -> Iterator[tuple[str, Any]]:
    for key, value in solution.job.certificate.items():
        yield key, value.isoformat() if hasattr(value, "isoformat") else value
