"""Observations, priors, derived quantities and constraints: models bound row by row to unknowns and known data."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import geometry
from calib.blocks import Array
from calib.effect import direct, positional_of, slots_of
from calib.errors import DeclarationError
from calib.frozen import Frozen
from calib.uncertainty import Gaussian
from calib.unknown import Selection, Unknown


@dataclass(frozen=True)
class Shared:
    """One known constant for all rows: a number, (d,) or (a, b), in SI."""

    value: ArrayLike


@dataclass(frozen=True)
class Argument:
    """One bound argument: either an unknown with an instance for each row, or data (n or 1, width) of a shape."""

    name: str
    unknown: Unknown | None = None
    index: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    data: Array = field(default_factory=lambda: np.zeros((0, 0)))
    shape: tuple[int, ...] = ()


def _data(name: str, values: Array, shape: tuple[int, ...]) -> Argument:
    stack = values.reshape(len(values), *shape)
    if len(shape) == 2:  # column by column, as CasADi reshapes
        stack = stack.transpose(0, 2, 1)
    return Argument(name, data=np.ascontiguousarray(stack.reshape(len(values), -1)), shape=shape)


class BoundModel(Frozen):
    """A model whose positional arguments are bound to unknowns and data, for n rows."""

    what = "model"

    def _bind(self, name: str, model: Callable[..., Any], arguments: Sequence[Any], n: int | None) -> None:
        self.name, self.model = name, model
        names = positional_of(model)
        self.model_name = getattr(model, "__name__", "model")
        if len(names) != len(arguments):
            raise DeclarationError(
                f"{self.what} '{name}': the model {self.model_name}({', '.join(names)}) takes "
                f"{len(names)} arguments, {len(arguments)} were given."
            )
        lengths = {}
        for label, argument in zip(names, arguments, strict=True):
            if isinstance(argument, Selection) and argument.index is not None and argument.index.ndim:
                lengths[label] = len(argument.index)
            elif not isinstance(argument, (Selection, Unknown, Shared)) and np.ndim(argument) > 0:
                lengths[label] = len(argument)
        if n is None:
            n = max(lengths.values(), default=1)
        for label, length in lengths.items():
            if length != n:
                raise DeclarationError(
                    f"{self.what} '{name}': argument '{label}' has {length} rows where {n} are "
                    "expected; give one value a row, or Shared(value) for a constant."
                )
        self.n = n
        self.arguments = tuple(self._argument(label, a, n) for label, a in zip(names, arguments, strict=True))

    def _argument(self, label: str, given: Any, n: int) -> Argument:
        where = f"{self.what} '{self.name}', argument '{label}'"
        if isinstance(given, Unknown):
            if given.count != 1:
                raise DeclarationError(
                    f"{where}: unknown '{given.name}' has {given.count} instances; bind it as "
                    f"{given.name}[index] or {given.name}.each."
                )
            return Argument(label, given, np.zeros(n, dtype=np.int64))
        if isinstance(given, Selection):
            if given.parts is not None:
                raise DeclarationError(
                    f"{where}: a model receives whole instances of '{given.unknown.name}', not "
                    "single parts; take the part inside the model."
                )
            return Argument(label, given.unknown, np.broadcast_to(given.instances(), (n,)))
        if isinstance(given, Shared):
            value = np.asarray(given.value, float)
            argument = _data(label, value[None], value.shape)
        else:
            values = np.asarray(given)
            if values.dtype.kind not in "fiub":
                raise DeclarationError(f"{where} holds {values.dtype}, not numbers; text belongs into covariates.")
            if values.ndim == 0:
                raise DeclarationError(f"{where} is a bare number; write Shared({given!r}) for a constant of all rows.")
            argument = _data(label, values.astype(float), values.shape[1:])
        bad = np.argwhere(~np.isfinite(argument.data))
        if len(bad):
            raise DeclarationError(f"{where}: row {bad[0][0] + 1} is not a finite number; mend or leave out that row.")
        return argument

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The unknowns among the arguments, each once."""
        return tuple(dict.fromkeys(a.unknown for a in self.arguments if a.unknown is not None))

    def __repr__(self) -> str:
        return f"{type(self).__name__}('{self.name}', {self.n} rows)"


