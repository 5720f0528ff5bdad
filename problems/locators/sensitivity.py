"""Sensitivities of the pose to single errors and the conclusions drawn from them (section 4, eq 53-56).

Source: Li Chen, Fang Qiang, Li Jiangxiong 2010, section 4: an error of length counts 1 mm, an angle 1 mm/stroke.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.units import degree, mm
from problems.locators import paper
from problems.locators.errors import AXES, BODY_OF
from problems.locators.pose_error import LinearForm

SQUARENESS_BODY = {"exy": "y", "eyz": "z", "ezx": "z"}


@dataclass(frozen=True)
class Sensitivity:
    """What one error does to the pose: source "A.ey_x", group, and the two sensitivities s_r [mm] and s_phi [deg]."""

    source: str
    group: str
    position: float
    attitude: float


def group_of(source: str) -> str:
    """The group of section 4 that a source belongs to: linear, ball, angular or squareness."""
    name = source.split(".")[1]
    if name[:2] in ("dq", "dr"):
        return "ball"
    if name in SQUARENESS_BODY:
        return "squareness"
    return "linear" if name[0] == "d" else "angular"


def sensitivities(form: LinearForm, strokes: NDArray[np.float64]) -> tuple[Sensitivity, ...]:
    """The sensitivities of all sources that move the part at all.

    form: linear form of the pose error; strokes: (3, 3) [m] by locator and axis, the lengths that angles are divided
    by.
    """
    result = []
    for source in form.seen:
        key, name = source.split(".")
        size = mm
        if group_of(source) in ("angular", "squareness"):
            body = BODY_OF.get(name) or SQUARENESS_BODY[name]
            size = mm / abs(strokes[paper.LOCATORS.index(key), AXES.index(body)])
        response = form.column(source) * size
        result.append(Sensitivity(source, group_of(source), float(np.linalg.norm(response[:3])) / mm,
                                  float(np.linalg.norm(response[3:])) / degree))
    return tuple(result)


def counts(found: Sequence[Sensitivity]) -> dict[str, int]:
    """How many sources each group has."""
    return {group: sum(one.group == group for one in found) for group in ("linear", "ball", "angular", "squareness")}


def attitude_below_position(found: Sequence[Sensitivity], angle_unit: float = degree) -> int:
    """How many sources have an attitude sensitivity below their position sensitivity in mm; angle_unit: [rad]."""
    return sum(one.attitude * degree / angle_unit < one.position for one in found)


def angular_above_linear(found: Sequence[Sensitivity]) -> int:
    """How many of the angular and squareness sources move the part farther than every linear and ball source does."""
    largest = max(one.position for one in found if one.group in ("linear", "ball"))
    return sum(one.position > largest * (1 + 1e-3) for one in found if one.group in ("angular", "squareness"))


def angle_levers(form: LinearForm) -> NDArray[np.float64]:
    """For each of the six components the longest lever [m]: largest response to an angle over that to an error of
    length."""
    angle = np.array([group_of(source) in ("angular", "squareness") for source in form.sources])
    return np.abs(form.matrix[:, angle]).max(1) / np.abs(form.matrix[:, ~angle]).max(1)


def table(found: Sequence[Sensitivity]) -> list[dict[str, object]]:
    """The sensitivities as plain rows, for a report."""
    return [{"source": one.source, "group": one.group, "s_r_mm": one.position, "s_phi_deg": one.attitude}
            for one in found]
