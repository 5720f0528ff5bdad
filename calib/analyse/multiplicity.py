"""Probabilities of many tests at a time."""

from __future__ import annotations

import numpy as np

from calib.blocks import Array


def holm(p_value: Array) -> Array:
    """Each of (n,) probabilities with regard to all n tests: the least level of all together at which it is rejected.

    Source: Holm (1979), A simple sequentially rejective multiple test procedure, Scandinavian Journal of Statistics 6.
    """
    order = np.argsort(p_value, kind="stable")
    adjusted = np.empty_like(p_value)
    adjusted[order] = np.minimum(np.maximum.accumulate(p_value[order] * (len(p_value) - np.arange(len(p_value)))), 1.0)
    return adjusted
