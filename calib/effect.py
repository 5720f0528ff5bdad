"""Effects: recipes for named physical contributions that act at the slots of a model."""

from __future__ import annotations

import inspect
from collections import namedtuple
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calib.errors import DeclarationError


def direct(value: Any, **quantities: Any) -> Any:
    """Hand a physical quantity through unchanged: the default of every slot."""
    return value


def slots_of(model: Callable[..., Any]) -> tuple[str, ...]:
    """Names of the keyword-only arguments of a model, its slots."""
    return tuple(
        name
        for name, parameter in inspect.signature(model).parameters.items()
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY
    )


def positional_of(model: Callable[..., Any]) -> tuple[str, ...]:
    """Names of the positional arguments of a model."""
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return tuple(name for name, parameter in inspect.signature(model).parameters.items() if parameter.kind in kinds)


def hands_slots_to(*inner: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Declare that a model hands its `**slots` on to other models, so that their slots are its own."""

    def decorate(model: Callable[..., Any]) -> Callable[..., Any]:
        signature = inspect.signature(model)
        own = [p for p in signature.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
        names = {p.name for p in own}
        for function in inner:
            for slot in slots_of(function):
                if slot not in names:
                    names.add(slot)
                    own.append(inspect.Parameter(slot, inspect.Parameter.KEYWORD_ONLY, default=direct))
        model.__signature__ = signature.replace(parameters=own)  # type: ignore[attr-defined]
        return model

    return decorate


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect: display unit, plausible magnitudes (low, high) in SI, and bounds in SI."""

    name: str
    unit: str
    plausible: tuple[float, float]
    lower: float = -np.inf
    upper: float = np.inf


@dataclass(frozen=True, eq=False)
class Effect:
    """A named physical contribution, added to the value at one slot; it starts at zero and held.

    name, channel: how answers call it (channel: the slot if not given); slot: where it acts.
    function: (value, parameters, further inputs) -> contribution in SI; the further argument names are names of
    quantities handed by the slot, model arguments or covariates.
    parameters: what may be estimated; per: covariate whose every key has parameters of its own.
    groups: the observation groups it may act in (None: wherever slot and inputs exist); source: where it is described.
    Raises DeclarationError where the function cannot take (value, parameters).
    """

    name: str
    slot: str
    function: Callable[..., Any]
    parameters: tuple[Parameter, ...] = ()
    channel: str = ""
    per: str | None = None
    groups: Sequence[str] | None = None
    source: str = ""
    inputs: tuple[str, ...] = field(init=False)
    bundle: type = field(init=False, repr=False)

    def __post_init__(self) -> None:
        names = list(inspect.signature(self.function).parameters)
        if len(names) < 2:
            raise DeclarationError(
                f"Effect '{self.name}': its function must take (value, parameters, ...inputs); "
                f"it takes ({', '.join(names)})."
            )
        if not self.parameters:
            raise DeclarationError(f"Effect '{self.name}' has no parameter; without one there is nothing to estimate.")
        object.__setattr__(self, "parameters", tuple(self.parameters))
        object.__setattr__(self, "channel", self.channel or self.slot)
        object.__setattr__(self, "inputs", tuple(names[2:]))
        object.__setattr__(self, "bundle", namedtuple("parameters", [p.name for p in self.parameters]))

    def channel_at(self, key: str) -> str:
        """Where it acts at one key: the channel with the key in place of `{key}`, or the key; without one, the
        channel."""
        if self.per is None:
            return self.channel
        return self.channel.replace("{key}", key) if "{key}" in self.channel else key

    @property
    def label(self) -> str:
        """Name and channel, such as `drift (reading)`; where each key has its own, `drift (each station circle)`."""
        return f"{self.name} ({self.channel.replace('{key}', f'each {self.per}')})"
