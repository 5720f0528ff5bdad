"""What attributes of a .gkf say: numbers, angles, keys and covariance matrices; what they cannot mean is refused."""

from __future__ import annotations

import math
import re
from typing import Protocol

import numpy as np

from calib import units
from calib.errors import InputError
from calib.units import degree, gon
from problems.network.survey import Array
from problems.network.xml import Element

DEGREES = re.compile(r"\s*([+-]?)(\d+)-(\d+)-(\d+(?:\.\d*)?)\s*")


class File(Protocol):
    """What is being read, which words an error in an element of it."""

    def wrong(self, element: Element, what: str) -> InputError:
        """The error, with file and line."""


def known(found: File, element: Element, names: tuple[str, ...]) -> None:
    for name in element.attributes:
        if name not in (*names, "extern", "xmlns", "version"):
            near = units.near_matches(name, list(names))
            raise found.wrong(element, f"has an attribute '{name}' that is not known; "
                              + (f"did you mean '{near[0]}'?" if near else f"there are: {', '.join(names)}"))


def number(found: File, element: Element, name: str, default: float | None = None) -> float:
    text = element.attributes.get(name)
    if text is None or not text.strip():
        if default is None:
            raise found.wrong(element, f"has no {name}; add it")
        return default
    try:
        value = float(text)
    except ValueError:
        raise found.wrong(element, f"{name}='{text}' is not a number; correct it") from None
    if not math.isfinite(value):
        raise found.wrong(element, f"{name}='{text}' is not a finite number; correct it or take the reading out")
    return value


def positive(found: File, element: Element, name: str, default: float) -> float:
    value = number(found, element, name, default)
    if value <= 0:
        raise found.wrong(element, f"{name} is {value:g}; it must be positive")
    return value


def angle(found: File, element: Element) -> tuple[float, str]:
    """An angle [rad] and its display unit."""
    text = element.attributes.get("val", "")
    parts = DEGREES.fullmatch(text)
    if parts is None:
        value = number(found, element, "val")
        # Directions and azimuths may have been turned by another angle, and then count on beyond a full circle.
        if abs(value) > (800.0 if element.tag in ("direction", "azimuth") else 400.0):
            raise found.wrong(element, f"val='{text}' gon is more than a full circle; angles are in gon, or in degrees "
                              "written 123-45-56.7")
        return value * gon, "gon"
    sign, whole, minutes, seconds = parts.groups()
    if int(minutes) >= 60 or float(seconds) > 60 or int(whole) > 360:    # 60.00" is a rounded minute
        raise found.wrong(element, f"val='{text}' is no angle in degrees, minutes and seconds; correct it")
    size = (int(whole) + int(minutes) / 60 + float(seconds) / 3600) * degree
    return -size if sign == "-" else size, "deg"


def key_of(found: File, element: Element, name: str, default: str = "") -> str:
    key = element.attributes.get(name, default).strip()
    if not key:
        raise found.wrong(element, f"does not say {name} which point; add {name}=...")
    return key


def banded(found: File, element: Element, size: int) -> Array:
    """Symmetric matrix from the rows of its upper band."""
    dim, band = int(number(found, element, "dim")), int(number(found, element, "band"))
    try:
        numbers = [float(text) for text in element.text.split()]
    except ValueError as error:
        raise found.wrong(element, f"holds what is no number ({error}); correct it") from None
    if dim != size:
        raise found.wrong(element, f"has dim={dim} for {size} readings; they must be equal")
    expected = sum(min(band, dim - 1 - i) + 1 for i in range(dim))
    if len(numbers) != expected:
        raise found.wrong(element, f"has {len(numbers)} numbers; dim={dim} and band={band} need {expected}")
    matrix, taken = np.zeros((dim, dim)), 0
    for i in range(dim):
        width = min(band, dim - 1 - i) + 1
        matrix[i, i : i + width] = matrix[i : i + width, i] = numbers[taken : taken + width]
        taken += width
    if np.linalg.eigvalsh(matrix)[0] <= 0:
        raise found.wrong(element, "is not positive definite; a correlation is wrong, or a variance is zero")
    return matrix
