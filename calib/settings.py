"""Settings from a job file: typed access with units, and the keys that nobody asked for, named with near matches."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib import columns, units
from calib.errors import InputError

REQUIRED: Any = object()


class MissingKey(InputError, KeyError):
    """A key that a job file must have; also a KeyError, so that `get` of a mapping works."""

    def __str__(self) -> str:
        return self.sentence


@dataclass(frozen=True)
class Origin:
    """The file that settings come from, to say in which line a key stands."""

    path: Path
    text: str

    def where(self, keys: Sequence[str]) -> str:
        """Where a key stands.

        keys: names of the tables and, last, of the key.
        return: "job.toml, line 7, key 'instruments.tracker.u'"; without the line where it cannot be found.
        """
        name = ".".join(keys)
        line = self._line(keys)
        return f"{self.path}{f', line {line}' if line else ''}, key '{name}'"

    def _line(self, keys: Sequence[str]) -> int | None:
        names = [key for key in keys if not key.isdigit()]
        heading, rank, last = "", 1, None
        wanted_rank = next((int(key) for key in keys if key.isdigit()), 1)
        for number, words in enumerate(self.text.splitlines(), start=1):
            table = re.match(r"\s*\[+\s*([^\]]+?)\s*\]+", words)
            if table:
                rank = rank + 1 if table[1] == heading else 1
                heading = table[1]
                if heading == ".".join(names) and rank == wanted_rank:
                    return number
                last = number if heading == ".".join(names[:-1]) and rank == wanted_rank else last
            key = re.match(r"""\s*["']?([^="']+?)["']?\s*=""", words)
            if key and rank == wanted_rank and ".".join(filter(None, (heading, key[1]))) == ".".join(names):
                return number
        return last


class Settings(Mapping[str, Any]):
    """One table of a job file; reading a key records that somebody asked for it.

    values: the table; name: its keys from the top; origin: the file.
    """

    def __init__(self, values: Mapping[str, Any], name: Sequence[str], origin: Origin) -> None:
        self._values = dict(values)
        self._name = tuple(name)
        self._origin = origin
        self._asked: set[str] = set()
        self._children: dict[tuple[str, ...], Settings] = {}

    def __getitem__(self, key: str) -> Any:
        self._asked.add(key)
        if key not in self._values:
            raise MissingKey(f"{self.where(key)}: is missing; add it")
        value = self._values[key]
        return self._below(value, key) if isinstance(value, Mapping) else value

    def __contains__(self, key: object) -> bool:
        self._asked.add(str(key))
        return key in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def where(self, *key: str) -> str:
        """Where the table, or a key of it, stands in the file: for messages."""
        return self._origin.where((*self._name, *key))

    def table(self, key: str) -> Settings:
        """The table below a key; an empty one where there is none.

        key: name of the table.
        return: its settings.
        raises InputError where the key holds no table.
        """
        self._asked.add(key)
        if not isinstance(self._values.get(key, {}), Mapping):
            raise InputError(f"{self.where(key)}: is a single value; write a table [{'.'.join((*self._name, key))}]")
        return self._below(self._values.get(key, {}), key)

    def tables(self, key: str) -> tuple[Settings, ...]:
        """The array of tables `[[key]]`; empty where there is none.

        key: name of the array.
        return: its tables in order.
        raises InputError where the key holds something else.
        """
        self._asked.add(key)
        found = self._values.get(key, [])
        if not isinstance(found, list) or not all(isinstance(one, Mapping) for one in found):
            raise InputError(f"{self.where(key)}: is not a list of tables; write [[{'.'.join((*self._name, key))}]]")
        return tuple(self._below(one, key, str(rank)) for rank, one in enumerate(found, start=1))

    def text(self, key: str, default: Any = REQUIRED, among: Sequence[str] | None = None) -> Any:
        """A text.

        key: its name; default: where it is missing; among: the texts that are allowed.
        return: the text.
        raises InputError where it is missing without default, no text, or none of those allowed.
        """
        value = self._value(key, default, str, "a text in quotation marks")
        if among is not None and key in self._values and value not in among:
            near = units.near_matches(value, list(among))
            hint = f"did you mean '{near[0]}'? " if near else ""
            raise InputError(f"{self.where(key)}: '{value}' is not known; {hint}Write one of: {', '.join(among)}")
        return value

    def flag(self, key: str, default: Any = REQUIRED) -> Any:
        """A truth value `true` or `false`; raises InputError like `text`."""
        return self._value(key, default, bool, "true or false")

    def whole(self, key: str, default: Any = REQUIRED) -> Any:
        """A whole number; raises InputError like `text`."""
        return self._value(key, default, int, "a whole number")

    def number(self, key: str, default: Any = REQUIRED) -> Any:
        """A number without unit, as float; raises InputError like `text`."""
        value = self._value(key, default, (int, float), "a number without quotation marks")
        return self._finite(key, value) if key in self._values else value

    def numbers(self, key: str, default: Any = REQUIRED) -> Any:
        """A list of numbers without unit, as array; raises InputError like `text`."""
        value = self._value(key, default, list, "a list of numbers such as [1.0, 2.0]")
        return np.array([self._finite(key, one) for one in value]) if key in self._values else value

    def texts(self, key: str, default: Any = REQUIRED) -> Any:
        """A list of texts, as tuple; raises InputError like `text`."""
        value = self._value(key, default, list, "a list of texts such as [\"x\", \"y\"]")
        if key in self._values and not all(isinstance(one, str) for one in value):
            raise InputError(f"{self.where(key)}: is not a list of texts; write [\"x\", \"y\"]")
        return tuple(value) if key in self._values else value

    def quantity(self, key: str, dimension: str, default: Any = REQUIRED) -> Any:
        """A value with its unit, in SI: `length = "0.1 mm"`, or with the unit in the key: `length_mm = 0.1`.

        key: its name without unit; dimension: "length", "angle" ...; default: where it is missing (SI).
        return: the number, or an array where the key holds a list.
        raises InputError where it is missing without default, has no unit or the wrong one.
        """
        for found in self._values:
            column = columns.column(found)
            if found != key and column.name == key and column.unit is not None:
                self._asked.add(found)
                if column.dimension != dimension:
                    raise InputError(f"{self.where(found)}: is of {column.dimension}, where {dimension} is wanted; "
                                     "correct it")
                values = self._values[found]
                numbers = [self._in_si(found, one, column.unit) for one in np.ravel(values)]
                return np.array(numbers).reshape(np.shape(values)) if isinstance(values, list) else numbers[0]
        wanted = f"a text with number and unit such as \"0.1 {units.customary(dimension)}\""
        value = self._value(key, default, (str, list), wanted)
        if key not in self._values:
            return value
        if isinstance(value, list):
            return np.array([self._with_unit(key, one, dimension) for one in value])
        return self._with_unit(key, value, dimension)

    def uncertainty(self, key: str, dimension: str, default: Any = REQUIRED) -> Any:
        """A standard uncertainty "a + b L", in SI: `u = "0.5 um + 0.2 um/m"`, or `sigma_um = 0.5`.

        key: its name without unit; dimension: that of the reading; default: where it is missing.
        return: (constant part, part per metre), SI.
        raises InputError where it is missing without default, not positive, or of the wrong dimension.
        """
        if key not in self._values:
            value = self.quantity(key, dimension, default)
            return value if value is default else (value, 0.0)
        text = self._value(key, REQUIRED, str, "a text such as \"0.5 um + 0.2 um/m\"")
        try:
            parts = units.uncertainty(text, dimension)
        except InputError as error:
            raise InputError(f"{self.where(key)}: {error}") from None
        if not max(parts) > 0:
            raise InputError(f"{self.where(key)}: '{text}' is no positive uncertainty; every reading needs one")
        return parts

    def unasked(self) -> list[str]:
        """Keys that nobody asked for, each as a sentence with where it stands and the near matches.

        return: the sentences; empty where every key was used.
        """
        asked = [key for key in self._asked if key not in self._values]
        found = []
        for key in self._values:
            if key not in self._asked:
                near = units.near_matches(key, sorted(asked))
                known = ", ".join(sorted(self._asked)) or "nothing"
                hint = f"did you mean '{near[0]}'?" if near else f"known here: {known}."
                found.append(f"{self.where(key)}: is not known; {hint} Correct the key or take it out")
        for child in self._children.values():
            found.extend(child.unasked())
        return found

    def _below(self, values: Mapping[str, Any], *keys: str) -> Settings:
        if keys not in self._children:
            self._children[keys] = Settings(values, (*self._name, *keys), self._origin)
        return self._children[keys]

    def _value(self, key: str, default: Any, kind: Any, wanted: str) -> Any:
        self._asked.add(key)
        if key not in self._values:
            if default is REQUIRED:
                raise InputError(f"{self.where(key)}: is missing; add it as {wanted}")
            return default
        value = self._values[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise InputError(f"{self.where(key)}: {value!r} is not {wanted}; correct it")
        return value

    def _finite(self, key: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
            raise InputError(f"{self.where(key)}: {value!r} is not a finite number; correct it")
        return float(value)

    def _in_si(self, key: str, value: Any, unit: str) -> float:
        number = self._finite(key, value.item() if isinstance(value, np.generic) else value)
        return float(units.kelvin_from_celsius(number)) if unit in columns.CELSIUS else float(units.to_si(number, unit))

    def _with_unit(self, key: str, text: Any, dimension: str) -> float:
        if not isinstance(text, str):
            raise InputError(f"{self.where(key)}: {text!r} has no unit; write a text such as "
                             f"\"{text} {units.customary(dimension)}\"")
        try:
            return signed_quantity(text, dimension)
        except InputError as error:
            raise InputError(f"{self.where(key)}: {error}") from None


def signed_quantity(text: str, dimension: str) -> float:
    """The SI value of a text such as "-0.1 mm".

    text: number and unit; dimension: what it must be of.
    return: SI value.
    raises InputError where it is no number with a unit of that dimension.
    """
    body = text.strip()
    return -units.quantity(body[1:], dimension) if body.startswith("-") else units.quantity(body, dimension)


def unit_in(text: str) -> str:
    """The unit in a text such as "0.1 mm", as written; empty where there is none."""
    return text.strip().lstrip("+-.0123456789eE").strip()
