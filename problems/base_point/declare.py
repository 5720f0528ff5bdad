"""The physics of a tracking interferometer at an unknown base point, and its declaration from readings along lines.

Source: Chen, Li, Zhang, Zhao, J. Astronautic Metrology and Measurement 27(2), 2007, 9-13 ("the paper").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from casadi import sqrt
from numpy.typing import ArrayLike, NDArray

from calib import (
    Constraint,
    Effect,
    Gaussian,
    Observations,
    Problem,
    Quantity,
    Shared,
    Unknown,
    direct,
    hands_slots_to,
)
from calib.errors import InputError
from calib.geometry import dot, norm
from calib.units import nm, um
from calib.unknown import Selection
from instruments import coordinate_machine, influence, interferometer
from problems.base_point import algebraic
from problems.base_point.lines import Array, Lines

LENGTHENING, SHORTENING = 1.0, -1.0                    # the counting sense: what makes the reading grow
COUNTS = {"lengthening": LENGTHENING, "shortening": SHORTENING}


# --- the physics -------------------------------------------------------------------------------------------------


@hands_slots_to(coordinate_machine.position, interferometer.tracking)
def tracked(base_point: Any, start_length: Any, position: Any, guide: Any, along: Any, velocity: Any, sense: Any, *,
            machine_point: Any = direct, **slots: Any) -> Any:
    """Reading [m] of a tracking interferometer on a reflector at a position [m] of a line.

    base_point: (3,); start_length: path at the zero of the reading; guide: the point (3,) of the line at position zero;
    along: unit direction (3,) of the line; velocity: (3,) [m/s] of the reflector, which late triggering asks for.
    sense: +1 or -1. Source: the paper, equation 6.
    """
    target = coordinate_machine.position(guide + along * position, machine_point=machine_point)
    return interferometer.tracking_in_motion(target, velocity, base_point, start_length, sense, **slots)


def one_line(start_length: Any, cos_angle: Any, travel: Any, sense: Any, *, displacement: Any = direct) -> Any:
    """Reading [m] after a travel b [m] along one line from the zero: the cosine theorem.

    cos_angle: cosine of the angle between the beam from the base point to the zero and the direction of travel.
    Source: the paper, equation 1.
    """
    path = sqrt(start_length**2 + travel**2 + 2 * start_length * travel * cos_angle)
    return displacement(sense * (path - start_length))


def coordinate(position: Any) -> Any:
    """What the fixed interferometer along a line reads: the position [m] of the reflector."""
    return position


def excess_at_zero(base_point: Any, start_length: Any, zero_point: Any) -> Any:
    """How much longer [m] the path to the zero point (3,) is than the path at the zero of the reading."""
    return norm(zero_point - base_point) - start_length


def reading_at(base_point: Any, start_length: Any, zero_point: Any, sense: Any) -> Any:
    """Reading [m] that the tracker would show with the reflector at a point (3,)."""
    return sense * excess_at_zero(base_point, start_length, zero_point)


def difference_of_squares(base_point: Any, start_length: Any, bracket: Any, target: Any, change: Any) -> Any:
    """|P|^2 - d^2 [m^2] for a path that changed by d since its zero: affine in B, L0 and the bracket |B|^2 - L0^2."""
    return 2 * dot(target, base_point) + 2 * start_length * change - bracket


def beside_the_line(start_length: Any, cos_angle: Any) -> Any:
    """The base point from equation 1: its foot on the line, counted from the zero, and its distance off it (2,) [m]."""
    return [-start_length * cos_angle, start_length * sqrt(1 - cos_angle**2)]


# --- the choices of an evaluation -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class FreeStart:
    """The path at the zero of each reading is unknown.

    zero_point: (3,) [m] where the reading should have been zero; the quantity `start_reading` is what it is there.
    """

    zero_point: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class TiedStart:
    """The trackers were zeroed with the reflector at a known point (3,) [m]: L0 = |zero_point - B|, as in the paper."""

    zero_point: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class AbsoluteRange:
    """The readings are whole lengths: L0 = 0."""


@dataclass(frozen=True)
class ExactCoordinates:
    """The recorded coordinates are taken as exact, as in the paper."""


@dataclass(frozen=True)
class ProjectedCoordinates:
    """The u of a coordinate along its line, projected on the line of sight, is added to the u of the tracker."""


@dataclass(frozen=True)
class AdjustedCoordinates:
    """A coordinate along its line is a reading of its own, with its own u: errors in variables."""


Zero = FreeStart | TiedStart | AbsoluteRange
Coordinates = ExactCoordinates | ProjectedCoordinates | AdjustedCoordinates
COORDINATES: dict[str, Coordinates] = {"exact": ExactCoordinates(), "projected": ProjectedCoordinates(),
                                       "adjusted": AdjustedCoordinates()}


# --- the declaration ------------------------------------------------------------------------------------------------


def declare(lines: Lines, zero: Zero = FreeStart(), coordinates: Coordinates = ExactCoordinates(),
            sense: float = LENGTHENING, begin: ArrayLike | None = None) -> Problem:
    """Base points of trackers from readings along lines.

    lines: what was read; zero: what is known of it; coordinates: how those along the lines enter.
    sense: LENGTHENING or SHORTENING; begin: (3,) or (trackers, 3) [m] start values of the base points, which also pick
    the branch where there is a mirror image; the algebraic start where None.
    Raises InputError where the targets stand at one point or the readings contradict the sense.
    """
    trackers, tracker = np.unique(lines.tracker, return_inverse=True)
    names = np.char.strip(np.char.add(np.char.add(lines.tracker.astype(str), " "), lines.zeroing.astype(str)))
    zeroings, zeroing = np.unique(names, return_inverse=True)
    base, lengths = start(lines, tracker, zeroing, sense, begin, isinstance(zero, AbsoluteRange))
    several, of_zeroing = len(trackers) > 1, np.array([tracker[zeroing == k][0] for k in range(len(zeroings))])
    if isinstance(zero, TiedStart):
        lengths = np.linalg.norm(np.array(zero.zero_point) - base[of_zeroing], axis=1)
    base_point = Unknown("base_point", base if several else base[0], "mm", ("x", "y", "z"),
                         trackers.tolist() if several else None)
    start_length = Unknown("start_length", lengths[:, None] if len(zeroings) > 1 else lengths[0], "mm",
                           keys=zeroings.tolist() if len(zeroings) > 1 else None)

    read = np.einsum("ni,ni->n", lines.along, lines.points)
    guide = lines.points - lines.along * read[:, None]
    observations, adjusted, seat = [], None, np.arange(len(read))
    if isinstance(coordinates, AdjustedCoordinates):
        seatings, first, seat = np.unique(lines.seating, return_index=True, return_inverse=True)
        adjusted = Unknown("position", read[first][:, None], "mm", keys=seatings.tolist())
        observations.append(Observations(coordinate, adjusted.each, readings=read[first], u=lines.u_coordinate[first],
                                         group="coordinates", unit="mm", rows=lines.rows[first]))
    for k, name in enumerate(zeroings):
        i = np.flatnonzero(zeroing == k)
        observations.append(Observations(
            tracked, base_point[tracker[i]], start_length[k], read[i] if adjusted is None else adjusted[seat[i]],
            guide[i], lines.along[i], lines.velocity[i], np.full(len(i), sense), u=_uncertainty(lines, coordinates, i),
            readings=None if lines.readings is None else lines.readings[i], group=str(name), unit="mm",
            rows=lines.rows[i], covariates=lines.covariates_of(i)))
    constraints, quantities = _at_zero(zero, base_point[of_zeroing], start_length, sense)
    held = [start_length] if isinstance(zero, AbsoluteRange) else []
    return Problem(observations, constraints, quantities, held=held, name="base point")


def _at_zero(zero: Zero, base: Selection, start_length: Unknown,
             sense: float) -> tuple[list[Constraint], list[Quantity]]:
    """The condition that a zero point sets, and `dead_path` and `start_reading` of each zeroing."""
    keys = start_length.keys if start_length.named_keys else None
    quantities = [Quantity("dead_path", coordinate, start_length.each, unit="mm", keys=keys)]
    if isinstance(zero, TiedStart):
        return [Constraint("zeroed at the zero point", excess_at_zero, base, start_length.each, Shared(zero.zero_point),
                           tolerance=1e-3 * nm, unit="um")], quantities
    if isinstance(zero, FreeStart) and zero.zero_point is not None:
        quantities.append(Quantity("start_reading", reading_at, base, start_length.each, Shared(zero.zero_point),
                                   Shared(sense), unit="um", keys=keys))
    return [], quantities


def _uncertainty(lines: Lines, coordinates: Coordinates, rows: NDArray) -> Any:
    """Standard uncertainty of the readings (n,) in some rows, with that of the coordinates where it is projected."""
    u, u_coordinate = lines.u[rows], lines.u_coordinate[rows]
    if not isinstance(coordinates, ProjectedCoordinates):
        return u

    def projected(base_point: Array, position: Array, guide: Array, along: Array) -> Array:
        sight = guide + along * position - base_point
        slope = np.sum(sight * along, axis=1) / np.linalg.norm(sight, axis=1)
        return np.hypot(u, slope * u_coordinate)[:, None]
    return Gaussian.depending(projected)


def start(lines: Lines, tracker: NDArray, zeroing: NDArray, sense: float, begin: ArrayLike | None = None,
          absolute: bool = False) -> tuple[Array, Array]:
    """Start values: base points (trackers, 3) and start lengths (zeroings,) [m].

    lines: what was read; tracker, zeroing: (n,) numbers from 0; sense: +1 or -1; begin: base points if known;
    absolute: the readings are whole lengths. Raises InputError where the readings contradict the sense.
    """
    bases, lengths = np.zeros((tracker.max() + 1, 3)), np.zeros(zeroing.max() + 1)
    known = None if begin is None else np.broadcast_to(begin, bases.shape)
    if lines.readings is None:
        if known is None:
            raise InputError("a plan without readings needs approximate base points (begin); state them")
        target = np.linalg.norm(lines.points - known[tracker], axis=1)
        return np.array(known), np.array([0.0 if absolute else target[zeroing == k][0] for k in range(len(lengths))])
    for t in range(len(bases)):
        i = np.flatnonzero(tracker == t)
        own, number = np.unique(zeroing[i], return_inverse=True)
        found = algebraic.begin(lines.points[i], lines.readings[i], number, sense, absolute=absolute,
                                           approximate=None if known is None else known[t],
                                           name=str(lines.tracker[i][0]))
        bases[t], lengths[own] = found.base_point, found.lengths
    return bases, lengths


def declare_one_line(travel: ArrayLike, readings: ArrayLike | None, u: ArrayLike, sense: float = LENGTHENING,
                     begin: ArrayLike = (1.0, 0.5)) -> Problem:
    """One line by equation 1: path at the zero and angle there; quantity `beside` is the base point as (foot, off) [m].

    travel: (n,) [m] from the zero, where both instruments read zero; readings: (n,) [m] or None; u: [m].
    sense: +1 or -1; begin: approximate (foot, off) [m]. In which direction it lies off the line is not seen.
    """
    foot, off = np.asarray(begin, float)
    start_length = Unknown("start_length", np.hypot(foot, off), "mm", lower=0.0)
    cos_angle = Unknown("cos_angle", -foot / np.hypot(foot, off), lower=-1.0, upper=1.0)
    read = Observations(one_line, start_length, cos_angle, np.asarray(travel, float), Shared(sense), readings=readings,
                        u=u, group="tracker", unit="mm")
    return Problem([read], quantities=[Quantity("beside", beside_the_line, start_length, cos_angle, unit="mm",
                                                parts=("foot", "off"))], name="base point beside one line")


def linear(lines: Lines, sense: float, about: Problem) -> Problem:
    """The difference of squares of one tracker since one zeroing; about: the declared problem, for the weights."""
    change = sense * lines.readings
    path = np.linalg.norm(lines.points - about.select("base_point").unknown.ambient[0], axis=1)
    base_point = Unknown("base_point", [0.0, 0.0, 0.0], "mm", ("x", "y", "z"))
    start_length, bracket = Unknown("start_length", 0.0, "mm"), Unknown("bracket", 0.0, "mm^2")
    squares = Observations(difference_of_squares, base_point, start_length, bracket, lines.points, change, unit="mm^2",
                           readings=np.sum(lines.points**2, axis=1) - change**2, u=2 * path * lines.u, group="squares",
                           rows=lines.rows)
    flat = [axis for axis, extent in zip(base_point.parts, np.ptp(lines.points, axis=0), strict=True) if extent == 0.0]
    return Problem([squares], quantities=[Quantity("dead_path", coordinate, start_length, unit="mm")],
                   held=[base_point.part(*flat)] if flat else [], name="base point by differences of squares")


# --- effects ----------------------------------------------------------------------------------------------------


def effects(blocks: Sequence[int] = (), middle: ArrayLike = (0.0, 0.0, 0.0), half_range: ArrayLike = (0.5, 0.5, 0.5),
            wavelength: float = interferometer.HELIUM_NEON) -> tuple[Effect, ...]:
    """Effects of the guides that move the reflector and of the tracking interferometer. blocks: at whose beginning the
    reading may have jumped; middle, half_range: (3,) [m] of the travel; wavelength: [m] of the interferometer."""
    guides = (e for e in coordinate_machine.guide_effects(middle=middle, half_range=half_range)
              if e.name != "zero_offset")  # a shift of all points is one of the base point
    tracker = (e for e in (*interferometer.effects(blocks, wavelength), *interferometer.tracking_effects())
               if e.name in ("scale", "cyclic", "drift", "thermal", "step", "time_sync") and e.channel.startswith("d"))
    return (*guides, *coordinate_machine.cosine_effects(), *tracker)


def with_recorded_effects(problem: Problem, lines: Lines, middle: ArrayLike, half_range: ArrayLike,
                          wavelength: float = interferometer.HELIUM_NEON) -> Problem:
    """The problem with every effect whose inputs were recorded, and where the start is not free its offset, held."""
    blocks = np.unique(lines.covariates["block"])[1:].tolist() if "block" in lines.covariates else []
    offered = [*effects(blocks, middle, half_range, wavelength)]
    if problem.constraints or problem.is_held(problem.select("start_length").unknown).all():
        offered.append(influence.offset("start_offset", "displacement", "o", "um", (0.2 * um, 100 * um), channel="d",
                                        source=interferometer.TRACKING))
    return problem.with_effects(*problem.acting(offered))
