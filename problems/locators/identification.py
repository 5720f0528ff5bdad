"""Which errors of the locators measured poses can tell, and how much better the pose is once they are corrected.

Every error of table 1 becomes a function of the travel of its body (`error_functions`): 48 numbers a locator, far more
than any campaign sees. `combinations` names what is seen; `identify` estimates all of them with what the tolerances say
beforehand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from casadi import vertcat
from numpy.typing import NDArray

from calib import (
    Effect,
    Estimate,
    Linearisation,
    Observations,
    Parameter,
    Pose,
    Problem,
    Quantity,
    Shared,
    linearise,
    prior,
    solve,
    units,
)
from calib.geometry import Transform, cross
from calib.linearisation import Functions
from calib.units import arcsec, mm, um
from problems.locators.measured import Readings, Setup, declare, rigid_fit
from problems.locators.vocabulary import axis_group, error_functions

RESTING = 0.1 * um     # how well the forces of the joints balance, as displacement
NAMED = 0.3       # a companion is named from this share of the leader's size on


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

    members: ((label, unit, factor), ...), value = sum of factor * member, in display units; derivatives: (size,) in SI
    with respect to all columns of the linearisation.
    """

    members: tuple[tuple[str, str, float], ...]
    derivatives: NDArray[np.float64]

    @property
    def leader(self) -> str:
        """Name of the first member."""
        return self.members[0][0]

    @property
    def words(self) -> str:
        """The combination as a sentence."""
        (name, unit, _), *others = self.members
        if not others:
            return f"{name} [{unit}] alone"
        terms = [f"{'-' if factor < 0 else '+'} {abs(factor):.3g} {label} [{its_unit}]"
                 for label, its_unit, factor in others[:5]]
        more = f" and {len(others) - 5} more" if len(others) > 5 else ""
        return f"{name} [{unit}] {' '.join(terms)}{more}"


def with_error_functions(problem: Problem) -> Problem:
    """The same problem with all 21 errors of every locator that is read as free functions of the travel."""
    prefix = axis_group("")
    keys = [o.group.removeprefix(prefix) for o in problem.observations if o.group.startswith(prefix)]
    functions = [effect for key in keys for effect in error_functions(key)]
    return problem.with_effects(*functions).free(*functions)


def functions_in(problem: Problem) -> tuple[Effect, ...]:
    """The error functions that are attached to a problem."""
    return tuple(effect for effect in problem.effects if effect.parameters[0].name == "constant")


def with_knowledge(problem: Problem, knowledge: Knowledge | None = None) -> Problem:
    """The same problem with what is known of its error functions beforehand as priors.

    problem: of `with_error_functions`; knowledge: standard uncertainties of the errors before the campaign.
    """
    knowledge = knowledge or Knowledge()
    return problem.with_observations(
        *(prior(problem.parameters(effect), 0.0, knowledge.u(effect)) for effect in functions_in(problem)))


def identify(problem: Problem, knowledge: Knowledge | None = None) -> Estimate:
    """All errors at once, with the knowledge beforehand as priors: what the readings do not see keeps its prior.

    problem, knowledge: as for `with_knowledge`.
    """
    return solve(with_knowledge(problem, knowledge))


