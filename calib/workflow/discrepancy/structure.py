"""Descriptions of structure that no effect explains: harmonics of angles, smooth functions, levels of what has few
values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Field
from calib.blocks import Array
from calib.workflow.discrepancy.readings import Channel
from calib.workflow.discrepancy.search import corrected, tail

HARMONICS = (1, 2, 3, 4, 5, 6)
WAVES = (1, 2, 3, 4, 5, 6)  # whole waves over the range of a covariate that is no angle
DEGREES = 5  # of the polynomials over one covariate
FEW = 12  # different values up to which a covariate is taken level by level
SPLIT_BY = 6  # different keys up to which a channel is also looked at key by key
DRAWS = 200  # simulated residuals from which the number of independent looks is judged
MOST = 5  # descriptions that may stand together


@dataclass(frozen=True)
class Pattern:
    """One description: channel, covariate and what of it; columns (m, k) over its places among all whitened rows."""

    channel: str
    covariate: str
    kind: str
    places: NDArray[np.int64]
    columns: Array

    def whole(self, n: int) -> Array:
        """Columns (n, k) over all whitened rows."""
        columns = np.zeros((n, self.columns.shape[1]))
        columns[self.places] = self.columns
        return columns


@dataclass(frozen=True)
class Place:
    """Where a model disagrees: channel, covariate, shape of the disagreement, corrected p-value, and figures of it."""

    channel: str
    covariate: str
    shape: str
    p_value: float
    figures: Mapping[str, float] = field(default_factory=dict)


def patterns(channels: Sequence[Channel]) -> list[Pattern]:
    """All descriptions of structure that the recorded covariates allow."""
    found: list[Pattern] = []
    for channel in channels:
        for name, inside in _parts(channel):
            for covariate, values in channel.covariates.items():
                found += [
                    Pattern(name, covariate, kind, channel.places[inside], columns)
                    for kind, columns in _shapes(values[inside], channel.units.get(covariate, "1"))
                ]
            found += [
                Pattern(name, covariates, kind, channel.places[inside], columns)
                for covariates, kind, columns in _products(channel, inside)
            ]
    return found


def _parts(channel: Channel) -> Iterator[tuple[str, NDArray]]:
    """The whole channel, and its readings key by key where a text covariate has a few keys."""
    yield channel.name, np.arange(len(channel.places))
    for covariate, values in channel.covariates.items():
        if values.dtype.kind not in "fiub":
            keys = list(dict.fromkeys(values.tolist()))
            if 1 < len(keys) <= SPLIT_BY:
                for key in keys:
                    yield f"{channel.name}, {covariate} {key}", np.flatnonzero(values == key)


def _shapes(values: NDArray, unit: str) -> Iterator[tuple[str, Array]]:
    if values.dtype.kind not in "fiub":
        different = list(dict.fromkeys(values.tolist()))
        if 1 < len(different) <= FEW:
            yield "level", np.stack([values == v for v in different], axis=1).astype(float)
        return
    numbers = values.astype(float)
    levels = np.unique(numbers)
    if len(levels) < 2:
        return
    if unit in ("rad", "deg"):
        orders = [o for o in HARMONICS if len(levels) > 2 * o]
        for order in orders:
            yield f"harmonic {order}", np.stack([np.cos(order * numbers), np.sin(order * numbers)], axis=1)
    scaled = _scaled(numbers)
    if len(levels) > 4:
        yield "cubic", np.polynomial.legendre.legvander(scaled, 3)[:, 1:]
    if len(levels) <= FEW:
        yield "level", (numbers[:, None] == levels).astype(float)
        if len(levels) > 3:
            yield "trend", scaled[:, None]
            yield "curve", (scaled**2)[:, None]
        return
    yield "smooth", np.polynomial.legendre.legvander(scaled, DEGREES)[:, 1:]
    if len(levels) > 4 * DEGREES:
        yield "fine", np.polynomial.legendre.legvander(scaled, 2 * DEGREES)[:, 1:]
    yield "trend", scaled[:, None]
    yield "curve", (scaled**2)[:, None]
    if unit not in ("rad", "deg"):
        for order in WAVES:
            if len(levels) > 3 * order:
                turns = np.pi * order * scaled
                yield f"{order} waves over the range", np.stack([np.cos(turns), np.sin(turns)], axis=1)
    yield "pieces", (np.digitize(scaled, np.linspace(-1, 1, 9)[1:-1])[:, None] == np.arange(8)).astype(float)


def _products(channel: Channel, inside: NDArray) -> Iterator[tuple[str, str, Array]]:
    """What grows with time or temperature: a width, a harmonic."""
    runs = [k for k in ("time", "temperature_difference") if _varies(channel.covariates.get(k), inside)]
    for run in runs:
        scaled = _scaled(channel.covariates[run][inside].astype(float))
        for name, values in channel.covariates.items():
            if name == run or values.dtype.kind not in "fiub" or not _varies(values, inside):
                continue
            if channel.units.get(name) in ("rad", "deg"):
                for order in (1, 2):
                    turn = order * values[inside].astype(float)
                    yield (f"{name} and {run}", f"harmonic {order} that changes with {run}",
                           scaled[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1))
            elif len(np.unique(values[inside])) <= 3:
                yield (f"{name} and {run}", f"difference between {name} that changes with {run}",
                       (scaled * values[inside])[:, None])


def _varies(values: NDArray | None, inside: NDArray) -> bool:
    return values is not None and values.dtype.kind in "fiub" and len(np.unique(values[inside])) > 1


def _scaled(numbers: Array) -> Array:
    low, high = numbers.min(), numbers.max()
    return 2 * (numbers - low) / max(high - low, 1e-300) - 1


class Screen:
    """Score tests of many patterns at once, each from its own rows, against residuals outside a basis."""

    def __init__(self, field: Field, shapes: Sequence[Pattern], seed: int, looks: float | None = None):
        self.shapes, self.field = [], field
        self.roots: list[Array] = []
        for shape in shapes:
            columns = shape.columns / np.maximum(np.linalg.norm(shape.columns, axis=0), 1e-300)
            taken = field.basis[shape.places].T @ columns
            values, vectors = np.linalg.eigh(columns.T @ columns - taken.T @ taken)
            seen = values > 1e-6
            if seen.any():
                self.shapes.append(shape)
                self.roots.append(columns @ (vectors[:, seen] / np.sqrt(values[seen])))
        self.dofs = np.array([r.shape[1] for r in self.roots], dtype=int)
        self.looks = self._looks(seed) if looks is None else looks

    def drops(self, residuals: Array) -> Array:
        """Drop of the sum of squares for each pattern (rows) and each column of residuals (n, count)."""
        return np.array([np.sum((root.T @ residuals[shape.places]) ** 2, axis=0)
                         for root, shape in zip(self.roots, self.shapes, strict=True)])

    def _looks(self, seed: int) -> float:
        from scipy.special import gammaincc

        if not self.shapes:
            return 1.0
        drawn = self.field.draw(np.random.default_rng(seed), DRAWS)
        smallest = np.min(gammaincc(self.dofs[:, None] / 2, self.drops(drawn) / 2), axis=0)
        middle = 1 / float(np.mean(-np.log1p(-np.minimum(smallest, 1 - 1e-12))))
        rare = np.log(0.95) / np.log1p(-max(float(np.quantile(smallest, 0.05)), 1e-12))
        return float(np.clip(max(middle, rare), 1.0, len(self.shapes)))

    def places(self) -> list[Place]:
        """The patterns as places, most significant first, their p-values corrected for the number of looks."""
        found: list[tuple[float, float, Place]] = []
        if not self.shapes:
            return []
        for shape, drop, dof in zip(self.shapes, self.drops(self.field.residual[:, None])[:, 0], self.dofs,
                                    strict=True):
            left = self.field.dof - int(dof)
            scale = max(1.0, (self.field.squares - drop) / left) if left > 0 else 1.0
            p = corrected(tail(drop, int(dof), scale, left), self.looks)
            found.append((p, -drop / dof, Place(shape.channel, shape.covariate, shape.kind, p)))
        return [place for _, _, place in sorted(found, key=lambda f: f[:2])]

    def best(self) -> tuple[Pattern, Place] | None:
        """The most significant pattern."""
        found = self.places()
        if not found:
            return None
        one = found[0]
        pattern = next(s for s in self.shapes if (s.channel, s.covariate, s.kind) ==
                       (one.channel, one.covariate, one.shape))
        return pattern, one


def described(
    field: Field, shapes: Sequence[Pattern], level: float, seed: int, first: Screen | None = None,
    known: float | None = None,
) -> tuple[list[Place], Field, int]:
    """Describe what is left over by patterns, one after another, as long as one is significant.

    first: the screen of this field where it is there already; known: the number of independent looks, if known.
    Returns the patterns, the field without them, and how many looks one of them was chosen from.
    """
    found: list[Place] = []
    looks = 1
    for _ in range(MOST):
        # What was taken changes the number of independent looks but little; simulating it is the dear part.
        screen = Screen(field, shapes, seed, known) if first is None else first
        first, known = None, screen.looks
        looks = max(looks, len(screen.shapes))
        best = screen.best()
        if best is None or best[1].p_value > level:
            break
        pattern, place = best
        signal = field.outside(pattern.whole(len(field.residual)))
        left, values, right = np.linalg.svd(signal, full_matrices=False)
        seen = values > 1e-6 * max(values[0], 1e-300)
        frame = left[:, seen]
        found.append(_with_figures(place, pattern, (right[seen].T / values[seen]) @ (frame.T @ field.residual)))
        field = field.taking(frame)
    return found, field, looks


def _with_figures(place: Place, pattern: Pattern, estimate: Array) -> Place:
    """Amplitude and phase of a harmonic, or the root mean square of a function, in units of the noise."""
    rms = float(np.sqrt(np.mean((pattern.columns @ estimate) ** 2)))
    figures = {"rms_over_u": rms}
    if pattern.kind.startswith("harmonic") and len(estimate) == 2:
        figures = {"amplitude_over_u": float(np.hypot(*estimate)),
                   "phase_deg": float(np.degrees(np.arctan2(estimate[1], estimate[0])))}
    return Place(place.channel, place.covariate, place.shape, place.p_value, figures)
