"""Coordinates from the readings of several tracking interferometers, calibrated on known targets or by themselves.

Each tracker has a base point B and a length L0 at the zero of its reading; each target has three coordinates:
reading = sense (|P - B| - L0). With targets of known position (points of lines) the trackers are calibrated; with four
trackers and enough unknown targets they calibrate themselves. What is then known of the trackers, with its full
covariance, goes into every coordinate that they measure.
Source: Chen, Li, Zhang, Zhao, J. Astronautic Metrology and Measurement 27(2), 2007, figure 1 and equation 6; number and
singular arrangements of self-calibration: Takatsuji et al., Measurement Science and Technology 9 (1998) 38-41.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import (
    Effect,
    Gaussian,
    Linearisation,
    Observations,
    Problem,
    Quantity,
    Unknown,
    covariance,
    hands_slots_to,
    linearise,
    prior,
    simulate,
)
from calib.errors import InputError
from calib.geometry import norm
from calib.job import Job
from calib.table import Table, written, xyz_mm
from calib.units import mm, um
from calib.unknown import Selection
from instruments import interferometer
from problems.base_point import COUNTS, LENGTHENING, algebraic
from problems.base_point.lines import coordinates
from problems.recorded import recorded

Array = NDArray[np.float64]
PARTS = ("x", "y", "z", "start")
accepts = ("multilateration",)


# --- the physics -------------------------------------------------------------------------------------------------


@hands_slots_to(interferometer.tracking)
def ranged(tracker: Any, target: Any, sense: Any, **slots: Any) -> Any:
    """Reading [m] of a tracker on a target (3,); tracker: base point and length at the zero of the reading (4,) [m]."""
    return interferometer.tracking(target, tracker[:3], tracker[3], sense, **slots)


@hands_slots_to(interferometer.tracking)
def ranged_by_one(trackers: Any, which: Any, target: Any, sense: Any, **slots: Any) -> Any:
    """The same with all k trackers in one vector (4k,), of which `which` (k,) is one for the tracker that reads."""
    return ranged(ca.reshape(trackers, 4, which.shape[0]) @ which, target, sense, **slots)


def between(first: Any, second: Any) -> Any:
    """Distance [m] of two targets (3,)."""
    return norm(second - first)


# --- what is read and known -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Ranges:
    """Readings of trackers on targets: n rows, SI.

    tracker, target: (n,) keys; readings: (n,), or None to plan; u: (n,) or number; covariates: {name: (n,)}.
    rows: (n,) row numbers of the file.
    """

    tracker: NDArray
    target: NDArray
    readings: Array | None
    u: ArrayLike
    covariates: Mapping[str, Any] = field(default_factory=dict)
    rows: NDArray | None = None

    @staticmethod
    def every(trackers: Sequence[str], targets: Sequence[str], u: float) -> Ranges:
        """A plan in which every tracker reads every target."""
        return Ranges(np.tile(trackers, len(targets)), np.repeat(targets, len(trackers)), None, u)


    def indices(self) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Keys of the trackers and, for each row, which one reads; keys of the targets and, for each row, which one."""
        return (*np.unique(self.tracker, return_inverse=True), *np.unique(self.target, return_inverse=True))


@dataclass(frozen=True, eq=False)
class Calibration:
    """Knowledge of k trackers: keys, values (k, 4) of base point and start length [m], covariance (4k, 4k) [m^2]."""

    keys: tuple[str, ...]
    values: Array
    covariance: Array

    @staticmethod
    def of(fit: Linearisation) -> Calibration:
        """The trackers of a linearised `declare`, with everything that is uncertain about them."""
        tracker = next(u for u in fit.layout.unknowns if u.name == "tracker")
        known = covariance(fit, tracker)
        return Calibration(tracker.keys, known.values.reshape(-1, 4), known.matrix)


# --- the declaration ------------------------------------------------------------------------------------------------


