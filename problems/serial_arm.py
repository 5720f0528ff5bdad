"""Serial arm: geometry, zeros, compliance and encoders of a robot arm from a ball seated in sockets at unknown places.

The arm is read from its URDF. A ball on the flange is put into two sockets a known distance apart in many postures;
the joint positions are recorded. Unknown are the places of the sockets in the base frame, the ball in the last frame
and the errors of the arm: the location errors of every axis but the first (whose place is that of the base),
deflection of the drives under the weight of the links, and harmonics of the encoders. How large each family may be is
the maker's tolerance, said in the job as a standard uncertainty; without it a family stays out. Drives with the same
torque limit are built alike.

The distance error of a placement is the mean distance of the predicted ball from the mean predicted ball of its socket.
Source: the contact method of Platonics, kinematics_calibration (Delft); errors: ISO 230-1:2012; Springer Handbook of
Robotics, 2nd ed., ch. 6 (Hollerbach, Khalil, Gautier).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from calib import Effect, Observations, Problem, Quantity, Unknown, linearise, predict, simulate
from calib.errors import InputError
from calib.job import Job
from calib.mechanism import Load, Mechanism, bending, encoder_harmonic, location_errors, observe, sag, urdf
from calib.mechanism.inputs import checked_positions
from calib.mechanism.read import data_path, joint_positions
from calib.mechanism.tolerance import alike, tolerances
from calib.units import degree, mm, mrad

accepts = ("problems.serial_arm",)
options = {
    "urdf, tip, base": "the description of the arm, the link of the ball, the link of the base (the root if not given)",
    "placements": "tables with name, files (one for each socket, joint positions without a header) and heldout = true",
    "positions": "\"rad\" or \"deg\": unit of the joint positions in the files",
    "distance, u_distance": "of the two sockets; u_seat: of a seated ball, each component",
    "u_length, u_tilt, u_zero": "tolerances of the location errors; u_sag: deflection of a drive per metre of lever "
                                "arm",
    "u_sag_between": "how much drives of one torque limit may differ; u_bending: tilt of an axis per metre of lever",
    "u_encoder": "amplitude of an encoder's harmonics",
    "encoder_orders": "harmonics of each encoder, [1] if not given",
}
columns = {"loads": {"link": "name in the URDF", "mass": "kg", "x, y, z": "centre of mass in the link's frame"}}


@dataclass(frozen=True)
class Tolerances:
    """How large errors may be, as standard uncertainties; None leaves a family out.

    length [m], tilt [rad]: place and direction of an axis; zero [rad]: of a joint; sag [rad/m]: of a drive under the
    whole weight at a lever arm; sag_between [rad/m]: of drives of one torque limit; bending [rad/m]: of an axis across;
    encoder [rad]: of each harmonic.
    """

    length: float
    tilt: float
    zero: float
    sag: float | None = None
    sag_between: float | None = None
    bending: float | None = None
    encoder: float | None = None


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm: mechanism, frame that carries the ball, and for each axis the torque limit that says which drive it
    has."""

    mechanism: Mechanism
    tip: str
    efforts: Mapping[str, float]


@lru_cache(maxsize=32)      # the same effects for the same arm, so that models with them are traced once
def effects(arm: Arm, orders: tuple[int, ...] = (1,)) -> tuple[Effect, ...]:
    """Location errors of all axes but the first; deflection of each drive where weights are known; encoder
    harmonics."""
    axes = arm.mechanism.axes
    sags = tuple(sag(arm.mechanism, axis) for axis in axes
                 if any(axis in arm.mechanism.path_of(x) for x in arm.mechanism.loads))
    return (*location_errors(arm.mechanism, [a.name for a in axes[1:]]), *sags,
            *(bending(arm.mechanism, axis) for axis in axes if arm.mechanism.loads),
            *(encoder_harmonic(axis, order) for axis in axes for order in orders))


