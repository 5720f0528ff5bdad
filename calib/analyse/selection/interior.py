"""Primal-dual interior point on the weights of a relaxation, for one smooth criterion or the worst of several values.

The worst of values is a variable of its own: the smallest s above all losses of pieces, or, for the largest eigenvalue
of F M^-1 F', the largest t with M - t F'F positive semidefinite, with a dual matrix (the direction of Helmberg, Rendl,
Vanderbei and Wolkowicz, 1996, in which rows enter by products of pairs only).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib.analyse.selection.limits import Limits
from calib.analyse.selection.objective import Objective
from calib.analyse.selection.terms import OfFunctions, Support, Tangent, flattened, projected, summed
from calib.analyse.selection.terms import Pieces as TermPieces
from calib.analyse.selection.worst import Largest, mean_of
from calib.blocks import Array

STEPS = 80
REGULAR = 1e-8       # smallest over largest pivot of a root that counts as regular
NEAREST = 1e-13      # of a weight to its bounds
RISE = 2.0           # of a smooth loss in one step
CLIMB = 0.1          # of the worst of several values in one step
ROOM = 0.3           # of the worst value above the largest piece at the start, in the logarithm


@dataclass(frozen=True)
class Newton:
    """One Newton system: matrix (v, v) and right side (v,), over the undecided weights and the worst value, if any."""

    matrix: Array
    right: Array


class Front(Protocol):
    """The criterion at some weights, with what multiplies its pieces."""

    @property
    def loss(self) -> float:
        """Of the criterion itself at the weights."""

    @property
    def unit(self) -> float:
        """Of the prices of limits, in relative changes of the criterion."""

    @property
    def support(self) -> Support:
        """A linear function above exp(-loss), from the multipliers alone."""

    @property
    def complementarity(self) -> tuple[float, int]:
        """Sum of the products of slack and multiplier, and how many they are."""

    def gradient(self) -> Array:
        """Of the Lagrangian, over the undecided weights and the worst value."""

    def newton(self, aim: float) -> Newton:
        """System that leads to products of size `aim`."""

    def reach(self, move: Array, aim: float) -> tuple[float, float]:
        """Largest steps of slack and multipliers."""

    def moved(self, weights: Array, move: Array, step: float, other: float, aim: float) -> Front | None:
        """The same after a step; None where it overshoots. Raises LinAlgError where the information is singular."""


def inverse_of(information: Array) -> Array:
    """Inverse of a positive definite matrix; LinAlgError where it is not."""
    lower = np.linalg.cholesky(information)
    diagonal = np.diag(lower)
    if not diagonal.min() > REGULAR * diagonal.max():      # what is inverted beyond this is rounding
        raise np.linalg.LinAlgError("the information is singular to rounding")
    root = np.linalg.inv(lower)
    return np.asarray(root.T @ root)


def front_of(objective: Objective, weights: Array, undecided: NDArray[np.int64]) -> Front:
    """The criterion at strictly feasible weights (n,), to move on the undecided ones."""
    # One function has one variance, which is its own trace and largest eigenvalue; a matrix of slack does not mind that
    # the best information is often singular.
    if all(isinstance(term, OfFunctions) and len(term.matrix) == 1 for term in objective.terms):
        single = tuple(Largest(t.rows, t.fixed, t.functions) for t in objective.terms)
        return Matrices.begun(type(objective)(single), weights, undecided)
    if any(isinstance(term, Largest) for term in objective.terms):
        return Matrices.begun(objective, weights, undecided)
    if objective.single:
        return Smooth(objective, weights, undecided)
    return Pieces.begun(objective, weights, undecided)


class Smooth:
    """One smooth loss."""

    complementarity = (0.0, 0)
    unit = 1.0

    def __init__(self, objective: Objective, weights: Array, undecided: NDArray[np.int64]):
        self.objective, self.undecided = objective, undecided
        self.term = objective.terms[0]
        self.tangent: Tangent = self.term.tangent(inverse_of(self.term.information(weights)))
        self.loss = self.tangent.loss
        self._gain = projected(self.term.rows[undecided], self.tangent.spread)

    @property
    def support(self) -> Support:
        return self.term.support(self.tangent.spread)

    def gradient(self) -> Array:
        return -self._gain

    def newton(self, aim: float) -> Newton:
        return Newton(self.tangent.curvature(self.term.rows[self.undecided]), self._gain)

    def reach(self, move: Array, aim: float) -> tuple[float, float]:
        return np.inf, np.inf

    def moved(self, weights: Array, move: Array, step: float, other: float, aim: float) -> Smooth | None:
        ahead = Smooth(self.objective, weights, self.undecided)
        # Far from the centre of the path a full step may overshoot: the loss must not rise steeply.
        return ahead if ahead.loss <= self.loss + RISE else None


class Pieces:
    """Losses of several pieces (m,) below one worst value, each with a multiplier; they add up to one."""

    unit = 1.0

    def __init__(self, objective: Objective, weights: Array, undecided: NDArray[np.int64], aim: float | None,
                 multipliers: Array | None):
        self.objective, self.undecided = objective, undecided
        self.pieces = [t.pieces(inverse_of(t.information(weights))) for t in objective.terms]
        losses = np.concatenate([p.losses for p in self.pieces])
        self.loss = float(losses.max())
        self.worst = self.loss + ROOM if aim is None else above(losses, aim)
        self.slack = np.maximum(self.worst - losses, 1e-15)      # at the very end rounding may leave none
        if multipliers is None:
            multipliers = 1.0 / self.slack
            multipliers = multipliers / multipliers.sum()
        self.multipliers = multipliers
        self.complementarity = (float(self.slack @ self.multipliers), len(losses))
        self._gains: Array | None = None

    @staticmethod
    def begun(objective: Objective, weights: Array, undecided: NDArray[np.int64]) -> Pieces:
        """With multipliers that begin near the centre."""
        return Pieces(objective, weights, undecided, None, None)

    @property
    def gains(self) -> Array:
        """Decrease of every loss (m, u) by each undecided candidate."""
        if self._gains is None:
            self._gains = np.concatenate([p.gains(t.rows[self.undecided])
                                          for p, t in zip(self.pieces, self.objective.terms, strict=True)])
        return self._gains

    def _split(self, values: Array) -> list[Array]:
        return list(np.split(values, np.cumsum([len(p.losses) for p in self.pieces])[:-1]))

    @property
    def support(self) -> Support:
        return support_of_pieces(self.objective, self.pieces, self._split(self.multipliers))

    def gradient(self) -> Array:
        return np.append(-self.multipliers @ self.gains, 1.0 - float(np.sum(self.multipliers)))

    def newton(self, aim: float) -> Newton:
        stiff, push = self.multipliers / self.slack, aim / self.slack
        u = len(self.undecided)
        matrix = np.zeros((u + 1, u + 1))
        for piece, term, part in zip(self.pieces, self.objective.terms, self._split(self.multipliers), strict=True):
            matrix[:u, :u] += piece.curvature(term.rows[self.undecided], part)
        # The curvature of a logarithm has -J'J in it; both products of the gains are one.
        matrix[:u, :u] += self.gains.T @ (self.gains * (stiff - self.multipliers)[:, None])
        matrix[:u, u] = matrix[u, :u] = stiff @ self.gains
        matrix[u, u] = float(np.sum(stiff))
        return Newton(matrix, np.append(push @ self.gains, float(np.sum(push)) - 1.0))

    def _change(self, move: Array, aim: float) -> tuple[Array, Array]:
        change = move[-1] + self.gains @ move[:-1]
        return change, (aim - self.multipliers * change) / self.slack - self.multipliers

    def reach(self, move: Array, aim: float) -> tuple[float, float]:
        return np.inf, largest_step(self.multipliers, self._change(move, aim)[1])      # the worst value follows

    def moved(self, weights: Array, move: Array, step: float, other: float, aim: float) -> Pieces | None:
        _, change = self._change(move, aim)
        ahead = Pieces(self.objective, weights, self.undecided, aim, self.multipliers + other * change)
        return ahead if ahead.worst <= self.worst + CLIMB else None


def support_of_pieces(objective: Objective, pieces: Sequence[TermPieces], multipliers: Sequence[Array]) -> Support:
    """The linear function above exp(-loss) that multipliers (m,) of the pieces of each term prove."""
    parts = []
    for term, piece, each in zip(objective.terms, pieces, multipliers, strict=True):
        # Shares in the logarithms of variances, made into shares in the variances themselves.
        mixture = each * np.exp(piece.losses.max() - piece.losses)
        parts.append((float(np.sum(each)), float(np.sum(each * piece.losses) / np.sum(each)),
                      term.support(piece.spread(each), mixture)))
    return mean_of(parts)


class Matrices:
    """Largest eigenvalues of several configurations below one 1/t: slack M - t F'F and a dual matrix for each."""

    def __init__(self, objective: Objective, weights: Array, undecided: NDArray[np.int64], t: float, scale: float,
                 duals: list[Array] | None):
        self.objective, self.undecided, self.t, self.scale = objective, undecided, t, scale
        self.unit = 1.0 / t
        informations = [term.information(weights) for term in objective.terms]
        self.outer = [scale * (term.functions.T @ term.functions) for term in objective.terms]
        self.slack = [m - t * f for m, f in zip(informations, self.outer, strict=True)]
        self.inverse = [inverse_of(s) for s in self.slack]
        self.loss = _largest(objective, informations)
        if duals is None:
            whole = sum(float(np.sum(i * f)) for i, f in zip(self.inverse, self.outer, strict=True))
            duals = [i / whole for i in self.inverse]
        self.duals = duals
        self.complementarity = (sum(float(np.sum(s * y)) for s, y in zip(self.slack, duals, strict=True)),
                                sum(len(s) for s in self.slack))

    @staticmethod
    def begun(objective: Objective, weights: Array, undecided: NDArray[np.int64]) -> Matrices:
        """With t below the value of the criterion, which is scaled to one there."""
        scale = float(np.exp(-_largest(objective, [term.information(weights) for term in objective.terms])))
        return Matrices(objective, weights, undecided, float(np.exp(-ROOM)), scale, None)

    @property
    def support(self) -> Support:
        return mean_of([(float(np.sum(y * f)), self.loss, term.support(y))
                        for term, y, f in zip(self.objective.terms, self.duals, self.outer, strict=True)])

    def gradient(self) -> Array:
        pull = sum(projected(term.rows[self.undecided], y)
                   for term, y in zip(self.objective.terms, self.duals, strict=True))
        return np.append(-np.asarray(pull), sum(float(np.sum(y * f)) for y, f in zip(self.duals, self.outer)) - 1.0)

    def newton(self, aim: float) -> Newton:
        u = len(self.undecided)
        matrix, right = np.zeros((u + 1, u + 1)), np.zeros(u + 1)
        right[u] = 1.0
        for term, y, f, inverse in zip(self.objective.terms, self.duals, self.outer, self.inverse, strict=True):
            rows = term.rows[self.undecided]
            flat = flattened(rows)
            matrix[:u, :u] += summed((flat @ y @ flat.T) * (flat @ inverse @ flat.T), u)
            across = y @ f @ inverse
            matrix[:u, u] -= projected(rows, 0.5 * (across + across.T))
            matrix[u, u] += float(np.sum((f @ across) * np.eye(len(f))))
            right[:u] += aim * projected(rows, inverse)
            right[u] -= aim * float(np.sum(inverse * f))
        matrix[u, :u] = matrix[:u, u]
        return Newton(matrix, right)

    def _change(self, move: Array, aim: float) -> list[tuple[Array, Array]]:
        changes = []
        for term, y, f, inverse in zip(self.objective.terms, self.duals, self.outer, self.inverse, strict=True):
            flat = flattened(term.rows[self.undecided])
            change = flat.T @ (flat * np.repeat(move[:-1], term.rows.shape[1])[:, None]) - move[-1] * f
            turned = y @ change @ inverse
            changes.append((change, aim * inverse - y - 0.5 * (turned + turned.T)))
        return changes

    def reach(self, move: Array, aim: float) -> tuple[float, float]:
        changes = self._change(move, aim)
        return (min(_matrix_step(s, d) for s, (d, _) in zip(self.slack, changes, strict=True)),
                min(_matrix_step(y, d) for y, (_, d) in zip(self.duals, changes, strict=True)))

    def moved(self, weights: Array, move: Array, step: float, other: float, aim: float) -> Matrices | None:
        changes = self._change(move, aim)
        return Matrices(self.objective, weights, self.undecided, self.t + step * move[-1], self.scale,
                        [y + other * d for y, (_, d) in zip(self.duals, changes, strict=True)])


