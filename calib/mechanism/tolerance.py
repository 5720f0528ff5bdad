"""Type B knowledge of many errors at once: tolerances of manufacture, and drives that are built alike."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from calib.errors import DeclarationError
from calib.observations import Observations, Prior
from calib.problem import Problem


def _of_columns(count: int, matrix: Any) -> Any:
    """A model of `count` arguments that returns a matrix times all of them."""
    def model(*parameters: Any) -> Any:
        return ca.mtimes(ca.DM(matrix), ca.vertcat(*parameters))
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    model.__signature__ = inspect.Signature(                                              # type: ignore[attr-defined]
        [inspect.Parameter(f"parameters_{i}", kind) for i in range(count)])
    return model


def tolerances(problem: Problem, u: Mapping[Any, float], name: str) -> Observations:
    """What the maker's tolerances say of the parameters of some effects: zero, with a standard uncertainty each.

    problem: with the effects attached; u: {effect or its name: standard uncertainty of each of its parameters, SI};
    name: of the group, as budgets list it. Returns observations for `problem.with_observations`.
    """
    unknowns = [problem.parameters(effect) for effect in u]
    if not unknowns:
        raise DeclarationError(f"'{name}': no effect is named; give at least one with its tolerance.")
    sizes = [value for value, x in zip(u.values(), unknowns, strict=True) for _ in range(x.freedom)]
    units = [unit for x in unknowns for unit in x.units]
    labels = [label for x in unknowns for label in x.labels]
    return Prior(_of_columns(len(unknowns), np.eye(len(sizes))), *unknowns, readings=np.zeros((1, len(sizes))),
                 u=np.array(sizes), group=name, unit=units, components=labels)


def alike(problem: Problem, effects: Sequence[Any], u: float, name: str) -> Observations:
    """Effects whose parameters are alike, such as the compliance of drives of one size: each differs from the next by
    u.

    problem: with the effects attached; effects: at least two, or their names, of one parameter each; u: standard
    uncertainty of a difference of neighbours, SI. Returns observations for `problem.with_observations`.
    """
    unknowns = [problem.parameters(effect) for effect in effects]
    if len(unknowns) < 2 or any(x.freedom != 1 for x in unknowns):
        raise DeclarationError(f"'{name}': give at least two effects of one parameter each.")
    differences = np.diff(np.eye(len(unknowns)), axis=0)
    return Observations(_of_columns(len(unknowns), differences), *unknowns, readings=np.zeros((1, len(differences))),
                        u=u,
                        group=name, unit=unknowns[0].units[0])
