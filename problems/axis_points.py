"""Points of a turning axis by theodolite: a target near the axis runs on a circle, whose centre is what is wanted.

A target at distance L (elevation e) sits off the axis by a vector of length r and phase phi, kept as a = r cos(phi),
b = r sin(phi). With the axis turned to alpha the line of sight to it is (Ren, Gao, Zhao 2015, eq 4-6)

    horizontal angle = centre.H + (a cos alpha - b sin alpha)/(L cos e)
    vertical angle   = centre.V + (a sin alpha + b cos alpha)/L

Both circles see the same r and phi; `circle_sharing` tests whether the readings bear that out before it is believed.
A filament has no height to point at and is seen in the horizontal circle only.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from casadi import atan2, cos, pi, sin, sqrt, vertcat
from numpy.typing import ArrayLike

from calib import (
    Effect,
    Estimate,
    Observations,
    Parameter,
    Problem,
    Quantity,
    Unknown,
    direct,
    hands_slots_to,
    prior,
    simulate,
)
from calib.errors import InputError
from calib.job import Job
from calib.scene import Points, Scene, Sights
from calib.table import Table, written
from calib.units import arcsec, degree, minute, mm, um
from instruments import theodolite
from problems.recorded import recorded

accepts = ("problems.axis_points", "theodolite_target")
source = "Ren, Gao, Zhao (2015), J. Harbin Inst. Tech. 47(10), eq (4)-(7)"
RUNOUT = "ISO 230-7:2015, radial error motion of an axis of rotation"


def across(eccentricity: Any, angle: Any) -> Any:
    """Sideways departure a cos(angle) - b sin(angle) of a target, in the unit of its eccentricity (a, b)."""
    return eccentricity[0] * cos(angle) - eccentricity[1] * sin(angle)


def upward(eccentricity: Any, angle: Any) -> Any:
    """Upward departure a sin(angle) + b cos(angle) of a target, in the unit of its eccentricity (a, b)."""
    return eccentricity[0] * sin(angle) + eccentricity[1] * cos(angle)


def one_circle(centre: Any, eccentricity: Any, angle: Any) -> Any:
    """Reading of the horizontal circle on a target or filament, with the eccentricity as the circle sees it (eq 6).

    centre: reading on the axis [rad]; eccentricity: (2,) a/L, b/L [rad]; angle: of the axis [rad]. Returns the
    reading [rad].
    """
    return centre + across(eccentricity, angle)


@hands_slots_to(theodolite.face_readings)
def both_circles(
    centre: Any, eccentricity_h: Any, eccentricity_v: Any, distance: Any, elevation: Any, angle: Any, face: Any, *,
    offset: Any = direct, **slots: Any
) -> Any:
    """Readings of both circles on a target of a turning axis (eq 4, 5), for any elevation and either face.

    centre: (2,) line of sight to the axis point, as horizontal angle and zenith angle of the circles [rad];
    eccentricity_h, eccentricity_v: (2,) a, b as the horizontal and the vertical circle see them, one and the same
    unless sharing is refused [m]; distance, elevation of the target [m, rad]; angle: of the axis [rad]; face: +1 or
    -1. Slots: `offset` ((2,) sideways and upward departure [m], may ask for angle) and those of
    `theodolite.face_readings`. Returns H, V [rad].
    """
    departure = offset(vertcat(across(eccentricity_h, angle), upward(eccentricity_v, angle)), angle=angle)
    return theodolite.face_readings(
        centre[0] + departure[0] / (distance * cos(elevation)), centre[1] + departure[1] / distance, elevation, face,
        **slots)


@hands_slots_to(theodolite.face_readings)
def on_filament(
    centre: Any, eccentricity: Any, distance: Any, angle: Any, face: Any, *, offset: Any = direct, **slots: Any
) -> Any:
    """Reading of the horizontal circle on a filament of a turning axis (eq 4), pointed at on the horizon.

    centre: reading on the axis [rad]; eccentricity: (2,) a, b [m]; distance: [m]; angle: of the axis [rad]; face: +1 or
    -1. Slots as of `both_circles`. Returns H [rad].
    """
    departure = offset(vertcat(across(eccentricity, angle), 0.0), angle=angle)
    return theodolite.face_readings(centre + departure[0] / distance, pi / 2, 0.0, face, **slots)[0]


def face_one(readings: ArrayLike, face: ArrayLike) -> np.ndarray:
    """Raw readings of two faces as angles of the line of sight, to start from.

    readings: (n, 2) H, V [rad]; face: (n,) +1 or -1. Returns (n, 2): H less half a turn and 2 pi - V on face 2 [rad].
    """
    readings, second = np.asarray(readings, float), np.asarray(face) < 0
    return np.where(second[:, None], readings * [1, -1] + [-np.pi, 2 * np.pi], readings)


def start(readings: ArrayLike, face: ArrayLike, index: np.ndarray, count: int) -> np.ndarray:
    """Mean line of sight to each target.

    readings: (n, 2) raw H, V [rad]; face: (n,); index: (n,) number of the target of each row; count: of targets.
    Returns (count, 2) [rad], the means taken round the circle.
    """
    seen = np.exp(1j * face_one(readings, face))
    sums = np.array([seen[index == i].sum(axis=0) for i in range(count)])
    return np.angle(sums) % (2 * np.pi)


def declare(
    readings: ArrayLike | None, target: Sequence[object], angle: ArrayLike, *, distance: Mapping[str, float],
    u: Sequence[float] = (1 * arcsec, 1 * arcsec), elevation: Mapping[str, float] | None = None,
    face: ArrayLike | None = None, shared: Collection[str] | None = None, u_distance: float = 0.0,
    covariates: Mapping[str, Any] | None = None, rows: ArrayLike | None = None,
    candidates: Sequence[Effect] = ()
) -> Problem:
    """The problem of the axis points seen from one theodolite.

    readings: (n, 2) raw H, V [rad], None for planning; target: (n,) ids; angle: (n,) of the axis [rad]; distance,
    elevation: of each target [m, rad]; u: of one H and one V reading [rad]; face: (n,) +1 or -1; shared: targets
    whose circles share r and phase (None: all); u_distance: of the distances, zero where they are exact [m];
    covariates, rows: as for Observations; candidates: effects. Returns the problem with r and phase of every target
    as quantities, and the difference of (a, b) between the circles of the targets that do not share them.
    Raises InputError for a target without a distance.
    """
    ids = list(dict.fromkeys(str(t) for t in target))
    _refuse_missing(ids, distance)
    apart = [t for t in ids if shared is not None and t not in shared]
    index = np.array([ids.index(str(t)) for t in target])
    faces = np.ones(len(index)) if face is None else np.asarray(face, float)
    first = np.tile([np.pi, np.pi / 2], (len(ids), 1)) if readings is None else start(readings, faces, index, len(ids))
    centre = Unknown("centre", first, "deg", parts=("H", "V"), keys=ids)
    eccentricity = Unknown(
        "eccentricity", np.zeros((len(ids) + len(apart), 2)), "mm", parts=("a", "b"),
        keys=ids + [f"{t} in V" for t in apart])
    in_v = np.array([len(ids) + apart.index(t) if t in apart else i for i, t in enumerate(ids)])
    known = np.array([distance[t] for t in ids])
    length = Unknown("distance", known[:, None], "mm", keys=ids)
    observations = [
        Observations(
            both_circles, centre[index], eccentricity[index], eccentricity[in_v[index]],
            length[index] if u_distance else known[index],
            np.array([(elevation or {}).get(t, 0.0) for t in ids])[index], np.asarray(angle, float), faces,
            readings=readings, u=u, group="circles", unit="arcsec", components=("H", "V"), period=theodolite.PERIOD,
            covariates={**(covariates or {}), "target": np.array(target, dtype=str)}, rows=rows)
    ]
    if u_distance:
        observations.append(prior(length, known[:, None], u_distance, name="distances"))
    quantities = [
        Quantity(
            "circle", radius_and_phase, eccentricity.each, unit=("mm", "deg"), parts=("r", "phase"),
            keys=eccentricity.keys)
    ]
    if apart:
        rows_apart = np.array([ids.index(t) for t in apart])
        quantities.append(
            Quantity(
                "circle difference", difference, eccentricity[rows_apart], eccentricity[in_v[rows_apart]], unit="mm",
                parts=("a", "b"), keys=apart)
        )
    return Problem(observations, quantities=quantities, effects=candidates, name="axis points")


def declare_filaments(
    readings: ArrayLike | None, target: Sequence[object], angle: ArrayLike, *, distance: Mapping[str, float],
    u: float = 1 * arcsec, face: ArrayLike | None = None, covariates: Mapping[str, Any] | None = None,
    rows: ArrayLike | None = None
) -> Problem:
    """The problem of axis points marked by filaments, which the horizontal circle alone sees.

    readings: (n,) raw H [rad], None for planning; the rest as for `declare`. Returns the problem with r and phase of
    every filament as quantities. Raises InputError for a filament without a distance.
    """
    ids = list(dict.fromkeys(str(t) for t in target))
    _refuse_missing(ids, distance)
    index = np.array([ids.index(str(t)) for t in target])
    faces = np.ones(len(index)) if face is None else np.asarray(face, float)
    seen = np.full((len(index), 2), np.pi) if readings is None else np.stack([readings, readings], axis=1)
    centre = Unknown("filament", start(seen, faces, index, len(ids))[:, :1], "deg", keys=ids)
    eccentricity = Unknown("filament_eccentricity", np.zeros((len(ids), 2)), "mm", parts=("a", "b"), keys=ids)
    observations = Observations(
        on_filament, centre[index], eccentricity[index], np.array([distance[t] for t in ids])[index],
        np.asarray(angle, float), faces, readings=readings, u=u, group="filaments", unit="arcsec", components=("H",),
        period=theodolite.PERIOD, covariates={**(covariates or {}), "target": np.array(target, dtype=str)}, rows=rows)
    circle = Quantity(
        "filament circle", radius_and_phase, eccentricity.each, unit=("mm", "deg"), parts=("r", "phase"), keys=ids)
    return Problem([observations], quantities=[circle], name="axis points by filaments")


def _refuse_missing(ids: Sequence[str], distance: Mapping[str, float]) -> None:
    missing = [t for t in ids if t not in distance]
    if missing:
        raise InputError(
            f"target '{missing[0]}' has readings but no distance; distances are given for "
            f"{', '.join(distance) or 'none'}. Measure it (some millimetres suffice) and add it."
        )


def radius_and_phase(eccentricity: Any) -> Any:
    """Length r [unit of a] and phase [rad] of an eccentricity (a, b)."""
    return vertcat(sqrt(eccentricity[0] ** 2 + eccentricity[1] ** 2), atan2(eccentricity[1], eccentricity[0]))


def difference(seen_by_horizontal: Any, seen_by_vertical: Any) -> Any:
    """Difference (2,) of the eccentricities that two circles see."""
    return seen_by_horizontal - seen_by_vertical


def effects(blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """What may be missing: the effects of the theodolite, and a motion of the axis twice per turn.

    blocks: set-ups at which a step may have happened. Returns the effects; every target has its own axis motion.
    """
    motion = Effect(
        "radial_runout_2x",
        "offset",
        lambda offset, p, angle: vertcat(
            p.hc * cos(2 * angle) + p.hs * sin(2 * angle), p.vc * cos(2 * angle) + p.vs * sin(2 * angle)
        ),
        tuple(Parameter(name, "um", (0.5 * um, 200 * um)) for name in ("hc", "hs", "vc", "vs")),
        "target",
        per="target",
        source=RUNOUT,
    )
    return (*theodolite.effects(blocks), motion)


columns = {
    "circles": {"target": "id", "angle": "of the axis", "H": "circle", "V": "circle", "face": "1 or 2 (optional)"},
    "filaments": {"target": "id", "angle": "of the axis", "H": "circle", "face": "1 or 2 (optional)"},
}
options = {
    "shared": "targets whose circles share r and phase, as a list; all if not given",
    "u_distance": "standard uncertainty of the distances; exact if not given",
}


def from_job(job: Job) -> Problem:
    """The problem of a job, or of a case of scenario `theodolite_target`.

    Columns of [data.circles] (or measurements.csv): target, angle, H, V; of [data.filaments]: target, angle, H; where
    there are: face (1 or 2), direction, block, time, temp. [[known.targets]]: id, L, elevation. The instrument gives
    u_H, u_V (a case: sigma_H, sigma_V).
    Raises InputError where something is missing.
    """
    return _from_job(job, job.options.texts("shared", None))


def formulations(job: Job) -> dict[str, Problem]:
    """The same readings with the circles of every target sharing r and phase, and each circle by itself (eq 6, 7)."""
    return {"both circles share r and phase": _from_job(job, None), "each circle by itself": _from_job(job, ())}


def _from_job(job: Job, shared: Collection[str] | None) -> Problem:
    case = "measurements" in job.tables
    stated = "sigma" if case else "u"
    targets = {one.text("id"): one for one in job.known.tables("targets")}
    distance = {key: one.quantity("L", "length") for key, one in targets.items()}
    elevation = {key: one.quantity("elevation", "angle", 0.0) for key, one in targets.items()}
    u_distance = job.options.quantity("u_distance", "length", 0.0)
    parts = []
    if case or "circles" in job.tables or "filaments" not in job.tables:
        data = job.table("measurements" if case else "circles")
        instrument = job.instruments.table("theodolite") if case else job.instrument("circles")
        parts.append(declare(
            np.stack([data.number("H", "angle"), data.number("V", "angle")], axis=1), list(data.text("target")),
            data.number("angle", "angle"), distance=distance, elevation=elevation,
            u=[instrument.quantity(f"{stated}_{circle}", "angle") for circle in "HV"], face=_faces(data), shared=shared,
            u_distance=u_distance, covariates=recorded(job, data), rows=data.row_numbers))
    if "filaments" in job.tables:
        data = job.table("filaments")
        parts.append(declare_filaments(
            data.number("H", "angle"), list(data.text("target")), data.number("angle", "angle"), distance=distance,
            u=job.instrument("filaments").quantity("u_H", "angle"), face=_faces(data),
            covariates=recorded(job, data), rows=data.row_numbers))
    problem = Problem([o for part in parts for o in part.observations], name="axis points",
                      quantities=[q for part in parts for q in part.quantities])
    blocks = sorted({int(b) for o in problem.observations for b in o.covariates.get("block", [])})[1:]
    return problem.with_effects(*_usable(effects(blocks), problem))


def _faces(data: Table) -> np.ndarray:
    face = data.whole("face") if data.has("face") else np.ones(len(data), dtype=int)
    second = np.mod(data.number("V", "angle"), 2 * np.pi) > np.pi if data.has("V") and not data.has("face") else []
    if np.any(second):
        place = data.place(int(np.argmax(second)), data.column("V"))
        raise InputError(f"{place}: more than half a turn from the zenith is a reading of face 2; add a column face, "
                         "1 or 2")
    for row in np.flatnonzero((face != 1) & (face != 2)):
        place = data.place(int(row), data.column("face"))
        raise InputError(f"{place}: face {face[row]} is neither 1 nor 2; correct it")
    return np.where(face == 1, 1.0, -1.0)


def _usable(found: Sequence[Effect], problem: Problem) -> tuple[Effect, ...]:
    """The effects whose inputs are there.

    Tilt of the standing axis and circle eccentricity are left out: the field of one axis is too narrow to see them.
    """
    names = {*problem.observations[0].covariates, "angle", "face", "elevation", "horizontal_angle", "zenith_angle"}
    left_out = {"standing_axis_tilt", "circle_eccentricity"}
    if all(o.group == "filaments" for o in problem.observations):
        left_out |= {e.name for e in found if e.channel == "V" or e.channel.startswith("V@")}
    return tuple(e for e in found if set(e.inputs) <= names and e.name not in left_out)


def example(seed: int) -> Problem:
    """Three targets on a pitch axis over a half turn, both faces, two set-ups; simulated readings.

    seed: of the noise. Returns the problem with its effects as held candidates.
    """
    ids, sweep = ("A", "B", "C"), np.arange(0.0, 181.0, 20.0) * degree
    target = np.tile(np.repeat(ids, 2), 2 * len(sweep))
    angle = np.repeat(np.concatenate([sweep, sweep[::-1]]), 2 * len(ids))
    count = len(angle)
    time = np.arange(count) * 0.5 * minute
    problem = declare(
        None,
        list(target),
        angle,
        distance=dict(zip(ids, (0.9875, 1.4170, 1.8525))),
        elevation=dict(zip(ids, np.array([3.0, 18.0, -9.0]) * degree)),
        face=np.tile([1.0, -1.0], count // 2),
        covariates={
            "time": (time, "s"),
            "temperature_difference": (0.5 * np.sin(time / (20 * minute)), "K"),
            "direction": np.repeat([1, -1], count // 2),
            "block": np.repeat([1, 2], count // 2),
        },
    )
    problem = problem.with_effects(*_usable(effects((2,)), problem))
    centre, eccentricity = (problem.select(name).unknown for name in ("centre", "eccentricity"))
    truth = {
        centre: np.array([[185.50, 87.0], [185.49, 72.0], [185.48, 99.0]]) * degree,
        eccentricity: np.array([[0.17, -0.13], [0.05, 0.11], [-0.02, 0.03]]) * mm,
    }
    return simulate(problem, truth, seed)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job with simulated readings: {file name: text}. seed: of the noise."""
    observations = example(seed).observations[0]
    known = {a.name: a.data[:, 0] for a in observations.arguments if a.unknown is None}
    c = observations.covariates
    h, v = np.mod(observations.recorded, 2.0 * np.pi).T
    circles = {"row": observations.rows, "target": c["target"], "face": np.where(known["face"] > 0, 1, 2),
               "block": c["block"], "direction": c["direction"], "angle_deg": known["angle"], "time_min": c["time"],
               "H_deg": h, "V_deg": v}
    places = {t: i for i, t in reversed(list(enumerate(c["target"])))}
    targets = "\n".join(
        f'[[known.targets]]\nid = "{t}"\nL = "{known["distance"][i] / mm:.1f} mm"\n'
        f'elevation = "{known["elevation"][i] / degree:.1f} deg"\n'
        for t, i in sorted(places.items())
    )
    return {"job.toml": _JOB + targets,
            "circles.csv": written("simulated, three targets over half a turn, both faces, two set-ups", circles)}


