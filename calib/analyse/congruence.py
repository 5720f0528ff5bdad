"""Two epochs of the same points: whether they are one figure, which points moved, and what would have been seen.

Points count as one rigid figure until the test says otherwise; then the point whose leaving explains most is taken out,
and the rest is tested again; who left too early comes back. Nothing depends on the datum of either epoch.
Source: Pelzer (1971), Zur Analyse geodaetischer Deformationsmessungen; Niemeier (2008), Ausgleichungsrechnung, 13.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.analyse.multiplicity import holm
from calib.blocks import Array

ROUNDING = 1e-13    # what rounding leaves of a variance that is zero, beside the largest
POWER = 0.8         # with which a movement called detectable is found


@dataclass(frozen=True)
class Shifts:
    """Coordinates of common points, second epoch less first.

    points, parts: (m,) key and x, y or z of each coordinate; shift (m,) and covariance (m, m), in any datum; datum:
    (m, k) directions in which either epoch leaves all points free to go; scatter: None where the covariance is as
    stated, else the variance factor of both epochs together and its degrees of freedom, by which it is multiplied.
    """

    points: Sequence[str]
    parts: Sequence[str]
    shift: Array
    covariance: Array
    datum: Array
    scatter: tuple[float, int] | None = None

    def at(self, keys: Sequence[str]) -> NDArray[np.bool_]:
        """Which coordinates (m,) belong to some points."""
        return np.isin(list(self.points), list(keys))

    def in_datum_of(self, keys: Sequence[str]) -> tuple[Array, Array]:
        """Shifts and covariance with the datum on some points (S-transformation; Baarda, 1973)."""
        chosen = self.datum * self.at(keys)[:, None]
        change = np.eye(len(self.shift)) - self.datum @ np.linalg.pinv(chosen.T @ self.datum) @ chosen.T
        factor = 1.0 if self.scatter is None else self.scatter[0]
        return change @ self.shift, factor * change @ self.covariance @ change.T

    def p_value(self, quantity: float, dof: int) -> float:
        """Probability of a larger quantity where nothing moved: chi-squared, or Fisher's F with an estimated factor."""
        from scipy.special import chdtrc, fdtrc

        if dof <= 0:
            return 1.0
        if self.scatter is None:
            return float(chdtrc(dof, quantity))
        return float(fdtrc(dof, self.scatter[1], quantity / dof))


@dataclass(frozen=True)
class Step:
    """One test: the points taken as stable, the test quantity, its degrees of freedom and the probability of more."""

    stable: tuple[str, ...]
    quantity: float
    dof: int
    p_value: float


@dataclass(frozen=True)
class Congruence:
    """What moved between two epochs.

    points; parts; shift, u (n, d) [m]: second less first in the datum of the stable points, not a number where a point
    has no such coordinate; covariance: (d, d) of each point; p_value, adjusted (n,): of each point against the stable
    others, alone and among n (Holm); detectable (n,) [m]: movement in its worst direction that is found with a
    probability of 0.8; stable, moved: keys; steps: the tests in order; level: of each; settled: whether the last of
    them left a figure; block: whether those that moved keep a figure of their own.
    """

    points: tuple[str, ...]
    parts: tuple[str, ...]
    shift: Array
    u: Array
    covariance: tuple[Array, ...]
    p_value: Array
    adjusted: Array
    detectable: Array
    stable: tuple[str, ...]
    moved: tuple[str, ...]
    steps: tuple[Step, ...]
    level: float
    settled: bool
    block: bool

    def sentences(self) -> list[str]:
        """What moved, in words."""
        if not self.moved:
            return [f"No point moved (p = {self.steps[-1].p_value:.2g} for {len(self.stable)} points as one figure)."]
        if not self.settled:
            return [f"The points are not one figure (p = {self.steps[0].p_value:.2g}), and no part of them that is "
                    "large enough to be a datum is: which moved cannot be told from these epochs. More points that "
                    "stand still would tell."]
        said = [
            f"Point '{key}' moved by " + ", ".join(
                f"{part} {1e3 * s:+.{_decimals(u)}f} mm (u {1e3 * u:.{_decimals(u)}f})" for part, s, u in
                zip(self.parts, self.shift[self.points.index(key)], self.u[self.points.index(key)], strict=True)
                if np.isfinite(s)) + "."
            for key in self.moved
        ]
        if self.block:
            names = ", ".join(f"'{key}'" for key in self.moved)
            said.append(f"{names} keep their figure among themselves: they moved as a block, or all the others did.")
        return said


def _decimals(u: float) -> int:
    """Decimals [mm] of two digits of u [m], two at least."""
    return 2 if not u > 0 else max(2, 1 - int(np.floor(np.log10(1e3 * u))))


