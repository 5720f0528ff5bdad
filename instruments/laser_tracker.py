"""Laser tracker: range, azimuth and zenith angle of a reflector in the frame of the tracker.

Frame: z along the standing axis, x toward azimuth zero, right-handed. Azimuth about z from x toward y, zenith angle
from z: x = r sin(ze) cos(az), y = r sin(ze) sin(az), z = r cos(ze). `face` is +1 in front sight and -1 in back sight;
readings of both are taken as the controller reports them, converted to front sight, so a face-dependent error enters
with the sign of the face.

Reported Cartesian coordinates are the exact transform of the polar readings; `polar_readings` turns them back, and
`cartesian_covariance` is their covariance where they have to be used as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from casadi import DM, SX, Function, atan2, cos, jacobian, sin, sqrt, tan, vertcat
from numpy.typing import ArrayLike

from calib import Effect, Gaussian, Observations, Parameter, Pose, Problem, Unknown, direct, hands_slots_to, simulate
from calib.errors import InputError
from calib.units import arcsec, hour, minute, ppm, um

from . import air, influence, stated

GEOMETRY = ("Muralikrishnan et al., J. Res. NIST 114 (2009) 21-35, performance evaluation tests and geometric "
            "misalignments in laser trackers; Loser and Kyle, Boeing Large Scale Optical Metrology Seminar 1999")
FIELD = "ISO 10360-10:2016, laser trackers: acceptance and reverification tests; magnitudes: bench experience"
BENDING = "Bomford, Geodesy, 4th ed., Clarendon Press 1980: curvature of a line of sight by a vertical gradient"
PERIOD = (None, 2 * np.pi, None)


def polar_in_face(point: Any, face: Any, *, tracker_point: Any = direct, range: Any = direct, azimuth: Any = direct,
                  zenith: Any = direct) -> tuple[Any, Any, Any]:
    """Polar readings of a reflector, in front or back sight.

    point: (3,) of the reflector in the frame of the tracker [m]; face: +1 front, -1 back sight. Slots:
    `tracker_point` ((3,)), `range`, `azimuth`, `zenith`; effects there may ask for distance [m], azimuth_angle,
    zenith_angle [rad] and face.
    Returns range [m], azimuth in (-pi, pi] and zenith angle [rad]; the period of the azimuth belongs to the
    observations (`PERIOD`).
    """
    seen = tracker_point(point, face=face)
    level_distance = sqrt(seen[0] ** 2 + seen[1] ** 2)
    asked = {"distance": sqrt(level_distance ** 2 + seen[2] ** 2), "azimuth_angle": atan2(seen[1], seen[0]),
             "zenith_angle": atan2(level_distance, seen[2]), "face": face}
    return (range(asked["distance"], **asked), azimuth(asked["azimuth_angle"], **asked),
            zenith(asked["zenith_angle"], **asked))


@hands_slots_to(polar_in_face)
def polar(point: Any, **slots: Any) -> tuple[Any, Any, Any]:
    """Polar readings of a reflector in front sight: `polar_in_face` with face +1.

    point: (3,) in the frame of the tracker [m]. Returns range [m], azimuth, zenith angle [rad].
    """
    return polar_in_face(point, 1, **slots)


@hands_slots_to(polar_in_face)
def polar_from_station(tracker_from_world: Any, point: Any, **slots: Any) -> tuple[Any, Any, Any]:
    """Polar readings of a reflector given in a world frame.

    tracker_from_world: Transform of the station; point: (3,) in the world frame [m]. Returns range [m], azimuth,
    zenith angle [rad].
    """
    return polar_in_face(tracker_from_world @ point, 1, **slots)


def cartesian(range: Any, azimuth: Any, zenith: Any) -> tuple[Any, Any, Any]:
    """Cartesian coordinates that a controller reports for polar readings.

    range [m], azimuth, zenith angle [rad]. Returns x, y, z [m].
    """
    return range * sin(zenith) * cos(azimuth), range * sin(zenith) * sin(azimuth), range * cos(zenith)


def polar_readings(coordinates: ArrayLike) -> np.ndarray:
    """Polar readings behind reported Cartesian coordinates.

    coordinates: (n, 3) or (3,) in the frame of the tracker [m]. Returns the same shape: range [m], azimuth in (-pi,
    pi], zenith angle [rad].
    Raises InputError for a point on the standing axis, where the azimuth does not exist.
    """
    columns = _three_columns(coordinates, "Cartesian coordinates")
    if np.any((columns[0] == 0.0) & (columns[1] == 0.0)):
        raise InputError("A point lies on the standing axis of the tracker (x = y = 0): its azimuth does not exist. "
                         "Are the coordinates in the frame of the tracker?")
    return _stacked(polar([DM(c) for c in columns]), coordinates)


def cartesian_readings(readings: ArrayLike) -> np.ndarray:
    """Cartesian coordinates of polar readings.

    readings: (n, 3) or (3,) range [m], azimuth, zenith angle [rad]. Returns the same shape: x, y, z [m].
    """
    return _stacked(cartesian(*[DM(c) for c in _three_columns(readings, "polar readings")]), readings)


def cartesian_covariance(readings: ArrayLike, u: ArrayLike) -> np.ndarray:
    """Covariance of Cartesian coordinates from the standard uncertainties of the polar readings, to first order.

    readings: (n, 3) range [m], azimuth, zenith angle [rad]; u: (3,) or (n, 3) standard uncertainties of these,
    independent.
    Returns (n, 3, 3) [m^2]: T diag(u^2) T', T the derivative of `cartesian`. Source: JCGM 102:2011, 6.2.
    """
    polar_symbols = SX.sym("polar", 3)
    derivative = jacobian(vertcat(*cartesian(polar_symbols[0], polar_symbols[1], polar_symbols[2])), polar_symbols)
    columns = np.stack(_three_columns(readings, "polar readings"))
    count = columns.shape[1]
    stacked = np.asarray(Function("derivative", [polar_symbols], [derivative]).map(count)(columns))
    derivatives = stacked.reshape(3, count, 3).transpose(1, 0, 2)
    rows = derivatives * np.broadcast_to(np.asarray(u, float), (count, 3))[:, None, :]
    return rows @ rows.transpose(0, 2, 1)


def _three_columns(values: ArrayLike, what: str) -> list[np.ndarray]:
    values = np.atleast_2d(np.asarray(values, dtype=float))
    if values.ndim != 2 or values.shape[1] != 3:
        raise InputError(f"The {what} must be (n, 3); they are {values.shape}.")
    return list(values.T)


def _stacked(columns: Sequence[Any], like: ArrayLike) -> np.ndarray:
    return np.column_stack([np.asarray(column).ravel() for column in columns]).reshape(np.shape(like))


@dataclass(frozen=True)
class PolarStatement:
    """Standard uncertainties of range and of the two transverse coordinates, each of the form fixed + rate distance.

    range_fixed [m], range_rate [1]: along the beam; transverse_fixed [m], transverse_rate [1]: across the beam, in
    each direction; all standard uncertainties.
    """

    range_fixed: float
    range_rate: float
    transverse_fixed: float
    transverse_rate: float

    def at(self, readings: ArrayLike) -> np.ndarray:
        """Standard uncertainties at polar readings.

        readings: (n, 3) range [m], azimuth, zenith angle [rad]. Returns (n, 3): of range [m], of azimuth,
        transverse/(range sin zenith), and of zenith angle, transverse/range [rad].
        """
        distance, _, zenith = _three_columns(readings, "polar readings")
        transverse = (self.transverse_fixed + self.transverse_rate * distance) / distance
        return np.column_stack([self.range_fixed + self.range_rate * distance, transverse / np.abs(np.sin(zenith)),
                                transverse])

    def gaussian(self) -> Gaussian:
        """These uncertainties as a function of the readings of `polar`, for the `u` of Observations."""
        return Gaussian.depending(lambda reading: self.at(reading))


def from_coordinate_statement(fixed: float, rate: float, coverage_factor: float = 2.0) -> PolarStatement:
    """A statement U = a + b L for each coordinate of a point at distance L, as range and angle uncertainties.

    fixed: a [m]; rate: b [m/m]; coverage_factor: k of the statement. Assumption: U holds for any coordinate,
    whichever way the axes point, so the error is isotropic, with u = (a + b L)/k along the beam and in both directions
    across it:

        u(range) = u,    u(zenith) = u/L,    u(azimuth) = u/(L sin zenith).

    Errors of different points are taken as independent, which is pessimistic for the range differences of an
    interferometer.
    Returns the statement. Source: the form U = (15 um + 6 um/m L), k = 2, in Li, Cao, Qu (2020), Metrology &
    Measurement Technology 40(2), section 3; JCGM 100:2008, 6.2.1.
    """
    a, b = (float(stated.from_expanded(value, coverage_factor)) for value in (fixed, rate))
    return PolarStatement(a, b, a, b)


def from_point_statement(fixed: float, rate: float, coverage_factor: float = 2.0) -> PolarStatement:
    """A statement U = a + b L for the length of the error vector of a point, as range and angle uncertainties.

    Arguments and return as for `from_coordinate_statement`. Assumption: isotropic, and U/k is the root mean square of
    the error vector, so each coordinate has 1/sqrt(3) of it.
    """
    return from_coordinate_statement(fixed, rate, coverage_factor * np.sqrt(3.0))


def from_separate_statements(range_statement: tuple[float, float], transverse_statement: tuple[float, float],
                             coverage_factor: float = 2.0) -> PolarStatement:
    """Separate statements a + b L for the range and for the transverse error, as range and angle uncertainties.

    range_statement, transverse_statement: (a [m], b [m/m]); coverage_factor: k of both. Assumption: the transverse
    statement holds for each of the two directions across the beam. Returns the statement.
    """
    values = [float(stated.from_expanded(value, coverage_factor))
              for value in (*range_statement, *transverse_statement)]
    return PolarStatement(*values)


def _horizontal_direction(point: Any) -> Any:
    return vertcat(point[0], point[1], 0) / sqrt(point[0] ** 2 + point[1] ** 2)


def effects(blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """The effects of a laser tracker: those of its readings and those of its base.

    blocks: blocks at which a step may have happened. Returns `reading_effects(blocks)` and `base_effects(blocks)`.
    """
    return (*reading_effects(blocks), *base_effects(blocks))


def reading_effects(blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """Effects on range, azimuth and zenith angle.

    blocks: blocks at which a step may have happened. Returns range offset, scale, air temperature error, air
    gradient, transit tilt, beam offsets, vertical index, encoder eccentricities and second harmonics, and drift,
    thermal, steps of each reading.
    """
    def each(function: Any, angle: tuple[float, float], length: tuple[float, float], *further: Any) -> list[Any]:
        return [function(slot, unit, plausible, *further, source=FIELD)
                for slot, unit, plausible in (("range", "um", length), ("azimuth", "arcsec", angle),
                                              ("zenith", "arcsec", angle))]

    angle, beam = (0.2 * arcsec, 20 * arcsec), (1 * um, 100 * um)
    return (
        influence.offset("range_offset", "range", "d", "um", (1 * um, 100 * um), source=GEOMETRY),
        influence.gain("scale", "range", "ppm", (0.1 * ppm, 20 * ppm), source=FIELD),
        Effect("air_temperature", "range", lambda value, p: -p.error * air.PER_KELVIN * value,
               (Parameter("error", "K", (0.1, 5.0)),), "range", source=air.SOURCE),
        Effect("air_gradient", "zenith",
               lambda value, p, distance, zenith_angle:
               0.5 * p.gradient * air.PER_KELVIN * distance * sin(zenith_angle),
               (Parameter("gradient", "K/m", (0.05, 3.0)),), "zenith", source=BENDING),
        Effect("transit_tilt", "azimuth", lambda value, p, zenith_angle, face: p.t * face / tan(zenith_angle),
               (Parameter("t", "arcsec", angle),), source=GEOMETRY),
        Effect("beam_tilt", "azimuth", lambda value, p, zenith_angle, face: p.c * face / sin(zenith_angle),
               (Parameter("c", "arcsec", angle),), source=GEOMETRY),
        Effect("beam_offset", "azimuth",
               lambda value, p, distance, zenith_angle, face: p.o * face / (distance * sin(zenith_angle)),
               (Parameter("o", "um", beam),), source=GEOMETRY),
        Effect("beam_offset", "zenith", lambda value, p, distance, face: p.o * face / distance,
               (Parameter("o", "um", beam),), source=GEOMETRY),
        Effect("transit_offset", "tracker_point", lambda value, p, face: p.o * face * _horizontal_direction(value),
               (Parameter("o", "um", beam),), source=GEOMETRY),
        Effect("vertical_index", "zenith", lambda value, p, face: p.i * face, (Parameter("i", "arcsec", angle),),
               source=GEOMETRY),
        *(influence.harmonic(name, slot, order, "arcsec", (0.1 * arcsec, 10 * arcsec), source=GEOMETRY)
          for name, order in (("encoder_ecc", 1), ("encoder_2nd", 2)) for slot in ("azimuth", "zenith")),
        *each(influence.drift, (0.1 * arcsec / hour, 20 * arcsec / hour), (0.5 * um / hour, 100 * um / hour)),
        *each(influence.thermal, (0.05 * arcsec, 5 * arcsec), (0.2 * um, 20 * um)),
        *(step for steps in each(influence.steps, (0.2 * arcsec, 30 * arcsec), (1 * um, 200 * um), blocks)
          for step in steps),
    )


def base_effects(blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """Effects of a moving base, on the coordinates of the reflector in the frame of the tracker.

    blocks: blocks at which the base may have jumped. Returns drift and steps of channels tracker_x, tracker_y,
    tracker_z.
    """
    axes = (("tracker_x", (1, 0, 0)), ("tracker_y", (0, 1, 0)), ("tracker_z", (0, 0, 1)))
    return (
        *(influence.drift("tracker_point", "um", (1 * um / hour, 200 * um / hour), channel=channel, along=axis,
                          source=FIELD)
          for channel, axis in axes),
        *(step for channel, axis in axes
          for step in influence.steps("tracker_point", "um", (2 * um, 500 * um), blocks, channel=channel, along=axis,
                                      source=FIELD)),
    )


def example(seed: int) -> Problem:
    """Nine reflectors and two calibrated distances, seen in both sights and from a second station; simulated readings.

    The frame of the first station is the datum. seed: of the simulated noise. Returns the problem with every effect
    of this module as a held candidate; those of the base belong to the first station.
    """
    grid = np.array([[x, y, z] for x in (1.5, 3.0, 4.0) for y, z in ((-1.5, -0.8), (0.2, 0.9), (1.8, -0.3))])
    points = Unknown("point", grid, "m", parts=("x", "y", "z"))
    c, s = np.cos(2.2), np.sin(2.2)
    second = Pose("second_station", rotation=np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]),
                  translation=np.array([4.5, 4.0, 0.3]))
    count = len(grid)

    def sight(model: Any, *arguments: Any, group: str, start: int, blocks: ArrayLike) -> Observations:
        time = np.arange(start, start + count) * minute
        return Observations(model, *arguments, u=from_separate_statements((1 * um, 0.5e-6), (15 * um, 6e-6)).gaussian(),
                            group=group, components=("range", "azimuth", "zenith"), unit=("um", "arcsec", "arcsec"),
                            period=PERIOD, covariates={
                                "time": (time, "s"), "temperature_difference": (0.5 * np.sin(3 * time / hour), "K"),
                                "block": np.broadcast_to(blocks, (count,))})

    observations = [
        sight(polar, points.each, group="front sight", start=0, blocks=[1, 1, 1, 1, 2, 2, 2, 2, 2]),
        sight(polar_in_face, points.each, -np.ones(count), group="back sight", start=count, blocks=2),
        sight(polar_from_station, second, points.each, group="second station", start=2 * count, blocks=3),
        Observations(_distance, points[[0, 2]], points[[8, 6]], u=3 * um, group="calibrated distances", unit="um"),
    ]
    first_station = [replace(effect, groups=("front sight", "back sight")) for effect in base_effects(blocks=(2,))]
    problem = Problem(observations, effects=(*reading_effects(blocks=(2,)), *first_station),
                      name="laser tracker on nine reflectors")
    return simulate(problem, {}, seed)


def _distance(a: Any, b: Any) -> Any:
    return sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)