def declare(ranges: Ranges, trackers: Mapping[str, ArrayLike], targets: Mapping[str, ArrayLike],
            known: Collection[str] = (), u_known: float | None = None, sense: float = LENGTHENING) -> Problem:
    """Trackers and targets in one problem; unknowns `tracker` (base point and start length) and `target`.

    ranges: what was read; trackers: {key: (3,)} approximate base points [m]; targets: {key: (3,)} positions [m],
    approximate, or known for the keys in `known`: exactly, or with u_known [m] in each coordinate.
    sense: +1 where readings grow with the path, -1 else. Without known targets the frame is that of the trackers: six
    of their coordinates are held at their approximate values (see `frame_of`).
    Raises InputError where a tracker or target of the readings has no position.
    """
    names, of_tracker, points, of_target = ranges.indices()
    base, place = _positions(names, trackers, "tracker"), _positions(points, targets, "target")
    path = np.linalg.norm(place[of_target] - base[of_tracker], axis=1)
    first = np.array([np.flatnonzero(of_tracker == k)[0] for k in range(len(names))])
    zero = path[first] if ranges.readings is None else np.array(
        [np.mean((path - sense * ranges.readings)[of_tracker == k]) for k in range(len(names))])
    tracker = Unknown("tracker", np.column_stack([base, zero]), "mm", PARTS, names.tolist())
    target = Unknown("target", place, "mm", ("x", "y", "z"), points.tolist())
    read = _read(ranges, sense, ranged, tracker[of_tracker], target[of_target])
    problem = Problem([read], name="multilateration")
    fixed = np.flatnonzero(np.isin(points, list(known)))
    if not len(fixed):
        return problem.hold(*frame_of(tracker))
    if u_known is None:
        return problem.hold(target[fixed])
    return problem.with_observations(prior(target[fixed], place[fixed], u_known, "known targets"))


def _read(ranges: Ranges, sense: float, model: Any, *arguments: Any) -> Observations:
    """The observations of the readings, with the last argument of the model, the sense, added."""
    return Observations(model, *arguments, np.full(len(ranges.tracker), sense), readings=ranges.readings, u=ranges.u,
                        group="ranges", unit="mm", rows=ranges.rows,
                        covariates={"tracker": ranges.tracker, "target": ranges.target, **ranges.covariates})


def _positions(keys: NDArray, positions: Mapping[str, ArrayLike], what: str) -> Array:
    """Positions (m, 3) of named trackers or targets."""
    missing = sorted(set(keys.tolist()) - set(positions))
    if missing:
        raise InputError(f"{what} '{missing[0]}' is read but has no approximate position (there are: "
                         f"{', '.join(positions)}); add its coordinates")
    return np.array([np.asarray(positions[key], float) for key in keys.tolist()])


def frame_of(tracker: Unknown) -> tuple[Selection, ...]:
    """Six coordinates of three trackers that, held, fix the frame: the three of one, two of a second, one of a third.

    Of all choices with the first tracker as origin the one with the longest lever arms.
    Raises InputError for fewer than three trackers or trackers on one line.
    """
    base = tracker.ambient[:, :3] - tracker.ambient[0, :3]
    second, axis = np.unravel_index(np.abs(base).argmax(), base.shape)
    moved = np.abs(np.cross(base[second], base))            # by a turn about the line from the first to the second
    third, part = np.unravel_index(moved.argmax(), moved.shape)
    if moved[third, part] <= 1e-6 * np.abs(base).max() ** 2:
        raise InputError("trackers that calibrate themselves need three base points that are not on one line, to fix "
                         "the frame; set up a third tracker beside the line, or read targets of known position")
    across = [part for k, part in enumerate(PARTS[:3]) if k != axis]
    return (tracker[0].part("x", "y", "z"), tracker[int(second)].part(*across), tracker[int(third)].part(PARTS[part]))


# --- coordinates measured with calibrated trackers -------------------------------------------------------------------


