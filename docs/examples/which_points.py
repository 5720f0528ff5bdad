"""Which 12 of 60 points to measure.

Sixty places on a plate could be probed for its tilt and height; twelve are wanted. The choice is compared with a
bound that no choice can beat, so one knows when to stop looking.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import calib
from calib.units import um

generator = np.random.default_rng(8)
x, y = generator.uniform(-1, 1, (2, 60))
inside = np.hypot(x, y) < 1
x, y = x[inside], y[inside]
plate = calib.Unknown("plate", [0.0, 0.0, 0.0], "um", parts=("height", "about x", "about y"))
plan = calib.Problem([calib.Observations(lambda p, x, y: p[0] + p[1] * y - p[2] * x, plate, x, y, u=1 * um, unit="um",
                                         group="probe")])
fit = calib.linearise(plan)
choice = calib.select(fit, keep=12, criterion=calib.D())
chosen = np.isin(np.arange(1, len(x) + 1), choice.rows["probe"])

figure, axes = plt.subplots(figsize=(6.5, 6.5))
axes.scatter(x, y, s=60, facecolors="none", edgecolors="0.6", label="could be probed")
axes.scatter(x[chosen], y[chosen], s=90, color="tab:blue", label="chosen")
axes.add_patch(plt.Circle((0, 0), 1, fill=False, color="0.8"))
axes.legend(frameon=False, loc="lower right")
axes.set(aspect="equal", title=f"within {100 * choice.gap:.2f} % of a proven bound")
figure.savefig(sys.argv[1], dpi=120)