def _largest(objective: Objective, informations: Sequence[Array]) -> float:
    """Logarithm of the largest eigenvalue of all F M^-1 F'."""
    found = []
    for term, information in zip(objective.terms, informations, strict=True):
        covariance = term.functions @ inverse_of(information) @ term.functions.T
        found.append(float(np.log(np.linalg.eigvalsh(covariance)[-1])))
    return max(found)


def interior(objective: Objective, limits: Limits, weights: Array, undecided: NDArray[np.int64], tolerance: float
             ) -> tuple[Array, Array, Front]:
    """Move the undecided weights to the best ones, the others kept; returns weights, prices of limits and the front."""
    weights, matrix = weights.copy(), limits.matrix[:, undecided]
    w = weights[undecided]
    fixed = weights.copy()
    fixed[undecided] = 0.0
    slack = np.maximum(limits.most - limits.matrix @ fixed - matrix @ w, 1e-12)
    front = front_of(objective, weights, undecided)
    active = np.any(matrix > 0, axis=1)
    u = len(w)
    product, count = front.complementarity
    mu = product / count if count else 0.1 / max(u, 1)
    price = np.where(active, mu / slack, 0.0)
    low, high = mu / w, mu / (1.0 - w)
    total = 2 * u + int(active.sum())
    step = other = 1.0
    for _ in range(STEPS):
        product, count = front.complementarity
        products = float(w @ low + (1.0 - w) @ high + slack @ price) + product
        dual = front.gradient()
        dual[:u] += matrix.T @ price - low + high
        if products < tolerance and np.max(np.abs(dual), initial=0.0) < tolerance:
            break
        # After a short step the path is first followed where it is, before it is asked to go on.
        aim = (0.15 if min(step, other) > 0.5 else 0.6) * products / (total + count)
        system = front.newton(aim)
        normal, right = system.matrix, system.right
        normal[np.arange(u), np.arange(u)] += low / w + high / (1.0 - w)
        normal[:u, :u] += matrix.T @ (matrix * (price / slack)[:, None])
        right[:u] += aim / w - aim / (1.0 - w) - matrix.T @ np.where(active, aim / slack, 0.0)
        if not (np.isfinite(normal).all() and np.isfinite(right).all()):
            break
        move = _solve(normal, right)
        use = matrix @ move[:u]
        d_price = np.where(active, (aim - slack * price + price * use) / slack, 0.0)
        d_low = (aim - w * low - low * move[:u]) / w
        d_high = (aim - (1.0 - w) * high + high * move[:u]) / (1.0 - w)
        try:
            far, wide = front.reach(move, aim)
        except np.linalg.LinAlgError:      # a dual matrix on the edge: rounding has the last word
            break
        near = 0.8 + 0.19 * min(step, other) if count else 0.99      # of the way to the walls
        step = min(1.0, near * min(largest_step(w, move[:u]), largest_step(1.0 - w, -move[:u]),
                                   largest_step(slack, -use), far))
        other = min(1.0, near * min(largest_step(price, d_price), largest_step(low, d_low),
                                    largest_step(high, d_high), wide))
        ahead = None
        while ahead is None:
            trial = weights.copy()
            trial[undecided] = w + step * move[:u]
            try:
                ahead = front.moved(trial, move, step, other, aim)
            except np.linalg.LinAlgError:
                ahead = None
            if ahead is None:
                step *= 0.5
            if step < 1e-7:
                return weights, price * front.unit, front
        weights, front = trial, ahead
        w = np.clip(weights[undecided], NEAREST, 1.0 - NEAREST)
        slack = np.maximum(slack - step * use, 1e-14)
        price, low, high = price + other * d_price, low + other * d_low, high + other * d_high
    return weights, price * front.unit, front


