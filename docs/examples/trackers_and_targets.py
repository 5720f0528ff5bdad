"""Self-calibration of four trackers that see sixteen targets.

Nobody knows where the trackers stand, where the targets are, or where the trackers began to count. Ranges alone
determine it all but for the choice of a frame. The ellipsoids are five thousand times as large as they are.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import calib
from calib.analyse.shapes import scene
from calib.scene import Points, Sights
from problems import multilateration

estimate = calib.solve(multilateration.example(seed=1))
shapes = scene(calib.linearise(estimate)).shapes
figure = plt.figure(figsize=(7.5, 6.5))
axes = figure.add_subplot(projection="3d")
u, v = np.mgrid[0 : 2 * np.pi : 16j, 0 : np.pi : 9j]
ball = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
for shape in shapes:
    if isinstance(shape, Sights):
        for start, end in zip(shape.starts, shape.ends):
            axes.plot(*np.stack([start, end]).T, color="0.85", linewidth=0.5)
    elif isinstance(shape, Points):
        colour = "tab:orange" if shape.name == "tracker" else "tab:blue"
        for place, matrix in zip(shape.places, shape.covariance):
            size, directions = np.linalg.eigh(matrix)
            arms = directions * np.sqrt(np.maximum(size, 0)) * 5000
            axes.plot_wireframe(*(place[:, None, None] + np.tensordot(arms, ball, 1)), color=colour, linewidth=0.4)
        axes.scatter(*shape.places.T, color=colour, s=14, label=f"{shape.name}s")
axes.legend(frameon=False)
axes.set(xlabel="x / m", ylabel="y / m", zlabel="z / m", aspect="equal")
figure.savefig(sys.argv[1], dpi=120)
