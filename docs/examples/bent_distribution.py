"""Where linear uncertainties stop holding.

The distance of two axes that nearly intersect cannot be negative: its distribution is bent, and the linear interval
says nonsense below zero. Far from zero the same declaration is as good as linear. Samples of the whole estimation
show which is which.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
from casadi import sqrt

import calib
from calib.units import um

offset = calib.Unknown("offset", [1 * um, 1 * um], "um", parts=("x", "y"))
distance = calib.Quantity("distance", lambda p: sqrt(p[0] ** 2 + p[1] ** 2), offset, unit="um")

figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
for side, true in zip(axes, (2.0, 20.0)):
    read = np.array([[true, 0.5]]) * um
    readings = calib.Observations(lambda p: p, offset, readings=read, u=2 * um, unit="um")
    problem = calib.Problem([readings], quantities=[distance])
    estimate = calib.solve(problem)
    found = calib.montecarlo(estimate, 50_000, seed=1)
    side.hist(found.samples[:, 0] / um, bins=120, density=True, color="tab:blue", alpha=0.4)
    x = np.linspace(*side.get_xlim(), 300)
    mean, u = found.linear[0] / um, found.linear_u[0] / um
    side.plot(x, np.exp(-0.5 * ((x - mean) / u) ** 2) / (u * np.sqrt(2 * np.pi)), color="tab:orange")
    for end in found.interval_shortest()[0] / um:
        side.axvline(end, color="0.5", linestyle="--")
    side.set(xlabel="distance of the axes / µm", yticks=[], title=f"linear: {mean:.1f} ± {1.96 * u:.1f} µm (95 %)")
figure.savefig(sys.argv[1], dpi=120)
