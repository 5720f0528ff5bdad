"""Everything in one problem: axes and instruments of `world`, all tables, one circle for a target where accepted.

Unknown with priors, because the paper does not print them (each has its line in the budget):

- standing axis of T1 and T2: plumb to less than 1 arcsec (section 1), rectangular, so u = 1/sqrt(3) arcsec;
- error of the yaw turn of 90 degrees before the roll axis is read: u = 2 arcsec, of the order of the encoder of such a
  table, whose positions table 2 prints to 0.0001 degree;
- height of the pointed place of each filament over the line of sight: u = 200 mm, half the clear height of the frame;
- azimuth of the level's seat against X at position 0: u = 1 degree, set by eye.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib import Observations, Problem, Quantity, Shared, Unknown, prior
from calib.observations import Prior
from calib.units import arcsec, degree, mm
from instruments import theodolite
from instruments.stated import rectangular

from . import world
from .formulas import axis_point, line_through, parallelism
from .readings import INSTRUMENTS, NEAR_AND_FAR, SIGHTS, TABLES, WIRES, Circle, Readings

AXES = ("pitch", "roll", "two_axis_pitch")
YAW_OF = {"pitch": 0, "roll": 0, "two_axis_pitch": 1}
LOOKS = {"T1": (1.0, 0.0), "T2": (0.0, -1.0)}
U_STANDING_AXIS = float(rectangular(1 * arcsec))
U_TURN = 2 * arcsec
U_WIRE_HEIGHT = 200 * mm
U_LEVEL_AZIMUTH = 1 * degree


@dataclass(frozen=True)
class Sharing:
    """Which circles share r and phase, and which way is up.

    circles: targets whose horizontal and vertical circle share; wires: filaments whose circle both theodolites share;
    turns: +1 where the yaw axes turn from X toward Y; up: +1 where Z is up as the paper says, -1 for circles of the
    usual make.
    """

    circles: Collection[str]
    wires: Collection[str] = ()
    turns: int = 1
    up: int = 1


def declare(readings: Readings, sharing: Sharing) -> Problem:
    """All tables as observations of one world, with the printed results as quantities.

    readings: of all tables; sharing: what is accepted as one circle. Returns the problem, groups as in `step_by_step`.
    """
    r = readings
    lengths = list(r.distance)
    read = [*dict.fromkeys((*r.pitch.target, *r.roll.target))]
    targets = [*read, *r.centre]
    apart = [t for t in read if t not in sharing.circles]
    axes = [a for a in AXES if NEAR_AND_FAR[a][0] in targets]
    instrument, wire = (
        np.array([names.index(x) for x in column])
        for names, column in ((INSTRUMENTS, r.wires.instrument), (WIRES, r.wires.target))
    )
    # a filament whose circle is shared is bound to what T1 sees
    seen_as = {f"{i} {w}": f"T1 {w}" if w in sharing.wires else f"{i} {w}" for i in INSTRUMENTS for w in WIRES}
    wire_circles = list(dict.fromkeys(seen_as.values()))
    one_circle = np.array([wire_circles.index(seen_as[f"{i} {w}"]) for i, w in zip(r.wires.instrument, r.wires.target)])
    unknowns = _unknowns(r, axes, read, apart, wire_circles, sharing.up)
    zero, index, standing, up = unknowns.zero, unknowns.index, unknowns.standing, unknowns.up
    to_yaw = np.array([lengths.index(i) for i in INSTRUMENTS])
    table = np.repeat([0, 1], len(r.level_angle))
    levels = Observations(
        world.level_reading, unknowns.plumb[table], unknowns.azimuth, np.tile(r.level_angle, 2),
        unknowns.level_zero[table], readings=r.level.T.ravel(), u=r.u_level, group="table 1", unit="arcsec",
        covariates={"table": np.array(TABLES)[table]}, rows=np.tile(r.level_rows, 2))

    wires = Observations(
        world.on_wire, np.array([LOOKS[i] for i in r.wires.instrument]), unknowns.offset[wire], unknowns.plumb[wire],
        unknowns.height[wire], unknowns.wire_circle[one_circle], r.wires.angle, unknowns.distance[to_yaw[instrument]],
        zero[instrument], standing[instrument], up, Shared(float(sharing.turns)), readings=r.wires.reading,
        u=r.u_circle, group="table 2", unit="arcsec", components=("H",), period=theodolite.PERIOD,
        covariates={"target": r.wires.target}, rows=r.wires.rows)

    def sight(names: np.ndarray) -> tuple[Any, ...]:
        axis = np.array([next(axes.index(a) for a in axes if t in NEAR_AND_FAR[a]) for t in names])
        return (
            unknowns.point[axis], unknowns.slope[axis], unknowns.distance[lengths.index("T1")],
            unknowns.distance[np.array([lengths.index(t) for t in names])])

    def circles(group: str, of: Circle) -> Observations:
        h = np.array([read.index(t) for t in of.target])
        v = np.array([len(read) + apart.index(t) if t in apart else read.index(t) for t in of.target])
        return Observations(
            world.on_target, *sight(of.target), unknowns.circle[h], unknowns.circle[v], of.angle, zero[0], index,
            standing[0], readings=of.reading, u=r.u_circle, group=group, unit="arcsec", components=("H", "V"),
            period=theodolite.PERIOD, covariates={"target": of.target}, rows=of.rows)

    observations = [levels, wires, circles("table 3", r.pitch), circles("table 4", r.roll)]
    still, angle = Shared(np.zeros(2)), Shared(0.0)
    if r.centre:
        values = np.array([c[:2] for c in r.centre.values()])
        # their readings are not known, so they are prior knowledge with a stated u and take no variance component
        observations.append(
            Prior(
                world.on_target, *sight(np.array(list(r.centre))), still, still, angle, zero[0], index, standing[0],
                readings=values, u=np.array([[c[2]] * 2 for c in r.centre.values()]), group="printed centres",
                unit="arcsec", components=("H", "V"), period=theodolite.PERIOD)
        )
    observations += _priors(r, unknowns)
    each = np.arange(len(SIGHTS))
    at_instrument, at_wire = each // len(WIRES), each % len(WIRES)
    quantities = _results(unknowns, axes) + [
        Quantity(
            "wire reading", world.on_wire, np.repeat([LOOKS[i] for i in INSTRUMENTS], len(WIRES), axis=0),
            unknowns.offset[at_wire], unknowns.plumb[at_wire], unknowns.height[at_wire], still, angle,
            unknowns.distance[to_yaw[at_instrument]], zero[at_instrument], standing[at_instrument], up, Shared(1.0),
            unit="deg", keys=SIGHTS),
        Quantity(
            "reading", world.on_target, *sight(np.array(targets)), still, still, angle, zero[0], index, standing[0],
            unit="deg", parts=("H", "V"), keys=targets),
        Quantity("point", world.axis_point, *sight(np.array(targets)), unit="mm", parts=("y", "z"), keys=targets),
    ]
    if r.feet:
        table_of, x, y = zip(*r.feet.values())
        places = np.stack([x, y], axis=1)
        quantities.append(
            Quantity(
                "foot", world.raise_of_foot, unknowns.plumb[np.array(table_of)], places, unit="um", keys=list(r.feet))
        )
    return Problem(observations, quantities=quantities, held=[unknowns.offset[0], up], name="five-axis, jointly")


@dataclass(frozen=True)
class _Unknowns:
    plumb: Unknown
    level_zero: Unknown
    azimuth: Unknown
    zero: Unknown
    index: Unknown
    standing: Unknown
    distance: Unknown
    offset: Unknown
    height: Unknown
    wire_circle: Unknown
    point: Unknown
    slope: Unknown
    circle: Unknown
    turn_error: Unknown
    up: Unknown


def _unknowns(
    r: Readings, axes: list[str], read: list[str], apart: list[str], wire_circles: list[str], up: int
) -> _Unknowns:
    first, names = r.sights(), ("x", "y")
    toward = [first[f"{i} S3"] for i in INSTRUMENTS]
    points, slopes = _first_axes(r, axes, first)
    return _Unknowns(
        plumb=Unknown("plumb", np.zeros((2, 2)), "arcsec", names, TABLES),
        level_zero=Unknown("level_zero", np.mean(r.level, axis=0)[:, None], "arcsec", keys=TABLES),
        azimuth=Unknown("level_azimuth", 0.0, "deg"),
        zero=Unknown("circle_zero", np.array(toward)[:, None], "deg", keys=INSTRUMENTS),
        index=Unknown("vertical_index", r.index[0], "deg"),
        standing=Unknown("standing_axis", np.zeros((2, 2)), "arcsec", names, INSTRUMENTS),
        distance=Unknown("distance", [[value] for value, _ in r.distance.values()], "mm", keys=list(r.distance)),
        # the three-axis yaw axis is where X ends, so its own offset is zero and held
        offset=Unknown("yaw_offset", np.zeros((2, 2)), "mm", names, TABLES),
        height=Unknown("wire_height", np.zeros((2, 1)), "mm", keys=WIRES),
        wire_circle=Unknown("wire_circle", np.zeros((len(wire_circles), 2)), "mm", ("a", "b"), wire_circles),
        point=Unknown("axis_point", points, "mm", ("y", "z"), axes),
        slope=Unknown("axis_slope", slopes, "urad", ("y", "z"), axes),
        circle=Unknown(
            "target_circle", np.zeros((len(read) + len(apart), 2)), "mm", ("a", "b"),
            read + [f"{t} in V" for t in apart]),
        turn_error=Unknown("turn_error", 0.0, "arcsec"),
        # which way Z points is known by assumption only: held, for the report to say it
        up=Unknown("up", float(up)),
    )


def _first_axes(r: Readings, axes: list[str], first: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Points at the yaw axis and slopes of the axes, from the mean readings of their targets, to start from."""

    def seen(target: str) -> tuple[float, float, float]:
        length = r.distance[target][0]
        return axis_point(length, first[f"{target} H"], first[f"{target} V"], first["T1 S3"], r.index[0])

    lines = [line_through(*map(seen, NEAR_AND_FAR[axis])) for axis in axes]
    return (np.array([line.at(r.distance["T1"][0]) for line in lines]),
            np.array([[line.dy / line.dx, line.dz / line.dx] for line in lines]))


