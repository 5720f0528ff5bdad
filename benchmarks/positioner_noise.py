"""Noise of the poses of a real positioner: each by itself, and what neighbours have in common.

Run: python benchmarks/positioner_noise.py JOB [--data FOLDER]. Restricted likelihood of the residuals of the identified
axes, with all free unknowns integrated out: independent poses, and smooth errors whose reach is measured along the
positions of the axes or between the places of the target. The job states what is likeliest.
Source: Patterson and Thompson, Biometrika 58(3), 1971 (restricted likelihood).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

import calib
from calib.job import Job
from calib.linearisation import Linearisation
from calib.mechanism.smooth import distances
from calib.units import degree, mm, mrad
from problems import positioner

START = {"axes": 0.4, "places": 0.2}       # reach to begin with [rad, m]


class Likelihood:
    """Restricted likelihood of the poses of an estimate, as a function of the noise of places and turns."""

    def __init__(self, fit: Linearisation):
        group = fit.group("pose")
        columns = np.zeros((len(group.rows), 6, fit.layout.size))
        for part in group.parts:
            for k in range(part.columns.shape[1]):
                columns[np.arange(len(group.rows)), :, part.columns[:, k]] += part.jacobian[:, :, k]
        self.columns, self.residual = columns[:, :, fit.layout.free_columns], group.residual

    def __call__(self, noise: np.ndarray, apart: np.ndarray | None) -> float:
        """Its logarithm; noise: own, smooth, reach of a place [m] and of a turn [rad]; apart (n, n) or None."""
        size = self.columns.shape[2]
        normal, right, squares, roots = np.zeros((size, size)), np.zeros(size), 0.0, 0.0
        for component in range(6):
            own, smooth, reach = noise[:3] if component < 3 else noise[3:]
            covariance = own ** 2 * np.eye(len(self.residual))
            if apart is not None:
                covariance += smooth ** 2 * np.exp(-0.5 * (apart / reach) ** 2)
            root = np.linalg.cholesky(covariance)
            columns = np.linalg.solve(root, self.columns[:, component])
            residual = np.linalg.solve(root, self.residual[:, component])
            normal, right = normal + columns.T @ columns, right + columns.T @ residual
            squares, roots = squares + residual @ residual, roots + np.log(np.diag(root)).sum()
        factor = np.linalg.cholesky(normal)
        pull = np.linalg.solve(factor, right)
        return float(-0.5 * (squares - pull @ pull) - roots - np.log(np.diag(factor)).sum())


def main() -> None:
    arguments = sys.argv[1:]
    folder = Path(arguments.pop(arguments.index("--data") + 1)) if "--data" in arguments else None
    problem = positioner.from_job(Job.read(arguments[0], folder))
    observed = problem.observations[0]
    likelihood = Likelihood(calib.solve(problem).fit)
    positions = np.stack([observed.covariates[name] for name in "AC"], axis=1)
    places = observed.recorded[:, :3]
    kernels = {"independent": None, "smooth along the axes": distances(positioner.positioner(), positions),
               "smooth in space": np.linalg.norm(places[:, None] - places, axis=2)}
    first = None
    for words, apart in kernels.items():
        reach = START["places" if words.endswith("space") else "axes"]
        start = np.log([0.1 * mm, 0.2 * mm, reach, 0.2 * mrad, 0.6 * mrad, reach])

        def loss(logs: np.ndarray, apart: np.ndarray | None = apart) -> float:
            return -likelihood(np.exp(logs), apart)
        found = minimize(loss, start, method="L-BFGS-B", options={"maxiter": 30})
        first = found.fun if first is None else first
        own, smooth, far, own_turn, smooth_turn, far_turn = np.exp(found.x)
        line = (f"{words:24s} log likelihood {first - found.fun:+8.1f}   by itself {own / mm:.3f} mm, "
                f"{own_turn / mrad:.2f} mrad")
        if apart is not None:
            unit, size = ("mm", mm) if words.endswith("space") else ("deg", degree)
            line += (f"; in common {smooth / mm:.2f} mm reaching {far / size:.0f} {unit}, "
                     f"{smooth_turn / mrad:.2f} mrad reaching {far_turn / size:.0f} {unit}")
        print(line, flush=True)


if __name__ == "__main__":
    main()
