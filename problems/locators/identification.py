"""Which errors of the locators measured poses can tell, and how much better the pose is once they are corrected.

Every error of table 1 becomes a function of the travel of its body (`error_functions`): 48 numbers a locator, far more
than any campaign sees. `combinations` names what is seen; `identify` estimates all of them with what the tolerances say
beforehand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib import Effect, Estimate, Linearisation, Problem, prior, solve, units
from calib.geometry import Transform
from calib.units import arcsec, um
from problems.locators.effects import axis_group, error_functions
from problems.locators.measured import Readings, Setup, declare, rigid_fit

SEEN = 1e-6       # share of a column of unit length that no other column imitates, above which an unknown is seen


@dataclass(frozen=True)
class Knowledge:
    """What is known of the errors before the campaign, as standard uncertainties about zero.

    length: of constant, slope and bow of a position error at the end of the range [m]; angle: of constant and slope of
    an angle error [rad]; squareness [rad].
    """

    length: float = 20 * um
    angle: float = 8 * arcsec
    squareness: float = 20 * arcsec

    def u(self, effect: Effect) -> list[float]:
        """Standard uncertainty of each parameter of an error function."""
        if effect.name.startswith("squareness"):
            return [self.squareness]
        return [self.length if p.unit == "um" else self.angle for p in effect.parameters]


@dataclass(frozen=True)
class Combination:
    """A combination of errors that the readings see: its first member with factor one, and what cannot be told from it.

    members: ((label, unit, factor), ...), value = sum of factor * member, in display units.
    """

    members: tuple[tuple[str, str, float], ...]

    @property
    def words(self) -> str:
        """The combination as a sentence."""
        first, *others = self.members
        if not others:
            return f"{first[0]} [{first[1]}] alone"
        terms = " ".join(f"{'-' if factor < 0 else '+'} {abs(factor):.3g} {label} [{unit}]" for label, unit,
                         factor in others[:5])
        more = f" and {len(others) - 5} more" if len(others) > 5 else ""
        return f"{first[0]} [{first[1]}], together with {terms}{more}"


def read_locators(setup: Setup) -> list[str]:
    """Keys of the locators of which at least one axis is read."""
    return [locator.key for locator in setup.locators if setup.axes_of(locator.key)]


def with_error_functions(problem: Problem) -> Problem:
    """The same problem with all 21 errors of every locator that is read as free functions of the travel."""
    groups = {o.group for o in problem.observations}
    functions = [effect for key in "ABC" if axis_group(key) in groups for effect in error_functions(key)]
    return problem.with_effects(*functions).free(*functions)


def functions_in(problem: Problem) -> tuple[Effect, ...]:
    """The error functions that are attached to a problem."""
    return tuple(effect for effect in problem.effects if effect.parameters[0].name == "constant")


def identify(problem: Problem, knowledge: Knowledge | None = None, start: Estimate | None = None) -> Estimate:
    """All errors at once, with the knowledge beforehand as priors: what the readings do not see keeps its prior.

    problem: of `with_error_functions`; knowledge: standard uncertainties of the errors before the campaign.
    """
    knowledge = knowledge or Knowledge()
    known = [prior(problem.parameters(effect), 0.0, knowledge.u(effect)) for effect in functions_in(problem)]
    return solve(problem.with_observations(*known), start=start)


def combinations(fit: Linearisation, first: Sequence[str] = ("part", "tracker")) -> tuple[Combination, ...]:
    """The combinations of errors that the readings see, each led by an error that stands for those like it.

    fit: linearisation of a problem of `with_error_functions`, without priors; first: unknowns that are wanted in any
    case, whose freedom the errors cannot have. Leaders are taken in the order constant positions, squareness,
    positions, angles. The columns of the readings' derivatives are taken up one after the other; one that those before
    it imitate is no leader.
    """
    jacobian = fit.rows[0].toarray()
    columns = fit.layout.free_columns
    labels = [fit.layout.label(c) for c in columns]
    factors = np.array([units.factor(fit.layout.unit(c)) for c in columns])
    size = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(size > 0.0, size, 1.0)
    order = sorted(np.flatnonzero(size > 0.0), key=lambda j: _rank(labels[j], first))
    basis, leaders, others = np.zeros((len(jacobian), 0)), [], []
    for j in order:
        rest = scaled[:, j] - basis @ (basis.T @ scaled[:, j])
        rest -= basis @ (basis.T @ rest)                    # twice: the second pass removes what rounding left
        length = np.linalg.norm(rest)
        (leaders if length > SEEN else others).append(j)
        if length > SEEN:
            basis = np.column_stack([basis, rest / length])
    imitates = np.linalg.lstsq(jacobian[:, leaders], jacobian[:, others], rcond=None)[0]
    display = imitates * factors[others] / factors[leaders][:, None]
    found = []
    for i, j in enumerate(leaders):
        if _rank(labels[j], first) > 0:
            share = np.abs(imitates[i] * size[j] / size[others]) if others else np.zeros(0)
            members = [(labels[j], fit.layout.unit(columns[j]), 1.0)]
            members += [(labels[others[k]], fit.layout.unit(columns[others[k]]), float(display[i, k]))
                        for k in np.argsort(-share) if share[k] > 1e-3]
            found.append(Combination(tuple(members)))
    return tuple(found)


def _rank(label: str, first: Sequence[str]) -> int:
    if any(label.startswith(name) for name in first):
        return 0
    if label.startswith("positioning") and label.endswith("constant"):
        return 1
    if label.startswith("squareness"):
        return 2
    return 3 if label.startswith(("positioning", "straightness")) else 4


def unseen(fit: Linearisation) -> tuple[str, ...]:
    """Names of the free unknowns that no reading sees at all, whatever the others do."""
    size = np.linalg.norm(fit.rows[0].toarray(), axis=0)
    return tuple(fit.layout.label(c) for c, length in zip(fit.layout.free_columns, size, strict=True) if length == 0.0)


def poses_from_axes(setup: Setup, axes: Readings, u_axis: float, functions: Mapping[Effect,
                                                                                    NDArray[np.float64]] | None = None
                    ) -> list[Transform]:
    """The pose of the part that the axis readings alone give, corrected by known errors.

    setup; axes: readings of the poses in question; u_axis [m]; functions: {error function: its parameters}, none:
    nominal.
    """
    problem = declare(setup, axes, None, u_axis=u_axis)
    functions = functions or {}
    problem = problem.with_effects(*functions)
    return solve(problem, start={effect.label: value for effect, value in functions.items()})["part"]


def pose_error(setup: Setup, estimated: Sequence[Transform], true: Sequence[Transform]) -> float:
    """Root mean square distance [m] of the targets from where they are, one common rigid motion of the hall removed.

    The hall frame of the locators is a datum that nothing fixes; what remains is the error from pose to pose.
    """
    points = np.array(list(setup.targets.values()), dtype=float)
    there = np.concatenate([pose @ points for pose in true])
    here = np.concatenate([pose @ points for pose in estimated])
    distance = there - rigid_fit(here, there) @ here
    return float(np.sqrt(np.mean(np.sum(distance ** 2, axis=1))))


def identified(estimate: Estimate) -> dict[Effect, NDArray[np.float64]]:
    """The error functions of an estimate with their parameters, for `poses_from_axes`."""
    return {effect: estimate[effect] for effect in functions_in(estimate.problem)}