def _priors(r: Readings, unknowns: _Unknowns) -> list[Observations]:
    return [
        prior(
            unknowns.distance, [[value] for value, _ in r.distance.values()], [[u] for _, u in r.distance.values()],
            "distances"),
        prior(unknowns.index, r.index[0], r.index[1], "vertical index"),
        prior(unknowns.standing, 0.0, U_STANDING_AXIS, "standing axes"),
        prior(unknowns.turn_error, 0.0, U_TURN, "yaw turn"),
        prior(unknowns.height, 0.0, U_WIRE_HEIGHT, "wire heights"),
        prior(unknowns.azimuth, 0.0, U_LEVEL_AZIMUTH, "level azimuth"),
    ]


def _results(unknowns: _Unknowns, axes: list[str]) -> list[Quantity]:
    plumb, offset, point, slope, up = unknowns.plumb, unknowns.offset, unknowns.point, unknowns.slope, unknowns.up
    yaw = np.array([YAW_OF[a] for a in axes])
    pitches = [i for i, a in enumerate(axes) if a != "roll"]
    pitch, roll = axes.index("pitch"), axes.index("roll")
    pair = (point[pitch], slope[pitch], point[roll], slope[roll], offset[0], plumb[0], unknowns.turn_error, up)
    results = [
        Quantity("plumb difference", parallelism, plumb[0], plumb[1], unit="arcsec", parts=("x", "y", "parallelism")),
        Quantity(
            "square", world.square, slope[np.array(pitches)], plumb[yaw[pitches]], up, unit="arcsec",
            keys=[axes[i] for i in pitches]),
        Quantity(
            "square to the plumb line", world.square, slope[np.array(pitches)], Shared(np.zeros(2)), up,
            unit="arcsec", keys=[axes[i] for i in pitches]),
        Quantity("square in plan", world.square_in_plan, *pair, unit="arcsec"),
        Quantity(
            "intersection", world.intersection, point.each, slope.each, offset[yaw], plumb[yaw], up, unit="mm",
            keys=axes),
        Quantity("roll over pitch", world.roll_over_pitch, *pair, unit="mm"),
        Quantity("yaw offset", lambda o: o, offset[1], unit="mm", parts=("x", "y")),
        Quantity("axis at the yaw axis", lambda at: at, point.each, unit="mm", parts=("y", "z"), keys=axes),
    ]
    if "two_axis_pitch" in axes:
        two = axes.index("two_axis_pitch")
        results.append(
            Quantity(
                "pitch over pitch", world.pitch_over_pitch, point[pitch], slope[pitch], point[two], slope[two],
                offset[1], unit="mm")
        )
    return results
