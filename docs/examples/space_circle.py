"""A circle in space, and how far each point misses it.

Thirteen targets on a turning table, measured by a tracker with a covariance for each point. The misses are drawn two
thousand times as large as they are.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import calib
from problems import circle

problem = circle.example(seed=4)
estimate = calib.solve(problem)
centre, normal, radius = (estimate[problem.select(name).unknown] for name in ("centre", "normal", "radius"))
in_plane = np.linalg.svd(np.reshape(normal, (1, 3)))[2][1:]          # two directions in the plane of the circle
measured = np.asarray(problem.observations[0].recorded)
place = 1e3 * (measured - np.ravel(centre)) @ in_plane.T
miss = 2000 * 1e3 * estimate.residuals["points"] @ in_plane.T
turn = np.linspace(0, 2 * np.pi, 200)

figure, axes = plt.subplots(figsize=(7, 7))
axes.plot(1e3 * radius * np.cos(turn), 1e3 * radius * np.sin(turn), color="0.7")
axes.plot(*place.T, "o", color="tab:blue")
axes.quiver(*place.T, *miss.T, angles="xy", scale_units="xy", scale=1, color="tab:orange", width=0.005)
u = calib.covariance(calib.linearise(estimate), problem.select("radius").unknown).u[0]
axes.set(aspect="equal", xlabel="mm", ylabel="mm", title=f"radius {1e3 * radius:.4f} mm, u = {1e3 * u:.4f} mm")
figure.savefig(sys.argv[1], dpi=120)
