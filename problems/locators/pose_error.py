"""Pose error of a part whose axes stand exactly at their commanded travels while the locators have errors.

A declared problem: the pose is unknown, the axis readings are the observations, the errors are held. The linear form
(eq 29-52) is the derivative of that problem, whichever six axes are driven, or all nine by least squares.
Source: Li Chen, Fang Qiang, Li Jiangxiong 2010, section 2.3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import Linearisation, Observations, Pose, Problem, Quantity, Shared, Unknown, linearise, solve
from calib.geometry import Transform, column, rpy_from_rotation
from calib.units import degree, mm, um
from problems.locators.errors import AXES, SHIFTS, TURNS
from problems.locators.kinematics import readings_of
from problems.locators.measured import Setup
from problems.locators.paper import strokes

COMPONENTS = ("dx_p", "dy_p", "dz_p", "dalpha", "dbeta", "dgamma")
COMPONENT_UNITS = ("mm", "mm", "mm", "deg", "deg", "deg")
IN_UNIT = np.array([mm] * 3 + [degree] * 3)
BALLS = tuple(f"dr_{axis}" for axis in AXES)
SOURCES = (*SHIFTS, *TURNS, *BALLS)              # of one locator: 24 of the locator and 3 of the ball in the part
Axes = Mapping[str, tuple[str, ...]]


def position_and_angles(part_pose: Transform) -> Any:
    """x, y, z [m] and alpha, beta, gamma [rad] (6,) of a pose, as the paper's delta E orders them (eq 44)."""
    angles = rpy_from_rotation(part_pose.rotation)
    return column(*(part_pose.translation[i] for i in range(3)), *(angles[i] for i in range(3)))


def declare(mechanism: Setup, part_pose: Transform, driven: Axes | None = None, *, shifts: ArrayLike | None = None,
            turns: ArrayLike | None = None, balls: ArrayLike | None = None) -> Problem:
    """The pose that axes at their commanded travels give the part, every axis weighing the same.

    mechanism: locators and balls; part_pose: the commanded hall_from_part; driven: {locator: axes} or all nine; shifts:
    (n, 3, 12) [m], turns: (n, 3, 12) [rad], balls: (n, 3, 3) [m], errors of n trials by locator, each with its own
    pose. Without them there is one pose and the errors are held unknowns `shift`, `turn` and `ball_in_part`.
    """
    driven = driven or {locator.key: AXES for locator in mechanism.locators}
    travel = strokes(mechanism, part_pose)
    keys = [locator.key for locator in mechanism.locators]
    nominal = np.array([locator.ball_in_part for locator in mechanism.locators])
    n = 1 if shifts is None else len(np.asarray(shifts))
    part = Pose("part", part_pose.rotation, np.repeat(part_pose.translation[None], n, 0), "mm", "deg")
    held: tuple[Unknown, ...] = ()
    if shifts is None:
        held = (Unknown("ball_in_part", nominal, "mm", AXES, keys),
                Unknown("shift", np.zeros((len(keys), len(SHIFTS))), "mm", SHIFTS, keys),
                Unknown("turn", np.zeros((len(keys), len(TURNS))), "deg", TURNS, keys))
    observations = []
    for i, locator in enumerate(mechanism.locators):
        axes = tuple(driven.get(locator.key, ()))
        if not axes:
            continue
        errors = [h[np.zeros(n, dtype=int) + i] for h in held] if held else [
            nominal[i] + np.asarray(balls)[:, i], np.asarray(shifts)[:, i], np.asarray(turns)[:, i]]
        observations.append(Observations(
            readings_of(axes), part.each, errors[0], Shared(locator.frames.matrix), Shared(travel[i]),
            Shared(mechanism.half_range), Shared(np.zeros(3)), errors[1], errors[2],
            readings=np.repeat(travel[i][None, [AXES.index(a) for a in axes]], n, 0), u=1 * um,
            group=f"drives {locator.key}", unit="um", components=axes))
    # A thousand trials have a thousand poses; their derivatives with respect to each other nobody wants.
    where = [Quantity("pose", position_and_angles, part.each, unit=COMPONENT_UNITS, parts=COMPONENTS)] if held else []
    return Problem(observations, quantities=where, held=held, name="pose under drive")


