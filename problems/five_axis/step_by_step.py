"""The paper's own way: each circle fitted by itself (eq 1, 6), then axis points, lines and twelve results by formula.

All tables stand in one problem, so that one linearisation gives the uncertainty of every number with its
correlations: the vertical index and the reading on the yaw axis are common to many results. The circles of one target
do not share r and phase here; the quantity `circle difference` says by how much they disagree.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from casadi import vertcat

from calib import Observations, Problem, Quantity, Unknown, prior
from instruments.level import on_turning_axis
from instruments.theodolite import PERIOD
from problems.axis_points import difference, one_circle, upward

from . import formulas
from .readings import INSTRUMENTS, NEAR_AND_FAR, SIGHTS, TABLES, WIRES, Circle, Readings


def on_target(centre_h: Any, centre_v: Any, circle_h: Any, circle_v: Any, angle: Any) -> Any:
    """Readings of both circles on one target, each with a centre and an eccentricity of its own (eq 4-6) [rad]."""
    return vertcat(one_circle(centre_h, circle_h, angle), centre_v + upward(circle_v, angle))


def centre_keys(readings: Readings) -> tuple[str, ...]:
    """Names of the fitted centres: instrument and filament, target and circle."""
    targets = [*dict.fromkeys((*readings.pitch.target, *readings.roll.target)), *readings.centre]
    return (*SIGHTS, *(f"{t} {circle}" for t in targets for circle in "HV"))


def declare(readings: Readings) -> Problem:
    """The procedure of sections 2 to 5 as one problem with the printed results as quantities.

    readings: of all tables. Returns the problem; its groups are table 1 to table 4, the printed centres and the priors.
    """
    r, keys, first = readings, centre_keys(readings), readings.sights()
    zero = Unknown("level_zero", np.mean(r.level, axis=0)[:, None], "arcsec", keys=TABLES)
    plumb = Unknown("plumb", np.zeros((2, 2)), "arcsec", parts=("x", "y"), keys=TABLES)
    centre = Unknown("centre", [[first[key]] for key in keys], "deg", keys=keys)
    read = [k for k in keys if k[0] not in r.centre]
    circle = Unknown("circle", np.zeros((len(read), 2)), "arcsec", parts=("a", "b"), keys=read)
    distance = Unknown("distance", [[value] for value, _ in r.distance.values()], "mm", keys=list(r.distance))
    index = Unknown("vertical_index", r.index[0], "deg")

    table = np.repeat([0, 1], len(r.level_angle))
    level = Observations(
        on_turning_axis, plumb[table], np.tile(r.level_angle, 2), zero[table], readings=r.level.T.ravel(),
        u=r.u_level, group="table 1", unit="arcsec", rows=np.tile(r.level_rows, 2))
    sight = np.array([keys.index(f"{i} {w}") for i, w in zip(r.wires.instrument, r.wires.target)])
    wires = Observations(
        one_circle, centre[sight], circle[sight], r.wires.angle, readings=r.wires.reading, u=r.u_circle,
        group="table 2", unit="arcsec", period=PERIOD, covariates={"target": r.wires.target}, rows=r.wires.rows)

    def targets(group: str, read: Circle) -> Observations:
        h, v = (np.array([keys.index(f"{t} {c}") for t in read.target]) for c in "HV")
        return Observations(
            on_target, centre[h], centre[v], circle[h], circle[v], read.angle, readings=read.reading, u=r.u_circle,
            group=group, unit="arcsec", components=("H", "V"), period=PERIOD, covariates={"target": read.target},
            rows=read.rows)

    priors = [
        prior(
            distance, [[value] for value, _ in r.distance.values()], [[u] for _, u in r.distance.values()],
            name="distances"),
        prior(index, r.index[0], r.index[1], name="vertical index"),
    ]
    if r.centre:
        own = np.array([keys.index(f"{t} {c}") for t in r.centre for c in "HV"])
        values = np.array([x for h, v, _ in r.centre.values() for x in (h, v)])
        u = np.array([x for *_, x in r.centre.values() for _ in "HV"])
        priors.append(prior(centre[own], values[:, None], u[:, None], name="printed centres"))
    return Problem(
        [level, wires, targets("table 3", r.pitch), targets("table 4", r.roll), *priors],
        quantities=_results(r, plumb, centre, circle, distance, index), name="five-axis, step by step")


# --- the printed results, from fitted centres (H, V) and distances L -----------------------------------------------


def _line(La: Any, Ha: Any, Va: Any, Lb: Any, Hb: Any, Vb: Any, yaw: Any, index: Any) -> formulas.Line:
    return formulas.line_through(
        formulas.axis_point(La, Ha, Va, yaw, index), formulas.axis_point(Lb, Hb, Vb, yaw, index)
    )


def point(L: Any, H: Any, V: Any, yaw: Any, index: Any) -> Any:
    """Axis point y, z behind a target, section 5.1 [m]."""
    return vertcat(*formulas.axis_point(L, H, V, yaw, index)[1:])


def line(La: Any, Ha: Any, Va: Any, Lb: Any, Hb: Any, Vb: Any, yaw: Any, index: Any, crossing: Any) -> Any:
    """Line of eq (8)-(10): dx, dy, dz, and y, z at the yaw axis [m]."""
    through = _line(La, Ha, Va, Lb, Hb, Vb, yaw, index)
    return vertcat(through.dx, through.dy, through.dz, *through.at(crossing))


def square(La: Any, Ha: Any, Va: Any, Lb: Any, Hb: Any, Vb: Any, yaw: Any, index: Any) -> Any:
    """Perpendicularity of a pitch axis and its yaw axis, items 1 and 6 [rad]."""
    return formulas.out_of_square(_line(La, Ha, Va, Lb, Hb, Vb, yaw, index))


def square_in_plan(
    La: Any, Ha: Any, Va: Any, Lb: Any, Hb: Any, Vb: Any, Lc: Any, Hc: Any, Vc: Any, Ld: Any, Hd: Any, Vd: Any,
    yaw: Any, index: Any
) -> Any:
    """Perpendicularity of the pitch axis (A, B) and the roll axis (C, D), item 2 [rad]."""
    return formulas.out_of_square_in_plan(
        _line(Lc, Hc, Vc, Ld, Hd, Vd, yaw, index), _line(La, Ha, Va, Lb, Hb, Vb, yaw, index)
    )


def height_between(
    La: Any, Ha: Any, Va: Any, Lb: Any, Hb: Any, Vb: Any, Lc: Any, Hc: Any, Vc: Any, Ld: Any, Hd: Any, Vd: Any,
    yaw: Any, index: Any, crossing: Any
) -> Any:
    """Height of the axis (C, D) over the axis (A, B) at the yaw axis, items 4 and 10 [m]."""
    over, under = _line(Lc, Hc, Vc, Ld, Hd, Vd, yaw, index), _line(La, Ha, Va, Lb, Hb, Vb, yaw, index)
    return over.at(crossing)[1] - under.at(crossing)[1]


def two_axis_intersection(
    La: Any, Ha: Any, Va: Any, Lb: Any, Hb: Any, Vb: Any, yaw: Any, index: Any, crossing: Any, yaw_two: Any
) -> Any:
    """Offset of the two-axis yaw axis from the two-axis pitch axis, item 7 [m]."""
    return formulas.off_the_sight(crossing, yaw_two, yaw) - _line(La, Ha, Va, Lb, Hb, Vb, yaw, index).at(crossing)[0]


def turned_wire(first: Any, second: Any, first_distance: Any, second_distance: Any, sense: Any) -> Any:
    """Disagreement of two theodolites at 90 degrees about the circle of one filament (2,) [m].

    sense: +1 where the yaw axis turns from X toward Y; then the second one sees -(a sin + b cos).
    """
    return vertcat(
        first[0] * first_distance - sense * second[1] * second_distance,
        first[1] * first_distance + sense * second[0] * second_distance,
    )


def _results(
    r: Readings, plumb: Unknown, centre: Unknown, circle: Unknown, distance: Unknown, index: Unknown
) -> list[Quantity]:
    lengths, keys = list(r.distance), centre_keys(r)

    def sight(*targets: str) -> tuple[Any, Any, Any]:
        h, v = (np.array([keys.index(f"{t} {c}") for t in targets]) for c in "HV")
        return distance[np.array([lengths.index(t) for t in targets])], centre[h], centre[v]

    yaw, crossing = centre[keys.index("T1 S3")], distance[lengths.index("T1")]
    axes = {name: pair for name, pair in NEAR_AND_FAR.items() if f"{pair[0]} H" in keys}
    near, far = zip(*axes.values())
    pitches = [name for name in axes if name != "roll"]
    near_pitch, far_pitch = zip(*(axes[name] for name in pitches))
    pitch, roll = [(*sight(a), *sight(b)) for a, b in (NEAR_AND_FAR["pitch"], NEAR_AND_FAR["roll"])]
    seen = [*near, *far]
    read = [t for t in seen if t not in r.centre]
    h, v = (np.array([circle.keys.index(f"{t} {c}") for t in read]) for c in "HV")
    s3, s2 = (np.array([keys.index(f"{i} {w}") for i in INSTRUMENTS]) for w in WIRES)
    first, second = (np.array([keys.index(f"{i} {w}") for w in WIRES]) for i in INSTRUMENTS)
    results = [
        Quantity(
            "plumb difference", formulas.parallelism, plumb[0], plumb[1], unit="arcsec", parts=("x", "y", "parallelism")
        ),
        Quantity("reading", lambda c: c, centre.each, unit="deg", keys=keys),
        Quantity("yaw angle", lambda a, b: b - a, centre[s3], centre[s2], unit="arcsec", keys=INSTRUMENTS),
        Quantity(
            "yaw offset", lambda L, a, b: formulas.off_the_sight(L, b, a),
            distance[np.array([lengths.index(i) for i in INSTRUMENTS])], centre[s3], centre[s2], unit="mm",
            keys=INSTRUMENTS),
        Quantity("point", point, *sight(*seen), yaw, index, unit="mm", parts=("y", "z"), keys=seen),
        Quantity(
            "line", line, *sight(*near), *sight(*far), yaw, index, crossing, unit="mm",
            parts=("dx", "dy", "dz", "y", "z"), keys=list(axes)),
        Quantity("square", square, *sight(*near_pitch), *sight(*far_pitch), yaw, index, unit="arcsec", keys=pitches),
        Quantity("square in plan", square_in_plan, *pitch, *roll, yaw, index, unit="arcsec"),
        Quantity("roll over pitch", height_between, *pitch, *roll, yaw, index, crossing, unit="mm"),
        Quantity("circle difference", difference, circle[h], circle[v], unit="arcsec", parts=("a", "b"), keys=read),
        Quantity(
            "wire difference", turned_wire, circle[first], circle[second], distance[lengths.index("T1")],
            distance[lengths.index("T2")], np.ones(2), unit="mm", parts=("a", "b"), keys=WIRES),
        Quantity(
            "wire difference, turned backwards", turned_wire, circle[first], circle[second],
            distance[lengths.index("T1")], distance[lengths.index("T2")], -np.ones(2), unit="mm", parts=("a", "b"),
            keys=WIRES),
    ]
    if "two_axis_pitch" in axes:
        two = (*sight("E"), *sight("F"))
        results += [
            Quantity("pitch over pitch", height_between, *pitch, *two, yaw, index, crossing, unit="mm"),
            Quantity(
                "two-axis intersection", two_axis_intersection, *two, yaw, index, crossing,
                centre[keys.index("T1 S2")], unit="mm"),
        ]
    return results
