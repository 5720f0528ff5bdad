"""Inclinometers on trackers and on frames: how far their axes x and y rise above the horizontal of the network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from casadi import atan2, sqrt
from numpy.typing import ArrayLike, NDArray

from calib import Observations, Pose, Shared, Unknown, direct
from calib.errors import InputError
from problems.network import carried, frames

COMPONENTS = ("along_x", "along_y")


@dataclass(frozen=True, eq=False)
class Tilts:
    """Readings of inclinometers: of "station" or "frame"; keys (n,) of these; readings (n, 2) elevations of the axes x
    and y [rad], or None; u: number, (2,) or (n, 2) [rad]; unit, rows, covariates, epoch: as of a batch."""

    of: str
    keys: Sequence[str] | NDArray[Any]
    readings: ArrayLike | None
    u: ArrayLike
    group: str = "tilts"
    unit: str = "rad"
    rows: ArrayLike | None = None
    covariates: Mapping[str, Any] = field(default_factory=dict)
    epoch: Sequence[str] | NDArray[Any] | None = None


def of_station(tracker_from_world: Any, *, tilt: Any = direct) -> Any:
    """Elevations [rad] of the axes x and y of a tracker, whose frame the vertical z of the network is turned into."""
    up = tracker_from_world.rotation[:, 2]
    return [tilt(atan2(up[0], sqrt(up[1] ** 2 + up[2] ** 2))), tilt(atan2(up[1], sqrt(up[0] ** 2 + up[2] ** 2)))]


def of_axes(origin: Any, along_x: Any, along_y: Any, *, tilt: Any = direct) -> Any:
    """Elevations [rad] of two lines from an origin to points (3,) along them."""
    return [tilt(atan2(line[2], sqrt(line[0] ** 2 + line[1] ** 2))) for line in (along_x - origin, along_y - origin)]


def observations(tilts: Sequence[Tilts], station: Pose | None, frame: Unknown | None,
                 standing: Sequence[frames.RigidFrame]) -> list[Observations]:
    """The readings of inclinometers. Raises InputError naming a station or frame that is not there."""
    found = []
    for one in tilts:
        keys = np.asarray(one.keys).astype(str)
        same: dict[str, Any] = {"readings": one.readings, "u": one.u, "unit": one.unit,
                                "components": COMPONENTS, "rows": one.rows}
        if one.of == "station":
            there = () if station is None else station.keys
            strange = sorted(set(keys.tolist()) - set(there))
            if station is None or strange:
                raise InputError(f"station '{strange[0]}' has tilts and no readings of a tracker"
                                 f"{frames.near(strange[0], there)}")
            found.append(Observations(of_station, station[np.array([there.index(key) for key in keys.tolist()])],
                                      group=one.group, covariates={"station": keys, **one.covariates}, **same))
            continue
        when = [""] * len(keys) if one.epoch is None else np.asarray(one.epoch).astype(str).tolist()
        inside = [frames.chain(standing, key, epoch) for key, epoch in zip(keys.tolist(), when, strict=True)]
        u = np.broadcast_to(one.u, (len(keys), 2))
        for depth in sorted({len(chain) for chain in inside}):
            rows = np.array([len(chain) == depth for chain in inside])
            levels = [frame[np.array([chain[level] for chain in inside if len(chain) == depth])]     # type: ignore[index]
                      for level in range(depth)]
            model = carried.OnFrames(of_axes, [(end, False) for end in range(3) for _ in levels], "xyz")
            tips = [Shared(tip) for tip in np.vstack([np.zeros(3), np.eye(3)[:2]])]
            of_depth = same | {name: None if given is None else np.asarray(given)[rows]
                               for name, given in (("readings", one.readings), ("rows", one.rows))}
            name = one.group if rows.all() else f"{one.group} {depth}"
            found.append(Observations(model, *tips, *levels * 3, group=name, **of_depth | {"u": u[rows]}))
    return found