class Observations(BoundModel):
    """Readings of one model: its arguments, n readings of dim components, and their uncertainty.

    model: plain function of row arguments in CasADi operations; keyword-only arguments are slots.
    arguments: one for each positional argument: an unknown `u`, `u[index]`, `u.each`, an array with n rows, or Shared.
    readings: (n,) or (n, dim) in SI, or None for planning; u: standard uncertainties or a Gaussian, SI.
    group: name in results; unit: display unit, one or one for each component; components: their names.
    covariates: {name: (n,) numbers or texts, or (array, unit)}; period: None, or one for each component, SI.
    rows: (n,) row numbers of the data file.
    Raises DeclarationError where lengths differ, a reading is not finite, or the uncertainty is missing.
    """

    what = "observations"
    is_prior = False

    def __init__(
        self,
        model: Callable[..., Any],
        *arguments: Any,
        readings: ArrayLike | None = None,
        u: ArrayLike | Gaussian | None = None,
        group: str = "readings",
        unit: str | Sequence[str] = "1",
        components: Sequence[str] | None = None,
        covariates: Mapping[str, Any] | None = None,
        period: Any = None,
        rows: ArrayLike | None = None,
    ):
        values = None if readings is None else np.array(readings, dtype=float)
        self._bind(group, model, arguments, None if values is None else len(np.atleast_1d(values)))
        self.group = group
        self.readings = None if values is None else values.reshape(self.n, -1)
        if self.readings is not None:
            bad = np.argwhere(~np.isfinite(self.readings))
            if len(bad):
                raise DeclarationError(
                    f"observations '{group}': reading {bad[0][0] + 1} is not a finite number; mend "
                    "or leave out that row."
                )
            self.readings.flags.writeable = False
        if u is None:
            raise DeclarationError(f"observations '{group}' have no uncertainty; every reading needs one (u=...).")
        self.uncertainty = u if isinstance(u, Gaussian) else Gaussian.standard(u)
        self.unit, self._components, self.period = unit, components, period
        self.rows = np.arange(1, self.n + 1) if rows is None else np.asarray(rows)
        self.covariates: dict[str, NDArray] = {}
        self.covariate_units: dict[str, str] = {}
        for name, given in (covariates or {}).items():
            array, measure = given if isinstance(given, tuple) else (given, "1")
            array = np.asarray(array)
            if array.ndim == 0:
                array = np.broadcast_to(array, (self.n,))
            if len(array) != self.n:
                raise DeclarationError(
                    f"observations '{group}': covariate '{name}' has {len(array)} rows, the readings {self.n}."
                )
            self.covariates[name], self.covariate_units[name] = array, measure

    @property
    def slots(self) -> tuple[str, ...]:
        """Names of the slots of the model."""
        return slots_of(self.model)

    @property
    def recorded(self) -> Array:
        """The readings (n, dim) in SI; raises DeclarationError where these are planned and not read."""
        if self.readings is None:
            raise DeclarationError(f"observations '{self.group}' are planned: they have no readings; simulate them.")
        return self.readings

    def units(self, dim: int) -> tuple[str, ...]:
        """Display unit of each of dim components."""
        return (self.unit,) * dim if isinstance(self.unit, str) else tuple(self.unit)

    def components(self, dim: int) -> tuple[str, ...]:
        """Name of each of dim components; empty where there is one without a name."""
        if self._components is not None:
            return tuple(self._components)
        return ("",) if dim == 1 else tuple(str(i + 1) for i in range(dim))

    def with_readings(self, readings: ArrayLike | None, u: Gaussian | None = None) -> Observations:
        """The same observations with other readings (n,) or (n, dim) in SI, and another uncertainty where given."""
        copy = object.__new__(type(self))
        values = None if readings is None else np.array(readings, dtype=float).reshape(self.n, -1)
        copy.__dict__.update(self.__dict__, readings=values, uncertainty=u or self.uncertainty)
        return copy

    def with_addition(self, coefficients: Unknown, columns: ArrayLike) -> Observations:
        """The same observations whose prediction gains a sum without physics, for what no effect explains.

        coefficients: one instance of k parts; columns: (n, dim, k), what one of each adds to every prediction.
        """
        whole = np.asarray(columns, float)
        _, dim, k = whole.shape
        inner, slots = self.model, self.slots

        def added(*arguments: Any, **taps: Any) -> list[Any]:
            value = inner(*arguments[:-2], **taps)
            pieces = value if isinstance(value, (list, tuple)) else [value]
            rows = [p[i] for p in pieces for i in range(p.shape[0])] if dim > 1 else pieces
            return [rows[i] + sum(arguments[-1][i, j] * arguments[-2][j] for j in range(k)) for i in range(dim)]

        kind, number = inspect.Parameter, len(self.arguments)
        names = [*(a.name for a in self.arguments), f"{coefficients.name} {number}", f"columns {number}"]
        added.__name__ = self.model_name
        signature = [kind(f"a{i}", kind.POSITIONAL_ONLY) for i in range(len(names))]
        signature += [kind(slot, kind.KEYWORD_ONLY, default=direct) for slot in slots]
        added.__signature__ = inspect.Signature(signature)  # type: ignore[attr-defined]
        further = (self._argument(names[-2], coefficients, self.n), self._argument(names[-1], whole, self.n))
        copy = object.__new__(type(self))
        copy.__dict__.update(self.__dict__, model=added, arguments=self.arguments + further)
        return copy

    def keep(self, keep: NDArray[np.bool_]) -> Observations:
        """The rows where keep (n,) is true."""
        copy, mask = object.__new__(type(self)), np.asarray(keep, dtype=bool)
        arguments = tuple(
            replace(a, index=a.index[mask])
            if a.unknown is not None
            else replace(a, data=a.data[mask])
            if len(a.data) == self.n > 1
            else a
            for a in self.arguments
        )
        copy.__dict__.update(
            self.__dict__,
            n=int(mask.sum()),
            arguments=arguments,
            rows=self.rows[mask],
            uncertainty=self.uncertainty.kept(mask),
            readings=None if self.readings is None else self.readings[mask],
            covariates={name: values[mask] for name, values in self.covariates.items()},
        )
        return copy


