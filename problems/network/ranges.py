"""Approximate coordinates from ranges alone: classical scaling of distances along shortest paths."""

from __future__ import annotations

import numpy as np

from calib.errors import InputError
from problems.network.survey import Survey

ATTEMPTS = 30       # placements that are tried where the first ones do not fit
GOOD = 2e-3         # misfit of the ranges, relative to their mean, that a right placement reaches
TURNED = 60         # points up to which each is tried on the other side of its neighbours


def scaled(survey: Survey, known: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Positions (3,) of all points that ranges join, laid onto those that are known.

    Distances that were not read are taken along the shortest path of those that were; the result is improved by
    majorising (each step lowers the misfit), and mirrored where that fits the known points better.
    Raises InputError naming a point that no range joins to the others.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import shortest_path

    dim = 3 if "z" in survey.parts else 2
    pairs = [(a, b, float(v)) for batch in survey.every_batch if batch.values is not None
             for a, b, v in zip(*(k.tolist() for k in batch.ends), batch.values[:, 0], strict=True)]
    keys = list(dict.fromkeys(k for a, b, _ in pairs for k in (a, b)))
    place = {key: i for i, key in enumerate(keys)}
    fixed = [k for k in keys if np.isfinite(known[k][:dim]).all()]
    pairs += [(a, b, float(np.linalg.norm(known[a][:dim] - known[b][:dim])))
              for i, a in enumerate(fixed) for b in fixed[i + 1 :] if not np.array_equal(known[a], known[b])]
    i, j = np.array([[place[a], place[b]] for a, b, _ in pairs]).T
    read = np.array([v for *_, v in pairs])
    graph = coo_matrix((read, (np.minimum(i, j), np.maximum(i, j))), (len(keys), len(keys))).tocsr()
    if graph.nnz < len(read):                          # a pair that was read twice: its mean
        count = coo_matrix((np.ones(len(read)), (np.minimum(i, j), np.maximum(i, j))), graph.shape).tocsr()
        graph.data /= count.data
    whole = shortest_path(graph, directed=False)
    if not np.isfinite(whole).all():
        alone = [k for k, far in zip(keys, np.isinf(whole[0]), strict=True) if far]
        raise InputError(f"no chain of ranges joins {', '.join(repr(k) for k in alone[:5])} to '{keys[0]}'; add ranges "
                         "between the two parts")
    found = _fitted(whole, dim, i, j, read)
    anchors = [place[k] for k in fixed]
    if anchors:
        found = _laid(found, anchors, np.array([known[k][:dim] for k in fixed]))
    return {k: np.concatenate([p, [np.nan] * (3 - dim)]) if k not in fixed else known[k]
            for k, p in zip(keys, found, strict=True)}


def _fitted(whole: np.ndarray, dim: int, i: np.ndarray, j: np.ndarray, read: np.ndarray) -> np.ndarray:
    """The placement that misses the ranges least, of the scaled one and of others where that is caught in a fold.

    A figure folded over in its own space can unfold in a space of more dimensions, and is flattened again.
    """
    generator = np.random.default_rng(0)             # further attempts, the same every time
    best, smallest = np.zeros((len(whole), dim)), np.inf
    for attempt in range(ATTEMPTS):
        size = dim + (attempt % 3)
        start = _classical(whole, min(size, len(whole) - 1))
        if attempt > 2:
            start = start + generator.normal(scale=0.3 * float(read.mean()), size=start.shape)
        unfolded = _majorised(start, i, j, read)
        axes = np.linalg.svd(unfolded - unfolded.mean(axis=0), full_matrices=False)[2][:dim]
        place = _majorised(unfolded @ axes.T, i, j, read)
        if (miss := _miss(place, i, j, read)) >= GOOD and len(place) <= TURNED:
            place = _unfolded(place, i, j, read)
            miss = _miss(place, i, j, read)
        if miss < smallest:
            best, smallest = place, miss
        if smallest < GOOD:
            break
    return best


def _miss(place: np.ndarray, i: np.ndarray, j: np.ndarray, read: np.ndarray) -> float:
    """Root mean square of the misfits, relative to the mean range."""
    return float(np.sqrt(np.mean((np.linalg.norm(place[i] - place[j], axis=1) - read) ** 2)) / read.mean())


def _unfolded(place: np.ndarray, i: np.ndarray, j: np.ndarray, read: np.ndarray) -> np.ndarray:
    """The placement with points, one after the other, on the other side of the points they are read from, as long as
    the ranges then fit better."""
    smallest, better = _miss(place, i, j, read), True
    while better and smallest > GOOD:
        better = False
        for k in range(len(place)):
            around = place[np.concatenate([j[i == k], i[j == k]])]
            middle = around.mean(axis=0)
            across = np.linalg.svd(around - middle, full_matrices=True)[2][-1]
            other = place.copy()
            other[k] -= 2.0 * ((place[k] - middle) @ across) * across
            other = _majorised(other, i, j, read)
            miss = _miss(other, i, j, read)
            if miss < 0.99 * smallest:
                place, smallest, better = other, miss, True
    return place


def _classical(distances: np.ndarray, dim: int) -> np.ndarray:
    n = len(distances)
    centring = np.eye(n) - 1.0 / n
    values, axes = np.linalg.eigh(-0.5 * centring @ distances**2 @ centring)
    return axes[:, -dim:] * np.sqrt(np.maximum(values[-dim:], 0.0))


def _majorised(place: np.ndarray, i: np.ndarray, j: np.ndarray, read: np.ndarray) -> np.ndarray:
    """Lower the sum of squared misfits of the ranges themselves (Guttman transform; de Leeuw, 1977)."""
    n = len(place)
    laplacian = np.zeros((n, n))
    np.add.at(laplacian, (i, j), -1.0)
    np.add.at(laplacian, (j, i), -1.0)
    laplacian -= np.diag(laplacian.sum(axis=1))
    inverse = np.linalg.pinv(laplacian)
    for _ in range(500):
        apart = place[i] - place[j]
        length = np.linalg.norm(apart, axis=1)
        ratio = np.where(length > 0, read / np.where(length > 0, length, 1.0), 0.0)
        right = np.zeros_like(place)
        np.add.at(right, i, ratio[:, None] * apart)
        np.add.at(right, j, -ratio[:, None] * apart)
        moved = inverse @ right
        change = float(np.abs(moved - (place - place.mean(axis=0))).max())
        place = moved
        if change < 1e-6 * float(read.max()):
            break
    return place


def _laid(place: np.ndarray, anchors: list[int], target: np.ndarray) -> np.ndarray:
    """Turned, mirrored where that is better, and shifted onto anchors (Kabsch)."""
    own, middle = place[anchors], target.mean(axis=0)
    left, _, right = np.linalg.svd((own - own.mean(axis=0)).T @ (target - middle))
    return (place - own.mean(axis=0)) @ (left @ right) + middle