def _solve(normal: Array, right: Array) -> Array:
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal * scale[:, None] * scale[None, :]
    try:
        return np.asarray(scale * cho_solve(cho_factor(scaled), scale * right))
    except LinAlgError:
        scaled[np.diag_indices(len(scaled))] += 1e-10
        return np.asarray(scale * np.linalg.lstsq(scaled, scale * right, rcond=1e-12)[0])


def above(losses: Array, aim: float) -> float:
    """The s above all losses (m,) at which aim / (s - losses) adds up to one: where a barrier of size aim leaves it."""
    top = float(losses.max())
    low, high = aim, aim * len(losses)
    s = low
    for _ in range(60):
        terms = aim / (top + s - losses)
        total = float(np.sum(terms))
        if abs(total - 1.0) < 1e-10 or high - low < 1e-14 * high:
            break
        low, high = (s, high) if total > 1.0 else (low, s)
        # The reciprocal of the sum is nearly a straight line in s.
        ahead = s + (1.0 - 1.0 / total) * total**2 / float(np.sum(terms**2)) * aim
        s = ahead if low < ahead < high else 0.5 * (low + high)
    return top + s


def largest_step(value: Array, change: Array) -> float:
    """Largest step at which value + step * change stays positive."""
    falling = change < -1e-200 * (1.0 + value)      # beyond that a quotient overflows
    return float(np.min(-value[falling] / change[falling], initial=np.inf))


def _matrix_step(value: Array, change: Array) -> float:
    root = np.linalg.inv(np.linalg.cholesky(value))
    lowest = float(np.linalg.eigvalsh(root @ change @ root.T)[0])
    return -1.0 / lowest if lowest < 0 else np.inf