def congruence(shifts: Shifts, level: float = 0.01) -> Congruence:
    """Find the points that moved.

    shifts: of the common points; level: of each test.
    Returns what moved. Shifts without covariance or redundancy to test them make no point move.
    """
    keys = list(dict.fromkeys(shifts.points))
    stable, steps = list(keys), []
    while True:
        steps.append(_tested(shifts, stable))
        if steps[-1].p_value >= level or not _enough(shifts, stable):
            break
        without = [_tested(shifts, [k for k in stable if k != key]) for key in stable]
        stable.pop(int(np.argmin([one.quantity - 2.0 * one.dof for one in without])))
    settled = steps[-1].p_value >= level
    while settled and len(stable) < len(keys):
        back = [_tested(shifts, [k for k in keys if k in stable or k == key]) for key in keys if key not in stable]
        best = max(back, key=lambda one: one.p_value)
        if best.p_value < level:
            break
        steps.append(best)
        stable = list(best.stable)
    moved = tuple(key for key in keys if key not in stable)
    together = _tested(shifts, moved) if len(moved) > 1 else None
    block = together is not None and together.dof > 0 and together.p_value >= level
    return _described(shifts, keys, stable, moved, tuple(steps), level, settled, block)


def _enough(shifts: Shifts, stable: Sequence[str]) -> bool:
    """Whether the stable points without the largest of them still hold the datum and one test besides."""
    sizes = [int(shifts.at([key]).sum()) for key in stable]
    return len(stable) > 1 and sum(sizes) - max(sizes) > shifts.datum.shape[1]


def _tested(shifts: Shifts, stable: Sequence[str]) -> Step:
    """Whether some points form one rigid figure in both epochs."""
    moved, matrix = shifts.in_datum_of(stable)
    inside = shifts.at(stable)
    datum = shifts.datum[inside]
    dof = int(inside.sum()) - (int(np.linalg.matrix_rank(datum)) if datum.size else 0)
    quantity, dof = _quadratic(moved[inside], matrix[np.ix_(inside, inside)], dof)
    return Step(tuple(stable), quantity, dof, shifts.p_value(quantity, dof))


def _quadratic(shift: Array, matrix: Array, most: int) -> tuple[float, int]:
    """shift' matrix^+ shift over at most so many of its strongest directions, and how many there are."""
    values, axes = np.linalg.eigh(matrix)
    strongest = np.argsort(values)[len(values) - most :]
    strongest = strongest[values[strongest] > ROUNDING * values.max(initial=0.0)]
    along = axes[:, strongest].T @ shift
    return float(np.sum(along**2 / values[strongest])), len(strongest)


def _described(
    shifts: Shifts, keys: list[str], stable: list[str], moved: tuple[str, ...], steps: tuple[Step, ...], level: float,
    settled: bool, block: bool,
) -> Congruence:
    parts = tuple(part for part in "xyz" if part in shifts.parts)
    place, covariances = np.full((len(keys), len(parts)), np.nan), []
    u, p, detectable = np.full_like(place, np.nan), np.ones(len(keys)), np.full(len(keys), np.nan)
    shift, matrix = shifts.in_datum_of(stable)
    for i, key in enumerate(keys):
        own = np.flatnonzero(shifts.at([key]))
        columns = [parts.index(shifts.parts[int(k)]) for k in own]
        place[i, columns] = shift[own]
        u[i, columns] = np.sqrt(np.maximum(np.diag(matrix)[own], 0.0))
        whole = np.zeros((len(parts), len(parts)))
        whole[np.ix_(columns, columns)] = matrix[np.ix_(own, own)]
        covariances.append(whole)
        p[i], detectable[i] = _alone(shifts, [other for other in stable if other != key], own, level / len(keys))
    return Congruence(tuple(keys), parts, place, u, tuple(covariances), p, holm(p), detectable, tuple(stable), moved,
                      steps, level, settled, block)


def _alone(shifts: Shifts, others: Sequence[str], own: NDArray[np.int64], level: float) -> tuple[float, float]:
    """One point against the stable others: probability of a larger shift, and the movement that would be found [m]."""
    from scipy.special import chdtri, chndtrinc

    shift, matrix = shifts.in_datum_of(others)
    held = shifts.datum[shifts.at(others)]
    if shifts.datum.size and np.linalg.matrix_rank(held) < np.linalg.matrix_rank(shifts.datum):
        return 1.0, float("nan")
    block = matrix[np.ix_(own, own)]
    quantity, dof = _quadratic(shift[own], block, len(own))
    if not dof:
        return 1.0, float("nan")
    far = float(chndtrinc(chdtri(dof, level), dof, 1.0 - POWER))
    return shifts.p_value(quantity, dof), float(np.sqrt(far * np.linalg.eigvalsh(block)[-1]))
