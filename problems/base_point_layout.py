"""Layout of three target points for the calibration of a base point in a plane: the smallest sqrt(Q11 + Q22).

Readings of unit u on targets in the unit directions e_i from the base point give its two coordinates by any linear
estimator B with B A = 1, where A has the rows e_i; the sum of the two variances is the sum of squares of B. Best
estimator and best layout together are one least-squares problem: every element of B is "read" as zero with u = 1,
B A = 1 is a condition, and v'Pv at its minimum is Q11 + Q22.
Source: Chen, Li, Zhang, Zhao, J. Astronautic Metrology and Measurement 27(2), 2007, equations 2 to 5 ("the paper").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import Constraint, Effect, Observations, Problem, Quantity, Unknown, covariance, linearise, solve
from calib.errors import CalibrationError, InputError, RankDefect
from calib.job import Job
from calib.solve.ipopt import Ipopt
from calib.solve.method import Method
from problems import base_point
from problems.base_point import AbsoluteRange, FreeStart, TiedStart
from problems.base_point.lines import Lines

Array = NDArray[np.float64]
accepts = ("base_point_layout", "base-point-layout")
measures = False      # a layout is sought: the readings are a goal, and no truth is to be covered
KNOWN, FREE, TIED = AbsoluteRange(), FreeStart(), TiedStart()      # of the length at the zero of the reading
TARGETS = 3
STRAIGHT = Ipopt()                    # with exact second derivatives: the conditions of a layout are curved


# --- the quality of a given layout -----------------------------------------------------------------------------------


def planar(targets: ArrayLike, centre: ArrayLike, zero: base_point.Zero, u: float = 1.0) -> Problem:
    """The plan of a calibration in a plane, without readings.

    targets: (n, 2) [m]; centre: (2,) [m] the base point; zero: what is known of the length at the zero of the reading:
    AbsoluteRange() it is known, FreeStart() it is not, TiedStart(point) it is the distance of that point; u: [m].
    """
    targets, centre = np.asarray(targets, float), np.asarray(centre, float)
    points = np.column_stack([targets, np.zeros(len(targets))])
    plan = base_point.declare(Lines(points, None, u), zero, begin=(*centre, 0.0))
    unknown = plan.select("base_point").unknown
    return plan.hold(unknown.part("z"))


def uncertainties(targets: ArrayLike, centre: ArrayLike, zero: base_point.Zero, u: float = 1.0) -> Array:
    """Standard uncertainties (2,) [m] of the base point from readings of u [m]; arguments as for `planar`.

    Raises RankDefect where the layout does not determine the base point.
    """
    plan = planar(targets, centre, zero, u)
    return covariance(linearise(plan), plan.select("base_point").unknown.part("x", "y")).u


def root_of_trace(targets: ArrayLike, centre: ArrayLike, zero: base_point.Zero) -> float:
    """sqrt(Q11 + Q22) of a layout, equation 4; arguments as for `planar`. Raises RankDefect as `uncertainties`."""
    return float(np.linalg.norm(uncertainties(targets, centre, zero)))


def mirror_rotation(travel: ArrayLike, foot: float, off: float) -> float:
    """How far [rad] the tracking mirror turns from the zero of a line to the end of the travel (n,) [m].

    foot: coordinate along the line of the point nearest to the base point, off: its distance from the line [m].
    A mirror turns by half the angle of its reflected beam.
    """
    seen = np.arctan2(foot - np.append(0.0, np.asarray(travel, float)), off)
    return float(np.ptp(seen)) / 2


# --- the best layout --------------------------------------------------------------------------------------------------


def nothing(estimator: Any) -> Any:
    """The elements of the estimator: "read" as zero with u = 1, so that v'Pv is the sum of the variances."""
    return estimator


def length_of(estimator: Any) -> Any:
    """sqrt(Q11 + Q22): the root of the sum of squares of an estimator (2n,)."""
    return ca.norm_2(estimator)


def lines_of_sight(angle: Any) -> Any:
    """Unit directions (n, 2) from the base point for angles (n,) [rad]: the matrix A of equation 5."""
    return ca.horzcat(ca.cos(angle), ca.sin(angle))


def unbiased(estimator: Any, angle: Any) -> Any:
    """B A - 1, which must vanish where the length at the zero is known; estimator (2n,), angle (n,)."""
    rows = lines_of_sight(angle)
    return ca.vec(ca.reshape(estimator, 2, rows.shape[0]) @ rows - ca.DM.eye(2))


def unbiased_from_free_start(estimator: Any, angle: Any) -> Any:
    """The same where that length is unknown: a change of it, which all readings share, must change nothing."""
    rows = ca.reshape(estimator, 2, angle.shape[0])
    return ca.vertcat(unbiased(estimator, angle), ca.sum2(rows))


