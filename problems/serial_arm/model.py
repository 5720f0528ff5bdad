"""Declaration of a serial arm whose ball is seated in sockets at unknown places; see problems.serial_arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from calib import Effect, Gaussian, Observations, Problem, Quantity, Unknown
from calib.errors import InputError
from calib.mechanism import Axis, Load, Mechanism, bending, encoder_harmonic, location_errors, observe, sag, urdf
from calib.mechanism.chain import STANDARD_GRAVITY
from calib.mechanism.drive import soft_windup
from calib.mechanism.sensitivity import place_by_positions
from calib.mechanism.tolerance import alike, tolerances

KNEE = 0.03      # share of a drive's torque limit that its teeth take up before the gear is stiff
FAMILIES = ("length", "tilt", "zero", "sag", "windup", "bending", "encoder")
GROUPS = {"length": "tolerance of lengths", "tilt": "tolerance of tilts", "zero": "tolerance of zeros",
          "sag": "compliance of drives", "windup": "soft windup of drives", "bending": "compliance of links",
          "encoder": "encoders"}


@dataclass(frozen=True)
class Tolerances:
    """How large errors may be, as standard uncertainties; None leaves a family out.

    length [m], tilt [rad]: place and direction of an axis; zero [rad]: of a joint; sag [rad/m]: of a drive under the
    whole weight at a lever arm; sag_between [rad/m]: of drives of one torque limit; windup [rad]: of a gear that is
    soft at small torque; bending [rad/m]: of an axis across; encoder [rad]: of each harmonic.
    """

    length: float | None
    tilt: float | None
    zero: float | None
    sag: float | None = None
    sag_between: float | None = None
    windup: float | None = None
    bending: float | None = None
    encoder: float | None = None


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm: mechanism, frame that carries the ball, and for each axis the torque limit [N m] that says which drive
    it has."""

    mechanism: Mechanism
    tip: str
    efforts: Mapping[str, float]


@lru_cache(maxsize=32)      # the same effects for the same arm, so that models with them are traced once
def effects(arm: Arm, orders: tuple[int, ...] = (1,), knee: float = KNEE) -> tuple[Effect, ...]:
    """Location errors of all axes but the first; deflection and windup of each drive and bending of each link where
    weights are known; encoder harmonics."""
    mechanism, loads = arm.mechanism, arm.mechanism.loads
    bearing = [axis for axis in mechanism.axes if any(axis in mechanism.path_of(x) for x in loads)]
    weight = STANDARD_GRAVITY * sum(load.mass for load in loads)
    return (*location_errors(mechanism, [a.name for a in mechanism.axes[1:]]),
            *(sag(mechanism, axis) for axis in bearing),
            *(soft_windup(mechanism, axis, knee * arm.efforts[axis.name] / weight)
              for axis in bearing if axis.name in arm.efforts and not _stays_plumb(mechanism, axis)),
            *(bending(mechanism, axis) for axis in mechanism.axes if loads),
            *(encoder_harmonic(axis, order) for axis in mechanism.axes for order in orders))


def _stays_plumb(mechanism: Mechanism, axis: Axis) -> bool:
    """Whether an axis is vertical in every posture, so that no weight ever turns it."""
    before = [mechanism.axis(axis.carried_by)] if axis.carried_by else []
    along = abs(float(np.dot(np.asarray(axis.direction), np.asarray(mechanism.down))))
    return along > 1 - 1e-9 and all(_stays_plumb(mechanism, one) for one in before)