class Prior(Observations):
    """Observations of unknowns themselves; made by `prior`."""

    what = "prior"
    is_prior = True


def prior(of: Unknown | Selection, value: Any, u: ArrayLike | Gaussian, name: str | None = None) -> Prior:
    """Type B knowledge of an unknown, as an observation of it.

    of: an unknown, instances or parts of it; value: in the declared shape of what is selected, SI (a rotation matrix,
    a direction, a Transform for those kinds); u: standard uncertainties, SI (radians about the local axes) or Gaussian.
    On a held unknown it is its considered uncertainty.
    Raises DeclarationError where shapes differ.
    """
    selection = of if isinstance(of, Selection) else Selection(of)
    unknown = selection.unknown
    index = np.atleast_1d(selection.instances())
    parts = tuple(range(unknown.freedom)) if selection.parts is None else selection.parts
    names = tuple(unknown.parts[p] for p in parts)
    units = tuple(unknown.units[p] for p in parts)
    group = name or f"prior {unknown.name}" + (f".{'.'.join(names)}" if selection.parts is not None else "")
    if unknown.kind == "vector":
        try:
            readings = np.broadcast_to(
                np.asarray(value, float).reshape(-1, len(parts)) if np.ndim(value) else np.asarray(value, float),
                (len(index), len(parts)),
            )
        except ValueError:
            raise DeclarationError(
                f"{group}: the value has shape {np.shape(value)}; give ({len(index)}, {len(parts)})."
            ) from None

        def itself(quantity: Any) -> Any:
            return quantity[list(parts)]

        return Prior(itself, unknown[index], readings=readings, u=u, group=group, unit=units, components=names)
    stored = (
        unknown.store(value) if len(index) == unknown.count else np.concatenate([unknown.store(value)[:1]] * len(index))
    )
    zero = np.zeros((len(index), len(parts)))

    def departure(quantity: Any, nominal: Any) -> Any:
        return ca.vertcat(*[_departure(unknown, quantity, nominal)[p] for p in parts])

    return Prior(departure, unknown[index], stored, readings=zero, u=u, group=group, unit=units, components=names)


