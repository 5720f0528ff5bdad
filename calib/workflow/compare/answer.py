"""An answer on common ground: its results by name, and the objective of the declared problem at it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.analyse.covariance import covariance
from calib.blocks import Array
from calib.errors import CalibrationError
from calib.linearisation import Linearisation, linearise, linearise_system
from calib.observations import Quantity
from calib.problem import Problem
from calib.solve.estimate import Estimate, solve
from calib.solve.gauss_newton import GaussNewton
from calib.system import System
from calib.unknown import Selection, Unknown
from calib.workflow.shown import values_by_label


@dataclass(frozen=True)
class Wanted:
    """The results that are compared: what was asked for, their names and display units."""

    what: tuple[Any, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]

    @staticmethod
    def of(problem: Problem, what: Sequence[Any]) -> Wanted:
        """The comparable results of a problem: all that was asked for but directions, whose two angles are relative."""
        kept = tuple(one for one in what if _unknown(one) is None or _unknown(one).kind != "direction")
        functions = linearise(problem).functions(*kept)
        return Wanted(kept, functions.labels, functions.units)


def _unknown(one: Any) -> Any:
    return one.unknown if isinstance(one, Selection) else one if isinstance(one, Unknown) else None


def name_of(one: Any) -> str:
    """Name of an unknown, a quantity or what a selection is taken from."""
    return str(one.unknown.name if isinstance(one, Selection) else one.name)


def results(fit: Linearisation, wanted: Wanted) -> tuple[dict[str, float], dict[str, float]]:
    """Values and u {name: SI} of those wanted results that a fit knows by name; wanted: of the declared problem."""
    values: dict[str, float] = {}
    u: dict[str, float] = {}
    for name in dict.fromkeys(name_of(one) for one in wanted.what):
        own: list[Any] = [q for q in fit.results if q.name == name] or [
            one for one in fit.layout.unknowns if one.name == name]
        for one in own:
            found = covariance(fit, one)
            readable = {} if isinstance(one, Quantity) or one.kind == "vector" else values_by_label(fit, one)
            for label, value, its in zip(found.names, found.values, found.u, strict=True):
                shown = readable.get(label, value)
                if label in wanted.names and shown is not None:
                    values[label], u[label] = float(shown), float(its)
    return {n: values[n] for n in wanted.names if n in values}, {n: u[n] for n in wanted.names if n in u}


@dataclass(frozen=True)
class Placed:
    """Where an answer puts the declared problem: its linearisation and v'Pv there; None and why where it cannot."""

    fit: Linearisation | None
    objective: float | None
    why: str = ""
    held: tuple[str, ...] = ()  # names of what the answer says, where it does not say everything


def placed(declared: Problem, said: Mapping[str, Any], around: Estimate) -> Placed:
    """The least objective of the declared problem with what an answer says.

    said: {name: value in its declared shape, SI}; names that are no unknown of the problem are passed over.
    around: an estimate of the declared problem, where the rest starts from.
    """
    start: dict[Unknown, Array] = dict(around.values)
    named = {u.name: u for u in declared.unknowns}
    held: list[Any] = []
    for name, value in said.items():
        unknown = named.get(name)
        silent = isinstance(value, Partly)
        value, parts = (value.value, value.parts) if isinstance(value, Partly) else (value, ())
        if unknown is None or not _fits(unknown, value):
            continue
        stored = unknown.store(value)
        if silent:      # what the formulation held itself it does not say
            columns = [unknown.parts.index(part) for part in parts if part in unknown.parts]
            kept = np.array(start[unknown])
            kept[:, columns] = stored[:, columns]
            stored = kept
        start[unknown] = stored
        if not declared.is_held(unknown).all():
            held.append(unknown.part(*parts) if silent else unknown)
    if not held:
        return Placed(None, None, "it gives no unknown of the declared problem by name")
    rest = declared.hold(*held)
    shown = {u: u.show(v) for u, v in start.items()}
    rest_is_held = all(rest.is_held(u).all() for u in rest.unknowns)
    try:
        if rest_is_held:
            values = start
        else:
            estimate = solve(rest, GaussNewton(), shown)
            if not estimate.converged:
                return Placed(None, None, f"with this answer held, {estimate.message}")
            values = dict(estimate.values)
        system = System(declared)
        _, _, excess = system.active_conditions(values)
        if excess > 1.0:
            return Placed(None, None, "this answer breaks a condition of the declared problem")
        residual = system.whitened(values, system.weightings(values))
    except CalibrationError as error:
        return Placed(None, None, str(error))
    names = () if rest_is_held else tuple(dict.fromkeys(name_of(one) for one in held))
    return Placed(linearise_system(system, values), float(residual @ residual), held=names)


def _fits(unknown: Unknown, value: Any) -> bool:
    if unknown.kind == "pose":
        return True
    return np.size(value) == np.size(np.asarray(unknown.show(unknown.ambient)))


@dataclass(frozen=True)
class Partly:
    """A value of which only some parts were estimated."""

    value: Any
    parts: tuple[str, ...]


def said_by(estimate: Estimate, names: Sequence[str]) -> dict[str, Any]:
    """What an estimate of any problem says under given names of unknowns: {name: value, or Partly}."""
    found: dict[str, Any] = {}
    for unknown in estimate.problem.unknowns:
        held = estimate.problem.is_held(unknown)
        if unknown.name not in names or held.all():
            continue
        parts = tuple(p for p, all_held in zip(unknown.parts, np.any(held, axis=0).tolist(), strict=True)
                      if not all_held)
        whole = unknown.kind != "vector" or not held.any()
        if whole or parts:
            found[unknown.name] = estimate[unknown] if whole else Partly(estimate[unknown], parts)
    found.update({q.name: estimate[q] for q in estimate.problem.quantities if q.name in names})
    return found