_JOB = """problem = "problems.axis_points"

[data.circles]
file = "circles.csv"
instrument = "theodolite"

[instruments.theodolite]
kind = "theodolite"
u_H = "1 arcsec"
u_V = "1 arcsec"

"""


def scene(job: Job, estimate: Estimate) -> Scene:
    """The theodolite, the points of the axis that it saw, and its lines of sight."""
    problem, told = estimate.problem, {one.text("id"): one for one in job.known.tables("targets")}
    seen: dict[str, np.ndarray] = {}
    for name, dim in (("filament", 1), ("centre", 2)):
        for unknown in problem.unknowns:
            if unknown.name == name:
                angles = np.reshape(estimate[unknown], (-1, dim))
                seen |= {key: np.append(one, pi / 2)[:2] for key, one in zip(unknown.keys, angles, strict=True)}
    # A circle counts clockwise: x ahead at zero, y to the left.
    places = [told[key].quantity("L", "length") * np.array([np.sin(v) * np.cos(h), -np.sin(v) * np.sin(h), np.cos(v)])
              for key, (h, v) in seen.items()]
    return Scene((Points("theodolite", np.zeros((1, 3)), ("theodolite",)), Points("axis points", places, list(seen)),
                  Sights("circle readings", np.zeros(3), places)))
