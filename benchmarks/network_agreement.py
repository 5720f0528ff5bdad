"""The table of docs/networks.md: every network of GNU Gama under CALIB_REFERENCE_DATA, adjusted and compared."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import network_reference

from calib import covariance, linearise, reliability, solve
from problems.network import declare, positions, read_gkf, settle

HEADER = ("network", "readings", "dof", "defect", "coordinates [m]", "u", "u at Gama's point", "f", "factor",
          "largest u", "u a posteriori")


def row(path: Path) -> tuple[str, ...]:
    """One line: largest difference of coordinates, relative differences of u at the estimate and at Gama's last
    approximate coordinates, difference of f = 100 (1 - sqrt(1 - r)), Gama's factor, and the largest u without and with
    it."""
    printed = network_reference.adjustment(path)
    survey = settle(positions(read_gkf(path)))
    estimate = solve(declare(survey))
    fit = linearise(estimate)
    point = next(u for u in fit.layout.unknowns if u.name == "point")
    values = np.reshape(estimate[point], (point.count, -1))
    place = {key: np.array(one.position) for key, one in survey.points.items()}
    for (key, part), value in printed.approximate.items():
        place[key]["xyz".index(part)] = value
    apart = max(abs(values[point.keys.index(k), point.parts.index(p)] - v) for (k, p), v in printed.values.items())
    tests = reliability(fit)
    order = np.argsort(tests.row, kind="stable")
    f = 100.0 * (1.0 - np.sqrt(np.maximum(1.0 - tests.redundancy[order], 0.0)))
    u = covariance(fit, point).u
    return (
        path.stem, str(len(f)), f"{estimate.dof} / {printed.dof}", str(printed.defect), f"{apart:.0e}",
        _ratio(fit, printed), _ratio(linearise(declare(survey.placed(place))), printed),
        f"{np.abs(f - printed.f).max():.4f}", f"{printed.factor:.4g}", f"{u.max() * 1e3:.4g} mm",
        f"{u.max() * np.sqrt(estimate.variance_factor) * 1e3:.4g} mm",
    )


def _ratio(fit, printed) -> str:  # type: ignore[no-untyped-def]
    point = next(u for u in fit.layout.unknowns if u.name == "point")
    u = covariance(fit, point).u.reshape(point.count, -1)
    worst = [abs(u[point.keys.index(k), point.parts.index(p)] / v - 1) for (k, p), v in printed.u.items()]
    return f"{max(worst):.0e}" if worst else "Gama prints 0"


def main() -> None:
    """Write the table to standard output."""
    lines = [HEADER, ("---",) * len(HEADER), *(row(path) for path in network_reference.NETWORKS)]
    sys.stdout.write("\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n")


if __name__ == "__main__":
    main()
