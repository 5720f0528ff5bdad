"""Transcription of a declared problem for a solver that differentiates by itself: row functions mapped by CasADi."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array, Mixing
from calib.system import System, Term, Values
from calib.uncertainty import Weighting

Index = NDArray[np.int64]


class MappedRows:
    """One bound model mapped over its rows: stored numbers are parameters, local coordinates are gathered from x."""

    def __init__(self, term: Term, step: ca.MX, position: Index):
        self.term, self.n, self.dim = term, term.n, term.dim
        symbols, wanted = term.traced.symbols, term.any_free
        ambient, local = ca.vertcat(*symbols.ambient), ca.vertcat(*symbols.local)
        moving = ca.vertcat(*[s for s, want in zip(symbols.local, wanted, strict=True) if want])
        place = [position[c] for c, want in zip(term.columns, wanted, strict=True) if want]
        self._place = np.concatenate(place, axis=1) if place else np.zeros((self.n, 0), dtype=np.int64)
        everywhere = np.concatenate([np.full((self.n, s.shape[0]), -1) if c is None else position[c]
                                     for c, s in zip(term.columns, symbols.local, strict=True)], axis=1)
        self.parameter = ca.MX.sym("stored", ambient.shape[0], self.n)
        gathered = ca.reshape(ca.vertcat(step, 0.0)[everywhere.ravel().tolist()], local.shape[0], self.n)
        self._inputs, self._size = (self.parameter, gathered), step.shape[0]
        prediction = ca.densify(term.traced.prediction)
        weights = ca.SX.sym("weights", self.dim)
        second = ca.hessian(ca.dot(weights, prediction), moving)[0]
        first = ca.jacobian(prediction, moving)
        self._jacobian = ca.Function("jacobian", [ambient, local], [ca.densify(ca.vec(first))])
        self._hessian = ca.Function("hessian", [ambient, local, weights], [ca.densify(ca.vec(second))])
        self.is_curved = second.nnz() > 0
        self.prediction = ca.vec(ca.Function("prediction", [ambient, local], [prediction]).map(self.n)(*self._inputs))

    def stored(self, values: Values) -> Array:
        """Stored numbers and data of every row, (width, n)."""
        return np.array([np.broadcast_to(column, (self.n,)) for column in self.term._inputs(values)])

    def jacobian(self) -> ca.MX:
        """Derivatives (n dim, p) of the prediction with respect to the free steps."""
        if not self._place.shape[1]:
            return ca.MX(self.n * self.dim, self._size)
        entries = ca.vec(self._jacobian.map(self.n)(*self._inputs))
        rows = np.arange(self.n)[:, None, None] * self.dim + np.arange(self.dim)
        rows = np.broadcast_to(rows, (self.n, self._place.shape[1], self.dim))
        columns = np.broadcast_to(self._place[:, :, None], rows.shape)
        return _assembled(entries, rows, columns, (self.n * self.dim, self._size))

    def curvature(self, weights: ca.MX) -> ca.MX:
        """Hessian (p, p) of weights (n dim,) times the prediction."""
        entries = ca.vec(self._hessian.map(self.n)(*self._inputs, ca.reshape(weights, self.dim, self.n)))
        shape = (self.n, self._place.shape[1], self._place.shape[1])
        rows, columns = (np.broadcast_to(p, shape) for p in (self._place[:, None, :], self._place[:, :, None]))
        return _assembled(entries, rows, columns, (self._size, self._size))


def _assembled(entries: ca.MX, rows: Index, columns: Index, shape: tuple[int, int]) -> ca.MX:
    """A sparse matrix from entries at rows and columns; several at one place add up, those at -1 are left out."""
    rows, columns = rows.ravel(), columns.ravel()
    kept = np.flatnonzero((rows >= 0) & (columns >= 0))
    places, slot = np.unique(columns[kept] * np.int64(shape[0]) + rows[kept], return_inverse=True)
    starts = np.searchsorted(places, np.arange(shape[1] + 1) * np.int64(shape[0]))
    pattern = ca.Sparsity(*shape, starts.tolist(), (places % shape[0]).tolist())
    entered = np.searchsorted(kept, np.arange(len(rows) + 1))
    gather = ca.Sparsity(len(places), len(rows), entered.tolist(), slot.tolist())
    return ca.MX(pattern, ca.mtimes(ca.DM(gather, 1.0), entries)) if len(places) else ca.MX(*shape)


def _whitening(mixings: Sequence[Mixing], n: int, dim: int) -> ca.DM:
    """The row operations of one group as a sparse matrix over its n dim readings."""
    from scipy import sparse
    pieces = []
    for mixing in mixings:
        if mixing.matrix.ndim == 2:
            weights, targets = mixing.matrix[:, :, None], mixing.matrix.shape[1]
            source = (mixing.rows[:, :1] * dim + np.arange(dim))[:, :, None]
        else:
            weights, targets = mixing.matrix, mixing.matrix.shape[1]
            source = (mixing.rows[:, :, None] * dim + np.arange(dim)).reshape(len(weights), 1, -1)
        rows = np.broadcast_to(np.arange(len(weights) * targets).reshape(len(weights), targets, 1), weights.shape)
        places = (rows.ravel(), np.broadcast_to(source, weights.shape).ravel())
        pieces.append(sparse.csc_matrix((weights.ravel(), places), (len(weights) * targets, n * dim)))
    return ca.DM(sparse.vstack(pieces, format="csc"))


class Transcription:
    """The declared problem in scaled local coordinates x around stored values, as CasADi functions.

    rows, conditions: the observations and constraints, mapped; problem, functions: what `nlpsol` takes.
    curved: whether the Hessian holds the curvature of the predictions. Parameters, in this order: scale of x (p,),
    units of the conditions (m,), readings, and the stored numbers of every row.
    """

    def __init__(self, system: System, weightings: Sequence[Weighting], curved: bool):
        layout = system.layout
        x, scale = ca.MX.sym("x", len(layout.free_columns)), ca.MX.sym("scale", len(layout.free_columns))
        self.rows = [MappedRows(t, scale * x, layout.position) for t in system.terms]
        self.conditions = [MappedRows(t, scale * x, layout.position) for t in system.conditions]
        self.condition_count = sum(c.n * c.dim for c in self.conditions)
        readings = [ca.MX.sym("readings", r.n * r.dim) for r in self.rows]
        unit = ca.MX.sym("unit", self.condition_count)
        stored = [ca.vec(r.parameter) for r in (*self.rows, *self.conditions)]
        parameters = ca.vertcat(scale, unit, *readings, *stored)
        whitenings = [_whitening(w.whitening, r.n, r.dim) for r, w in zip(self.rows, weightings, strict=True)]
        residuals = [ca.mtimes(w, y - r.prediction) for w, y, r in zip(whitenings, readings, self.rows, strict=True)]
        objective = 0.5 * sum((ca.sumsqr(r) for r in residuals), ca.MX(0.0))
        excess = ca.vertcat(*[c.prediction for c in self.conditions], ca.MX(0, 1)) / unit
        spread = ca.diag(scale)
        whole = [ca.mtimes([w, r.jacobian(), spread]) for w, r in zip(whitenings, self.rows, strict=True)]
        gradient = -sum((ca.mtimes(j.T, r) for j, r in zip(whole, residuals, strict=True)), ca.MX.zeros(x.shape[0]))
        slopes = ca.mtimes([ca.diag(1.0 / unit), ca.vertcat(*[c.jacobian() for c in self.conditions],
                                                            ca.MX(0, x.shape[0])), spread])
        weight, multipliers = ca.MX.sym("weight"), ca.MX.sym("multipliers", self.condition_count)
        bend = ca.MX(x.shape[0], x.shape[0])
        if curved:
            for w, residual, r in zip(whitenings, residuals, self.rows, strict=True):
                if r.is_curved:
                    bend += r.curvature(-weight * ca.mtimes(w.T, residual))
        begin = 0
        for c in self.conditions:
            if c.is_curved:
                bend += c.curvature((multipliers / unit)[begin:begin + c.n * c.dim])
            begin += c.n * c.dim
        lagrangian = weight * sum((ca.mtimes(j.T, j) for j in whole), ca.MX(x.shape[0], x.shape[0]))
        lagrangian += ca.mtimes([spread, bend, spread])
        self.problem = {"x": x, "p": parameters, "f": objective, "g": excess}
        self.functions = {
            "grad_f": ca.Function("nlp_grad_f", [x, parameters], [objective, gradient]),
            "jac_g": ca.Function("nlp_jac_g", [x, parameters], [excess, slopes]),
            "hess_lag": ca.Function("nlp_hess_l", [x, parameters, weight, multipliers], [ca.triu(lagrangian)])}