def declare(zero: base_point.Zero = KNOWN, begin: ArrayLike | None = None) -> Problem:
    """The layout of three targets with the smallest sqrt(Q11 + Q22), the first direction held as in equation 5.

    zero: AbsoluteRange() where the length at the zero of the reading is known, FreeStart() where it is not.
    begin: (3,) [rad] start angles, spread unevenly over the circle where None. Quantity `sqrt_q` is the result. The
    conditions are curved: Ipopt() goes straight to the minimum, GaussNewton() ever more slowly. (Of more than three
    targets whole families share the smallest value, evenly spread ones among them: there is nothing to search.)
    Raises InputError for another number of angles, and for a start that is tied to a point of the plane.
    """
    if isinstance(zero, TiedStart):
        raise InputError("the best layout is declared for a known or a free length at the zero of the reading; with a "
                         "length tied to a zero point compare given layouts by `uncertainties`")
    free = isinstance(zero, FreeStart)
    begin = np.array([0.0, 2.5, 5.0]) if begin is None else np.asarray(begin, float)
    if begin.shape != (TARGETS,):
        raise InputError(f"{begin.size} start angles were given for {TARGETS} targets; give one for each")
    angle = Unknown("angle", begin - begin[0], "deg", parts=[str(k + 1) for k in range(TARGETS)])
    rows = np.column_stack([np.array(lines_of_sight(angle.ambient[0])), *([np.ones(TARGETS)] if free else [])])
    estimator = Unknown("estimator", np.linalg.pinv(rows)[:2].T.ravel(),
                        parts=[f"{axis}{k + 1}" for k in range(TARGETS) for axis in "xy"])
    variance = Observations(nothing, estimator, readings=np.zeros((1, 2 * TARGETS)), u=1.0, group="variance")
    condition = Constraint("unbiased", unbiased_from_free_start if free else unbiased, estimator, angle,
                           tolerance=1e-10)
    return Problem([variance], [condition], [Quantity("sqrt_q", length_of, estimator)], held=[angle.part("1")],
                   name="layout of target points")


@dataclass(frozen=True)
class BestLayout:
    """The smallest sqrt(Q11 + Q22) found, a bound below which no layout lies, and the angles (3,) [rad] that have it.

    found: how many of the starts led there.
    """

    value: float
    bound: float
    angles: Array
    found: int
    starts: int

    @property
    def gap(self) -> float:
        """value/bound - 1: zero proves the minimum."""
        return self.value / self.bound - 1.0


def bound(targets: int) -> float:
    """A value that sqrt(Q11 + Q22) of n targets cannot fall below: 2/sqrt(n).

    The rows of A have length 1, so the eigenvalues a, b of A'A have a + b = n, and Q11 + Q22 = 1/a + 1/b >= 4/(a + b);
    an unknown length at the zero only adds to Q.
    """
    return float(np.sqrt(4.0 / targets))


def best_layout(zero: base_point.Zero, starts: int, seed: int, method: Method = STRAIGHT) -> BestLayout:
    """Search the best layout of three targets from random starts.

    zero: as for `declare`; starts: how many; seed: of the start angles; method: of the solver.
    Raises CalibrationError where no start leads to a minimum.
    """
    generator = np.random.default_rng(seed)
    results = []
    for _ in range(starts):
        try:
            estimate = solve(declare(zero, generator.uniform(0.0, 2 * np.pi, TARGETS)), method)
        except RankDefect:                               # a start whose targets fall together
            continue
        if estimate.certificate.passed:
            results.append((estimate["sqrt_q"], np.ravel(estimate["angle"]) % (2 * np.pi)))
    if not results:
        raise CalibrationError(f"none of {starts} starts led to a minimum; try more starts or another seed")
    value, angles = min(results, key=lambda one: one[0])
    return BestLayout(value, bound(TARGETS), angles, sum(v < value + 1e-9 for v, _ in results), starts)


# --- jobs and an example ----------------------------------------------------------------------------------------------


def effects() -> tuple[Effect, ...]:
    """No effects: a layout is planned, nothing is read."""
    return ()


def from_job(job: Job) -> Problem:
    """The best layout of three targets; option start_reading ("known" or "free").

    Raises InputError naming the key.
    """
    zeros: dict[str, base_point.Zero] = {"known": KNOWN, "free": FREE}
    return declare(zeros[job.options.text("start_reading", "known", tuple(zeros))])


def example(seed: int) -> Problem:
    """Three targets and an unknown length at the zero; seed: of the start angles."""
    return declare(FREE, np.array([0.0, 2.1, 4.2]) + np.random.default_rng(seed).uniform(-0.4, 0.4, 3))


def example_job(seed: int) -> dict[str, str]:
    """A runnable job {file name: text}: the layout of three targets; to be solved with --method ipopt."""
    return {"job.toml": """problem = "problems.base_point_layout"
[options]
start_reading = "free"
[report]
quantities = ["sqrt_q"]
"""}
