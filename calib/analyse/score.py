"""Score tests: what held effects would explain of the residuals, from one linearisation and without a refit."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array
from calib.effect import Effect
from calib.factor import DenseFactor, null_space
from calib.linearisation import Linearisation
from calib.unknown import Selection, Unknown

ROUNDING = 1e-7  # by which a basis of many directions may miss being orthonormal
NEVER = 1e-6  # u over all readings that the largest usual parameter shows, below which its derivatives are rounding
INVISIBLE = 1e-7  # share of a candidate's signal that the free unknowns leave over, below which it cannot be seen


@dataclass(frozen=True)
class Candidate:
    """One held effect, or one key of it, that may be freed: its parameters as columns of the linearisation; parts:
    those that can be told, where not all can."""

    effect: Effect
    unknown: Unknown
    instance: int
    columns: tuple[int, ...]
    parts: tuple[int, ...] | None = None

    @property
    def key(self) -> str:
        """Key of the covariate that it belongs to; empty where the effect has none."""
        return self.unknown.keys[self.instance] if self.effect.per is not None else ""

    @property
    def channel(self) -> str:
        """Where it acts."""
        return self.effect.channel_at(self.key)

    @property
    def label(self) -> str:
        """Name and channel, such as `drift (reading)`."""
        return f"{self.effect.name} ({self.channel})"

    @property
    def selection(self) -> Selection:
        """What to free in the problem."""
        return Selection(self.unknown, np.array(self.instance), self.parts)

    def told_by(self, signal: Array, count: int) -> Candidate:
        """The same with as many parts as a signal (n, k) beside the unknowns has directions: those that show most, each
        beside the ones before it, at usual sizes."""
        from scipy.linalg import qr

        if count in (0, signal.shape[1]):
            return self
        usual = np.array([p.plausible[1] for p in self.effect.parameters])
        order = qr(signal * usual, mode="r", pivoting=True)[1]
        return replace(self, parts=tuple(sorted(int(i) for i in order[:count])))


@dataclass(frozen=True)
class Score:
    """Score test of one candidate.

    statistic: drop of v'Pv that a linear refit would give; dof; p_value: of the candidate being absent, uncorrected;
    separability: smallest share of its signal that the free unknowns cannot imitate, 0 to 1;
    step, u: one-step estimate and standard uncertainty of its parameters (k,), SI.
    """

    candidate: Candidate
    statistic: float
    dof: int
    p_value: float
    separability: float
    step: Array
    u: Array


def candidates(fit: Linearisation) -> list[Candidate]:
    """All held effects of a linearisation, one candidate for each key."""
    found = []
    for effect, unknown in fit.effects.items():
        for instance in range(unknown.count):
            begin = fit.layout.offset[unknown] + instance * unknown.freedom
            columns = range(begin, begin + unknown.freedom)
            if not fit.layout.free[list(columns)].any():
                found.append(Candidate(effect, unknown, instance, tuple(columns)))
    return found


@dataclass(frozen=True)
class Field:
    """Whitened residuals outside the reach of the free unknowns, and what the candidates leave there.

    residual (n,): of all scalar readings; redundancy (n,): share of an error of each reading that shows in it;
    basis (n, q): orthonormal directions that are taken; signals: for each candidate its columns (n, k) outside the
    basis; sizes: for each candidate the norms (k,) of its columns before anything was taken away; drawn: simulated
    residuals by seed and number, kept as long as the basis is.
    """

    residual: Array
    redundancy: Array
    basis: Array
    signals: tuple[Array, ...]
    sizes: tuple[Array, ...]
    drawn: dict[tuple[int, int], Array] = dataclasses.field(default_factory=dict, repr=False, compare=False)

    @property
    def dof(self) -> int:
        """Degrees of freedom."""
        return len(self.residual) - self.basis.shape[1]

    @cached_property
    def squares(self) -> float:
        """Sum of squared whitened residuals."""
        return float(self.residual @ self.residual)

    def outside(self, columns: Array) -> Array:
        """Columns (n, k) less their part within the basis."""
        once = columns - self.basis @ (self.basis.T @ columns)
        return once - self.basis @ (self.basis.T @ once)

    def _outside_each(self, columns: Sequence[Array]) -> tuple[Array, ...]:
        """Each of several sets of columns less its part within the basis, all in one multiplication."""
        if not columns:
            return ()
        splits = np.cumsum([c.shape[1] for c in columns])[:-1]
        return tuple(np.split(self.outside(np.concatenate(columns, axis=1)), splits, axis=1))

    def with_signals(self, columns: Sequence[Array]) -> Field:
        """The same with other candidates, given by their whole columns (n, k)."""
        return replace(
            self,
            signals=self._outside_each(columns),
            sizes=tuple(np.linalg.norm(c, axis=0) for c in columns),
        )

    @cached_property
    def frames(self) -> tuple[Array, ...]:
        """Orthonormal basis (n, k') of what can be seen of each candidate; k' is 0 where nothing can."""
        return tuple(orthonormal(s, z) for s, z in zip(self.signals, self.sizes, strict=True))

    @cached_property
    def statistics(self) -> tuple[Array, NDArray[np.int64]]:
        """Drop of the sum of squares for each candidate, and its degrees of freedom."""
        drops = np.array([float(np.sum((f.T @ self.residual) ** 2)) for f in self.frames])
        return drops, np.array([f.shape[1] for f in self.frames], dtype=np.int64)

    def taking(self, frame: Array) -> Field:
        """The field after further orthonormal directions (n, k), outside the basis, are taken."""
        if not frame.shape[1]:
            return self
        basis = np.concatenate([self.basis, frame], axis=1)

        def less(columns: Array) -> Array:
            return columns - frame @ (frame.T @ columns)

        return Field(
            less(self.residual),
            np.maximum(self.redundancy - np.sum(frame**2, axis=1), 0.0),
            basis,
            tuple(less(s) for s in self.signals),
            self.sizes,
        )

    def alone(self, places: Sequence[int]) -> Array:
        """What an error of each of some readings alone would show in the residuals (n, k)."""
        unit = np.zeros((len(self.residual), len(places)))
        unit[list(places), np.arange(len(places))] = 1.0
        return self.outside(unit)

    def without(self, places: Sequence[int]) -> Field:
        """The field without some of the readings: each of them is one direction that is taken."""
        return self.taking(orthonormal(self.alone(places), np.ones(len(places)))) if len(places) else self

    def draw(self, seed: int, count: int) -> Array:
        """Residuals (n, count) as they would be if nothing but the stated noise were there, the same for a seed."""
        if (seed, count) not in self.drawn:
            noise = np.random.default_rng(seed).standard_normal((len(self.residual), count))
            self.drawn[seed, count] = noise - self.basis @ (self.basis.T @ noise)
        return self.drawn[seed, count]


def orthonormal(columns: Array, sizes: Array) -> Array:
    """Orthonormal basis of columns (n, k), leaving out what is no more than rounding of columns of the given sizes
    (k,)."""
    scaled = columns / np.where(sizes > 0, sizes, 1.0)
    left, values, _ = np.linalg.svd(scaled, full_matrices=False)
    return left[:, values > INVISIBLE]


def field_of(fit: Linearisation, chosen: Sequence[Candidate]) -> Field:
    """The field of a linearisation: whitened residuals and the signals of candidates outside the free unknowns."""
    _, residual = fit.rows
    basis = _orthonormal_rows(fit)
    residual = residual - basis @ (basis.T @ residual)
    redundancy = np.maximum(1.0 - np.sum(basis**2, axis=1), 0.0)
    return Field(residual, redundancy, basis, (), ()).with_signals(columns_of(fit, chosen))


def columns_of(fit: Linearisation, chosen: Sequence[Candidate]) -> list[Array]:
    """Whitened derivatives (n, k) by the parameters of each candidate; zero where they are no more than rounding, as
    those by a sine of three turns at every sixth of a turn."""
    if not chosen:
        return []
    together = fit.held_columns([c for one in chosen for c in one.columns])
    usual = np.array([p.plausible[1] for one in chosen for p in one.effect.parameters])
    together[:, np.linalg.norm(together, axis=0) * usual < NEVER] = 0.0
    return np.split(together, np.cumsum([len(one.columns) for one in chosen])[:-1], axis=1)


def _orthonormal_rows(fit: Linearisation) -> Array:
    """Orthonormal basis (n, q) of what the free unknowns can do within the conditions."""
    from scipy.linalg.lapack import dpotrf, dtrtri

    derivatives, _ = fit.rows
    if isinstance(fit.factor, DenseFactor):
        return np.asarray(np.linalg.qr(derivatives @ fit.factor.root)[0])
    # Of many unknowns the derivatives are sparse: their normal matrix is cheap, and so is the product with its root.
    scale = np.where(fit.sizes > 0, fit.sizes, 1.0)
    normal = (derivatives.T @ derivatives).toarray() / np.outer(scale, scale)
    free = null_space(fit.conditions.matrix / scale, fit.conditions.target)[0] if len(fit.conditions.target) else None
    corner, failed = dpotrf(normal if free is None else free.T @ normal @ free, lower=0)
    if failed:
        dense = derivatives.toarray() / scale
        return np.asarray(np.linalg.qr(dense if free is None else dense @ free)[0])
    root = dtrtri(np.triu(corner))[0]
    basis = np.asarray(derivatives @ ((root if free is None else free @ root) / scale[:, None]))
    probe = np.cos(np.arange(basis.shape[1]))
    if np.max(np.abs(basis.T @ (basis @ probe) - probe)) > ROUNDING:
        return np.asarray(np.linalg.qr(basis)[0])
    return basis


def scores(fit: Linearisation, chosen: Sequence[Candidate] | None = None) -> list[Score]:
    """Score tests of held effects, largest first.

    fit: a linearisation of an estimate; chosen: candidates (all held effects if not given).
    T = (A'r)' V^-1 (A'r), V = A'A - A'J (J'J)^-1 J'A; separability is the smallest eigenvalue of (V, A'A).
    Source: Rao's score test; DESIGN section 3.
    """
    from scipy.special import gammaincc

    chosen = candidates(fit) if chosen is None else list(chosen)
    columns = columns_of(fit, chosen)
    field = field_of(fit, ()).with_signals(columns)
    result = []
    for one, whole, signal, size in zip(chosen, columns, field.signals, field.sizes, strict=True):
        frame = orthonormal(signal, size)
        statistic, dof = float(np.sum((frame.T @ field.residual) ** 2)), frame.shape[1]
        separability = _separability(signal, whole, size)
        step, u = np.zeros(len(one.columns)), np.full(len(one.columns), np.inf)
        if dof == len(one.columns):
            inverse = np.linalg.pinv(signal)
            step, u = inverse @ field.residual, np.sqrt(np.einsum("ij,ij->i", inverse, inverse))
        p_value = float(gammaincc(dof / 2, statistic / 2)) if dof else 1.0
        result.append(Score(one, statistic, dof, p_value, separability, step, u))
    return sorted(result, key=lambda s: s.p_value)


def _separability(signal: Array, whole: Array, size: Array) -> float:
    scale = np.where(size > 0, size, 1.0)
    corner = np.asarray(np.linalg.qr(whole / scale, mode="r"))
    if not np.all(np.abs(np.diag(corner)) > 1e-12):
        return 0.0
    return float(np.linalg.svd(signal / scale @ np.linalg.inv(corner), compute_uv=False)[-1] ** 2)
