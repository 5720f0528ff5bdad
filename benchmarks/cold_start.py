"""Cold start: from the declaration of a problem of 20 readings to its result with covariance, after import.

Every run is a process of its own; medians of CPU time. Usage: OMP_NUM_THREADS=1 python benchmarks/cold_start.py
"""

from __future__ import annotations

import subprocess
import sys

import numpy as np

CIRCLE = """
import time
import numpy as np
import casadi as ca
import calib
from calib import Observations, Problem, Quantity, Unknown, covariance, linearise, reliability, solve
generator = np.random.default_rng(1)
angle = np.linspace(0.0, 5.0, 10)
points = np.column_stack([3 + 2 * np.cos(angle), 1 + 2 * np.sin(angle)]) + generator.normal(0, 1e-5, (10, 2))
times = [time.process_time()]
centre, radius = Unknown("centre", [2.9, 1.1], "mm"), Unknown("radius", 1.9, "mm")
turn = Unknown("turn", angle[:, None], "rad")
model = lambda c, r, t: ca.vertcat(c[0] + r * ca.cos(t), c[1] + r * ca.sin(t))
observed = Observations(model, centre, radius, turn.each, readings=points, u=1e-5, unit="mm")
problem = Problem([observed], quantities=[Quantity("diameter", lambda r: 2 * r, radius, unit="mm")])
times.append(time.process_time())
estimate = solve(problem)
times.append(time.process_time())
fit = linearise(estimate)
covariance(fit, "diameter", centre, radius)
times.append(time.process_time())
print(*np.diff(times))
"""


def main() -> None:
    """Write the medians to standard output."""
    found = np.array([[float(x) for x in subprocess.run([sys.executable, "-c", CIRCLE], check=True, text=True,
                                                        capture_output=True).stdout.split()] for _ in range(9)])
    for name, spent in zip(("declaration", "solve", "covariance"), 1e3 * np.median(found, axis=0), strict=True):
        print(f"{name:12s} {spent:6.2f} ms")
    print(f"{'together':12s} {1e3 * np.median(found.sum(axis=1)):6.2f} ms")


if __name__ == "__main__":
    main()