def declare(arm: Arm, placements: Mapping[str, Sequence[np.ndarray]], u_seat: float, distance: float | None,
u_distance: float,
            sizes: Tolerances, orders: tuple[int, ...] = (1,)) -> Problem:
    """Declare the calibration of an arm from seated balls.

    arm; placements: {name: for each socket the joint positions (n, axes) [rad]}; u_seat: standard uncertainty of each
    component of a seat [m]; distance: of neighbouring sockets of a placement, None where nobody knows it; u_distance
    [m]; sizes: of the errors; orders: of the encoder harmonics.
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
        readings=np.zeros((len(positions), 3)), u=u_seat, group="seat", unit="mm", components=("x", "y", "z"),
        covariates={"socket": np.array(names)[index]})]
    first = [names.index(f"{place} {i + 1}") for place, group in placements.items() for i in range(len(group) - 1)]
    quantities = []
    if first:
        pair = (socket[np.array(first)], socket[np.array(first) + 1])
        keys = [names[i].rsplit(" ", 1)[0] for i in first] if len(set(names)) else None
        quantities.append(Quantity("distance", observe.distance_between, *pair, unit="mm", keys=keys))
        if distance is not None:
            observations.append(Observations(observe.distance_between, *pair, readings=np.full(len(first), distance),
                                             u=u_distance, group="distance of sockets", unit="mm"))
    problem = Problem(observations, quantities=quantities, effects=effects(arm, orders), name="serial arm")
    return _with_tolerances(problem, arm, sizes)


def _with_tolerances(problem: Problem, arm: Arm, sizes: Tolerances) -> Problem:
    """The families that have a size freed, each with its tolerance as a prior."""
    families: dict[str, dict[str, float]] = {"tolerance of lengths": {}, "tolerance of tilts": {}, "tolerance of "
                                                                                                   "zeros": {},
                                             "compliance of drives": {}, "compliance of links": {}, "encoders": {}}
    sags: dict[float, list[str]] = {}
    for effect in problem.effects:
        axis = arm.mechanism.axis(effect.channel)
        if effect.name[:1] == "E" and effect.slot.endswith("_location"):
            component = "XYZABC".index(effect.name[1])
            zero = component % 3 == axis.along
            size = sizes.length if component < 3 else sizes.zero if zero else sizes.tilt
            families["tolerance of " + ("lengths" if component < 3 else "zeros" if zero
                                        else "tilts")][effect.label] = size
        elif effect.name.startswith("sag") and sizes.sag is not None:
            families["compliance of drives"][effect.label] = sizes.sag
            sags.setdefault(arm.efforts.get(axis.name, 0.0), []).append(effect.label)
        elif effect.name.startswith("bending"):
            if sizes.bending is not None:
                families["compliance of links"][effect.label] = sizes.bending
        elif effect.name.startswith("encoder") and sizes.encoder is not None:
            families["encoders"][effect.label] = sizes.encoder
    free = [label for family in families.values() for label in family]
    priors = [tolerances(problem, family, name) for name, family in families.items() if family]
    if sizes.sag_between is not None:
        priors += [alike(problem, labels, sizes.sag_between, f"drives of {effort:g} N m alike")
                   for effort, labels in sags.items() if len(labels) > 1]
    return problem.free(*(problem.parameters(label) for label in free)).with_observations(*priors)


# --- from files -------------------------------------------------------------------------------------------------------


def arm_from_urdf(description: urdf.Description, tip: str, base: str | None = None, loads: Sequence[tuple[str, float,
Any]] = ()
                  ) -> Arm:
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


@dataclass(frozen=True)
class Setup:
    """What a job says: the arm, the postures of each placement, which are held out, and the numbers for `declare`."""

    arm: Arm
    used: Mapping[str, list[np.ndarray]]
    heldout: Mapping[str, list[np.ndarray]]
    arguments: Mapping[str, Any]


def setup(job: Job) -> Setup:
    """Read a job. Raises InputError naming file, row and axis where something is missing or cannot be."""
    said = job.options
    tip = said.text("tip")
    description = urdf.read(data_path(job, said.text("urdf")))
    loads = []
    if "loads" in job.tables:
        table = job.table("loads")
        centres = np.stack([table.number(name, "length") for name in "xyz"], axis=1)
        loads = list(zip(table.text("link"), table.number("mass"), centres, strict=True))
    arm = arm_from_urdf(description, tip, said.text("base", None), loads)
    scale = degree if said.text("positions", "rad", ("rad", "deg")) == "deg" else 1.0
    found: dict[bool, dict[str, list[np.ndarray]]] = {False: {}, True: {}}
    for placement in said.tables("placements"):
        paths = [data_path(job, name) for name in placement.texts("files")]
        seats = [joint_positions(path, len(arm.mechanism.axes)) * scale for path in paths]
        for path, seat in zip(paths, seats, strict=True):
            checked_positions(arm.mechanism, seat, where=str(path), slack=0.02)
        found[placement.flag("heldout", False)][placement.text("name")] = seats
    if not found[False]:
        raise InputError(f"{job.path}: no placement is used for the calibration; add [[options.placements]] with name "
                         "and files.")
    length, angle = "length", "angle"
    slope = "angle/length"
    sizes = Tolerances(length=said.quantity("u_length", length), tilt=said.quantity("u_tilt", angle),
                       zero=said.quantity("u_zero", angle), sag=said.quantity("u_sag", slope, None),
                       sag_between=said.quantity("u_sag_between", slope, None),
                       bending=said.quantity("u_bending", slope, None), encoder=said.quantity("u_encoder", angle, None))
    orders = tuple(int(v) for v in said.numbers("encoder_orders", (1,)))
    return Setup(arm, found[False], found[True], {
        "u_seat": said.quantity("u_seat", length), "distance": said.quantity("distance", length, None),
        "u_distance": said.quantity("u_distance", length, 0.02 * mm), "sizes": sizes, "orders": orders})


def from_job(job: Job) -> Problem:
    """Declare the arm of a job from the placements that are not held out."""
    read = setup(job)
    return declare(read.arm, read.used, **read.arguments)


# --- held-out ---------------------------------------------------------------------------------------------------------


def distance_errors(arm: Arm, seats: Sequence[np.ndarray], arguments: Mapping[str, Any], values: Mapping[str, Any]
                    ) -> tuple[np.ndarray, float | None]:
    """Distance of each predicted ball from the mean predicted ball of its socket (n,) [m], and the distance of the
    first two mean balls [m], None for one socket.

    values: {unknown: value} of ball and effects; those not named are nominal.
    """
    problem = declare(arm, {"placement": seats}, **arguments)
    socket = problem.select("socket").unknown
    index = np.repeat(np.arange(len(seats)), [len(seat) for seat in seats])
    balls = socket.ambient[index] - predict(problem, values)["seat"]
    means = np.array([balls[index == i].mean(axis=0) for i in range(len(seats))])
    apart = float(np.linalg.norm(means[1] - means[0])) if len(seats) > 1 else None
    return np.linalg.norm(balls - means[index], axis=1), apart


def heldout(job: Job, estimate: Any) -> list[tuple[str, float, float, str]]:
    """Mean distance error and error of the known distance of every placement, before (URDF) and after the calibration.

    Returns (quantity, before, after, unit); beside each mean its standard uncertainty over the postures.
    """
    read = setup(job)
    found = {x.name: estimate[x] for x in estimate.problem.unknowns if x.name != "socket"}
    rows = []
    for name, seats in {**read.used, **read.heldout}.items():
        role = f"{name}, not used" if name in read.heldout else f"{name}, used"
        (before, apart_before), (after, apart_after) = (distance_errors(read.arm, seats, read.arguments, values)
                                                        for values in ({}, found))
        rows.append((f"mean distance error ({role})", float(before.mean()) / mm, float(after.mean()) / mm, "mm"))
        u_before, u_after = (float(e.std(ddof=1) / np.sqrt(len(e))) / mm for e in (before, after))
        rows.append((f"its standard uncertainty over the postures ({role})", u_before, u_after, "mm"))
        known = read.arguments["distance"]
        if known is not None and apart_before is not None and apart_after is not None:
            rows.append((f"error of the distance of the sockets ({role})", (apart_before - known) / mm,
                         (apart_after - known) / mm, "mm"))
    return rows


# --- simulated
# ----------------------------------------------------------------------------------------------------------

_EXAMPLE_LINKS = ((0.0, 0.0, 0.0, 0.30, "0 0 1", 80), (-np.pi / 2, 0.0, 0.0, 0.0, "0 0 1", 80),
                  (np.pi / 2, 0.0, -0.32, 0.0, "0 0 1", 80), (np.pi / 2, 0.08, 0.0, 0.0, "0 0 1", 80),
                  (-np.pi / 2, -0.08, 0.36, 0.0, "0 0 1", 12), (np.pi / 2, 0.0, 0.0, 0.0, "0 0 1", 12))


def example_urdf() -> str:
    """A six-axis arm with weights, as URDF text."""
    lines = ['<?xml version="1.0"?>', '<robot name="example_arm">', '  <link name="link0"/>']
    for i, (roll, x, y, z, axis, effort) in enumerate(_EXAMPLE_LINKS, 1):
        lines += [f'  <link name="link{i}"><inertial><origin xyz="0 -0.05 0.05"/><mass '
                  f'value="{4.0 - 0.5 * i}"/></inertial></link>',
                  f'  <joint name="joint{i}" type="revolute"><parent link="link{i - 1}"/><child link="link{i}"/>',
                  f'    <origin rpy="{roll!r} 0 0" xyz="{x} {y} {z}"/><axis xyz="{axis}"/>',
                  f'    <limit effort="{effort}" lower="-2.9" upper="2.9" velocity="2"/></joint>']
    lines += ['  <link name="ball"/>', '  <joint name="ball_joint" type="fixed"><parent link="link6"/><child '
                                       'link="ball"/>',
              '    <origin rpy="0 0 0" xyz="0.02 0.01 0.15"/></joint>', '</robot>']
    return "\n".join(lines) + "\n"


def example_arm() -> Arm:
    """The arm of `example_urdf`."""
    return arm_from_urdf(urdf.parse(example_urdf(), "example.urdf"), "ball")


EXAMPLE_SIZES = Tolerances(0.2 * mm, 1.0 * mrad, 5 * mrad, sag=5e-3, encoder=0.2 * mrad)


def example_postures(seed: int, count: int) -> list[np.ndarray]:
    """For each of two sockets `count` postures (count, 6) [rad] that hold the ball there by the nominal geometry."""
    generator, seats = np.random.default_rng(seed), []
    for y in (-0.025, 0.025):
        found = reaching(example_arm(), np.array([0.40, y, 0.10]), generator.uniform(-1.5, 1.5, (20 * count, 6)), {})
        seats.append(found[np.all(np.abs(found) < 2.8, axis=1)][:count])
    return seats


def reaching(arm: Arm, place: np.ndarray, positions: np.ndarray, truth: Mapping[str, Any]) -> np.ndarray:
    """Postures (m, axes) that hold the ball at a place, from nearby ones (n, axes), by damped steps of the declared
    model.

    place: (3,) or (n, 3) in the base frame [m]; truth: {name: value} of `ball` and effects. Those that cannot are left
    out.
    """
    moved, places = Unknown("positions", positions, "rad"), np.broadcast_to(place, (len(positions), 3))
    problem = Problem([Observations(observe.contact(arm.mechanism.pose(arm.tip)), places, moved.each,
                                    Unknown("ball", np.zeros(3)), readings=np.zeros((len(positions), 3)), u=1.0,
                                    group="seat")],
                      effects=effects(arm) if truth else ())
    for _ in range(15):
        group = linearise(problem, {**truth, "positions": positions}).group("seat")
        if np.abs(group.residual).max() < 1e-9:
            break
        jacobian = next(part.jacobian for part in group.parts if part.jacobian.shape[2] == len(arm.mechanism.axes))
        across = jacobian.transpose(0, 2, 1)
        positions = positions + (across @ np.linalg.solve(jacobian @ across + 1e-6 * np.eye(3),
                                                          group.residual[:, :, None]))[:, :, 0]
    missed = np.linalg.norm(linearise(problem, {**truth, "positions": positions}).group("seat").residual, axis=1)
    return positions[missed < 1e-7]


def example(seed: int) -> Problem:
    """Forty seats of a six-axis arm with simulated errors of every family. seed: of the errors and their truth."""
    return simulated(seed, seed)[0]


def simulated(seed: int, truth_seed: int, count: int = 20) -> tuple[Problem, dict[str, Any]]:
    """A simulated calibration and its truth {name of unknown: value}: errors drawn from their tolerances."""
    arm = example_arm()
    problem = declare(arm, {"bench": example_postures(7, count)}, 0.05 * mm, None, 0.02 * mm, EXAMPLE_SIZES)
    generator = np.random.default_rng(truth_seed)
    truth: dict[str, Any] = {"ball": np.array([0.4, -0.3, 0.2]) * mm}
    for observations in problem.observations:
        if observations.is_prior:
            sizes = observations.uncertainty.weighting(1, len(observations.recorded[0]), "tolerance").u[0]
            drawn = list(generator.standard_normal(len(sizes)) * sizes)
            for unknown in observations.unknowns:
                truth[unknown.name] = np.array([[drawn.pop(0) for _ in range(unknown.freedom)]])
    return simulate(problem, truth, seed), truth


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with a simulated arm: {file name: text}. seed: of the errors of the arm and of the seats."""
    arm, generator = example_arm(), np.random.default_rng(seed)
    _, truth = simulated(seed, seed)
    truth = {name: value for name, value in truth.items() if name != "socket"}
    files = {"arm.urdf": example_urdf()}
    for placement, shift in (("bench", (0.0, 0.0, 0.0)), ("shelf", (-0.05, 0.25, 0.15))):
        for number, nominal in enumerate(example_postures(7, 20), 1):
            place = np.array([0.40, -0.075 + 0.05 * number, 0.10]) + shift
            start = reaching(arm, place, nominal, {})
            start = start[np.all(np.abs(start) < 2.8, axis=1)]
            seated = reaching(arm, place + generator.normal(0.0, 0.05 * mm, (len(start), 3)), start, truth)
            files[f"{placement}_{number}.csv"] = "\n".join(",".join(f"{v:.9f}" for v in row) for row in seated) + "\n"
    files["job.toml"] = """problem = "problems.serial_arm"

[options]
urdf = "arm.urdf"
tip = "ball"
distance = "50 mm"
u_distance = "0.02 mm"
u_seat = "0.05 mm"
u_length = "0.2 mm"
u_tilt = "1 mrad"
u_zero = "5 mrad"
u_sag = "5 mrad/m"
u_encoder = "0.2 mrad"

[[options.placements]]
name = "bench"
files = ["bench_1.csv", "bench_2.csv"]

[[options.placements]]
name = "shelf"
files = ["shelf_1.csv", "shelf_2.csv"]
heldout = true
"""
    return files
