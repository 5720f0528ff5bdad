"""Sets of effects from a convex program: least squares with a price on the size of every effect as a group."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.workflow.discrepancy.subsets import Products

PRICES = (0.5, 0.25, 0.12, 0.06)  # of an effect, over the price at which none is worth it
ALIVE = 1e-3  # share of the largest effect, below which one counts as absent


def sparse_sets(products: Products, most: int) -> list[list[int]]:
    """Sets of effects that stay in the sum of squares plus a price times the sizes of the effects, for several prices.

    products: inner products of the candidates; most: effects in a set at most, the largest are taken.
    minimise 1/2 |r - F z|^2 + price sum_g sqrt(k_g) |z_g|, a cone of second order for every effect.
    Source: Yuan and Lin 2006 (group lasso); solved as a cone program by Clarabel (Goulart and Chen 2024).
    """
    groups = [g for g in range(len(products.starts)) if products.ends[g] > products.starts[g]]
    size = len(products.pull)
    if len(groups) < 2:
        return []
    weights = np.sqrt([products.ends[g] - products.starts[g] for g in groups])
    pulls = [np.linalg.norm(products.pull[products.starts[g] : products.ends[g]]) for g in groups]
    dearest = float(np.max(pulls / weights))
    found: list[list[int]] = []
    for share in PRICES:
        steps = _solved(products, groups, size, share * dearest * weights)
        if steps is None:
            continue
        norms = np.array([np.linalg.norm(steps[products.starts[g] : products.ends[g]]) for g in groups])
        order = [int(i) for i in np.argsort(-norms) if norms[i] > ALIVE * norms.max()]
        found += [sorted(groups[i] for i in order[:count]) for count in range(2, min(len(order), most) + 1)]
    return [list(one) for one in dict.fromkeys(map(tuple, found))]


def _solved(products: Products, groups: list[int], size: int, prices: Any) -> Any:
    import clarabel  # type: ignore[import-untyped]
    from scipy import sparse

    count = len(groups)
    quadratic = sparse.block_diag([sparse.csc_matrix(products.matrix), sparse.csc_matrix((count, count))], format="csc")
    linear = np.concatenate([-products.pull, prices])
    rows = []
    for i, g in enumerate(groups):  # the size of an effect, then its directions
        rows.append(size + i)
        rows += range(products.starts[g], products.ends[g])
    cones = [clarabel.SecondOrderConeT(1 + int(products.ends[g] - products.starts[g])) for g in groups]
    condition = sparse.csc_matrix((-np.ones(len(rows)), (np.arange(len(rows)), rows)), (len(rows), size + count))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solution = clarabel.DefaultSolver(
        sparse.triu(quadratic, format="csc"), linear, condition, np.zeros(len(rows)), cones, settings
    ).solve()
    return np.array(solution.x[:size]) if str(solution.status) in ("Solved", "AlmostSolved") else None