def measure(calibration: Calibration, ranges: Ranges, targets: Mapping[str, ArrayLike],
            sense: float = LENGTHENING) -> Problem:
    """Targets measured by calibrated trackers, which stay as they were calibrated, with their whole covariance.

    calibration: of the trackers; ranges: what was read; targets: {key: (3,)} approximate positions [m]; sense: as for
    `declare`. Quantity `distance` is that of each other target from the first.
    """
    names, of_tracker, points, of_target = ranges.indices()
    place = _positions(points, targets, "target")
    _positions(names, dict(zip(calibration.keys, calibration.values, strict=True)), "tracker")
    trackers = Unknown("trackers", calibration.values.ravel(), "mm",
                       [f"{key}.{part}" for key in calibration.keys for part in PARTS])
    target = Unknown("target", place, "mm", ("x", "y", "z"), points.tolist())
    column = np.array([calibration.keys.index(name) for name in names.tolist()])
    which = np.eye(len(calibration.keys))[column[of_tracker]]
    read = _read(ranges, sense, ranged_by_one, trackers, which, target[of_target])
    uncertain = np.flatnonzero(np.diag(calibration.covariance) > 0.0)
    known = prior(trackers.part(*(trackers.parts[k] for k in uncertain)), calibration.values.ravel()[uncertain],
                  Gaussian.matrix(calibration.covariance[np.ix_(uncertain, uncertain)]), "calibration")
    others = np.arange(1, len(points))
    distance = Quantity("distance", between, target[np.zeros(len(others), int)], target[others], unit="mm",
                        keys=points[others].tolist())
    return Problem([read, known], quantities=[distance] if len(others) else [], held=[trackers],
                   name="measured targets")


@dataclass(frozen=True, eq=False)
class Volume:
    """Standard uncertainties (m, 3) [m] of coordinates at m targets: from the readings, from the trackers, of both."""

    targets: Array
    from_readings: Array
    from_trackers: Array

    @property
    def u(self) -> Array:
        """The combined standard uncertainties (m, 3) [m]."""
        return np.hypot(self.from_readings, self.from_trackers)


def over_volume(calibration: Calibration, targets: Array, u: float) -> Volume:
    """What the uncertainty of the trackers does to coordinates measured over a volume.

    calibration: of the trackers; targets: (m, 3) [m]; u: of each reading [m].
    """
    keys = [f"{k:06d}" for k in range(len(targets))]
    plan = measure(calibration, Ranges.every(calibration.keys, keys, u), dict(zip(keys, targets, strict=True)))
    fit = linearise(plan)
    target = plan.select("target").unknown
    readings = np.diag(covariance(linearise(plan.without("calibration")), target).matrix).reshape(-1, 3)
    both = np.diag(covariance(fit, target).matrix).reshape(-1, 3)
    return Volume(np.asarray(targets, float), np.sqrt(readings), np.sqrt(np.maximum(both - readings, 0.0)))


# --- effects, jobs and an example -------------------------------------------------------------------------------------


