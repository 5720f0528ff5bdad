"""The smallest curvature of the objective in the metric of the Gauss-Newton matrix, by directions instead of a Hessian.

Lanczos steps with the exact second derivatives along one direction at a time. From a random start, after k steps the
extreme value found differs from the true one by more than a part e of the whole range of values with a probability of
at most 1.648 sqrt(p) exp(-sqrt(e) (2 k - 1)). Source: Kuczynski and Wozniakowski (1992), SIAM Journal on Matrix
Analysis and Applications 13(4), theorem 4.2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from calib.blocks import Array
from calib.linearisation import Linearisation, pulled

DOUBT = 1e-9  # probability at most that a direction of downward curvature stays unseen
KNOWN = 1e-3  # to which the smallest curvature is wanted, where it is not small
STEPS = 200


def _normals(shapes: Sequence[tuple[int, ...]]) -> list[Array]:
    """Normal deviates, always the same ones; to load numpy.random takes longer than to solve a small problem.

    Source: Steele, Lea, Flood (2014), OOPSLA, for the generator.
    """
    sizes = [math.prod(shape) for shape in shapes]
    state = np.arange(1, 2 * sum(sizes) + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    first, second = ((state ^ (state >> np.uint64(31))) >> np.uint64(11)).reshape(2, -1) * 2.0**-53
    normal = np.sqrt(-2.0 * np.log1p(-first)) * np.cos(2.0 * np.pi * second)
    ends = np.cumsum(sizes)
    return [normal[e - n : e].reshape(shape) for e, n, shape in zip(ends, sizes, shapes, strict=True)]


def smallest_curvature(bend: Callable[[Array], Array], fit: Linearisation) -> float:
    """Smallest eigenvalue of the exact Hessian of half v'Pv in the metric of the Gauss-Newton matrix: 1 where straight.

    bend: what the Hessian adds to the Gauss-Newton matrix, times a step (p,); fit: that matrix.
    Not a number where second derivatives are not finite.
    """
    factor = fit.factor
    # A random step whose size in units of u is alike in all directions: it answers random readings.
    force = pulled(fit.blocks, _normals([b.residual.shape for b in fit.blocks]), fit.layout)
    step = factor.solve(force[:, None])[:, 0]
    length = math.sqrt(max(float(force @ step), 0.0))
    if not length > 0.0:
        return 1.0
    # Force and step are the two faces of a direction: step = covariance force, so that force'step is its length.
    most = min(factor.rank, STEPS)
    forces, steps, inner = np.empty((most, len(force))), np.empty((most, len(force))), np.zeros((most, most))
    for k in range(1, most + 1):
        forces[k - 1], steps[k - 1] = force / length, step / length
        force = bend(steps[k - 1])
        if not np.isfinite(force).all():
            return math.nan
        inner[k - 1, k - 1] = steps[k - 1] @ force
        for _ in range(2):  # twice, for directions that are orthogonal to rounding
            force = force - (steps[:k] @ force) @ forces[:k]
        step = factor.solve(force[:, None])[:, 0]
        length = math.sqrt(max(float(force @ step), 0.0))
        values, axes = np.linalg.eigh(inner[:k, :k])  # looks at what is on and below the diagonal
        smallest, reach = 1.0 + float(values[0]), float(max(values[-1], 0.0) - min(values[0], 0.0))
        if k == most or length <= 1e-12 * max(reach, 1e-300):
            break
        unseen = (math.log(1.648 * math.sqrt(factor.rank) / DOUBT) / (2 * k - 1)) ** 2
        near = length * abs(float(axes[-1, 0])) <= KNOWN * max(abs(smallest), KNOWN)
        if near and (smallest <= 0.0 or (unseen < 0.5 and smallest > unseen * reach / (1.0 - 2.0 * unseen))):
            break
        inner[k, k - 1] = length
    return smallest
