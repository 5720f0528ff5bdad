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
    Estimate,
    Gaussian,
    Observations,
    Problem,
    Shared,
    Unknown,
    direct,
    hands_slots_to,
    simulate,
)
from calib.analyse.shapes import scene as follows
from calib.errors import InputError
from calib.geometry import cross
from calib.job import MEASUREMENTS
from calib.scene import Points, Scene, Sights
from calib.table import written
from calib.units import arcsec, degree, kelvin_from_celsius, um
from instruments import laser_tracker
from problems import measured_points
from problems.circle import algebraic, in_plane
from problems.recorded import recorded
from problems.turntable.effects import table_effects, tracker_effects

if TYPE_CHECKING:
    from calib.job import Job
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


def start(command: ArrayLike, points: ArrayLike, reflectors: ArrayLike, axis: ArrayLike | None = None
          ) -> dict[str, Array]:
    """Start values from an algebraic circle through the points of each reflector.

    command: (n,) [rad]; points: (n, 3) [m] in the frame of the tracker; reflectors: (n,) names, reflector 1 first.
    axis: (3,) approximate direction, its sense included, or None: the sense in which the points follow the command.
    Returns centre (3,) [m], axis (3,), reference (3,), and radius, phase, height of each reflector [m, rad, m].
    Raises InputError where the points of a reflector make no circle or turn the other way about the axis.
    """
    command, points, names = np.asarray(command, float), np.asarray(points, float), np.asarray(reflectors)
    circles, phases = [], []
    for name in dict.fromkeys(names.tolist()):
        mine = names == name
        try:
            circles.append(algebraic.space_circle(points[mine], command=command[mine], axis=axis))
        except InputError as error:
            raise InputError(f"reflector {name}: {error}") from None
        direction, reference = circles[0].normal, circles[0].reference
        offset = points[mine] - circles[0].centre
        angle = np.arctan2(offset @ np.cross(direction, reference), offset @ reference)
        phases.append(np.angle(np.exp(1j * (angle - command[mine])).mean()))
        with_command, against = (1.0 - np.abs(np.exp(1j * (angle - sign * command[mine])).mean())
                                 for sign in (1.0, -1.0))
        if against < 0.01 * with_command:
            raise InputError(f"reflector {name} turns left-handed about the given axis direction while the command "
                             "grows; reverse the axis direction, or the sign of the commanded angles")
    centre, direction = circles[0].centre, circles[0].normal
    return {"centre": centre, "axis": direction, "reference": circles[0].reference, "phase": np.array(phases),
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
    Raises InputError where the readings of a reflector make no circle or turn the other way about the axis.
    """
    command, readings = np.asarray(command, float), np.asarray(readings, float)
    n = len(command)
    names = np.full(n, "1") if reflectors is None else np.asarray(reflectors).astype(str)
    keys = list(dict.fromkeys(names.tolist()))
    item = np.array([keys.index(name) for name in names])
    begin = start(command, laser_tracker.cartesian_readings(readings), names, axis)
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
    blocks = np.unique(seen.covariates["block"])[1:].tolist() if "block" in given else []
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
    covariates = recorded(job, table)
    if table.has("split"):
        covariates["split"] = table.text("split")
    stops = consecutive_stops(command, covariates.get("direction")) if positioning else None
    return declare(command, readings, measured_points.stated_polar(instrument, readings),
                   table.text("smr") if table.has("smr") else None, axis, stops, covariates, table.row_numbers)


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
    c = seen.covariates
    points = {"command_deg": c["command"], "smr": c["reflector"], "time_min": c["time"], "direction": c["direction"],
              "temp_C": kelvin_from_celsius(20.0 + c["temperature_difference"]), "block": c["block"],
              **dict(zip(("range_mm", "azimuth_deg", "zenith_deg"), seen.recorded.T, strict=True))}
    return {
        "job.toml": 'problem = "problems.turntable"\n\n[data.points]\nfile = "points.csv"\ninstrument = "tracker"\n\n'
                    '[instruments.tracker]\nkind = "laser_tracker"\nsigma_range_um = 4.0\nsigma_azimuth_arcsec = 1.0\n'
                    'sigma_zenith_arcsec = 1.0\n\n[options]\npositioning = true\naxis_direction = [0.0, 0.0, 1.0]\n\n'
                    '[report]\nquantities = ["deviation"]\n',
        "points.csv": written(f"simulated, seed {seed}", points)}


# --- the published comparison ------------------------------------------------------------------------------------

published = "turntable"


def reproduce() -> Reproduction:
    """Every printed number of the paper beside what its own tables give: see `problems.turntable.comparison`."""
    from problems.turntable import comparison

    return comparison.reproduce()


def scene(job: Job, estimate: Estimate) -> Scene:
    """The reflectors as seen from the tracker, the centre with its uncertainty, and the axis."""
    seen = laser_tracker.cartesian_readings(estimate.problem.observations[0].recorded)
    return Scene((*follows(estimate.fit).shapes, Points("reflectors as measured", seen),
                  Points("tracker", np.zeros((1, 3)), ("tracker",)), Sights("tracker", np.zeros(3), seen)))