def choice(numbers: tuple[int, ...]) -> dict[str, tuple[str, ...]]:
    """Driven axes by locator of numbers 0..8 that count X_A, Y_A, Z_A, X_B, ... as eq 41 does."""
    return {key: tuple(AXES[n % 3] for n in numbers if n // 3 == i) for i, key in enumerate("ABC")}


@dataclass(frozen=True)
class LinearForm:
    """Pose error as a linear function of all errors: delta E = matrix @ errors.

    matrix: (6, 81), x, y, z [m], alpha, beta, gamma [rad] per error [m or rad]; sources: "A.ex_x", one for each column.
    """

    matrix: NDArray[np.float64]
    sources: tuple[str, ...]

    def column(self, source: str) -> NDArray[np.float64]:
        """Derivative (6,) of the pose error with respect to one source."""
        return self.matrix[:, self.sources.index(source)]

    @property
    def seen(self) -> tuple[str, ...]:
        """The sources that move the part at all."""
        return tuple(s for s, size in zip(self.sources, np.abs(self.matrix).max(0), strict=True) if size > 1e-12)

    @property
    def response(self) -> NDArray[np.float64]:
        """The matrix (6, 81) with rows in mm and degrees, columns per metre and per radian."""
        return self.matrix / IN_UNIT[:, None]


def linear_form(mechanism: Setup, part_pose: Transform, driven: Axes | None = None) -> LinearForm:
    """The linear form of the pose error, differentiated from the exact model (the paper's eq 32-34 and 52).

    mechanism; part_pose: the commanded hall_from_part; driven: {locator: axes}, or all nine by least squares.
    """
    return form_of(linearise(declare(mechanism, part_pose, driven)))


def form_of(fit: Linearisation) -> LinearForm:
    """The linear form in a linearisation of `declare`: how the free pose gives way to what is held."""
    layout = fit.layout
    by_name = {u.name: u for u in layout.unknowns}
    column_of: dict[str, int] = {}
    for unknown, names in ((by_name["shift"], SHIFTS), (by_name["turn"], TURNS), (by_name["ball_in_part"], BALLS)):
        span = layout.span(unknown)
        sources = (f"{key}.{name}" for key in unknown.keys for name in names)
        column_of.update(zip(sources, range(span.start, span.stop), strict=True))
    ordered = tuple(f"{key}.{name}" for key in by_name["shift"].keys for name in SOURCES)
    columns = [column_of[source] for source in ordered]
    follows = -np.linalg.lstsq(fit.rows[0].toarray(), fit.held_columns(columns), rcond=None)[0]
    pose = fit.functions("pose").derivatives
    return LinearForm(fit.free_part(pose) @ follows + pose[:, columns], ordered)


def conditioning(mechanism: Setup, part_pose: Transform) -> dict[tuple[int, ...], float]:
    """Condition number of the Jacobian J_p of each of the 84 choices of six driven axes, best first.

    Rotations are measured by the way of the farthest ball, so that the number has no unit.
    """
    jacobian = linearise(declare(mechanism, part_pose)).rows[0].toarray()
    size = max(float(np.linalg.norm(locator.ball_in_part)) for locator in mechanism.locators)
    scaled = jacobian / np.array([1.0] * 3 + [size] * 3)
    numbers = {six: float(np.linalg.cond(scaled[list(six)])) for six in combinations(range(9), 6)}
    return dict(sorted(numbers.items(), key=lambda item: item[1]))


def exact_pose_errors(mechanism: Setup, part_pose: Transform, driven: Axes | None, shifts: ArrayLike, turns: ArrayLike,
                      balls: ArrayLike) -> NDArray[np.float64]:
    """Pose errors (n, 6) [mm, deg] of n trials from the exact model, solved without linearisation.

    Arguments as for `declare`.
    """
    problem = declare(mechanism, part_pose, driven, shifts=shifts, turns=turns, balls=balls)
    poses = solve(problem)["part"]
    return np.array([position_and_angles(one) - position_and_angles(part_pose) for one in poses]) / IN_UNIT
