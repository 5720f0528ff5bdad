"""Turntable calibrated by coordinates: a laser tracker follows one or more reflectors that the table carries round.

One model serves the calibration of the axis, the positioning error of every commanded angle and the discrepancy cases.
Source: Li, Cao, Qu 2020, Metrology and Measurement Technology 40(2), 14-19 ("the paper").
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import (
    Direction,
    Effect,
    Gaussian,
    Observations,
    Problem,
    Quantity,
    Shared,
    Unknown,
    direct,
    hands_slots_to,
    simulate,
)
from calib.geometry import Transform, cross, matrix, norm, product
from calib.job import MEASUREMENTS
from calib.units import arcsec, degree, kelvin_from_celsius, minute, mm, um
from instruments import laser_tracker
from problems import algebraic_circle, circle, pairwise_circle
from problems.circle import in_plane
from problems.turntable_effects import table_effects, tracker_effects

if TYPE_CHECKING:
    from calib.job import Job
    from calib.settings import Settings
    from calib.table import Table
    from calib.workflow.reproduce import Reproduction

Array = NDArray[np.float64]


# --- the physics -------------------------------------------------------------------------------------------------


def reflector(command: Any, deviation: Any, centre: Any, axis: Any, radius: Any, phase: Any, height: Any,
              first_phase: Any, reference: Any, *, theta: Any = direct, arm: Any = direct, motion: Any = direct) -> Any:
    """Position (3,) [m] of a reflector on the table in the frame of the tracker.

    command: commanded angle [rad]; deviation: what the table turns further [rad]; centre: (3,) point of the axis [m];
    axis: its unit direction (3,); radius [m], phase [rad], height along the axis [m] of this reflector; first_phase:
    phase of reflector 1 [rad], which fixes the directions `toward` and `across` of the error motions; reference: (3,)
    from which phases count. Slots: `theta` (true angle), `arm` (radius), `motion` (the point, moved by the axis).
    """
    first, second = in_plane(axis, reference)
    angle = theta(command, command=command) + deviation + phase
    toward = ca.cos(first_phase) * first + ca.sin(first_phase) * second
    outward = ca.cos(angle) * first + ca.sin(angle) * second
    point = centre + arm(radius, command=command) * outward + height * axis
    return motion(point, command=command, toward=toward, across=cross(axis, toward), axis=axis, centre=centre)


@hands_slots_to(reflector, laser_tracker.polar)
def reflector_seen(command: Any, deviation: Any, centre: Any, axis: Any, radius: Any, phase: Any, height: Any,
                   first_phase: Any, reference: Any, *, theta: Any = direct, arm: Any = direct, motion: Any = direct,
                   **slots: Any) -> Any:
    """Polar readings (range [m], azimuth, zenith angle [rad]) of a `reflector` by a laser tracker."""
    point = reflector(command, deviation, centre, axis, radius, phase, height, first_phase, reference,
                      theta=theta, arm=arm, motion=motion)
    return laser_tracker.polar(point, **slots)


def effects(blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """Effects of encoder, axis and table, then those of the tracker that a turntable can show.

    blocks: values of covariate `block` at which a reflector was nested anew. Inputs: covariates `direction`, `time`,
    `temperature_difference`, `block`.
    """
    return (*table_effects(), *tracker_effects(blocks))


# --- the declaration ---------------------------------------------------------------------------------------------


def start(command: ArrayLike, points: ArrayLike, item: ArrayLike, axis: ArrayLike | None = None) -> dict[str, Array]:
    """Start values from an algebraic circle through the points of each reflector.

    command: (n,) [rad]; points: (n, 3) [m] in the frame of the tracker; item: (n,) reflector of each row, from 0.
    axis: (3,) approximate direction, its sense included, or None: the sense in which the points follow the command.
    Returns centre (3,) [m], axis (3,), reference (3,), and radius, phase, height of each reflector [m, rad, m].
    """
    command, points, item = np.asarray(command, float), np.asarray(points, float), np.asarray(item, int)
    circles = [algebraic_circle.space_circle(points[item == k], command=command[item == k], axis=axis)
               for k in range(item.max() + 1)]
    centre, direction = circles[0].centre, circles[0].normal
    reference = circles[0].reference
    side = np.cross(direction, reference)
    phases = []
    for k in range(len(circles)):
        offset = points[item == k] - centre
        angle = np.arctan2(offset @ side, offset @ reference) - command[item == k]
        phases.append(np.angle(np.exp(1j * angle).mean()))
    return {"centre": centre, "axis": direction, "reference": reference, "phase": np.array(phases),
            "radius": np.array([c.radius for c in circles]),
            "height": np.array([(c.centre - centre) @ direction for c in circles])}


def declare(command: ArrayLike, readings: ArrayLike, u: ArrayLike | Gaussian, reflectors: ArrayLike | None = None,
            axis: ArrayLike | None = None, stops: ArrayLike | None = None, covariates: Mapping[str, Any] | None = None,
            rows: ArrayLike | None = None) -> Problem:
    """A turntable seen by a laser tracker, with every effect of table and tracker attached, zero and held.

    command: (n,) commanded angles [rad], not reduced modulo a turn; readings: (n, 3) range [m], azimuth, zenith angle
    [rad]; u: their standard uncertainties (3,) or (n, 3), or a Gaussian; reflectors: (n,) names, reflector 1
    first; axis: (3,) approximate direction with its sense; stops: (n,) number of the stop, from 0, where the
    positioning error of every stop is wanted (unknown `deviation`, zero by definition at stop 0), or None for a table
    that obeys.
    covariates: time [s], direction, temperature_difference [K], block, each (n,); rows: (n,) row numbers of the file.
    Raises InputError where the readings of a reflector do not make a circle.
    """
    command, readings = np.asarray(command, float), np.asarray(readings, float)
    n = len(command)
    names = np.full(n, "1") if reflectors is None else np.asarray(reflectors).astype(str)
    keys = list(dict.fromkeys(names.tolist()))
    item = np.array([keys.index(name) for name in names])
    begin = start(command, laser_tracker.cartesian_readings(readings), item, axis)
    centre = Unknown("centre", begin["centre"], unit="mm", parts=("x", "y", "z"))
    direction = Direction("axis", begin["axis"], unit="arcsec")
    radius = Unknown("radius", begin["radius"][:, None], unit="mm", keys=keys)
    phase = Unknown("phase", begin["phase"][:, None], unit="deg", keys=keys)
    height = Unknown("height", np.where(np.arange(len(keys)) == 0, 0.0, begin["height"])[:, None], unit="mm", keys=keys)
    deviation, held = _deviations(command, stops)
    given = covariates or {}
    seen = Observations(reflector_seen, command, deviation, centre, direction, radius[item], phase[item], height[item],
                        phase[np.zeros(n, dtype=int)], Shared(begin["reference"]), readings=readings, u=u,
                        group="tracker", unit=("um", "arcsec", "arcsec"), components=("range", "azimuth", "zenith"),
                        period=laser_tracker.PERIOD, rows=rows,
                        covariates={"command": (command, "deg"), "reflector": names, **given})
    blocks = np.unique(seen.covariates["block"])[1:] if "block" in given else ()
    candidates = [e for e in effects(blocks) if set(e.inputs) & _DRIVERS <= set(given)]
    return Problem([seen], held=[height[0], *held], effects=candidates, name="turntable by coordinates")


_DRIVERS = {"time", "direction", "temperature_difference", "block"}


def _deviations(command: Array, stops: ArrayLike | None) -> tuple[Any, list[Any]]:
    if stops is None:
        return Shared(0.0), []
    stops = np.asarray(stops, int)
    keys = [f"{np.degrees(command[np.flatnonzero(stops == k)[0]]):.6g}#{k + 1}" for k in range(stops.max() + 1)]
    deviation = Unknown("deviation", np.zeros((len(keys), 1)), unit="arcsec", keys=keys)
    return deviation[stops], [deviation[0]]


# --- the paper's way: frame change and angles --------------------------------------------------------------------


def table_frame(centre: Any, normal: Any, first: Any) -> Transform:
    """The frame of the table from that of the tracker: origin at the centre, z along the normal, x to a first point.

    centre, first: (3,) points [m]; normal: unit (3,). The paper points x at the first point itself, which only a point
    exactly in the plane allows; here at its foot in the plane. Source: the paper, equation 15 and figure 3.
    """
    x, y = in_plane(normal, first - centre)
    rotation = matrix([[x[0], x[1], x[2]], [y[0], y[1], y[2]], [normal[0], normal[1], normal[2]]])
    return Transform(rotation, -product(rotation, centre))


def angles_in_table(point: Any, first: Any, centre: Any, normal: Any) -> Any:
    """Angle turned [rad], right-handed about the normal, axial angle [rad] and distance [m] of a point (3,) [m].

    first: (3,) the first point [m]; centre (3,) [m]; normal: unit (3,). The axial part leaves the angle turned.
    Source: the paper, equation 18, with the sign and the quadrant that its arc tangent loses.
    """
    seen = table_frame(centre, normal, first) @ point
    return ca.vertcat(ca.atan2(seen[1], seen[0]), ca.atan2(seen[2], ca.sqrt(seen[0]**2 + seen[1]**2)), norm(seen))


def declare_paper(points: ArrayLike, weights: ArrayLike | None = None) -> Problem:
    """The paper's procedure: circle by equation 8, or 14 with weights, then frame change and angles as a quantity.

    points: (n, 3) [m]; weights: (n,) of equations 9 to 13, or None. Quantity `angles`: turned, axial, distance.
    """
    points = np.asarray(points, float)
    problem = (pairwise_circle.pairwise(points) if weights is None
               else pairwise_circle.weighted_pairwise(points, weights))
    centre, plane = (problem.select(name).unknown for name in ("centre", "plane"))

    def angles(point: Any, first: Any, centre: Any, plane: Any) -> Any:
        return angles_in_table(point, first, centre, plane[:3] / norm(plane[:3]))
    return problem.with_quantities(Quantity("angles", angles, points, Shared(points[0]), centre, plane,
                                            parts=("turned", "axial", "distance"), unit=("deg", "arcsec", "mm")))


# --- jobs, cases and examples ------------------------------------------------------------------------------------

accepts = ("turntable", "turntable_tracker")


def from_job(job: Job) -> Problem:
    """A turntable from a job or from a case of scenario `turntable_tracker`.

    Table `points` (of a case: measurements): command (angle), range, azimuth, zenith or x, y, z; optionally smr, time,
    temp, direction, block. Its instrument, kind = "laser_tracker": sigma_range, sigma_azimuth, sigma_zenith or
    u = "a + b L". Options: positioning = true for an unknown deviation at every stop; axis_direction = [x, y, z];
    reference_temperature_C.
    """
    case = job.path.name == "case.toml"
    table = job.table(MEASUREMENTS if case else "points")
    if case:
        instrument, settings = job.instruments.table("tracker"), job.known
        axis: Any = settings.numbers("axis_direction_approx")
        positioning = False
    else:
        instrument, settings = job.instrument("points"), job.options
        instrument.text("kind", among=("laser_tracker",))
        axis, positioning = settings.numbers("axis_direction", None), settings.flag("positioning", False)
    if table.has("range"):
        readings = np.column_stack([table.number("range", "length"), table.number("azimuth", "angle"),
                                    table.number("zenith", "angle")])
    else:
        readings = laser_tracker.polar_readings(np.column_stack([table.number(c, "length") for c in ("x", "y", "z")]))
    command = table.number("command", "angle")
    covariates = _covariates(table, settings)
    stops = consecutive_stops(command, covariates.get("direction")) if positioning else None
    return declare(command, readings, circle.stated_by_tracker(instrument, readings),
                   table.text("smr") if table.has("smr") else None, axis, stops, covariates, table.row_numbers)


def _covariates(table: Table, settings: Settings) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if table.has("time"):
        time = table.number("time", "time")
        found["time"] = (time - time[0], "min")
    if table.has("temp"):
        reference = kelvin_from_celsius(settings.number("reference_temperature_C", 20.0))
        found["temperature_difference"] = (table.number("temp", "temperature") - reference, "K")
    found.update({name: table.whole(name) for name in ("direction", "block") if table.has(name)})
    found.update({name: table.whole(name) for name in ("sweep", "repeat") if table.has(name)})
    if table.has("split"):
        found["split"] = table.text("split")
    return found


def consecutive_stops(command: ArrayLike, direction: ArrayLike | None = None) -> NDArray[np.int64]:
    """Number of the stop of each row (n,), from 0: a new one where command (n,) or direction (n,) changes."""
    changes = np.diff(np.asarray(command, float)) != 0.0
    if direction is not None:
        changes |= np.diff(np.asarray(direction, float)) != 0.0
    return np.concatenate([[0], np.cumsum(changes)])


EXAMPLE = {"centre": (2.4, -0.9, -0.3), "axis": (0.05, -0.03, 1.0), "radius": (0.25, 0.4), "height": (0.0, 0.12)}


def example(seed: int) -> Problem:
    """A two-way run of a table in 30 degree steps with two reflectors, 2.5 m from a tracker; simulated readings."""
    sweep = np.arange(0.0, 361.0, 30.0)
    command = np.repeat(np.concatenate([sweep, sweep[::-1]]), 2) * degree
    n = len(command)
    item = np.tile([0, 1], n // 2)
    axis = np.array(EXAMPLE["axis"]) / np.linalg.norm(EXAMPLE["axis"])
    first, second = in_plane(axis, np.array([1.0, 0.0, 0.0]))
    angle = command + item * 130.0 * degree
    radius, height = (np.array(EXAMPLE[name])[item][:, None] for name in ("radius", "height"))
    points = (np.array(EXAMPLE["centre"]) + radius * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
              + height * axis)
    covariates = {"time": (np.arange(n) * 30.0, "min"), "direction": np.repeat([1, -1], n // 2),
                  "temperature_difference": (0.4 * np.sin(np.arange(n) / 9.0), "K"), "block": np.repeat([1, 2], n // 2)}
    exact = declare(command, laser_tracker.polar_readings(points), [4.0 * um, 1.0 * arcsec, 1.0 * arcsec],
                    np.array(["1", "2"])[item], axis, None, covariates)
    return simulate(exact, None, seed)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job that asks for the positioning error of every stop of the table of `example`: {file name: text}."""
    seen = example(seed).observations[0]
    assert seen.readings is not None
    names = ("command", "reflector", "time", "direction", "temperature_difference", "block")
    lines = [f"{np.degrees(c):.0f},{s},{t / minute:.1f},{way},{20.0 + warmer:.3f},{b},"
             f"{r / mm:.5f},{np.degrees(az):.7f},{np.degrees(ze):.7f}"
             for c, s, t, way, warmer, b, (r, az, ze) in zip(*(seen.covariates[k] for k in names), seen.readings)]
    header = "command_deg,smr,time_min,direction,temp_C,block,range_mm,azimuth_deg,zenith_deg"
    return {
        "job.toml": 'problem = "problems.turntable"\n\n[data.points]\nfile = "points.csv"\ninstrument = "tracker"\n\n'
                    '[instruments.tracker]\nkind = "laser_tracker"\nsigma_range_um = 4.0\nsigma_azimuth_arcsec = 1.0\n'
                    'sigma_zenith_arcsec = 1.0\n\n[options]\npositioning = true\naxis_direction = [0.0, 0.0, 1.0]\n\n'
                    '[report]\nquantities = ["deviation"]\n',
        "points.csv": f"# source: simulated, seed {seed}\n{header}\n" + "\n".join(lines) + "\n"}


# --- the published comparison ------------------------------------------------------------------------------------

published = "turntable"


def reproduce() -> Reproduction:
    """Every printed number of the paper beside what its own tables give: see `problems.turntable_published`."""
    from problems import turntable_published

    return turntable_published.reproduce()
