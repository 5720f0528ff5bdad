"""Stations with six degrees of freedom and range-only instruments in a network: laser trackers and interferometers.

Start values: a tracker is laid onto three or more placed targets (Kabsch), and places the others; the base point and
dead path of an interferometer follow from five placed targets linearly.
Sources: Kabsch (1976), Acta Crystallographica A32; Takatsuji et al. (1998), Measurement Science and Technology 9.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import Gaussian, Observations, Pose, Shared, Unknown, hands_slots_to
from calib.errors import InputError
from instruments import interferometer, laser_tracker

Array = NDArray[np.float64]
FLAT = 1e-3  # second singular value of targets, relative to the first, below which they lie on one line
POLAR = ("range", "azimuth", "zenith")


@dataclass(frozen=True, eq=False)
class Sightings:
    """Polar readings of trackers: station, target (n,) keys; readings (n, 3) range [m], azimuth, zenith angle [rad], or
    None to plan; u: (3,), (n, 3) or Gaussian; levelled: whether the standing axes are along z; covariates: as of
    Observations; epoch: (n,) of each reading, for targets in frames that move."""

    station: Sequence[str] | NDArray
    target: Sequence[str] | NDArray
    readings: ArrayLike | None
    u: ArrayLike | Gaussian
    levelled: bool = False
    group: str = "tracker"
    rows: ArrayLike | None = None
    covariates: Mapping[str, Any] = field(default_factory=dict)
    epoch: Sequence[str] | NDArray | None = None

    @property
    def targets(self) -> list[str]:
        """Keys of all targets, each once."""
        return list(dict.fromkeys(np.asarray(self.target).astype(str).tolist()))


@dataclass(frozen=True, eq=False)
class Ranging:
    """Readings of tracking interferometers of unknown base point and dead path: instrument, target (n,) keys; readings
    (n,) [m] or None; u: number, (n,) or Gaussian; counts: +1 where readings grow with the path, else -1; covariates and
    epoch: as of Sightings."""

    instrument: Sequence[str] | NDArray
    target: Sequence[str] | NDArray
    readings: ArrayLike | None
    u: ArrayLike | Gaussian
    counts: float = 1.0
    group: str = "ranges"
    rows: ArrayLike | None = None
    covariates: Mapping[str, Any] = field(default_factory=dict)
    epoch: Sequence[str] | NDArray | None = None

    @property
    def targets(self) -> list[str]:
        """Keys of all targets, each once."""
        return list(dict.fromkeys(np.asarray(self.target).astype(str).tolist()))


def laid(own: Array, world: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) of own_from_world that lay points (n, 3) of the world onto own ones."""
    a, b = own - own.mean(axis=0), world - world.mean(axis=0)
    left, _, right = np.linalg.svd(a.T @ b)
    left[:, -1] *= np.sign(np.linalg.det(left @ right))
    rotation = left @ right
    return rotation, own.mean(axis=0) - rotation @ world.mean(axis=0)


def based(readings: Array, targets: Array) -> Array:
    """Base point and dead path (4,) [m] from lengthening readings (n,) of targets (n, 3): from the differences of the
    squares (|P - B|^2 = (reading + dead path)^2), linear in both."""
    middle = targets.mean(axis=0)
    place = targets - middle
    matrix = np.column_stack([2.0 * place, 2.0 * readings, np.ones(len(readings))])
    solution, _, rank, _ = np.linalg.lstsq(matrix, np.sum(place**2, axis=1) - readings**2, rcond=1e-9)
    if rank == 4 and len(readings) > 4:
        solution = _beside(matrix, solution)
        rank = 5 if np.isfinite(solution).all() else rank
    if rank < 5:
        raise InputError("its targets lie in one plane, or are fewer than five, and its base point does not follow; "
                         "read targets off the plane")
    return np.append(solution[:3] + middle, solution[3])


def _beside(matrix: Array, solution: Array) -> Array:
    """The base point beside the plane of all targets, on one of the two sides that give the same readings: of the
    solutions along what the targets leave open, where |B|^2 - (dead path)^2 is what it stands for."""
    open_way = np.linalg.svd(matrix)[2][-1]
    sign = np.array([1.0, 1.0, 1.0, -1.0])          # B.B - l l + K = 0, K the last unknown
    quadratic = [float(sign @ open_way[:4] ** 2), float(2.0 * sign @ (solution[:4] * open_way[:4]) + open_way[4]),
                 float(sign @ solution[:4] ** 2 + solution[4])]
    roots = np.roots(quadratic)
    real = roots[np.abs(roots.imag) < 1e-6 * np.abs(roots).max(initial=1.0)].real
    return solution + real.max() * open_way if len(real) else np.full(5, np.nan)


def spread(known: Mapping[str, Array], sightings: Sequence[Sightings]) -> bool:
    """Lay trackers onto placed targets and place their other targets; the first tracker is the world where nothing is
    placed. known: {target: (3,) [m]}, not numbers where unknown; filled in. Returns whether anything was placed."""
    views = _views(sightings)
    placed_any = False
    if views and not any(np.isfinite(known[key]).all() for _, keys, _ in views for key in keys):
        _, keys, own = views[0]
        for key, place in zip(keys, own, strict=True):
            known[key][:] = place
        placed_any = True
    progress = True
    while progress:
        progress = False
        for _, keys, own in views:
            there = np.array([np.isfinite(known[key]).all() for key in keys])
            if there.all() or not _rigid(own[there]):
                continue
            rotation, shift = laid(own[there], np.array([known[k] for k, t in zip(keys, there, strict=True) if t]))
            for key, place, has in zip(keys, own, there, strict=True):
                if not has:
                    known[key][:] = rotation.T @ (place - shift)
            progress = placed_any = True
    return placed_any