def declare(arm: Arm, placements: Mapping[str, Sequence[np.ndarray]], u_seat: float, distance: float | None,
            u_distance: float, sizes: Tolerances, orders: tuple[int, ...] = (1,), u_joint: float = 0.0,
            knee: float = KNEE) -> Problem:
    """Declare the calibration of an arm from seated balls.

    arm; placements: {name: for each socket the joint positions (n, axes) [rad]}; u_seat: standard uncertainty of each
    component of a seat [m]; distance: of neighbouring sockets of a placement, None where nobody knows it; u_distance
    [m]; sizes: of the errors; orders: of the encoder harmonics; u_joint: what friction and hysteresis leave unknown of
    each joint position [rad]; knee: share of a drive's torque limit up to which its gear is soft.
    Returns the problem with the unknowns `socket`, `ball` and those families free for which a size is given, and the
    `distance` of each pair of sockets as result.
    """
    names = [f"{place} {i + 1}" for place, seats in placements.items() for i in range(len(seats))]
    seats = [seat for group in placements.values() for seat in group]
    positions = np.concatenate(seats)
    index = np.repeat(np.arange(len(seats)), [len(seat) for seat in seats])
    rough = np.array([arm.mechanism.poses(arm.tip, seat)[1].mean(axis=0) for seat in seats])
    socket = Unknown("socket", rough, "mm", keys=names)
    ball = Unknown("ball", np.zeros(3), "mm")
    observations = [Observations(
        observe.contact(arm.mechanism.pose(arm.tip)), socket[index], positions, ball,
        readings=np.zeros((len(positions), 3)), u=Gaussian.matrix(seat_covariance(arm, positions, u_seat, u_joint))
        if u_joint else u_seat, group="seat", unit="mm",
        components=("x", "y", "z"), covariates={
            "socket": np.array(names)[index],
            **{axis.name: (positions[:, i], axis.unit) for i, axis in enumerate(arm.mechanism.axes)}})]
    first = [names.index(f"{place} {i + 1}") for place, group in placements.items() for i in range(len(group) - 1)]
    quantities = []
    if first:
        pair = (socket[np.array(first)], socket[np.array(first) + 1])
        keys = [names[i].rsplit(" ", 1)[0] for i in first] if len(set(names)) else None
        quantities.append(Quantity("distance", observe.distance_between, *pair, unit="mm", keys=keys))
        if distance is not None:
            observations.append(Observations(observe.distance_between, *pair, readings=np.full(len(first), distance),
                                             u=u_distance, group="distance of sockets", unit="mm"))
    problem = Problem(observations, quantities=quantities, effects=effects(arm, orders, knee), name="serial arm")
    return _with_tolerances(problem, arm, sizes)


def seat_covariance(arm: Arm, positions: np.ndarray, u_seat: float, u_joint: float) -> np.ndarray:
    """Covariance (n, 3, 3) [m2] of a ball that is seated to u_seat [m] on an arm whose joints stand to u_joint [rad].

    positions: (n, axes) [rad].
    """
    by_joint = place_by_positions(arm.mechanism, arm.tip, positions)
    return u_seat ** 2 * np.eye(3) + u_joint ** 2 * by_joint @ by_joint.transpose(0, 2, 1)


def family_of(effect: Effect, arm: Arm) -> str:
    """Which of FAMILIES an effect of an arm belongs to."""
    if effect.name[:1] != "E":
        return next(family for family in FAMILIES if effect.name.startswith(family))
    component = "XYZABC".index(effect.name[1])
    if component < 3:
        return "length"
    return "zero" if component % 3 == arm.mechanism.axis(effect.channel).along else "tilt"


def _with_tolerances(problem: Problem, arm: Arm, sizes: Tolerances) -> Problem:
    """The families that have a size freed, each with its tolerance as a prior."""
    families: dict[str, dict[str, float]] = {}
    for effect in problem.effects:
        size = getattr(sizes, family_of(effect, arm))
        if size is not None:
            families.setdefault(family_of(effect, arm), {})[effect.label] = size
    priors = [tolerances(problem, families[name], GROUPS[name]) for name in FAMILIES if name in families]
    if sizes.sag_between is not None:
        sags: dict[float, list[str]] = {}
        for label in families.get("sag", {}):
            axis = label.partition("(")[2].rstrip(")")
            sags.setdefault(arm.efforts.get(axis, 0.0), []).append(label)
        priors += [alike(problem, labels, sizes.sag_between, f"drives of {effort:g} N m alike")
                   for effort, labels in sags.items() if len(labels) > 1]
    free = [label for family in families.values() for label in family]
    return problem.free(*(problem.parameters(label) for label in free)).with_observations(*priors)


def arm_from_urdf(description: urdf.Description, tip: str, base: str | None = None,
                  loads: Sequence[tuple[str, float, Any]] = ()) -> Arm:
    """The arm between two links of a URDF; loads: (link, mass [kg], centre (3,) in the link's frame [m]) in place of
    the inertials of the URDF. Raises InputError for a link that does not exist or is not on the way."""
    mechanism = urdf.mechanism(description, base, tip)
    if loads:
        weights = []
        for link, mass, centre in loads:
            frame = mechanism.frame(urdf.identifier(link)) if link in description.links else None
            if frame is None:
                raise InputError(f"{description.path}: has no link '{link}' to carry a load; there are: "
                                 f"{', '.join(description.links)}.")
            if frame.carried_by is not None:
                weights.append(Load(frame.name, frame.home @ np.asarray(centre, float), frame.carried_by, mass))
        mechanism = Mechanism(mechanism.name, mechanism.axes, mechanism.frames, weights, mechanism.down)
    efforts = {urdf.identifier(j.name): j.effort for j in description.joints if j.effort is not None}
    return Arm(mechanism, urdf.identifier(tip), efforts)
