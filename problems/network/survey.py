"""What was surveyed: points with what is known of them, and readings in columns, kind by kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import Gaussian
from calib.errors import InputError
from calib.units import gon
from problems.network.frames import RigidFrame
from problems.network.models import KINDS, Kind
from problems.network.stations import Ranging, Sightings

if TYPE_CHECKING:
    from problems.network.tilts import Tilts

Array = NDArray[np.float64]
LEFT_HANDED, RIGHT_HANDED = ("ne", "sw", "es", "wn"), ("en", "nw", "se", "ws")
# Angle from the axis x clockwise to north, by the first letter of the axes.
NORTH = {"e": 300.0 * gon, "n": 0.0, "s": 200.0 * gon, "w": 100.0 * gon}
FIXED, ADJUSTED, CONSTRAINED = "fixed", "adjusted", "constrained"


@dataclass(frozen=True)
class Point:
    """A point: position (x, y, z) [m], not a number where unknown, and what its plane position and its height are.

    plane, height: FIXED, ADJUSTED, CONSTRAINED (adjusted, and part of a free datum), or "" where it has none; frame:
    name of the frame that the position is in, "" for the network.
    """

    position: tuple[float, float, float] = (np.nan, np.nan, np.nan)
    plane: str = ""
    height: str = ""
    frame: str = ""

    def role(self, part: str) -> str:
        """What the coordinate x, y or z of the point is."""
        return self.height if part == "z" else self.plane

    def has(self, parts: str) -> bool:
        """Whether the point takes part with all these coordinates."""
        return all(self.role(part) for part in parts)


@dataclass(frozen=True, eq=False)
class Batch:
    """n readings of one kind, in columns.

    kind: of KINDS; station, target, back: (n,) keys of points (target empty where a reading is of one point, back only
    of angles); readings: (n,) or (n, dim) SI, or None to plan; u: standard uncertainties or Gaussian, SI.
    orientation: (n,) keys of the settings of the circle, of directions; station_height, target_height: (n,) [m].
    group: name in results; unit: display unit; rows: (n,) numbers in the file; covariates: as of Observations;
    epoch: (n,) of each reading, for points in frames that move.
    """

    kind: str
    station: Sequence[str] | NDArray[Any]
    target: Sequence[str] | NDArray[Any]
    readings: ArrayLike | None
    u: ArrayLike | Gaussian
    back: Sequence[str] | NDArray[Any] | None = None
    orientation: Sequence[str] | NDArray[Any] | None = None
    station_height: ArrayLike = 0.0
    target_height: ArrayLike = 0.0
    group: str = ""
    unit: str = "m"
    rows: ArrayLike | None = None
    covariates: Mapping[str, Any] = field(default_factory=dict)
    epoch: Sequence[str] | NDArray[Any] | None = None

    def __len__(self) -> int:
        return len(self.station)

    @property
    def model(self) -> Kind:
        """The kind of reading."""
        if self.kind not in KINDS:
            raise InputError(f"there is no kind of reading '{self.kind}'; there are: {', '.join(KINDS)}")
        return KINDS[self.kind]

    @property
    def ends(self) -> tuple[NDArray[Any], ...]:
        """Keys (n,) of the points of each reading, in the order in which the model takes them."""
        station, target = np.asarray(self.station).astype(str), np.asarray(self.target).astype(str)
        if self.model.points == 3:
            return station, np.asarray(self.back).astype(str), target
        return (station, target)[: self.model.points]

    @property
    def values(self) -> Array | None:
        """Readings (n, dim)."""
        return None if self.readings is None else np.asarray(self.readings, float).reshape(len(self), -1)

    @property
    def numbers(self) -> NDArray[np.int64]:
        """Row numbers (n,) in the file."""
        return np.arange(1, len(self) + 1) if self.rows is None else np.asarray(self.rows, np.int64)

    def heights(self, name: str) -> Array:
        """`station_height` or `target_height` (n,) [m]."""
        return np.broadcast_to(np.asarray(getattr(self, name), float), (len(self),))


@dataclass(frozen=True, eq=False)
class Correlated:
    """Readings of different kinds with one covariance matrix: single readings, and the matrix over all of them [SI]."""

    members: tuple[Batch, ...]
    covariance: Array
    group: str
    row: int


@dataclass(frozen=True, eq=False)
class Survey:
    """A network: points, readings, and how axes and circles turn.

    points: {key: Point}; batches; correlated: clusters of mixed readings; sightings, ranging: of stations with six
    degrees of freedom and of instruments that read ranges alone; axes: directions of x and y, as "ne";
    tilts: of inclinometers; frames: bodies that points belong to, where they stand and how they move;
    clockwise: whether circles count clockwise; remarks: sentences about what was left out, and why.
    a_posteriori: whether the file wants its uncertainties multiplied by the root of the variance factor; tolerance:
    misfit [m] beyond which the file wants readings left out, None where it does not say.
    """

    points: Mapping[str, Point]
    batches: Sequence[Batch]
    correlated: Sequence[Correlated] = ()
    sightings: Sequence[Sightings] = ()
    ranging: Sequence[Ranging] = ()
    tilts: Sequence[Tilts] = ()
    frames: Sequence[RigidFrame] = ()
    axes: str = "ne"
    clockwise: bool = True
    remarks: tuple[str, ...] = ()
    a_posteriori: bool = False
    tolerance: float | None = None
    name: str = "network"

    @property
    def sense(self) -> float:
        """+1 where circles turn from x to y, else -1."""
        return 1.0 if (self.axes in LEFT_HANDED) == self.clockwise else -1.0

    @property
    def north(self) -> float:
        """Angle [rad] from the axis x to north in the sense of the circles."""
        turned = NORTH[self.axes[0]]
        return turned if self.clockwise else (2.0 * np.pi - turned) % (2.0 * np.pi)

    @property
    def parts(self) -> str:
        """The coordinates that points of this network have: "xy", "z" or "xyz"."""
        read = {part for batch in self.every_batch for part in batch.model.needs}
        if self.sightings or self.ranging:
            return "xyz"
        return "".join(part for part in "xyz" if part in read)

    @property
    def every_batch(self) -> list[Batch]:
        """All batches, single readings of mixed clusters among them."""
        return [*self.batches, *(member for cluster in self.correlated for member in cluster.members)]

    @property
    def read(self) -> set[str]:
        """Keys of the points that any reading sees."""
        ends = {key for batch in self.every_batch for keys in batch.ends for key in keys.tolist()}
        ends |= {key for seen in self.sightings for key in seen.targets}
        return ends | {key for seen in self.ranging for key in seen.targets}

    def placed(self, positions: Mapping[str, ArrayLike]) -> Survey:
        """The same survey with other positions (3,) of some points."""
        points = {
            key: replace(point, position=tuple(np.asarray(positions[key], float))) if key in positions else point
            for key, point in self.points.items()
        }
        return replace(self, points=points)
