"""Which errors of a real arm to estimate, and how large they may be, chosen on the placement used for the calibration.

Run: python benchmarks/mechanism_model_choice.py JOB [--data FOLDER]. The placements held out in the job are not read.

For each set of families the sizes (standard uncertainties of seat, joint positions and errors) of largest marginal
likelihood are found: the density of the readings when every error is drawn from its size. It weighs fit against
freedom without leaving postures out. Each size has a log-normal prior about what makers and catalogues let expect, a
factor e wide. Beside it, as a check: clusters of like postures predicted from the other clusters.
Source: MacKay, Bayesian interpolation, Neural Computation 4(3), 1992 (the evidence).
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

import calib
from calib.job import Job
from calib.mechanism.clusters import alike_postures
from calib.mechanism.sensitivity import place_by_positions
from calib.units import arcsec, mm, mrad
from problems import serial_arm
from problems.serial_arm.model import family_of

EXPECTED = {"length": 0.5 * mm, "tilt": 2 * mrad, "zero": 5 * mrad, "sag": 5 * mrad, "windup": 60 * arcsec,
            "bending": 5 * mrad, "encoder": 0.2 * mrad, "seat": 0.1 * mm, "joint": 30 * arcsec}
GEOMETRY = ("length", "tilt", "zero")
SETS = {
    "geometry": (*GEOMETRY, "seat"),
    "geometry; joints stand to u_joint": (*GEOMETRY, "seat", "joint"),
    "and drives that sag": (*GEOMETRY, "sag", "seat", "joint"),
    "and gears with soft windup": (*GEOMETRY, "sag", "windup", "seat", "joint"),
    "and encoder harmonics": (*GEOMETRY, "sag", "windup", "encoder", "seat", "joint"),
    "and links that bend": (*GEOMETRY, "sag", "windup", "bending", "encoder", "seat", "joint"),
    "the same, joints known exactly": (*GEOMETRY, "sag", "windup", "bending", "encoder", "seat"),
}


class Evidence:
    """Marginal likelihood of the readings of a problem, linear about an estimate, as a function of the sizes."""

    def __init__(self, setup: serial_arm.Setup, sizes: Mapping[str, float]):
        (seats,) = setup.used.values()
        problem = declared(setup, dict(setup.used), sizes)
        fit = calib.solve(problem).fit
        layout, group = fit.layout, fit.group("seat")
        self.free = layout.free_columns
        position = np.full(layout.size, -1)
        position[self.free] = np.arange(len(self.free))
        rows = np.zeros((len(group.rows), 3, len(self.free)))
        for part in group.parts:
            for k in range(part.columns.shape[1]):
                columns = position[part.columns[:, k]]
                kept = np.flatnonzero(columns >= 0)
                rows[kept, :, columns[kept]] += part.jacobian[kept, :, k]
        self.at = np.zeros(len(self.free))          # value of each error at the estimate
        self.family = np.full(len(self.free), "", dtype=object)
        for attached in problem.attached:
            span = layout.span(attached.unknown)
            for column, value in zip(range(span.start, span.stop), fit.values[attached.unknown].ravel(), strict=True):
                if position[column] >= 0:
                    self.at[position[column]] = value
                    self.family[position[column]] = family_of(attached.effect, setup.arm)
        self.rows, self.reading = rows, group.residual + rows @ self.at
        positions = np.concatenate(seats)
        self.by_joint = place_by_positions(setup.arm.mechanism, setup.arm.tip, positions)
        blocks = fit.group("distance of sockets").whitened if setup.arguments["distance"] is not None else ()
        self.others = [(b.dense(position, len(self.free)).reshape(-1, len(self.free)), b.residual.ravel())
                       for b in blocks]

    def __call__(self, sizes: Mapping[str, float]) -> float:
        """Logarithm of the marginal likelihood, less what does not depend on the sizes."""
        covariance = sizes["seat"] ** 2 * np.eye(3) + sizes.get("joint", 0.0) ** 2 * (
            self.by_joint @ self.by_joint.transpose(0, 2, 1))
        root = np.linalg.cholesky(covariance)
        rows = np.linalg.solve(root, self.rows).reshape(-1, len(self.free))
        reading = np.linalg.solve(root, self.reading[:, :, None]).ravel()
        size = np.array([sizes[f] if f else np.inf for f in self.family])
        normal = rows.T @ rows + np.diag(size ** -2.0)
        right, squares = rows.T @ reading, reading @ reading
        for other, residual in self.others:
            whole = residual + other @ self.at
            normal, right, squares = normal + other.T @ other, right + other.T @ whole, squares + whole @ whole
        factor = np.linalg.cholesky(normal)
        pull = np.linalg.solve(factor, right)
        return float(-0.5 * (squares - pull @ pull) - np.log(np.diag(factor)).sum()
                     - np.log(size[np.isfinite(size)]).sum() - np.log(np.einsum("nii->ni", root)).sum())


def declared(setup: serial_arm.Setup, placements: Mapping[str, list[np.ndarray]], sizes: Mapping[str, float],
             **more: object) -> calib.Problem:
    """The arm with those families free that have a size."""
    tolerances = serial_arm.Tolerances(**{name: sizes.get(name) for name in
                                          ("length", "tilt", "zero", "sag", "windup", "bending", "encoder")})
    return serial_arm.declare(setup.arm, placements, **{
        **setup.arguments, "sizes": tolerances, "u_seat": sizes["seat"], "u_joint": sizes.get("joint", 0.0), **more})


def likeliest(setup: serial_arm.Setup, families: tuple[str, ...]) -> tuple[dict[str, float], float]:
    """The sizes of largest marginal likelihood with their priors, and its logarithm."""
    sizes = {name: EXPECTED[name] for name in families}
    expected = np.log(list(sizes.values()))
    for _ in range(3):          # the errors are some milliradians: linear about the estimate, and again about the next
        evidence = Evidence(setup, sizes)

        def loss(logs: np.ndarray, evidence: Evidence = evidence) -> float:
            return 0.5 * float(np.sum((logs - expected) ** 2)) - evidence(dict(zip(families, np.exp(logs))))
        found = minimize(loss, np.log(list(sizes.values())), method="L-BFGS-B")
        sizes = dict(zip(families, np.exp(found.x).tolist()))
    return sizes, -float(found.fun)


def left_out_error(setup: serial_arm.Setup, sizes: Mapping[str, float], seeds: int = 2) -> float:
    """Mean distance [m] of balls of left-out clusters from the sockets found with the others."""
    (name, seats), = setup.used.items()
    positions = np.concatenate(seats)
    socket = np.repeat(np.arange(len(seats)), [len(seat) for seat in seats])
    missed: list[float] = []
    for seed in range(seeds):
        cluster = alike_postures(positions, serial_arm.BLOCKS, seed)
        for k in np.unique(cluster):
            kept = [positions[(socket == i) & (cluster != k)] for i in range(len(seats))]
            left = [positions[(socket == i) & (cluster == k)] for i in range(len(seats))]
            if any(len(rows) < 3 for rows in kept):
                continue
            estimate = calib.solve(declared(setup, {name: kept}, sizes))
            values = {x.name: estimate[x] for x in estimate.problem.unknowns}
            for i, rows in enumerate(left):
                if len(rows):
                    one = declared(setup, {name: [rows]}, sizes, distance=None)
                    found = calib.predict(one, {**values, "socket": [values["socket"][i]]})["seat"]
                    missed += list(np.linalg.norm(found, axis=1))
    return float(np.mean(missed))


def shown(name: str, size: float) -> str:
    """A size in a handy unit."""
    return f"{name} {size / mm:.3g} mm" if name in ("length", "seat") else (
        f"{name} {size / mrad:.3g} mrad" + ("/m" if name in ("sag", "bending") else ""))


def main() -> None:
    arguments = sys.argv[1:]
    folder = Path(arguments.pop(arguments.index("--data") + 1)) if "--data" in arguments else None
    setup = serial_arm.setup(Job.read(arguments[0], folder))
    print(f"{'free':36s} {'log evidence':>12s} {'left out':>10s}   sizes of largest marginal likelihood")
    first = None
    for words, families in SETS.items():
        sizes, evidence = likeliest(setup, families)
        first = evidence if first is None else first
        print(f"{words:36s} {evidence - first:+12.1f} {left_out_error(setup, sizes) / mm:7.3f} mm   "
              + ", ".join(shown(*item) for item in sizes.items()), flush=True)


if __name__ == "__main__":
    main()
