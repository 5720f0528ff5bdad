"""Prior knowledge of a job: single values, and earlier results with their full covariance, as observations."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib import files, units
from calib.errors import CalibrationError, DeclarationError, InputError
from calib.job import PriorKnowledge
from calib.observations import Argument, Observations, Quantity, Shared, prior
from calib.problem import Problem
from calib.uncertainty import Gaussian
from calib.unknown import Selection, Unknown


def with_priors(problem: Problem, knowledge: Sequence[PriorKnowledge]) -> Problem:
    """A problem with the prior knowledge of a job among its observations.

    problem: as declared; knowledge: of the job.
    return: the problem with one more group of observations for each piece.
    raises InputError where a name is not in the problem or a unit does not fit.
    """
    for one in knowledge:
        if one.earlier is None:
            assert one.quantity is not None
            problem = problem.with_observations(_single(problem, one, one.quantity))
        else:
            problem = problem.with_observations(_earlier(problem, one, one.earlier))
    return problem


def named(problem: Problem, name: str, where: str) -> Selection | Quantity:
    """What a name of a job means in a problem: an unknown, one of its instances or parts, an effect, or a quantity.

    name: "squareness", "base_point.z", "target[A].r"; where: place in the job, for the message.
    return: the selection or the quantity.
    raises InputError with near names where there is none.
    """
    labels: list[str] = []
    for unknown in problem.unknowns:
        if name == unknown.name:
            return Selection(unknown)
        if name in unknown.labels:
            instance, part = divmod(unknown.labels.index(name), unknown.freedom)
            return Selection(unknown, np.array([instance]), (part,))
        labels += [unknown.name, *unknown.labels]
    for quantity in problem.quantities:
        if name == quantity.name:
            return quantity
        labels.append(quantity.name)
    try:
        return Selection(problem.parameters(name))
    except DeclarationError:
        pass
    near = units.near_matches(name, labels)
    hint = f"did you mean '{near[0]}'? " if near else ""
    known = [unknown.name for unknown in problem.unknowns] + [quantity.name for quantity in problem.quantities]
    raise InputError(f"{where}: '{name}' is not in {problem.name}; {hint}There are: {', '.join(known)}")


def _single(problem: Problem, one: PriorKnowledge, name: str) -> Observations:
    what = named(problem, name, one.where)
    if isinstance(what, Quantity):
        reading, variance = np.array([one.value]), np.array([[one.u**2]])
        return _stacked([(what, None)], reading, variance, f"prior {name}", [one.unit], one.where)
    kinds = {units.dimension(unit) for unit in what.unknown.units}
    if kinds != {units.dimension(one.unit)}:
        theirs = " and ".join(sorted(kinds))
        raise InputError(f"{one.where}: u is of {units.dimension(one.unit)}, where '{name}' is of {theirs}; "
                         "correct the unit, or name one part")
    if what.unknown.kind != "vector":
        raise InputError(f"{one.where}: '{name}' is a {what.unknown.kind}, which has no single value; "
                         "give the prior in Python")
    return prior(what, one.value, one.u, name=f"prior {name}")


def _earlier(problem: Problem, one: PriorKnowledge, path: Path) -> Observations:
    content = files.read_json(path)
    try:
        names, matrix = list(content["covariance"]["names"]), np.array(content["covariance"]["matrix"], float)
        values = {label_of(entry): (float(entry["value"]), str(entry["unit"]))
                  for entry in (*content["unknowns"], *content["derived"]) if entry["value"] is not None}
        stated = [values[name] for name in names]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: is no result.json of `calib solve` (missing: {error}); name one as `from`") from None
    if one.quantity is not None:
        chosen = [i for i, name in enumerate(names) if name == one.quantity or name.startswith((f"{one.quantity}.",
                                                                                                  f"{one.quantity}["))]
        if not chosen:
            raise InputError(f"{one.where}: {path} holds no '{one.quantity}'; it holds {', '.join(names)}")
        names, stated, matrix = [names[i] for i in chosen], [stated[i] for i in chosen], matrix[np.ix_(chosen, chosen)]
    scale = np.array([units.factor(unit) for _, unit in stated])
    readings = np.array([value for value, _ in stated]) * scale
    pieces = [_piece(problem, name, one.where) for name in names]
    return _stacked(pieces, readings, matrix * np.outer(scale, scale), f"earlier {path.name}",
                    [unit for _, unit in stated], one.where)


def label_of(entry: dict[str, Any]) -> str:
    """The label of an entry of result.json, such as "target[A].r"."""
    label = str(entry["name"])
    if entry.get("instance") is not None:
        label += f"[{entry['instance']}]"
    return label if entry.get("part") is None else f"{label}.{entry['part']}"


def _piece(problem: Problem, name: str, where: str) -> tuple[Selection | Quantity, int | None]:
    """A named scalar: an unknown's part, or a quantity and which of its parts (None: its only one)."""
    for quantity in problem.quantities:
        if name != quantity.name and name.startswith(f"{quantity.name}."):
            parts = quantity.parts(3 if name[-1] in "xyz" else 2)
            part = name.removeprefix(f"{quantity.name}.")
            if part in parts:
                return quantity, parts.index(part)
    return named(problem, name, where), None