def _departure(unknown: Unknown, quantity: Any, nominal: Any) -> list[Any]:
    """Small local coordinates of a rotation, direction or pose away from a stored nominal one."""
    if unknown.kind == "rotation":
        turn = geometry.rotation_vector(ca.mtimes(ca.reshape(nominal, 3, 3).T, quantity))
        return [turn[i] for i in range(3)]
    if unknown.kind == "direction":
        local = ca.mtimes(ca.reshape(nominal, 3, 3).T, quantity)
        angle = ca.atan2(ca.sqrt(local[0] ** 2 + local[1] ** 2 + 1e-300), local[2])
        ratio = angle / ca.sqrt(local[0] ** 2 + local[1] ** 2 + 1e-300)
        return [ratio * local[0], ratio * local[1]]
    turn = geometry.rotation_vector(ca.mtimes(ca.reshape(nominal[3:], 3, 3).T, quantity.rotation))
    return [quantity.translation[i] - nominal[i] for i in range(3)] + [turn[i] for i in range(3)]


class Quantity(BoundModel):
    """A named function of unknowns that somebody asked for.

    name; function: like a model; arguments: bound like those of observations (n rows are n instances).
    unit: display unit, one or one for each part; parts, keys: names. Its uncertainty follows from the declaration.
    """

    what = "quantity"

    def __init__(
        self,
        name: str,
        function: Callable[..., Any],
        *arguments: Any,
        unit: str | Sequence[str] = "1",
        parts: Sequence[str] | None = None,
        keys: Sequence[object] | None = None,
    ):
        self._bind(name, function, arguments, None if keys is None else len(keys))
        self.unit = unit
        self._parts = None if parts is None else tuple(parts)
        self.keys = tuple(str(k) for k in keys) if keys is not None else tuple(str(i + 1) for i in range(self.n))
        self.named_keys = keys is not None

    def labels(self, dim: int) -> list[str]:
        """Names of all scalars for dim parts, instance by instance."""
        parts = self.parts(dim)
        names = [self.name if self.n == 1 and not self.named_keys else f"{self.name}[{key}]" for key in self.keys]
        return [name if dim == 1 else f"{name}.{part}" for name in names for part in parts]

    def parts(self, dim: int) -> tuple[str, ...]:
        """Names of dim parts."""
        if self._parts is not None:
            return self._parts
        return ("x", "y", "z") if dim == 3 else tuple(str(i + 1) for i in range(dim))

    def units(self, dim: int) -> tuple[str, ...]:
        """Display unit of each of dim parts."""
        return (self.unit,) * dim if isinstance(self.unit, str) else tuple(self.unit)


class Constraint(BoundModel):
    """A condition lower <= function <= upper on unknowns; an equality where the two limits are equal.

    tolerance: how far it may be missed, in SI of the function; unit: display unit; lower, upper: in SI.
    """

    what = "constraint"

    def __init__(
        self,
        name: str,
        function: Callable[..., Any],
        *arguments: Any,
        tolerance: float,
        unit: str = "1",
        lower: ArrayLike = 0.0,
        upper: ArrayLike = 0.0,
    ):
        self._bind(name, function, arguments, None)
        self.tolerance, self.unit = float(tolerance), unit
        self.lower, self.upper = np.asarray(lower, float), np.asarray(upper, float)
        if np.any(self.lower > self.upper):
            raise DeclarationError(f"constraint '{name}': its lower limit lies above its upper limit.")

    @property
    def is_equality(self) -> bool:
        """Whether all of it are equations."""
        return bool(np.all(self.lower == self.upper))
