"""Where to measure, continuously: positions of targets, tracker stations, angles as the unknowns of a declared problem.

Readings with whitened derivatives J(places) give quantities F x with the covariance F (J'J)^-1 F'. With J'J = L L' its
trace is the sum of squares of L^-1 F', so the best places are a least-squares problem: every element of L^-1 F' is
"read" as zero with u = 1, and v'Pv at the minimum is the sum of the variances.
Source: Pukelsheim (2006), Optimal Design of Experiments, chapter 3 (information matrices of parameter systems).
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from calib.analyse.covariance import covariance
from calib.blocks import Array
from calib.errors import CalibrationError, InputError, RankDefect
from calib.linearisation import Group, Linearisation, linearise, linearise_system
from calib.observations import Argument, Observations, Quantity, prior
from calib.problem import Problem
from calib.solve.estimate import solve
from calib.solve.ipopt import Ipopt
from calib.solve.method import Method
from calib.system import System, Term
from calib.unknown import Unknown

LARGEST = 40       # free unknowns: the root of their information is written out
LOOSE = 100.0      # u of a place about where it begins, in ranges: it decides between equally good ones only


def as_settings(problem: Problem, group: str, ranges: Mapping[str, tuple[ArrayLike, ArrayLike]], unit: str = "m"
                ) -> tuple[Problem, tuple[Unknown, ...]]:
    """The same problem with known arguments of one group as held unknowns, one instance a row, that may be placed.

    problem; group: of the observations; ranges: {argument of its model: (lower, upper)} in SI; unit: for display.
    Returns the problem and the unknowns. Raises InputError where there is no such group or argument.
    """
    found = [o for o in problem.observations if o.group == group]
    if not found:
        raise InputError(f"{problem.name} has no group '{group}'; there are "
                         f"{', '.join(o.group for o in problem.observations if not o.is_prior)}")
    old = found[0]
    known = {a.name: a for a in old.arguments if a.unknown is None and len(a.shape) <= 1}
    for name in ranges:
        if name not in known:
            raise InputError(f"'{group}' has no known argument '{name}'; there are {', '.join(known) or 'none'}")
    settings = {}
    for name, (lower, upper) in ranges.items():
        shape = (old.n, known[name].data.shape[1])
        settings[name] = Unknown(name, np.array(np.broadcast_to(known[name].data, shape)), unit,
                                 lower=np.broadcast_to(lower, shape), upper=np.broadcast_to(upper, shape))
    every = np.arange(old.n)
    new = object.__new__(Observations)
    new.__dict__.update(old.__dict__, arguments=tuple(
        Argument(a.name, settings[a.name], every) if a.name in settings else a for a in old.arguments))
    again = problem._replaced(lambda o: new if o is old else o)
    return again.hold(*settings.values()), tuple(settings.values())


def declare(problem: Problem, places: Sequence[Any], *what: Any, start: Mapping[Any, Any] | None = None) -> Problem:
    """The search for the best places as a problem of its own, for Ipopt().

    problem: the plan, at whose start values (or start) derivatives are taken; places: held unknowns of it that may be
    moved within their bounds (positions of targets, of stations, angles); what: quantities of one unit whose
    variances are added up. Every place also has a prior about where it begins, with u of a hundred ranges, which
    only decides between places that are equally good. The quantity `root of trace` is the root of that sum.
    Raises InputError where there is nothing to move, units differ or the search is too large, RankDefect where the
    places to begin with do not determine the quantities.
    """
    system = System(problem)
    values = dict(system.layout.start())
    for key, value in (start or {}).items():
        unknown = problem.select(key).unknown
        values[unknown] = unknown.store(value)
    moved = [problem.select(place).unknown for place in places]
    _refuse(problem, moved)
    fit = linearise_system(system, values)
    functions = fit.functions(*what)
    if len(set(functions.units)) > 1:
        raise InputError(f"the best places: {' and '.join(sorted(set(functions.units)))} do not add; name quantities "
                         "of one unit")
    matrix, wanted = fit.rows[0].toarray(), fit.free_part(functions.derivatives)
    size = fit.sizes
    scaled, aim = matrix / size, wanted / size
    begin = aim @ np.linalg.pinv(scaled, 1e-12)
    if not np.allclose(begin @ scaled, aim, atol=1e-8 * np.abs(aim).max()) or fit.factor.defect:
        raise RankDefect(f"{problem.name}: the places to begin with do not determine all that is free; begin elsewhere")
    if aim.shape[1] > LARGEST:
        raise InputError(f"the best places: {aim.shape[1]} free unknowns are more than {LARGEST}; choose among "
                         "candidates with `calib.select`")
    unit_of_trace = float(np.linalg.norm(begin))
    rows = _Rows(system, fit, values, moved, size)
    instances = [(unknown, k) for unknown in moved for k in range(unknown.count)]

    def spread(*here: Any) -> Any:
        derivatives = rows.derivatives({key: ca.vertcat(one) for key, one in zip(instances, here, strict=True)})
        return ca.vec(_forward(ca.chol(derivatives.T @ derivatives).T, ca.DM(aim.T / unit_of_trace)))

    def root(*here: Any) -> Any:
        return unit_of_trace * ca.norm_2(spread(*here))

    for model in (spread, root):
        model.__signature__ = inspect.Signature([    # type: ignore[attr-defined]
            inspect.Parameter(f"place_{i + 1}", inspect.Parameter.POSITIONAL_ONLY) for i in range(len(instances))])
    bound = [u[k] if u.count > 1 else u for u, k in instances]
    return Problem(
        [Observations(spread, *bound, readings=np.zeros((1, aim.size)), u=1.0, group="spread"),
         *(prior(u, values[u].reshape(u.shape), LOOSE * _span(u)) for u in moved)],
        quantities=[Quantity("root of trace", root, *bound, unit=functions.units[0])],
        name=f"places for {problem.name}")


def _forward(lower: Any, right: Any) -> Any:
    """Solution of a lower triangular system, row by row."""
    solved: list[Any] = []
    for i in range(lower.shape[0]):
        rest = right[i, :]
        for j in range(i):
            rest = rest - lower[i, j] * solved[j]
        solved.append(rest / lower[i, i])
    return ca.vertcat(*solved)


def _span(unknown: Unknown) -> Array:
    """Range (count, dim) of each place, its size or one where it has none."""
    span = unknown.upper - unknown.lower
    return np.where(np.isfinite(span) & (span > 0), span, np.maximum(np.abs(unknown.ambient), 1.0))


def _refuse(problem: Problem, moved: Sequence[Unknown]) -> None:
    if not moved:
        raise InputError("the best places: name at least one held unknown that may be moved")
    for unknown in moved:
        if unknown.kind != "vector" or not problem.is_held(unknown).all():
            raise InputError(f"the best places: '{unknown.name}' is {'not held' if unknown.kind == 'vector' else 'a '}"
                             f"{'' if unknown.kind == 'vector' else unknown.kind}; what may be moved is a held vector, "
                             "known where it is")
    for quantity in problem.quantities:
        seen = [u.name for u in quantity.unknowns if u in moved]
        if seen:
            raise InputError(f"the best places: quantity '{quantity.name}' is a function of '{seen[0]}', which is to "
                             "be moved")


class _Rows:
    """Whitened derivatives of all readings with respect to the free unknowns, as expressions of the moved places."""

    def __init__(self, system: System, fit: Linearisation, values: Mapping[Unknown, Array], moved: Sequence[Unknown],
                 size: Array):
        self.system, self.values, self.moved, self.size = system, values, tuple(moved), size
        self.position = system.layout.position
        self.whitening = [_whitening(group) for group in fit.groups]
        self.functions = [self._function(term) for term in system.terms]

    def _function(self, term: Term[Any]) -> Any:
        """(stored numbers and data of one row) -> derivatives (dim, steps of the wanted arguments)."""
        symbols, wanted = term.traced.symbols, term.any_free
        local = ca.vertcat(*[s for s, want in zip(symbols.local, wanted, strict=True) if want])
        jacobian = ca.jacobian(term.traced.prediction, local)
        at_rest = ca.substitute([jacobian], symbols.local, [ca.SX.zeros(s.shape[0]) for s in symbols.local])[0]
        return ca.Function("row", [ca.vertcat(*symbols.ambient)], [ca.densify(at_rest)])

    def derivatives(self, places: Mapping[tuple[Unknown, int], Any]) -> Any:
        """(N, p), for the place of each instance of what is moved."""
        blocks = []
        for term, function, whitening in zip(self.system.terms, self.functions, self.whitening, strict=True):
            rows = []
            for i in range(term.n):
                one = function(ca.vertcat(*[self._input(feed, i, places) for feed in term.feeds]))
                columns = np.concatenate([c[i] for c, want in zip(term.columns, term.any_free, strict=True) if want])
                row = ca.SX(term.dim, len(self.size))
                for k, place in enumerate(self.position[columns]):
                    if place >= 0:
                        row[:, int(place)] += one[:, k] / float(self.size[place])
                rows.append(row)
            blocks.append(ca.DM(whitening) @ ca.vertcat(*rows))
        return ca.vertcat(*blocks)

    def _input(self, feed: Any, i: int, places: Mapping[tuple[Unknown, int], Any]) -> Any:
        if feed.unknown in self.moved:
            return places[feed.unknown, int(feed.index[i])]
        numbers = feed.data[i if len(feed.data) > 1 else 0] if feed.unknown is None else \
            self.values[feed.unknown][feed.index[i]]
        return ca.DM(np.asarray(numbers, dtype=float))


def _whitening(group: Group) -> Array:
    """The whitening of a group as one matrix (N, n dim)."""
    n, dim = group.residual.shape
    pieces = []
    for mixing in group.weighting.whitening:
        k = mixing.rows.shape[1]
        full = np.zeros((len(mixing.rows), mixing.matrix.shape[1], n * dim))
        each = np.arange(len(mixing.rows))
        for j in range(k):
            for c in range(dim):
                column = mixing.rows[:, j] * dim + c
                if mixing.matrix.ndim == 2:
                    full[each, c, column] = mixing.matrix[:, c]
                else:
                    full[each, :, column] = mixing.matrix[:, :, j * dim + c]
        pieces.append(full.reshape(-1, n * dim))
    return np.concatenate(pieces)


@dataclass(frozen=True)
class Placed:
    """The best places that were found.

    value: root of the sum of the variances, SI; begin: the same for the places to begin with; places: {unknown: where,
    (count, dim) SI}; found: how many of the starts led there within a millionth; starts.
    """

    value: float
    begin: float
    places: Mapping[Unknown, Array]
    found: int
    starts: int


def _drawn(unknown: Unknown, generator: np.random.Generator) -> Array:
    """Random places within the bounds of an unknown, about its start where there are none."""
    spread = np.maximum(np.abs(unknown.ambient), 1.0)
    low = np.where(np.isfinite(unknown.lower), unknown.lower, unknown.ambient - spread)
    high = np.where(np.isfinite(unknown.upper), unknown.upper, unknown.ambient + spread)
    return generator.uniform(low, high)


def best_places(problem: Problem, places: Sequence[Any], *what: Any, starts: int, seed: int,
                method: Method | None = None) -> Placed:
    """Search the best places from where they are and from random ones within their bounds.

    problem, places, what: as for `declare`; starts: how many; seed: of the random ones; method: Ipopt() if none.
    Raises CalibrationError where no start leads to a minimum, and what `declare` raises.
    """
    generator = np.random.default_rng(seed)
    moved = [problem.select(place).unknown for place in places]
    results: list[tuple[float, dict[Unknown, Array]]] = []
    begin = np.nan
    for k in range(starts):
        where = {u: (u.ambient if k == 0 else _drawn(u, generator)).reshape(u.shape) for u in moved}
        try:
            search = declare(problem, places, *what, start=where)
            estimate = solve(search, method or Ipopt(), {u: where[u] for u in moved})
        except (RankDefect, np.linalg.LinAlgError):
            continue
        if k == 0:
            begin = float(np.linalg.norm(covariance(linearise(problem, where), *what).u))
        if estimate.certificate.passed:
            results.append((float(np.ravel(estimate["root of trace"])[0]),
                            {u: np.asarray(estimate[u]).reshape(u.count, -1) for u in moved}))
    if not results:
        raise CalibrationError(f"none of {starts} starts led to a minimum; try more starts or another seed")
    value, best = min(results, key=lambda one: one[0])
    return Placed(value, begin, best, sum(v < value * (1 + 1e-6) for v, _ in results), starts)