def _stacked(
    pieces: Sequence[tuple[Selection | Quantity, int | None]], readings: np.ndarray, matrix: np.ndarray, group: str,
    display: Sequence[str], where: str,
) -> Observations:
    """One observation of several scalars at once, with their covariance."""
    arguments: list[Any] = []
    scalars: list[Callable[[Sequence[Any]], Any]] = []
    for what, part in pieces:
        begin = len(arguments)
        if isinstance(what, Quantity):
            if what.n != 1:
                raise InputError(f"{where}: '{what.name}' repeats {what.n} times; name an unknown instead")
            arguments += [_rebound(argument) for argument in what.arguments]
            scalars.append(_of_quantity(what, begin, len(what.arguments), part))
        else:
            index = np.zeros(1, int) if what.index is None else what.index
            if what.unknown.kind != "vector" or len(index) != 1 or (what.parts is None and what.unknown.freedom != 1):
                raise InputError(f"{where}: '{what.unknown.name}' is not a single number; name one part of it")
            arguments.append(what.unknown[index])
            scalars.append(_of_unknown(what.unknown, begin, 0 if what.parts is None else what.parts[0]))

    def known_together(*given: Any) -> Any:
        return [scalar(given) for scalar in scalars]

    names = [inspect.Parameter(f"a{i}", inspect.Parameter.POSITIONAL_ONLY) for i in range(len(arguments))]
    known_together.__signature__ = inspect.Signature(names)  # type: ignore[attr-defined]
    try:
        return Observations(known_together, *arguments, readings=readings[None], u=Gaussian.matrix(matrix), group=group,
                            unit=tuple(display))
    except CalibrationError as error:
        raise InputError(f"{where}: {error}") from error


def _of_unknown(unknown: Unknown, place: int, part: int) -> Callable[[Sequence[Any]], Any]:
    return lambda given: given[place] if unknown.freedom == 1 else given[place][part]


def _of_quantity(quantity: Quantity, begin: int, count: int, part: int | None) -> Callable[[Sequence[Any]], Any]:
    def scalar(given: Sequence[Any]) -> Any:
        value = quantity.model(*given[begin : begin + count])
        return value if part is None else value[part]

    return scalar


def _rebound(argument: Argument) -> Any:
    if argument.unknown is not None:
        assert argument.index is not None
        return argument.unknown[argument.index]
    assert argument.data is not None
    # Matrices are stored column by column.
    value = argument.data[0].reshape(argument.shape[::-1]).T if argument.shape else argument.data[0, 0]
    return Shared(value)
