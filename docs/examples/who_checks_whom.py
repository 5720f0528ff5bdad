"""Who checks whom in a network.

Every reading's redundancy number: the part of its own error that shows in its own residual. Thin lines are checked by
hardly anybody; an error in them would go into the points unseen.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import calib
from problems import network

estimate = calib.solve(network.example(seed=2))
fit = calib.linearise(estimate)
checked = calib.reliability(fit)
point = estimate.problem.select("point").unknown
place = {key: np.asarray(where)[:2] for key, where in zip(point.keys, np.asarray(estimate[point]))}

figure, axes = plt.subplots(figsize=(8, 5.5))
for group in fit.groups:
    if {"station", "target"} <= set(group.covariates):
        numbers = checked.redundancy[checked.of(group.name)].reshape(len(group.rows), -1).mean(axis=1)
        for a, b, r in zip(group.covariates["station"], group.covariates["target"], numbers):
            if a in place and b in place:
                axes.plot(*np.stack([place[a], place[b]]).T, color=plt.cm.viridis(r), linewidth=0.5 + 4 * r, alpha=0.6)
for key, (x, y) in place.items():
    axes.plot(x, y, "o", color="black", markersize=4)
    axes.annotate(key, (x, y), xytext=(4, 4), textcoords="offset points")
figure.colorbar(plt.cm.ScalarMappable(plt.Normalize(0, 1), "viridis"), ax=axes, label="redundancy number")
axes.set(aspect="equal", xlabel="x / m", ylabel="y / m")
figure.savefig(sys.argv[1], dpi=120)
