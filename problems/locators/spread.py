"""Spread of the pose error from the tolerances of table 4: which lengths would give the printed sigmas of table 6.

The tolerances of angles are printed "per full guide length", "per stroke", but no length is printed. The variance of
each component of the pose error is affine in the inverse squares of these lengths, so the search for them is a declared
problem.
Source: Li Chen, Fang Qiang, Li Jiangxiong 2010, tables 4 and 6, section 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from casadi import dot, sqrt
from numpy.typing import NDArray

from calib import Estimate, Observations, Problem, Quantity, Unknown, solve
from calib.table import shipped
from calib.units import um
from problems.locators.errors import AXES
from problems.locators.pose_error import COMPONENTS, IN_UNIT, LinearForm

SAMPLES = 5000
LENGTHS = ("guide of X", "guide of Y", "guide of Z", "stroke of X or Y", "stroke of Z")
BALL = "ball tolerance"
LENGTH_UNIT = 0.1       # the search counts in inverse squares of 0.1 m, of size one


@dataclass(frozen=True)
class Assumption:
    """One reading of table 4.

    name; full_width: the index is the whole width of the interval (else half of it); roll_by_parallelism: the roll of a
    guide follows from the parallelism of its rails (else from its straightness, like pitch and yaw); ball: the ball
    centres have an error of their own, of one unknown half width; lengths: which lengths are taken as one, by group.
    """

    name: str
    full_width: bool = False
    roll_by_parallelism: bool = False
    ball: bool = True
    groups: tuple[tuple[str, ...], ...] = (LENGTHS,)


ASSUMPTIONS = (
    Assumption("one length for everything"),
    Assumption("one length for everything, indices as full widths", full_width=True),
    Assumption("one length for everything, roll from parallelism", roll_by_parallelism=True),
    Assumption("one length for guides, one for strokes, roll from parallelism", roll_by_parallelism=True,
               groups=(LENGTHS[:3], LENGTHS[3:])),
    Assumption("one length for everything, balls without error", ball=False),
)
ALL_LENGTHS = Assumption("every length by itself", groups=tuple((length,) for length in LENGTHS))


def scale_of(source: str, tolerances: dict[str, float], assumption: Assumption) -> tuple[float, str | None]:
    """Half width of one source: tolerance [m] and the length it is divided by (None for a length error).

    source: "A.ey_x"; tolerances: of table 4 [m]. A ball error has one, to be multiplied by the unknown ball tolerance.
    """
    name = source.split(".")[1]
    if name[:2] in ("dq", "dr"):
        return 1.0, BALL
    half = 0.5 if assumption.full_width else 1.0
    if name[0] == "d":
        return half * tolerances["positioning" if name[1] == name[-1] else "straightness"], None
    if name == "exy":
        return half * tolerances["square_xy"], LENGTHS[3]
    if name in ("eyz", "ezx"):
        return half * tolerances["square_z"], LENGTHS[4]
    rolls = name[1] == name[-1] and assumption.roll_by_parallelism
    return half * tolerances["parallelism" if rolls else "straightness"], LENGTHS[AXES.index(name[-1])]


def variance_weights(form: LinearForm, tolerances: dict[str, float], assumption: Assumption
                     ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Variance of the six components as known (6,) + by_length (6, k) @ inverse squares + by_ball (6,) * ball^2, SI.

    The inverse squares [1/m^2] are those of the k groups of lengths; ball: half width of the errors of ball centres
    [m]. Errors are independent and uniform, so each has a third of the square of its half width.
    """
    known, by_length, by_ball = np.zeros(6), np.zeros((6, len(assumption.groups))), np.zeros(6)
    for source, response in zip(form.sources, form.matrix.T, strict=True):
        scale, length = scale_of(source, tolerances, assumption)
        part = (response * scale) ** 2 / 3.0
        if length is None:
            known += part
        elif length == BALL:
            by_ball += part
        else:
            by_length[:, next(i for i, group in enumerate(assumption.groups) if length in group)] += part
    return known, by_length, by_ball


