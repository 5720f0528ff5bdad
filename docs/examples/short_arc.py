"""How the centre gets lost on a short arc.

The same number of points, the same uncertainty, on shorter and shorter arcs: planned without any reading, from the
declaration alone. The uncertainty of the centre towards the arc grows with the inverse square of the arc, across it
with the inverse.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
from casadi import cos, sin

import calib
from calib.units import mm, um

centre = calib.Unknown("centre", [0.0, 0.0], "um", parts=("towards", "across"))
radius = calib.Unknown("radius", 100 * mm, "um")


def point(centre, radius, angle):
    return [centre[0] + radius * cos(angle), centre[1] + radius * sin(angle)]


def distance(centre, radius, x, y):
    return ((x - centre[0]) ** 2 + (y - centre[1]) ** 2) ** 0.5 - radius


arcs = np.geomspace(8, 360, 25)
found = []
for arc in arcs:
    angle = np.radians(np.linspace(-arc / 2, arc / 2, 24, endpoint=arc < 360))
    x, y = 0.1 * np.cos(angle), 0.1 * np.sin(angle)
    plan = calib.Problem([calib.Observations(distance, centre, radius, x, y, u=5 * um, unit="um")])
    found.append(calib.covariance(calib.linearise(plan), centre, radius).u / um)

figure, axes = plt.subplots(figsize=(7, 5))
axes.loglog(arcs, np.array(found), "-o", markersize=3)
axes.legend(["centre, towards the arc", "centre, across", "radius"], frameon=False)
axes.set(xlabel="arc / degrees", ylabel="standard uncertainty / µm", title="24 points, each with u = 5 µm")
axes.grid(alpha=0.3, which="both")
figure.savefig(sys.argv[1], dpi=120)
