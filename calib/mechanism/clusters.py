"""Postures of a mechanism put together by likeness, so that what is left out is unlike what remains."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

ROUNDS = 50


def alike_postures(positions: ArrayLike, count: int, seed: int) -> np.ndarray:
    """Cluster (n,) of each posture (n, axes) [rad], by means of the sines and cosines of its joints.

    count: clusters at most; seed: of the postures to begin with.
    Source: Lloyd, Least squares quantization in PCM, IEEE Transactions on Information Theory 28(2), 1982.
    """
    angles = np.asarray(positions, float)
    places = np.concatenate([np.cos(angles), np.sin(angles)], axis=1)
    centres = places[np.random.default_rng(seed).choice(len(places), min(count, len(places)), replace=False)]
    cluster = np.zeros(len(places), dtype=np.int64)
    for _ in range(ROUNDS):
        cluster = np.argmin(((places[:, None] - centres) ** 2).sum(axis=2), axis=1)
        centres = np.array([places[cluster == k].mean(axis=0) if np.any(cluster == k) else centre
                            for k, centre in enumerate(centres)])
    return cluster
