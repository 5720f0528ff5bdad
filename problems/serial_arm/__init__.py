"""Serial arm: geometry, zeros, compliance and encoders of a robot arm from a ball seated in sockets at unknown places.

The arm is read from its URDF. A ball on the flange is put into two sockets a known distance apart in many postures;
the joint positions are recorded. Unknown are the places of the sockets in the base frame, the ball in the last frame
and the errors of the arm: the location errors of every axis but the first (whose place is that of the base),
deflection and soft windup of the drives and bending of the links under the weight of the arm, and harmonics of the
encoders. How large each family may be is a tolerance, said in the job as a standard uncertainty; without it a family
stays out. What a joint's friction leaves unknown of its position counts in every posture by where the ball then goes.

The distance error of a placement is the mean distance of the predicted ball from the mean predicted ball of its socket.
Source: the contact method of Franzese, Spahn, Kober, Della Santina, arXiv 2503.12584 (2025); errors: ISO 230-1:2012;
Springer Handbook of Robotics, 2nd ed., ch. 6 (Hollerbach, Khalil, Gautier).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib import Estimate, Problem, covariance, linearise, predict, solve
from calib.analyse.shapes import points_of
from calib.errors import InputError
from calib.job import Job
from calib.linearisation import Functions
from calib.mechanism import urdf
from calib.mechanism.clusters import alike_postures
from calib.mechanism.inputs import checked_positions
from calib.mechanism.read import joint_positions
from calib.mechanism.resolved import quantity
from calib.mechanism.scene import axes_of
from calib.scene import Points, Scene
from calib.units import degree, mm
from problems.serial_arm.example import (
    example,
    example_arm,
    example_job,
    example_postures,
    example_urdf,
    reaching,
    simulated,
)
from problems.serial_arm.model import (
    KNEE,
    Arm,
    Tolerances,
    arm_from_urdf,
    declare,
    effects,
    family_of,
    seat_covariance,
)

__all__ = ["Arm", "Setup", "Tolerances", "arm_from_urdf", "declare", "distance_errors", "effects", "example",
           "example_arm", "example_job", "example_postures", "example_urdf", "from_job", "heldout", "reaching",
           "seat_covariance", "setup", "simulated"]
accepts = ("problems.serial_arm",)
BLOCKS = 5
options = {
    "urdf, tip, base": "the description of the arm, the link of the ball, the link of the base (the root if not given)",
    "placements": "tables with name, files (one for each socket, joint positions without a header) and heldout = true",
    "positions": "\"rad\" or \"deg\": unit of the joint positions in the files",
    "distance, u_distance": "of the two sockets; u_seat: of a seated ball, each component",
    "u_length, u_tilt, u_zero": "tolerances of the location errors; u_sag: deflection of a drive per metre of lever "
                                "arm",
    "u_sag_between": "how much drives of one torque limit may differ; u_bending: tilt of an axis per metre of lever",
    "u_windup": "windup of a gear that is soft at small torque; windup_share: of the torque limit, up to which it is",
    "u_joint": "what friction and hysteresis leave unknown of each joint position, nothing if not given",
    "errors": "\"free\" (if not given), or \"held\": the arm as in its URDF, each error a candidate for discover",
    "u_encoder": "amplitude of an encoder's harmonics",
    "encoder_orders": "harmonics of each encoder, [1] if not given",
}
columns = {"loads": {"link": "name in the URDF", "mass": "kg", "x, y, z": "centre of mass in the link's frame"}}


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
    description = urdf.read(job.file(said.text("urdf")))
    loads = []
    if "loads" in job.tables:
        table = job.table("loads")
        centres = np.stack([table.number(name, "length") for name in "xyz"], axis=1)
        loads = list(zip(table.text("link"), table.number("mass"), centres, strict=True))
    arm = arm_from_urdf(description, tip, said.text("base", None), loads)
    scale = degree if said.text("positions", "rad", ("rad", "deg")) == "deg" else 1.0
    found: dict[bool, dict[str, list[np.ndarray]]] = {False: {}, True: {}}
    for placement in said.tables("placements"):
        paths = [job.file(name) for name in placement.texts("files")]
        seats = [joint_positions(path, len(arm.mechanism.axes)) * scale for path in paths]
        for path, seat in zip(paths, seats, strict=True):
            checked_positions(arm.mechanism, seat, where=str(path), slack=0.02)
        found[placement.flag("heldout", False)][placement.text("name")] = seats
    if not found[False]:
        raise InputError(f"{job.path}: no placement is used for the calibration; add [[options.placements]] with name "
                         "and files.")
    length, angle = "length", "angle"
    slope = "angle/length"
    sizes = Tolerances(length=said.quantity("u_length", length, None), tilt=said.quantity("u_tilt", angle, None),
                       zero=said.quantity("u_zero", angle, None), sag=said.quantity("u_sag", slope, None),
                       sag_between=said.quantity("u_sag_between", slope, None),
                       windup=said.quantity("u_windup", angle, None), bending=said.quantity("u_bending", slope, None),
                       encoder=said.quantity("u_encoder", angle, None))
    orders = tuple(int(v) for v in said.numbers("encoder_orders", (1,)))
    return Setup(arm, found[False], found[True], {
        "u_seat": said.quantity("u_seat", length), "distance": said.quantity("distance", length, None),
        "u_distance": said.quantity("u_distance", length, 0.02 * mm), "sizes": sizes, "orders": orders,
        "u_joint": said.quantity("u_joint", angle, 0.0), "knee": float(said.number("windup_share", KNEE))})


def from_job(job: Job) -> Problem:
    """Declare the arm of a job from the placements that are not held out."""
    read = setup(job)
    problem = declare(read.arm, read.used, **read.arguments)
    if job.options.text("errors", "free", ("free", "held")) == "free":
        return problem
    return problem.hold(*(a.unknown for a in problem.attached))


def blocks(problem: Problem) -> Mapping[str, np.ndarray]:
    """Postures that are alike, which are left out together: {group: (n,) block}."""
    group = next(o for o in problem.observations if o.group == "seat")
    axes = [name for name in group.covariates if name != "socket"]
    return {"seat": alike_postures(np.stack([group.covariates[name] for name in axes], axis=1), BLOCKS, 0)}


def scene(job: Job, estimate: Estimate) -> Scene:
    """The axes at zero, the sockets with their uncertainty, and the ball in every posture as predicted."""
    arm, seats = setup(job).arm, estimate.problem.select("socket").unknown
    index = next(o for o in estimate.problem.observations if o.group == "seat").arguments[0].index
    balls = estimate[seats][index] - estimate.predicted["seat"]
    return Scene((axes_of(arm.mechanism), points_of(estimate.fit, seats), Points("balls in every posture", balls)))


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


def heldout(job: Job, estimate: Estimate) -> list[tuple[str, float, float, str]]:
    """Mean distance error and error of the known distance of every placement, before (URDF) and after the calibration.

    Returns (quantity, before, after, unit). Beside each mean stand its standard uncertainty over the postures and, for
    placements not used, the mean that the stated uncertainties let expect: of the tolerances before, of the
    calibration after. Where there are two placements or more, each is also predicted from all the others.
    """
    read = setup(job)
    rows: list[tuple[str, float, float, str]] = []
    everything = {**read.used, **read.heldout}
    for name in everything:
        role = f"{name}, not used" if name in read.heldout else f"{name}, used"
        rows += _compared(read, name, role, estimate)
        if name in read.heldout:
            before, after = _expected(read, everything[name], estimate)
            rows.append((f"mean distance error to be expected by the stated uncertainties ({role})", before / mm,
                         after / mm, "mm"))
    if read.heldout:
        for name in everything:
            others = {other: seats for other, seats in everything.items() if other != name}
            problem = _freed_alike(declare(read.arm, others, **read.arguments), estimate)
            rows += _compared(read, name, f"{name}, calibrated on {' and '.join(others)}", solve(problem))
    return rows


def _freed_alike(problem: Problem, estimate: Estimate) -> Problem:
    """The problem with those effects free that an estimate has free."""
    free = {a.unknown.name for a in estimate.problem.attached if not estimate.problem.is_held(a.unknown).all()}
    return problem.hold(*(a.unknown for a in problem.attached if a.unknown.name not in free)).free(
        *(a.unknown for a in problem.attached if a.unknown.name in free))


def _compared(read: Setup, name: str, role: str, estimate: Estimate) -> Iterator[tuple[str, float, float, str]]:
    seats, known = {**read.used, **read.heldout}[name], read.arguments["distance"]
    found = {x.name: estimate[x] for x in estimate.problem.unknowns if x.name != "socket"}
    (before, apart_before), (after, apart_after) = (distance_errors(read.arm, seats, read.arguments, values)
                                                    for values in ({}, found))
    yield f"mean distance error ({role})", float(before.mean()) / mm, float(after.mean()) / mm, "mm"
    u_before, u_after = (float(e.std(ddof=1) / np.sqrt(len(e))) / mm for e in (before, after))
    yield f"its standard uncertainty over the postures ({role})", u_before, u_after, "mm"
    if known is not None and apart_before is not None and apart_after is not None:
        yield (f"error of the distance of the sockets ({role})", (apart_before - known) / mm,
               (apart_after - known) / mm, "mm")


def _expected(read: Setup, seats: Sequence[np.ndarray], estimate: Estimate) -> tuple[float, float]:
    """Mean distance error [m] of a placement that follows from the tolerances of the errors of the arm, and from what
    the calibration leaves of them, each with the seats of the placement.

    The length of a normal vector of covariance S is taken at sqrt(8 / (3 pi) tr S), exact where S is isotropic.
    """
    positions, mechanism = np.concatenate(seats), read.arm.mechanism
    balls = quantity(estimate.problem, "balls", mechanism.pose(read.arm.tip), lambda pose, q, ball: pose(q) @ ball,
                     positions, estimate.problem.select("ball").unknown, unit="m")
    fit = linearise(estimate.problem.with_quantities(balls), {x: estimate[x] for x in estimate.problem.unknowns})
    found = fit.functions(balls)
    derivatives = found.derivatives.reshape(len(positions), 3, -1).copy()
    begin = 0
    for seat in seats:
        rows = slice(begin, begin + len(seat))
        derivatives[rows] -= derivatives[rows].mean(axis=0)
        begin += len(seat)
    flat = derivatives.reshape(3 * len(positions), -1)
    after = covariance(fit, Functions(found.labels, found.units, found.values, flat)).u ** 2
    before = np.zeros(len(flat))
    for attached in estimate.problem.attached:
        size = getattr(read.arguments["sizes"], family_of(attached.effect, read.arm)) or 0.0
        before += size ** 2 * np.sum(flat[:, fit.layout.span(attached.unknown)] ** 2, axis=1)
    spread = seat_covariance(read.arm, positions, read.arguments["u_seat"], read.arguments["u_joint"])
    traces = (np.trace(spread, axis1=1, axis2=2) + v.reshape(-1, 3).sum(axis=1) for v in (before, after))
    prior, posterior = (float(np.mean(np.sqrt(8 / (3 * np.pi) * trace))) for trace in traces)
    return prior, posterior
