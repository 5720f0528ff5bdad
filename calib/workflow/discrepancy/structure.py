"""Descriptions of structure that no effect explains: harmonics of angles, smooth functions, levels of what has few
values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, groupby

import numpy as np
from numpy.typing import NDArray

from calib.analyse.score import Field
from calib.blocks import Array
from calib.workflow.discrepancy.looks import corrected_each, effective_looks, smallest_tails, tails
from calib.workflow.discrepancy.readings import PLACES, Channel

HARMONICS = (1, 2, 3, 4, 5, 6)
WAVES = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)  # waves over the range of a covariate that is no angle
TURNING = ("face",)  # settings of an instrument that turn the sense of its readings
TURNED = ", turned with the "  # between a channel and such a setting, in the name of a pattern
SETTLING = (0.03, 0.07, 0.15, 0.3)  # of the time, in which something settles
STEPS = 16  # parts of the time between which a step may be
DEGREES = 5  # of the polynomials over one covariate
FEW = 12  # different values up to which a covariate is taken level by level
SPLIT_BY = 6  # different keys up to which a channel is also looked at key by key
DRAWS = 200  # simulated residuals from which the number of independent looks is judged
RUN = "run"  # the shape of what has no other: it runs on from reading to reading
INSIDE = 1e-6  # part of a pattern outside the effects of one kind, below which it is theirs
SUM = 3  # parameters up to which a sum of such effects is an answer
MOST = 5  # descriptions that may stand together


@dataclass(frozen=True)
class Pattern:
    """One description: channel, covariate and what of it; columns (m, k) over its places among all whitened rows;
    plain: of one covariate over a whole channel."""

    channel: str
    covariate: str
    kind: str
    places: NDArray[np.int64]
    columns: Array
    plain: bool = False

    def whole(self, n: int) -> Array:
        """Columns (n, k) over all whitened rows."""
        columns = np.zeros((n, self.columns.shape[1]))
        columns[self.places] = self.columns
        return columns


@dataclass(frozen=True)
class Place:
    """Where a model disagrees: channel, covariate, shape of the disagreement, corrected p-value, and figures of it."""

    channel: str
    covariate: str
    shape: str
    p_value: float
    figures: Mapping[str, float] = field(default_factory=dict)


def patterns(channels: Sequence[Channel]) -> list[Pattern]:
    """All descriptions of structure that the recorded covariates allow."""
    found: list[Pattern] = []
    before: Channel | None = None
    parts: list[tuple[str, NDArray, list[tuple[str, str, Array]]]] = []
    for channel in channels:
        if before is None or not _alike(before, channel):
            parts = [(part, inside, list(_kinds(channel, inside))) for part, inside in _parts(channel)]
            parts += [turned for turn in _turns(channel) for turned in _turned(parts, *turn)]
        before = channel
        for part, inside, kinds in parts:
            places = channel.places[inside]
            found += [Pattern(channel.name + part, covariate, kind, places, columns,
                              len(inside) == len(channel.places) and covariate in channel.covariates)
                      for covariate, kind, columns in kinds]
    return found


def _turns(channel: Channel) -> Iterator[tuple[str, Array]]:
    """Settings that turn the sense of a reading, as the second face does, so that what lies before them shows with
    either sign."""
    for name in TURNING:
        values = channel.covariates.get(name)
        if values is not None and values.dtype.kind in "fiu" and len(np.unique(values)) == 2:
            yield name, sense_of(values)


def sense_of(values: NDArray) -> Array:
    """+1 at the larger of two values of a setting, -1 at the other."""
    return np.where(values == values.max(), 1.0, -1.0)


def _turned(
    parts: Sequence[tuple[str, NDArray, list[tuple[str, str, Array]]]], name: str, sense: Array
) -> list[tuple[str, NDArray, list[tuple[str, str, Array]]]]:
    """The same patterns over the same parts of a channel, turned with a setting."""
    return [(f"{part}{TURNED}{name}", inside,
             [(covariate, kind, columns * sense[inside, None]) for covariate, kind, columns in kinds])
            for part, inside, kinds in parts if len(np.unique(sense[inside])) == 2]


def _alike(one: Channel, other: Channel) -> bool:
    """Whether two components of a group were read together, so that the same patterns serve both."""
    return one.covariates.keys() == other.covariates.keys() and one.units == other.units and all(
        np.array_equal(values, other.covariates[name]) for name, values in one.covariates.items())


def _kinds(channel: Channel, inside: NDArray) -> Iterator[tuple[str, str, Array]]:
    for covariate, values in channel.covariates.items():
        for kind, columns in _shapes(values[inside], channel.units.get(covariate, "1")):
            yield covariate, kind, columns
    yield from _products(channel, inside)


def _parts(channel: Channel) -> Iterator[tuple[str, NDArray]]:
    """The whole channel, and its readings key by key where a text covariate has a few keys."""
    yield "", np.arange(len(channel.places))
    for covariate, values in channel.covariates.items():
        if values.dtype.kind not in "fiub":
            keys = list(dict.fromkeys(values.tolist()))
            if 1 < len(keys) <= SPLIT_BY:
                for key in keys:
                    yield f", {covariate} {key}", np.flatnonzero(values == key)


def _shapes(values: NDArray, unit: str) -> Iterator[tuple[str, Array]]:
    if values.dtype.kind not in "fiub":
        different = list(dict.fromkeys(values.tolist()))
        if 1 < len(different) <= FEW:
            yield "level", np.stack([values == v for v in different], axis=1).astype(float)
        return
    numbers = values.astype(float)
    levels = np.unique(numbers)
    if len(levels) < 2:
        return
    if unit in ("rad", "deg"):
        spacing = float(np.median(np.diff(levels)))  # an order shows where more than two readings fall into a turn
        orders = [o for o in HARMONICS if len(levels) > 4 and o * spacing < 0.9 * np.pi]
        for order in orders:
            yield f"harmonic {order}", _turning(order * numbers)
    scaled = _scaled(numbers)
    if len(levels) > 4:
        yield "cubic", np.polynomial.legendre.legvander(scaled, 3)[:, 1:]
    if len(levels) <= FEW:
        yield "level", (numbers[:, None] == levels).astype(float)
        if len(levels) > 3:
            yield "trend", scaled[:, None]
            yield "curve", (scaled**2)[:, None]
        return
    yield "smooth", np.polynomial.legendre.legvander(scaled, DEGREES)[:, 1:]
    if len(levels) > 4 * DEGREES:
        yield "fine", np.polynomial.legendre.legvander(scaled, 2 * DEGREES)[:, 1:]
    yield "trend", scaled[:, None]
    yield "curve", (scaled**2)[:, None]
    if unit not in ("rad", "deg"):
        for waves in WAVES:
            if len(levels) > 3 * waves:
                yield f"{waves:g} waves over the range", _turning(np.pi * waves * scaled)
    if unit == "s":
        for share in np.arange(1, STEPS) / STEPS:
            column = (numbers >= np.quantile(numbers, share)).astype(float)
            yield f"step at {share:.2f} of the time", column[:, None]
        for share in SETTLING:
            yield f"settling within {share:g} of the time", np.exp(-(scaled + 1) / 2 / share)[:, None]
    yield "pieces", (np.digitize(scaled, np.linspace(-1, 1, 9)[1:-1])[:, None] == np.arange(8)).astype(float)


def _products(channel: Channel, inside: NDArray) -> Iterator[tuple[str, str, Array]]:
    """What changes with time or temperature or differs by direction: a width, a harmonic, a run along a travel; and
    what two travels do together."""
    varying = {name: values[inside].astype(float) for name, values in channel.covariates.items()
               if _varies(values, inside)}
    travels = {name: _scaled(v) for name, v in varying.items() if name.startswith(PLACES) and len(np.unique(v)) > 4}
    shapes = [(name, f"harmonic {order}", _turning(order * varying[name])) for name in varying
              if channel.units.get(name) in ("rad", "deg") for order in (1, 2, 3)]
    shapes += [(name, f"{waves} waves", _turning(np.pi * waves * v)) for name, v in travels.items() for waves in (1, 2)]
    shapes += [(name, "trend", v[:, None]) for name, v in travels.items()]
    for run in ("time", "temperature_difference"):
        if run in varying:
            shapes += [(name, "difference", v[:, None]) for name, v in varying.items()
                       if name != run and len(np.unique(v)) <= 3]
    for run in varying:
        by_direction = run == "direction" or run.startswith("approach")
        if run in ("time", "temperature_difference") or by_direction:
            how = "differs by" if by_direction else "changes with"
            for name, shape, columns in shapes:
                other_axis = by_direction and " " in run and " " in name and run.split()[-1] != name.split()[-1]
                if name != run and not other_axis:
                    yield f"{name} and {run}", f"{shape} that {how} {run}", _scaled(varying[run])[:, None] * columns
    for one, other in combinations([name for name in travels if name.startswith("travel")], 2):
        yield f"{one} and {other}", "product", (travels[one] * travels[other])[:, None]


def _turning(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _varies(values: NDArray | None, inside: NDArray) -> bool:
    return values is not None and values.dtype.kind in "fiub" and len(np.unique(values[inside])) > 1


def _scaled(numbers: Array) -> Array:
    low, high = numbers.min(), numbers.max()
    return 2 * (numbers - low) / max(high - low, 1e-300) - 1


class Screen:
    """Score tests of many patterns at once, each from its own rows, against residuals outside a basis.

    families: orthonormal directions (n, k) of effects of one kind, which a pattern within them is no structure beside.
    """

    def __init__(self, field: Field, shapes: Sequence[Pattern], seed: int, looks: tuple[float, float] | None = None,
                 families: Sequence[Array] = ()):
        self.shapes, self.field = [], field
        self._sheets: list[_Sheet] = []
        for _, run in groupby(shapes, lambda shape: id(shape.places)):
            sheet, seen = _sheet(field, list(run))
            self._sheets += [sheet] if seen else []
            self.shapes += seen
        self.dofs = np.concatenate([np.zeros(0, int), *(np.diff(s.ends, prepend=0) for s in self._sheets)])
        self.plain = np.array([shape.plain for shape in self.shapes], dtype=bool)
        self.named = self.dofs <= SUM
        self.named &= np.max([self.drops(frame).sum(axis=1) for frame in families], axis=0,
                             initial=0.0) > self.dofs - INSIDE
        self.looks = self._looks(seed) if looks is None else looks

    @property
    def nameless(self) -> list[Pattern]:
        """The patterns that no effects of one kind account for."""
        return [shape for shape, named in zip(self.shapes, self.named, strict=True) if not named]

    def drops(self, residuals: Array) -> Array:
        """Drop of the sum of squares for each pattern (rows) and each column of residuals (n, count)."""
        found = []
        for sheet in self._sheets:
            squared = (sheet.roots.T @ residuals[sheet.places]) ** 2
            found.append(np.add.reduceat(squared, np.concatenate([[0], sheet.ends[:-1]]), axis=0))
        return np.concatenate(found) if found else np.zeros((0, residuals.shape[1]))

    def _looks(self, seed: int) -> tuple[float, float]:
        """Independent looks at patterns over one covariate of a whole channel, and at the many others: each of the two
        has half of the level, so that the many do not hide what is looked for first."""
        if not self.shapes:
            return 1.0, 1.0
        drops = self.drops(self.field.draw(seed, DRAWS))
        found = []
        for which in (self.plain, ~self.plain):
            smallest = smallest_tails(drops[which], self.dofs[which]) if which.any() else np.ones(DRAWS)
            found.append(2 * effective_looks(smallest, int(which.sum())))
        return found[0], found[1]

    @property
    def each(self) -> Array:
        """Number of looks that each pattern stands among."""
        return np.where(self.plain, *self.looks)

    @cached_property
    def judged(self) -> tuple[Array, Array]:
        """Corrected p-value of each pattern, and by how much it lowers a Schwarz criterion."""
        drops = self.drops(self.field.residual[:, None])[:, 0]
        left = self.field.dof - self.dofs
        scale = np.where(left > 0, np.maximum(1.0, (self.field.squares - drops) / np.maximum(left, 1)), 1.0)
        p = corrected_each(tails(drops, self.dofs, scale, left), self.each)
        return p, drops / scale - self.dofs * np.log(max(self.field.dof, 2))

    def places(self) -> list[Place]:
        """The patterns as places, most significant first, their p-values corrected for the number of looks."""
        if not self.shapes:
            return []
        p, gain = self.judged
        return [Place(s.channel, s.covariate, s.kind, float(p[i])) for i in np.lexsort((-gain, p))
                for s in (self.shapes[i],)]

    def best(self, level: float) -> tuple[Pattern, Place, float] | None:
        """The significant pattern that says most with fewest parameters, and among how many looks it stands; None where
        none is significant."""
        if not self.shapes:
            return None
        p, gain = self.judged
        odd = (p <= level) & ~self.named
        if not odd.any():
            return None
        one = int(np.argmax(np.where(odd, gain, -np.inf)))
        shape = self.shapes[one]
        return shape, Place(shape.channel, shape.covariate, shape.kind, float(p[one])), float(self.each[one])


@dataclass(frozen=True)
class _Sheet:
    """Patterns over the same places: their orthonormal columns side by side, and where each one ends."""

    places: NDArray[np.int64]
    roots: Array
    ends: NDArray[np.int64]


def _sheet(field: Field, shapes: Sequence[Pattern]) -> tuple[_Sheet, list[Pattern]]:
    """What of patterns over the same places can be seen outside the basis of a field, and which they are."""
    places = shapes[0].places
    together = np.concatenate([s.columns for s in shapes], axis=1)
    together = together / np.maximum(np.linalg.norm(together, axis=0), 1e-300)
    taken = field.basis[places].T @ together
    lines, lost = np.ascontiguousarray(together.T), np.ascontiguousarray(taken.T)
    starts = np.cumsum([0, *(s.columns.shape[1] for s in shapes)])
    sizes = np.diff(starts)
    kept: dict[int, Array] = {}
    for size in np.unique(sizes):
        which = np.flatnonzero(sizes == size)
        columns = starts[which][:, None] + np.arange(size)
        own, less = lines[columns], lost[columns]
        values, vectors = np.linalg.eigh(own @ own.transpose(0, 2, 1) - less @ less.transpose(0, 2, 1))
        for i, value, vector in zip(which, values, vectors, strict=True):
            seen = value > 1e-6
            if seen.any():
                kept[int(i)] = together[:, starts[i]:starts[i + 1]] @ (vector[:, seen] / np.sqrt(value[seen]))
    spare = field.redundancy[places].sum()  # what takes most of it describes nothing
    order = sorted(i for i, root in kept.items() if 2 * root.shape[1] <= spare)
    roots = np.concatenate([kept[i] for i in order], axis=1) if order else np.zeros((len(places), 0))
    return _Sheet(places, roots, np.cumsum([kept[i].shape[1] for i in order], dtype=int)), [shapes[i] for i in order]


def described(
    field: Field, shapes: Sequence[Pattern], level: float, seed: int, first: Screen | None = None,
    known: tuple[float, float] | None = None, most: int = MOST,
) -> tuple[list[Place], Field, float]:
    """Describe what is left over by patterns, one after another, as long as one is significant.

    first: the screen of this field where it is there already; known: the number of independent looks, if known;
    most: patterns at most.
    Returns the patterns, the field without them, and twice the logarithm of the choices made.
    """
    found: list[Place] = []
    choices = 0.0
    for _ in range(most):
        # What was taken changes the number of independent looks but little; simulating it is the dear part.
        screen = Screen(field, shapes, seed, known) if first is None else first
        first, known = None, screen.looks
        best = screen.best(level)
        if best is None:
            break
        pattern, place, looks = best
        choices += 2 * float(np.log(max(looks, 2.0)))
        signal = field.outside(pattern.whole(len(field.residual)))
        left, values, right = np.linalg.svd(signal, full_matrices=False)
        seen = values > 1e-6 * max(values[0], 1e-300)
        frame = left[:, seen]
        found.append(_with_figures(place, pattern, (right[seen].T / values[seen]) @ (frame.T @ field.residual)))
        field = field.taking(frame)
    return found, field, choices


def _with_figures(place: Place, pattern: Pattern, estimate: Array) -> Place:
    """Amplitude and phase of a harmonic, or the root mean square of a function, in units of the noise."""
    rms = float(np.sqrt(np.mean((pattern.columns @ estimate) ** 2)))
    figures = {"rms_over_u": rms}
    if pattern.kind.startswith("harmonic") and len(estimate) == 2:
        figures = {"amplitude_over_u": float(np.hypot(*estimate)),
                   "phase_deg": float(np.degrees(np.arctan2(estimate[1], estimate[0])))}
    return Place(place.channel, place.covariate, place.shape, place.p_value, figures)
