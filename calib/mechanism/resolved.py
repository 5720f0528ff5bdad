"""A model with the effects of a problem in it, as a function of their parameters: for derived quantities and
constraints."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca

from calib.effect import Effect, positional_of, slots_of
from calib.errors import DeclarationError
from calib.observations import Quantity
from calib.problem import Problem
from calib.unknown import Unknown


def resolved(model: Callable[..., Any], problem: Problem, function: Callable[..., Any],
             known: Mapping[str, float] | None = None) -> tuple[Callable[..., Any], tuple[Unknown, ...]]:
    """A function of a model in which the effects of a problem act, as a function of their parameters too.

    model: with slots; problem: with the effects attached, free or held; function: `(model, *arguments)`, where it
    receives the model without slots; known: values of covariates that effects ask for, such as {"approach": 1.0}.
    Returns the function of (*arguments, *parameters) and the unknowns to bind to its last arguments.
    Raises DeclarationError where an effect asks for something that neither the slot nor `known` offers.
    """
    acting = [a for a in problem.attached if a.effect.slot in slots_of(model)]
    shared = next((a for a in acting if a.keys), None)
    if shared is not None:
        raise DeclarationError(f"effect '{shared.effect.label}' has parameters for each '{shared.effect.per}'; a "
                               "derived quantity "
                               "cannot tell which are meant. Leave it out of the problem, or write the quantity by "
                               "hand.")
    own = positional_of(function)[1:]

    def with_parameters(*arguments: Any) -> Any:
        values = dict(zip((a.effect for a in acting), arguments[len(own):], strict=True))
        taps = {slot: _tap(slot, [e for e in values if e.slot == slot], values, known or {})
                for slot in dict.fromkeys(e.slot for e in values)}
        return function(lambda *given: model(*given, **taps), *arguments[:len(own)])
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    names = [*own, *(f"parameters_{i}" for i in range(len(acting)))]
    signature = inspect.Signature([inspect.Parameter(n, kind) for n in names])
    with_parameters.__signature__ = signature      # type: ignore[attr-defined]
    with_parameters.__name__ = getattr(function, "__name__", "function")
    return with_parameters, tuple(a.unknown for a in acting)


def quantity(problem: Problem, name: str, model: Callable[..., Any], function: Callable[..., Any], *arguments: Any,
             known: Mapping[str, float] | None = None, **labels: Any) -> Quantity:
    """A derived quantity of a model in which the effects of a problem act.

    problem, model, function, known: as of `resolved`; arguments: bound to those of the function after the model;
    labels: unit, parts and keys, as of Quantity.
    """
    with_parameters, unknowns = resolved(model, problem, function, known)
    return Quantity(name, with_parameters, *arguments, *unknowns, **labels)


def _tap(slot: str, effects: Sequence[Effect], values: Mapping[Effect, Any],
         known: Mapping[str, float]) -> Callable[..., Any]:
    def tap(value: Any, **quantities: Any) -> Any:
        available, total = {**known, **quantities}, value
        for effect in effects:
            missing = [name for name in effect.inputs if name not in available]
            if missing:
                raise DeclarationError(f"effect '{effect.label}' asks for '{missing[0]}', which the slot '{slot}' "
                                       f"does not offer; give it as known={{'{missing[0]}': ...}}.")
            column = values[effect]
            parameters = ca.vertsplit(column) if column.shape[0] > 1 else [column]
            total = total + effect.function(value, effect.bundle(*parameters),
                                            **{n: available[n] for n in effect.inputs})
        return total
    return tap
