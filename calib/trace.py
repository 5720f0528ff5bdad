"""Trace: a model called once with CasADi symbols becomes row functions that know nothing of the number of rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from calib.effect import Effect, slots_of
from calib.errors import DeclarationError
from calib.observations import BoundModel, Observations
from calib.rows import Program
from calib.unknown import Unknown


@dataclass(frozen=True)
class Source:
    """Where one argument of a row function comes from: the kind of an unknown, or the shape of data."""

    name: str
    kind: type[Unknown] | None
    width: int
    freedom: int
    shape: tuple[int, ...]


def sources_of(bound: BoundModel) -> tuple[Source, ...]:
    """The arguments of a bound model as sources, without effects."""
    return tuple(
        Source(a.name, type(a.unknown), a.unknown.width, a.unknown.freedom, ())
        if a.unknown is not None
        else Source(a.name, None, a.data.shape[1], 0, a.shape)
        for a in bound.arguments
    )


class _Symbols:
    """CasADi symbols of one row: stored numbers and local coordinates of unknowns, and data."""

    def __init__(self, sources: Sequence[Source], representatives: Sequence[Unknown | None]):
        self.ambient = [ca.SX.sym(s.name, s.width) for s in sources]
        self.local = [ca.SX.sym(f"{s.name}_step", s.freedom) for s in sources]
        self.arguments = []
        for source, ambient, local, unknown in zip(sources, self.ambient, self.local, representatives, strict=True):
            if unknown is not None:
                self.arguments.append(unknown.argument(ambient, local))
            else:
                self.arguments.append(ca.reshape(ambient, *source.shape) if len(source.shape) == 2 else ambient)


class Traced:
    """One model with the effects attached to it, as an expression of stored numbers, steps and data.

    dim: number of components; affine: whether the prediction is affine in every unknown (and all are vectors).
    """

    def __init__(
        self,
        bound: BoundModel,
        sources: tuple[Source, ...],
        effects: tuple[Effect, ...],
        parameters: tuple[Unknown, ...],
        covariates: tuple[str, ...],
    ):
        own = sources_of(bound)
        unknowns = [a.unknown for a in bound.arguments] + list(parameters) + [None] * len(covariates)
        self.sources = sources
        self.symbols = _Symbols(sources, unknowns)
        given = dict(zip([s.name for s in own], self.symbols.arguments, strict=False))
        steps = dict(zip(effects, self.symbols.arguments[len(own) :], strict=False))
        known = dict(zip(covariates, self.symbols.arguments[len(own) + len(effects) :], strict=True))
        taps = {
            slot: _tap(slot, bound, [e for e in effects if e.slot == slot], steps, given, known)
            for slot in dict.fromkeys(e.slot for e in effects)
        }
        self.prediction = _column(bound, bound.model(*given.values(), **taps))
        self.dim = self.prediction.shape[0]
        steps_all = ca.vertcat(*self.symbols.local)
        self.affine = all(s.kind is None or s.kind.kind == "vector" for s in sources) and bool(
            ca.is_linear(self.prediction, steps_all)
        )
        self._programs: dict[object, Program] = {}

    def _at_rest(self, expressions: Sequence[ca.SX]) -> list[ca.SX]:
        """Expressions with all steps zero: solvers move the stored numbers instead."""
        return ca.substitute(
            list(expressions), self.symbols.local, [ca.SX.zeros(s.shape[0]) for s in self.symbols.local]
        )

    def program(self, wanted: tuple[bool, ...]) -> Program:
        """Row function of stored numbers and data that returns the prediction and its derivatives.

        wanted: for each source whether its derivatives are asked for. The result lists the prediction, then for each
        wanted source its (dim, freedom) derivatives column by column.
        """
        if wanted not in self._programs:
            at_rest = self._at_rest([self.prediction, *self.derivatives(self._wanted(wanted))])
            flat = ca.vertcat(*[ca.densify(ca.vec(e)) for e in at_rest])
            self._programs[wanted] = Program([ca.vertcat(*self.symbols.ambient)], flat)
        return self._programs[wanted]

    def _wanted(self, wanted: tuple[bool, ...]) -> list[ca.SX]:
        return [local for local, want in zip(self.symbols.local, wanted, strict=True) if want]

    def derivatives(self, steps: list[ca.SX]) -> list[ca.SX]:
        """Derivatives of the prediction in each of the steps, as every row function has them."""
        widths = [s.shape[0] for s in steps]
        if sum(widths) <= 4 * self.dim:
            return [ca.jacobian(self.prediction, s) for s in steps]
        # A chain with many parameters: a sweep backwards from each component shares what forward sweeps repeat.
        return ca.horzsplit(ca.jacobian(self.prediction, ca.vertcat(*steps)), np.cumsum([0, *widths]).tolist())

    def bend(self, wanted: tuple[bool, ...]) -> Program:
        """Row function of stored numbers, data, weights (dim,) and a direction in the wanted steps (F,): the Hessian of
        weights'prediction times the direction (F,)."""
        key = ("bend", wanted)
        if key not in self._programs:
            weights, steps = ca.SX.sym("weights", self.dim), ca.vertcat(*self._wanted(wanted))
            direction = ca.SX.sym("direction", steps.shape[0])
            slope = ca.gradient(ca.dot(weights, self.prediction), steps)
            flat = ca.densify(self._at_rest([ca.jtimes(slope, steps, direction)])[0])
            self._programs[key] = Program([ca.vertcat(*self.symbols.ambient), weights, direction], flat)
        return self._programs[key]

    def curvature(self, wanted: tuple[bool, ...]) -> Program:
        """Row function of stored numbers, data and weights (dim,): the Hessian of weights'prediction in the wanted
        steps."""
        key = ("curvature", wanted)
        if key not in self._programs:
            weights = ca.SX.sym("weights", self.dim)
            steps = ca.vertcat(*self._wanted(wanted))
            hessian = ca.hessian(ca.dot(weights, self.prediction), steps)[0]
            flat = ca.densify(ca.vec(self._at_rest([hessian])[0]))
            self._programs[key] = Program([ca.vertcat(*self.symbols.ambient), weights], flat)
        return self._programs[key]

    def bent_pairs(self, wanted: tuple[bool, ...]) -> tuple[list[int], list[int]]:
        """Places among the wanted steps whose second derivatives may differ from zero, as two lists."""
        weights, steps = ca.SX.sym("weights", self.dim), ca.vertcat(*self._wanted(wanted))
        hessian = ca.hessian(ca.dot(weights, self.prediction), steps)[0]
        first, second = hessian.sparsity().get_triplet()
        return first, second

    def function(self) -> ca.Function:
        """CasADi function (stored numbers and data, steps) -> prediction, for solvers that differentiate themselves."""
        return ca.Function(
            "row", [ca.vertcat(*self.symbols.ambient), ca.vertcat(*self.symbols.local)], [ca.densify(self.prediction)]
        )