def combinations(fit: Linearisation, knowledge: Knowledge | None = None) -> tuple[Combination, ...]:
    """The combinations of errors of which the readings tell more than was known before.

    fit: linearisation of a problem of `with_error_functions`, without priors; knowledge: standard uncertainties of the
    errors before the campaign. Poses and tracker come first, then the errors one after the other: constant positions,
    squareness, positions, angles. An error leads a combination if as much of it as was possible beforehand, less what
    poses and earlier leaders imitate, stands out of the noise; what cannot be told from the leaders is named with them.
    """
    known = knowledge or Knowledge()
    size = np.full(fit.layout.size, np.inf)
    for effect in fit.effects:
        if effect.parameters[0].name == "constant":
            size[fit.layout.span(fit.effects[effect])] = known.u(effect)
    columns = fit.layout.free_columns
    size, labels = size[columns], [fit.layout.label(int(c)) for c in columns]
    jacobian = fit.rows[0].toarray()
    errors = np.flatnonzero(np.isfinite(size))
    scaled = jacobian.copy()
    scaled[:, errors] *= size[errors]
    wanted = np.linalg.qr(jacobian[:, np.isinf(size)] / np.linalg.norm(jacobian[:, np.isinf(size)], axis=0))[0]
    leaders, others = _leaders(scaled, wanted, sorted(errors, key=lambda j: _rank(labels[j])))
    basis = np.column_stack([wanted, scaled[:, leaders]])
    imitates = np.linalg.lstsq(basis, scaled[:, others], rcond=None)[0][wanted.shape[1]:]
    found = []
    for i, j in enumerate(leaders):
        derivatives = np.zeros(fit.layout.size)
        derivatives[columns[j]], derivatives[columns[others]] = 1.0, imitates[i] * size[j] / size[others]
        named = [j, *(others[k] for k in np.argsort(-np.abs(imitates[i])) if abs(imitates[i, k]) > NAMED)]
        unit = [fit.layout.unit(columns[k]) for k in named]
        scale = np.array([units.factor(u) for u in unit])
        factor = derivatives[columns[named]] * scale / scale[0]
        members = tuple(zip((labels[k] for k in named), unit, factor.tolist(), strict=True))
        found.append(Combination(members, derivatives))
    return tuple(found)


def _leaders(columns: NDArray[np.float64], basis: NDArray[np.float64], order: Sequence[int]
             ) -> tuple[list[int], list[int]]:
    """Columns taken up in an order: those that keep more than one unit beside basis and earlier ones, and the rest."""
    leaders, others = [], []
    for j in order:
        rest = columns[:, j] - basis @ (basis.T @ columns[:, j])
        rest -= basis @ (basis.T @ rest)                    # twice: the second pass removes what rounding left
        length = np.linalg.norm(rest)
        if length > 1.0:
            leaders.append(j)
            basis = np.column_stack([basis, rest / length])
        else:
            others.append(j)
    return leaders, others


def _rank(label: str) -> int:
    if label.startswith("positioning") and label.endswith("constant"):
        return 1
    if label.startswith("squareness"):
        return 2
    return 3 if label.startswith(("positioning", "straightness")) else 4


def balance(part_pose: Transform, give_a: Any, give_b: Any, give_c: Any, balls: Any) -> Any:
    """Force and moment (6,) of three ball joints that give way alike, per stiffness; zero where the part is at rest.

    part_pose: hall_from_part; give_*: (3,) [m] of each joint; balls: (3, 3) [m], their centres in the part by rows.
    Returns the force [m] and the moment [m m].
    """
    arms = [part_pose.turn(balls[i, :].T) for i in range(3)]
    moments = [cross(arm, give) for arm, give in zip(arms, (give_a, give_b, give_c), strict=True)]
    return vertcat(give_a + give_b + give_c, moments[0] + moments[1] + moments[2])


def give_in_joints(problem: Problem, setup: Setup, u_give: float = 1 * mm) -> Problem:
    """All nine axes driven: the ball joints give way, each by an unknown amount per pose, in balance for every pose.

    problem: of `declare` with tracker and all nine axes; setup; u_give: [m], prior of how far a joint gives.
    It has to be wide: what a joint gives follows from the errors and returns in every pose, it is no draw of each.
    Without it the strain of the joints would pass for an error of measurement, and what causes it would be lost.
    """
    part = next(u for u in problem.unknowns if u.name == "part")
    joints = [Effect("give", "ball_point", lambda value, p: vertcat(-p.x, -p.y, -p.z),
                     tuple(Parameter(axis, "um", (1 * um, 200 * um)) for axis in "xyz"), locator.key, per="pose",
                     groups=(axis_group(locator.key),), source="rigid part on joints of equal stiffness")
              for locator in setup.locators]
    wider = problem.with_effects(*joints).free(*joints)
    gives = [wider.parameters(joint) for joint in joints]
    balls = np.array([locator.ball_in_part for locator in setup.locators])

    in_order = (give[[give.keys.index(key) for key in part.keys]] for give in gives)
    rest = Observations(balance, part.each, *in_order, Shared(balls), readings=np.zeros((part.count, 6)), u=RESTING,
                        group="balance", unit="um", components=("x", "y", "z", "about x", "about y", "about z"))
    return wider.with_observations(rest, *(prior(give, 0.0, u_give) for give in gives))


