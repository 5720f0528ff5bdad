"""Every module of `problems` and `instruments` that offers an example, found by looking: a new one needs no listing."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache
from types import ModuleType

import numpy as np

import instruments
import problems
from calib import Problem
from calib.effect import Effect
from calib.errors import DeclarationError
from calib.system import System, Values


@cache
def modules() -> tuple[ModuleType, ...]:
    """All modules of the two packages."""
    found = []
    for package in (instruments, problems):
        names = [m.name for m in pkgutil.walk_packages(package.__path__, package.__name__ + ".")]
        found += [importlib.import_module(name) for name in names]
    return tuple(found)


# a package may hand on the example of one of its modules: each is taken once
EXAMPLES = tuple({m.example: m.__name__ for m in reversed(modules()) if callable(getattr(m, "example", None))}.values())


@cache
def example(name: str, seed: int = 1) -> Problem:
    """The example of a module."""
    return importlib.import_module(name).example(seed)


@cache
def offered_effects(name: str) -> tuple[Effect, ...]:
    """The effects that a module offers to a caller who says nothing more."""
    offer = getattr(importlib.import_module(name), "effects", None)
    if not callable(offer) or any(p.default is p.empty for p in inspect.signature(offer).parameters.values()):
        return ()
    return tuple(offer())


@cache
def example_with_effects(name: str) -> Problem:
    """The example with every effect of its module attached that can act there."""
    problem = example(name)
    for effect in offered_effects(name):
        if effect.label not in [e.label for e in problem.effects]:
            try:
                problem = problem.with_effects(effect)
            except DeclarationError:       # it acts nowhere here; test_effects asks whether it does in any example
                continue
    return problem


def plausible_values(problem: Problem, system: System, seed: int, share: float = 1.0) -> Values:
    """Start values a little moved, with every effect at a plausible size."""
    generator = np.random.default_rng(seed)
    step = 1e-4 * generator.uniform(-1.0, 1.0, system.layout.size)
    for attached in problem.attached:
        high = np.array([p.plausible[1] for p in attached.effect.parameters])
        size = share * high * generator.uniform(0.3, 1.0, (attached.unknown.count, len(high)))
        sign = np.where(attached.unknown.lower >= 0.0, 1.0, generator.choice([-1.0, 1.0], size.shape))
        step[system.layout.span(attached.unknown)] = (sign * size).ravel()
    return system.layout.move(system.layout.start(), step)