def _rigid(points: Array) -> bool:
    if len(points) < 3:
        return False
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(sizes[1] > FLAT * sizes[0])


def _views(sightings: Sequence[Sightings]) -> list[tuple[str, list[str], Array]]:
    """(station, targets, their positions in its frame), the station that sees most first."""
    views: dict[str, tuple[list[str], list[Array]]] = {}
    for batch in sightings:
        if batch.readings is None:
            continue
        own = laser_tracker.cartesian_readings(np.asarray(batch.readings, float))
        stations, targets = (np.asarray(k).astype(str) for k in (batch.station, batch.target))
        number: dict[str, int] = {}
        which = np.array([number.setdefault(s, len(number)) for s in stations.tolist()], dtype=np.int64)
        rows = np.split(np.argsort(which, kind="stable"), np.cumsum(np.bincount(which))[:-1])
        for station, of_station in zip(number, rows, strict=bool(number)):
            keys, places = views.setdefault(station, ([], []))
            keys += targets[of_station].tolist()
            places.append(own[of_station])
    return sorted(((s, k, np.concatenate(p)) for s, (k, p) in views.items()), key=lambda view: -len(view[1]))


def poses(sightings: Sequence[Sightings], known: Mapping[str, Array]) -> Pose | None:
    """The unknown `station`: the frame of each tracker from that of the network.

    Raises InputError naming a station with fewer than three targets, or with all of them on one line.
    """
    stations = list(dict.fromkeys(chain.from_iterable(np.asarray(b.station).astype(str).tolist() for b in sightings)))
    if not stations:
        return None
    turns, shifts = {key: np.eye(3) for key in stations}, {key: np.zeros(3) for key in stations}
    for station, keys, own in _views(sightings):
        if not _rigid(own):
            raise InputError(f"station '{station}' sees {len(own)} target(s), too few or on one line to place it; it "
                             "needs three that are not on one line")
        turns[station], shifts[station] = laid(own, np.array([known[key] for key in keys]))
    turn, shift = (np.array([each[k] for k in stations]) for each in (turns, shifts))
    return Pose("station", turn, shift, keys=stations)


def bases(ranging: Sequence[Ranging], known: Mapping[str, Array]) -> Unknown | None:
    """The unknown `interferometer`: base point and dead path of each. Raises InputError naming it where it has too few
    targets."""
    found: dict[str, tuple[list[float], list[Array]]] = {}
    for batch in ranging:
        readings = np.zeros(len(batch.target)) if batch.readings is None else np.asarray(batch.readings, float)
        ends = (np.asarray(k).astype(str).tolist() for k in (batch.instrument, batch.target))
        for instrument, target, value in zip(*ends, readings, strict=True):
            values, places = found.setdefault(instrument, ([], []))
            values.append(batch.counts * value)
            places.append(known[target])
    if not found:
        return None
    start = []
    for key, (values, places) in found.items():
        try:
            start.append(based(np.array(values), np.array(places)))
        except InputError as error:
            raise InputError(f"interferometer '{key}': {error}") from None
    return Unknown("interferometer", np.array(start), "m", ("x", "y", "z", "dead_path"), list(found))


@hands_slots_to(interferometer.tracking)
def ranged(target: Any, instrument: Any, counts: Any, **slots: Any) -> Any:
    """Reading [m] of an interferometer (base point and dead path (4,) [m]) on a target (3,); counts: its sense."""
    return interferometer.tracking(target, instrument[:3], instrument[3], counts, **slots)


def observations(
    sightings: Sequence[Sightings],
    ranging: Sequence[Ranging],
    point: Unknown,
    station: Pose | None,
    base: Unknown | None,
    stand: Callable[..., tuple[Any, list[Any]]],
) -> list[Observations]:
    """The readings of trackers and interferometers on the points of a network; stand: puts a model on frames."""
    place = {key: i for i, key in enumerate(point.keys)}
    found = []
    for batch in sightings:
        assert station is not None
        number = {key: i for i, key in enumerate(station.keys)}
        stations, targets = (np.asarray(k).astype(str) for k in (batch.station, batch.target))
        model, further = stand(laser_tracker.polar_from_station, [(1, targets)], batch.epoch)
        found.append(Observations(
            model,
            station[np.array([number[k] for k in stations.tolist()])],
            point[np.array([place[k] for k in targets.tolist()])],
            *further,
            readings=batch.readings, u=batch.u, group=batch.group, unit=("m", "rad", "rad"), components=POLAR,
            period=laser_tracker.PERIOD, rows=batch.rows, covariates={"station": stations, "target": targets,
                                                                     **batch.covariates},
        ))
    for one in ranging:
        assert base is not None
        number = {key: i for i, key in enumerate(base.keys)}
        instruments, targets = (np.asarray(k).astype(str) for k in (one.instrument, one.target))
        model, further = stand(ranged, [(0, targets)], one.epoch)
        found.append(Observations(
            model,
            point[np.array([place[k] for k in targets.tolist()])],
            base[np.array([number[k] for k in instruments.tolist()])],
            Shared(one.counts),
            *further,
            readings=one.readings, u=one.u, group=one.group, unit="m", rows=one.rows,
            covariates={"station": instruments, "target": targets, **one.covariates},
        ))
    return found