def leaders_only(problem: Problem, found: Sequence[Combination]) -> Problem:
    """The same problem with the leaders of combinations free and all other errors held: regular without any prior.

    problem: of `with_error_functions`; found: its combinations. What is estimated for a leader is its combination.
    """
    held = problem.hold(*functions_in(problem))
    by_label = {label: (unknown, i) for unknown in problem.unknowns for i, label in enumerate(unknown.labels)}
    return held.free(*(unknown.part(unknown.parts[i]) for unknown, i in (by_label[one.leader] for one in found)))


def unseen(fit: Linearisation) -> tuple[str, ...]:
    """Names of the free unknowns that no reading sees at all, whatever the others do."""
    size = np.linalg.norm(fit.rows[0].toarray(), axis=0)
    return tuple(fit.layout.label(int(c)) for c, length in zip(fit.layout.free_columns, size, strict=True)
                 if length == 0.0)


def pose_error_to_come(fit: Linearisation, setup: Setup, axes: Readings, u_axis: float) -> Functions:
    """What the uncertainty of identified errors does to poses that axes alone will give: a criterion for the choice of
    identification poses.

    fit: linearisation of a campaign of `with_knowledge`; setup; axes: readings of the poses in question, as measured or
    as planned; u_axis [m]. The squares of the uncertainties of these functions add up to the mean square distance [m]
    of the targets from where they would be with the true errors, one common rigid motion of the hall removed.
    """
    points = np.array(list(setup.targets.values()), dtype=float)
    functions = tuple(e for e in fit.effects if e.parameters[0].name == "constant")
    plain = declare(setup, axes, None, u_axis=u_axis)
    part = next(u for u in plain.unknowns if u.name == "part")
    assert isinstance(part, Pose)
    where = Quantity("target", target_in_hall, part[np.repeat(np.arange(part.count), len(points))],
                     np.tile(points, (part.count, 1)), unit="um", parts=("x", "y", "z"))
    later = linearise(plain.with_quantities(where).with_effects(*functions))
    columns = np.concatenate([np.arange(later.layout.size)[later.layout.span(later.effects[e])] for e in functions])
    rows = later.rows[0]
    # Axes read the pose by least squares, so an error of the axes turns into one of the pose.
    follows = -later.factor.solve(rows.T @ later.held_columns(columns.tolist()))
    seen = later.results[where]
    moved = later.free_part(seen.derivatives) @ follows
    place = seen.values.reshape(-1, 3)
    rigid = np.concatenate([np.tile(np.eye(3), (len(place), 1)),
                            np.concatenate([np.cross(np.eye(3), one).T for one in place])], axis=1)
    basis = np.linalg.qr(rigid)[0]
    corner = np.linalg.qr((moved - basis @ (basis.T @ moved)) / np.sqrt(len(place)), mode="r")
    derivatives = np.zeros((len(corner), fit.layout.size))
    here = np.concatenate([np.arange(fit.layout.size)[fit.layout.span(fit.effects[e])] for e in functions])
    derivatives[:, here] = corner
    return Functions(tuple(f"pose error to come {k + 1}" for k in range(len(corner))), ("um",) * len(corner),
                     np.zeros(len(corner)), derivatives)


def target_in_hall(part_pose: Transform, in_part: Any) -> Any:
    """Where a point of the part is in the hall."""
    return part_pose @ in_part


def poses_from_axes(setup: Setup, axes: Readings, u_axis: float,
                    functions: Mapping[Effect, NDArray[np.float64]] | None = None) -> list[Transform]:
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
