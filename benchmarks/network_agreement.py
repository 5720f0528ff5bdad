"""The table of docs/networks.md: every network of GNU Gama under CALIB_REFERENCE_DATA, adjusted and compared.

Usage: python benchmarks/network_agreement.py [NETWORK.gkf ...], each with Gama's adjustment NETWORK.xml beside it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import network_reference

from calib import Linearisation, Problem, covariance, linearise, reliability, solve
from calib.errors import InputError
from problems.network import checked, declare, positions, read_gkf, settle, tolerable

HEADER = ("network", "readings", "dof", "defect", "coordinates [m]", "u", "u at Gama's point", "f",
          "f of whitened rows", "factor", "largest u", "u a posteriori", "v'Pv", "v'Pv at Gama's coordinates")


def row(path: Path) -> tuple[str, ...]:
    """One line: largest difference of coordinates, relative differences of u at the estimate and at Gama's last
    approximate coordinates, difference of f = 100 (1 - sqrt(1 - r)) and of what Gama takes for it where readings are
    correlated, Gama's factor, the largest u without and with it, and v'Pv at the estimate and, with circles turned to
    fit, at the coordinates that Gama prints."""
    printed = network_reference.adjustment(path)
    try:
        survey = settle(tolerable(positions(checked(read_gkf(path)))))
    except InputError as error:
        return (path.stem, f"refused: {error.sentence[:80]}", *[""] * (len(HEADER) - 2))
    estimate = solve(declare(survey))
    fit = linearise(estimate)
    point = next(u for u in fit.layout.unknowns if u.name == "point")
    values = np.reshape(estimate[point], (point.count, -1))
    places = [{key: np.array(one.position) for key, one in survey.points.items()} for _ in range(2)]
    for place, theirs in zip(places, (printed.approximate, printed.values), strict=True):
        for (key, part), value in theirs.items():
            place[key]["xyz".index(part)] = value
    apart = max(abs(values[point.keys.index(k), point.parts.index(p)] - v) for (k, p), v in printed.values.items())
    tests = reliability(fit)
    order = np.argsort(tests.row, kind="stable")
    u = covariance(fit, point).u
    return (
        path.stem, str(len(tests)), f"{estimate.dof} / {printed.dof}", str(printed.defect), f"{apart:.0e}",
        _ratio(fit, printed), _ratio(linearise(declare(survey.placed(places[0]))), printed),
        _control(tests.redundancy[order], printed.f), _control(_whitened_redundancy(fit)[order], printed.f),
        f"{printed.factor:.4g}", f"{u.max() * 1e3:.4g} mm",
        f"{u.max() * np.sqrt(estimate.variance_factor) * 1e3:.4g} mm",
        f"{estimate.objective:.8g}", f"{_fitted(declare(survey.placed(places[1]))):.8g}",
    )


def _control(redundancy: np.ndarray, theirs: np.ndarray) -> str:
    if len(redundancy) != len(theirs):
        return f"{len(redundancy)} / {len(theirs)} readings"
    return f"{np.abs(100.0 * (1.0 - np.sqrt(np.clip(1.0 - redundancy, 0.0, 1.0))) - theirs).max():.4f}"


def _whitened_redundancy(fit: Linearisation) -> np.ndarray:
    """One less the leverage of each whitened row (N,), in the order of the readings: what Gama computes f from. Where
    readings are correlated it depends on their order; its source says that this is missing."""
    found = []
    for group in fit.groups:
        control = np.empty(group.residual.shape)
        for block in group.whitened:
            rows = block.dense(fit.layout.position, len(fit.layout.free_columns))
            leverage = np.einsum("ij,ji->i", rows, fit.factor.solve(rows.T))
            control[block.rows] = 1.0 - leverage.reshape(*block.rows.shape, -1)
        found.append(control.ravel())
    return np.concatenate(found)


def _fitted(problem: Problem) -> float:
    """v'Pv where all points stand where they start, circles turned to fit."""
    points = next(u for u in problem.unknowns if u.name == "point")
    held = Problem(problem.observations, name=problem.name).hold(points)
    free = [u for u in held.unknowns if not held.is_held(u).all()]
    return solve(held).objective if free else linearise(held).objective


def _ratio(fit, printed) -> str:  # type: ignore[no-untyped-def]
    point = next(u for u in fit.layout.unknowns if u.name == "point")
    u = covariance(fit, point).u.reshape(point.count, -1)
    worst = [abs(u[point.keys.index(k), point.parts.index(p)] / v - 1) for (k, p), v in printed.u.items()]
    return f"{max(worst):.0e}" if worst else "Gama prints 0"


def main() -> None:
    """Write the table to standard output."""
    networks = [Path(name) for name in sys.argv[1:]] or network_reference.NETWORKS
    for line in (HEADER, ("---",) * len(HEADER), *(row(path) for path in networks)):
        sys.stdout.write("| " + " | ".join(line) + " |\n")


if __name__ == "__main__":
    main()