def effects(blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """Effects of each tracking interferometer by itself; blocks: at whose beginning its reading may have jumped."""
    return tuple(replace(effect, per="tracker") for effect in interferometer.effects(blocks)
                 if effect.name in ("scale", "drift", "thermal", "step"))


def with_recorded_effects(problem: Problem, covariates: Mapping[str, Any]) -> Problem:
    """The problem with every effect whose inputs were recorded, all held at zero."""
    blocks = np.unique(covariates["block"])[1:].tolist() if "block" in covariates else []
    return problem.with_effects(*(e for e in effects(blocks) if set(e.inputs) <= set(covariates)))


def from_job(job: Job) -> Problem:
    """The problem of a job with the tables `ranges` (tracker, target, d), `trackers` and `targets` (key, x, y, z).

    Positions are approximate, except those of targets whose column `known` is 1: they are exact, or have the u of
    options.u_known. `ranges` may have what `problems.recorded` takes (time, block). Its instrument has kind
    tracking_interferometer, u and counts.
    Raises InputError naming file, line, key or column.
    """
    table, instrument = job.table("ranges"), job.instrument("ranges")
    readings = table.number("d", "length")
    fixed, rate = instrument.uncertainty("u", "length")
    instrument.text("kind", "tracking_interferometer", ("tracking_interferometer",))
    covariates = recorded(job, table)
    ranges = Ranges(table.text("tracker"), table.text("target"), readings, fixed + rate * np.abs(readings), covariates,
                    table.row_numbers)
    trackers, targets = job.table("trackers"), job.table("targets")
    known = targets.text("target")[targets.whole("known") == 1] if targets.has("known") else ()
    problem = declare(ranges, _places(trackers, "tracker"), _places(targets, "target"), known,
                      job.options.quantity("u_known", "length", None),
                      COUNTS[instrument.text("counts", among=tuple(COUNTS))])
    return with_recorded_effects(problem, covariates)


def _places(table: Table, what: str) -> dict[str, Array]:
    """Positions {key: (3,)} of a table."""
    return dict(zip(table.text(what).tolist(), coordinates(table), strict=True))


def remarks(job: Job) -> tuple[str, ...]:
    """What no reading of a job can show, in words; empty where all is seen."""
    targets = job.table("targets")
    if targets.has("known") and targets.whole("known").any():
        return algebraic.unseen(coordinates(targets)[targets.whole("known") == 1])
    return unseen_by(coordinates(job.table("trackers")))


def unseen_by(base: Array) -> tuple[str, ...]:
    """What trackers at base points (k, 3) [m] that calibrate themselves cannot show, in words."""
    mirror = ("Trackers that calibrate themselves see lengths only: the mirror image of all trackers and targets "
              "together gives the same readings. The approximate positions choose the side.",)
    hidden = 6 - len(base)                          # found from the rank of plans with 4 to 8 trackers in one plane
    if algebraic.Span.of(base).rank == 3 or hidden < 1:
        return mirror
    ways = "two independent deformations" if hidden == 2 else "one deformation"
    return (*mirror, f"All {len(base)} base points lie in one plane: {ways} of their figure in that plane, with the "
            "distances of the targets from it following, change no reading. Raise one tracker out of the plane, set up "
            "six, or read targets of known position.")


def example(seed: int) -> Problem:
    """Four trackers that calibrate themselves on 16 unknown targets, effects held; seed: of targets and noise."""
    trackers = {"A": (0.0, 0.0, 0.0), "B": (1.6, 0.1, 0.0), "C": (0.2, 1.5, 0.1), "D": (0.6, 0.5, 1.4)}
    places = np.random.default_rng(seed).uniform((0.2, 0.2, 0.3), (1.4, 1.4, 1.2), (16, 3))
    targets = {f"T{k + 1:02d}": place for k, place in enumerate(places)}
    ranges = Ranges.every(tuple(trackers), tuple(targets), 0.5 * um)
    ranges = replace(ranges, covariates={"time": (60.0 * np.arange(64), "s"), "block": 1 + np.arange(64) // 32})
    return with_recorded_effects(simulate(declare(ranges, trackers, targets), None, seed), ranges.covariates)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job {file name: text}: four trackers and unknown targets, all positions approximate."""
    truth = example(seed)
    tracker, target = (truth.select(name).unknown for name in ("tracker", "target"))
    read = truth.observations[0]
    rough = np.random.default_rng(seed).normal(0.0, 1.0 * mm, target.ambient.shape)
    ranges = {"row": read.rows, "tracker": read.covariates["tracker"], "target": read.covariates["target"],
              "d_mm": read.recorded[:, 0]}
    return {"ranges.csv": written(f"simulated, seed {seed}", ranges), "job.toml": EXAMPLE_JOB,
            "trackers.csv": written("roughly", {"tracker": tracker.keys, **xyz_mm(tracker.ambient[:, :3])}),
            "targets.csv": written("roughly", {"target": target.keys, **xyz_mm(target.ambient + rough)})}


EXAMPLE_JOB = """problem = "problems.multilateration"
[data.ranges]
file = "ranges.csv"
instrument = "tracker"
[data.trackers]
file = "trackers.csv"
[data.targets]
file = "targets.csv"
[instruments.tracker]
kind = "tracking_interferometer"
u = "0.5 um"
counts = "lengthening"
"""