def printed_sigmas() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The six sigmas of table 6 and their standard uncertainties from sampling and rounding, (6,) each in SI."""
    table = shipped("locators/table6_pose_error.csv")
    rows = [i for i, text in enumerate(table.text("statistic")) if text == "sigma"]
    texts = [str(table.text("value")[i]) for i in rows]
    sigma = np.array([float(text) for text in texts])
    half_digit = np.array([0.5 * 10.0 ** -len(text.split(".")[1]) for text in texts])
    u = np.hypot(sigma / np.sqrt(2 * SAMPLES), half_digit / np.sqrt(3.0))
    return sigma * IN_UNIT, u * IN_UNIT


def control_point_sigmas(form: LinearForm) -> dict[str, Any]:
    """What table 6 says without any length: standard deviations of a ball along x, y and z, the same at every locator.

    form: linear form of the pose error. Three numbers for six sigmas; returns them with v'Pv and its freedom.
    """
    sigma, u = printed_sigmas()
    by_axis = np.array([sum(form.column(f"{key}.d{axis}_x") ** 2 for key in "ABC") for axis in AXES]).T
    variance = Unknown("variance", np.full(3, 4e-10), "mm^2", AXES, lower=0.0)
    rows = Observations(lambda weight, variances: dot(weight, variances), by_axis / sigma[:, None] ** 2, variance,
                        readings=np.ones(6), u=2 * u / sigma, group="table 6")
    estimate = solve(Problem([rows], name="table 6 by control points"))
    return {**{f"sigma of a ball along {axis} [mm]": float(np.sqrt(value)) / 1e-3
               for axis, value in zip(AXES, estimate[variance], strict=True)},
            "v'Pv": estimate.objective, "dof": estimate.dof, "p_value": estimate.p_value}


def relative_variance(known: Any, by_length: Any, by_ball: Any, inverse_square: Any, ball_square: Any) -> Any:
    """Variance of one component in units of the printed one: affine in the unknowns."""
    return known + dot(by_length, inverse_square) + by_ball * ball_square


def declare(form: LinearForm, tolerances: dict[str, float], assumption: Assumption) -> Problem:
    """The lengths and the ball tolerance that would give the six printed sigmas.

    form: the linear form of the pose error; tolerances: of table 4 [m]; assumption: how table 4 is read.
    """
    sigma, u = printed_sigmas()
    known, by_length, by_ball = (part / (sigma ** 2 if part.ndim == 1 else sigma[:, None] ** 2)
                                 for part in variance_weights(form, tolerances, assumption))
    names = [" = ".join(group) for group in assumption.groups]
    inverse_square = Unknown("inverse square", np.full(len(names), 10.0), "1/m^2", names, lower=0.0)
    ball_square = Unknown("square of the ball tolerance", 2.5e-11 if assumption.ball else 0.0, "um^2", lower=0.0)
    observations = Observations(relative_variance, known, by_length, by_ball, inverse_square, ball_square,
                                readings=np.ones(6), u=2 * u / sigma, group="table 6",
                                covariates={"component": np.array(COMPONENTS)})
    quantities = [Quantity("length", lambda squares: [1 / sqrt(squares[i]) for i in range(len(names))], inverse_square,
                           unit="mm", parts=names)]
    if assumption.ball:
        quantities.append(Quantity("ball tolerance", lambda square: sqrt(square), ball_square, unit="um"))
    return Problem([observations], quantities=quantities, held=() if assumption.ball else (ball_square,),
                   name=f"table 6, {assumption.name}")


def component_sigmas(form: LinearForm, tolerances: dict[str, float], assumption: Assumption, estimate: Estimate
                     ) -> NDArray[np.float64]:
    """The six sigmas (6,) [mm, deg] that an assumption gives with its estimated lengths."""
    relative = estimate.predicted["table 6"][:, 0]
    return np.sqrt(relative) * printed_sigmas()[0] / IN_UNIT


def half_widths(form: LinearForm, tolerances: dict[str, float], assumption: Assumption, estimate: Estimate
                ) -> NDArray[np.float64]:
    """Half width (81,) [m or rad] of every source of a linear form under an assumption with its estimated lengths."""
    inverse_square = np.atleast_1d(estimate["inverse square"])
    ball = float(np.sqrt(estimate["square of the ball tolerance"]))
    result = []
    for source in form.sources:
        scale, length = scale_of(source, tolerances, assumption)
        if length == BALL:
            scale = ball
        elif length is not None:
            scale *= np.sqrt(inverse_square[next(i for i, group in enumerate(assumption.groups) if length in group)])
        result.append(scale)
    return np.array(result)


def length_ranges(form: LinearForm, tolerances: dict[str, float], assumption: Assumption,
                  within: dict[str, tuple[float, float]], ball: tuple[float, float] = (0.0, 20 * um)
                  ) -> dict[str, tuple[float, float]] | None:
    """How short and how long each length can be if all six printed sigmas are to come out.

    assumption: its groups of lengths; within: the range that is searched for each group [m]; ball: that of the ball
    tolerance [m]. "Come out": within the 95% interval of sampling and rounding. The variances are affine in the inverse
    squares, so both ends are linear programs. Returns {group: (shortest, longest)} [m], the ball tolerance too, or None
    where no lengths do it.
    """
    from scipy.optimize import linprog
    sigma, u = printed_sigmas()
    known, by_length, by_ball = variance_weights(form, tolerances, assumption)
    names = [" = ".join(group) for group in assumption.groups]
    weights = np.column_stack([by_length / LENGTH_UNIT ** 2, by_ball * um ** 2]) / sigma[:, None] ** 2
    half = 1.96 * 2 * u / sigma
    limits = np.concatenate([half + 1 - known / sigma ** 2, half - 1 + known / sigma ** 2])
    bounds = [((LENGTH_UNIT / within[name][1]) ** 2, (LENGTH_UNIT / within[name][0]) ** 2) for name in names]
    bounds.append(((ball[0] / um) ** 2, (ball[1] / um) ** 2))
    found = {}
    for i, name in enumerate([*names, BALL]):
        ends = []
        for sign in (-1.0, 1.0):
            program = linprog(sign * np.eye(len(bounds))[i], np.concatenate([weights, -weights]), limits, bounds=bounds)
            if program.status == 2:
                return None
            ends.append(float(program.x[i]))
        found[name] = ((np.sqrt(ends[1]) * um, np.sqrt(ends[0]) * um) if name == BALL
                       else (LENGTH_UNIT / np.sqrt(ends[0]), LENGTH_UNIT / np.sqrt(ends[1])))
    return found
