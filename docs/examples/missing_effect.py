"""A drift that the model did not know.

A level turned on a table reads its tilt; the readings drift by 3 arcseconds an hour. The estimate looks fine until
its residuals are drawn over time. One score test a candidate names the effect, and freeing it takes the structure
away.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import calib
from calib.analyse.score import scores
from calib.units import arcsec, hour
from problems import plumb

planned = plumb.example(seed=3)
drift = planned.parameters("drift (reading)")
measured = calib.simulate(planned, {drift: [[3 * arcsec / hour]]}, seed=3)
blind = calib.solve(measured)
ranking = sorted(scores(calib.linearise(blind)), key=lambda one: -one.statistic)
known = calib.solve(measured.free(measured.parameters(ranking[0].candidate.effect.label)))

figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
time = np.asarray(measured.observations[0].covariates["time"]) / 60
for side, estimate, title in zip(axes, (blind, known), ("without the drift", "with it")):
    side.axhspan(-1.96, 1.96, color="0.9")
    side.plot(time, estimate.residuals["level"].ravel() / (0.2 * arcsec), ".", color="tab:blue")
    side.set(xlabel="minutes", ylim=(-9, 9), title=f"{title}: p = {max(estimate.p_value, 1e-99):.1g}")
axes[0].set_ylabel("residual / u")
names = [one.candidate.effect.label for one in ranking]
axes[2].barh(names[::-1], [one.statistic for one in ranking][::-1], color="tab:orange")
axes[2].set(xlabel="drop of v'Pv if freed", title="candidates")
figure.savefig(sys.argv[1], dpi=120)