def _column(bound: BoundModel, returned: Any) -> ca.SX:
    parts = returned if isinstance(returned, (list, tuple)) else [returned]
    try:
        column = ca.vertcat(*[ca.vec(ca.SX(p)) for p in parts])
    except (NotImplementedError, TypeError, RuntimeError) as error:
        raise DeclarationError(
            f"{bound.what} '{bound.name}': the model {bound.model_name} returned "
            f"{type(returned).__name__}, which is not a number, a column or a list of numbers."
        ) from error
    if column.shape[0] == 0:
        raise DeclarationError(f"{bound.what} '{bound.name}': the model {bound.model_name} returned nothing.")
    return column


def _tap(
    slot: str,
    bound: BoundModel,
    effects: list[Effect],
    steps: dict[Effect, Any],
    given: dict[str, Any],
    known: dict[str, Any],
) -> Callable[..., Any]:
    """The function at a slot: the nominal value plus the contributions of all effects, which all see the nominal
    one."""

    def tap(value: Any, **quantities: Any) -> Any:
        available = {**known, **given, **quantities}
        total = value
        for effect in effects:
            missing = [name for name in effect.inputs if name not in available]
            if missing:
                raise DeclarationError(
                    f"effect '{effect.label}' needs '{missing[0]}', which {bound.what} '{bound.name}' "
                    f"does not offer at slot '{slot}'; there are: {', '.join(sorted(available))}."
                )
            values = ca.vertsplit(steps[effect]) if steps[effect].shape[0] > 1 else [steps[effect]]
            total = total + effect.function(value, effect.bundle(*values), **{n: available[n] for n in effect.inputs})
        return total

    return tap


@lru_cache(maxsize=512)
def _offered(
    model: Callable[..., Any], sources: tuple[Source, ...], unknowns: tuple[Unknown | None, ...]
) -> dict[str, frozenset[str]]:
    heard: dict[str, set[str]] = {}

    def listen(slot: str) -> Callable[..., Any]:
        def ear(value: Any, **quantities: Any) -> Any:
            heard.setdefault(slot, set()).update(quantities)
            return value

        return ear

    model(*_Symbols(sources, unknowns).arguments, **{slot: listen(slot) for slot in slots_of(model)})
    return {slot: frozenset(names) for slot, names in heard.items()}


def offered(observations: Observations) -> dict[str, frozenset[str]]:
    """For each slot that the model really calls, the names an effect may ask for there."""
    unknowns = tuple(a.unknown for a in observations.arguments)
    names = {a.name for a in observations.arguments} | set(numeric_covariates(observations))
    return {
        slot: quantities | names
        for slot, quantities in _offered(observations.model, sources_of(observations), unknowns).items()
    }


def numeric_covariates(observations: Observations) -> tuple[str, ...]:
    """Names of the covariates that hold numbers."""
    return tuple(name for name, values in observations.covariates.items() if np.asarray(values).dtype.kind in "fiub")


@lru_cache(maxsize=512)
def _trace(
    model: Callable[..., Any],
    sources: tuple[Source, ...],
    effects: tuple[Effect, ...],
    covariates: tuple[str, ...],
    kept: _Kept,
) -> Traced:
    return Traced(kept.bound, sources, effects, kept.parameters, covariates)


class _Kept:
    """What a trace needs besides its key; all instances are equal, so that the key alone decides."""

    def __init__(self, bound: BoundModel, parameters: tuple[Unknown, ...]):
        self.bound, self.parameters = bound, parameters

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Kept)

    def __hash__(self) -> int:
        return 0


def trace(
    bound: BoundModel,
    effects: tuple[Effect, ...] = (),
    parameters: tuple[Unknown, ...] = (),
    covariates: tuple[str, ...] = (),
) -> Traced:
    """Trace a bound model with effects; the same model, kinds of arguments and effects are traced once.

    effects with their parameter unknowns; covariates: names of those that effects read, as further data.
    """
    sources = (
        sources_of(bound)
        + tuple(Source(e.label, type(u), u.width, u.freedom, ()) for e, u in zip(effects, parameters, strict=True))
        + tuple(Source(name, None, 1, 0, ()) for name in covariates)
    )
    return _trace(bound.model, sources, effects, covariates, _Kept(bound, parameters))
