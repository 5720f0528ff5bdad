"""Unknowns: named blocks of quantities to be estimated, as handles that never hold a result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import geometry
from calib.errors import DeclarationError
from calib.frozen import Frozen

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Selection:
    """Some instances and parts of an unknown: what `u[index]`, `u.each` and `u.part(name)` return."""

    unknown: Unknown
    index: NDArray[np.int64] | None = None
    parts: tuple[int, ...] | None = None

    def part(self, *names: str) -> Selection:
        """Restrict the selection to named parts."""
        return Selection(self.unknown, self.index, self.unknown.part(*names).parts)

    def instances(self) -> NDArray[np.int64]:
        """Numbers of the instances, as they were asked for."""
        return np.arange(self.unknown.count) if self.index is None else self.index

    def mask(self) -> NDArray[np.bool_]:
        """Boolean array (count, freedom) that is true where this selection points."""
        chosen = np.zeros((self.unknown.count, self.unknown.freedom), dtype=bool)
        rows = slice(None) if self.index is None else np.atleast_1d(self.index)
        columns = range(self.unknown.freedom) if self.parts is None else self.parts
        for column in columns:
            chosen[rows, column] = True
        return chosen


class Unknown(Frozen):
    """A named block of unknown quantities with start values, one display unit, bounds and part names.

    name: how messages and files call it.
    start: number, (dim,) for one instance, or (count, dim) for several; SI.
    unit: display unit, one or one for each part; parts: names of the dim parts; keys: names of the instances.
    lower, upper: bounds in SI, broadcast to (count, dim).
    Raises DeclarationError where names and sizes do not agree or a start value is not finite.
    """

    kind = "vector"

    def __init__(
        self,
        name: str,
        start: ArrayLike = 0.0,
        unit: str | Sequence[str] = "1",
        parts: Sequence[str] | None = None,
        keys: Sequence[object] | None = None,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
    ):
        values = np.array(start, dtype=float)
        if values.ndim > 2:
            raise DeclarationError(
                f"Unknown '{name}': the start value has {values.ndim} dimensions; give a number, "
                "(dim,) for one instance or (count, dim) for several."
            )
        self._declare(
            name,
            np.atleast_2d(values),
            values.shape,
            keys,
            [unit] * (values.shape[-1] if values.ndim else 1) if isinstance(unit, str) else list(unit),
            parts,
        )
        self.lower = np.broadcast_to(np.asarray(lower, float), self.ambient.shape)
        self.upper = np.broadcast_to(np.asarray(upper, float), self.ambient.shape)
        if np.any(self.lower > self.upper):
            raise DeclarationError(f"Unknown '{name}': a lower bound lies above its upper bound.")

    def _declare(
        self,
        name: str,
        ambient: Array,
        shape: tuple[int, ...],
        keys: Sequence[object] | None,
        units: Sequence[str],
        parts: Sequence[str] | None,
    ) -> None:
        self.name, self.ambient, self.shape = name, ambient, shape
        self.ambient.flags.writeable = False
        self.count = len(ambient)
        self.units = tuple(units)
        self.freedom = len(self.units)
        default = ("x", "y", "z") if self.freedom == 3 else tuple(str(i + 1) for i in range(self.freedom))
        self.parts = tuple(parts) if parts is not None else default
        self.keys = tuple(str(k) for k in keys) if keys is not None else tuple(str(i + 1) for i in range(self.count))
        self.named_keys = keys is not None
        self.lower = np.full((self.count, self.freedom), -np.inf)
        self.upper = np.full((self.count, self.freedom), np.inf)
        if self.kind == "vector" and self.freedom != self.width:
            raise DeclarationError(
                f"Unknown '{name}' has {self.width} parts but {self.freedom} units; give one unit for "
                "all parts or one for each."
            )
        if len(self.parts) != self.freedom:
            raise DeclarationError(
                f"Unknown '{name}' has {self.freedom} parts but {len(self.parts)} part names "
                f"{self.parts}; name each part once."
            )
        if len(self.keys) != self.count or len(set(self.keys)) != self.count:
            raise DeclarationError(
                f"Unknown '{name}' has {self.count} instances but {len(set(self.keys))} different "
                "keys; name each instance once."
            )
        if not np.all(np.isfinite(ambient)):
            raise DeclarationError(f"Unknown '{name}': a start value is not a finite number; give one that is.")

    # --- what people write with -------------------------------------------------------------------------------

    def __getitem__(self, index: ArrayLike) -> Selection:
        rows = np.asarray(index)
        if rows.dtype.kind not in "iu":
            raise DeclarationError(
                f"Unknown '{self.name}' is indexed with {rows.dtype}; use integers "
                "(np.searchsorted or a dictionary turns keys into them)."
            )
        if rows.size and (rows.min() < 0 or rows.max() >= self.count):
            raise DeclarationError(
                f"Unknown '{self.name}' has {self.count} instances; index "
                f"{int(rows.max() if rows.max() >= self.count else rows.min())} does not exist."
            )
        return Selection(self, rows.astype(np.int64))

    @property
    def each(self) -> Selection:
        """Instance i to row i."""
        return Selection(self, np.arange(self.count))

    def part(self, *names: str) -> Selection:
        """Select parts by name."""
        missing = [n for n in names if n not in self.parts]
        if missing:
            raise DeclarationError(
                f"Unknown '{self.name}' has no part '{missing[0]}'; its parts are {', '.join(self.parts)}."
            )
        return Selection(self, None, tuple(self.parts.index(n) for n in names))

    def label(self, instance: int, part: int) -> str:
        """Name of one scalar, such as `plumb.x` or `target[A].r`."""
        text = self.name if self.count == 1 and not self.named_keys else f"{self.name}[{self.keys[instance]}]"
        return text if self.freedom == 1 else f"{text}.{self.parts[part]}"

    @property
    def labels(self) -> list[str]:
        """Names of all scalars, instance by instance."""
        return [self.label(i, j) for i in range(self.count) for j in range(self.freedom)]

    def __repr__(self) -> str:
        return f"{type(self).__name__}('{self.name}', {self.count} x {self.freedom})"

    # --- what the engine asks: ambient values and their local coordinates ----------------------------------------

    @property
    def width(self) -> int:
        """Numbers that store one instance."""
        return self.ambient.shape[1]

    def argument(self, ambient: ca.SX, local: ca.SX) -> object:
        """What a model receives for stored numbers (width,) moved by local coordinates (freedom,)."""
        return ambient + local

    def move(self, ambient: Array, step: Array) -> Array:
        """Stored numbers (n, width) moved by steps (n, freedom)."""
        return ambient + step

    def difference(self, ambient: Array, origin: Array) -> Array:
        """Local coordinates (n, freedom) that move `origin` to `ambient` (exact for vectors, first order else)."""
        return ambient - origin

    def store(self, value: object) -> Array:
        """Stored numbers (count, width) of a value in the declared shape."""
        return np.array(np.broadcast_to(np.asarray(value, float), self.shape), dtype=float).reshape(self.count, -1)

    def show(self, ambient: Array) -> object:
        """A value in the declared shape, from stored numbers (count, width)."""
        return float(ambient[0, 0]) if self.shape == () else ambient.reshape(self.shape).copy()


def _columns(matrices: Array) -> Array:
    """Store (n, 3, 3) matrices column by column, as CasADi reshapes them."""
    return np.ascontiguousarray(matrices.transpose(0, 2, 1)).reshape(len(matrices), 9)


def _matrices(stored: Array) -> Array:
    return stored.reshape(len(stored), 3, 3).transpose(0, 2, 1)


class Rotation(Unknown):
    """A rotation matrix `a_from_b`; its uncertainty is a small rotation about the axes of b, in radians.

    name: how messages call it; start: (3, 3) or (count, 3, 3) rotation matrices; keys: names of the instances.
    Raises DeclarationError where a start value is not a rotation.
    """

    kind = "rotation"

    def __init__(
        self, name: str, start: ArrayLike | None = None, keys: Sequence[object] | None = None, unit: str = "rad"
    ):
        matrices = np.eye(3) if start is None else np.array(start, dtype=float)
        stack = matrices.reshape(-1, 3, 3)
        error = np.abs(stack @ stack.transpose(0, 2, 1) - np.eye(3)).max()
        if error > 1e-6 or np.any(np.linalg.det(stack) < 0):
            raise DeclarationError(
                f"Rotation '{name}': the start value is not a rotation matrix (R R' differs from "
                f"the identity by {error:.1e}); normalise it or exchange rows and columns."
            )
        self._declare(name, _columns(stack), matrices.shape, keys, [unit] * 3, ("x", "y", "z"))

    def argument(self, ambient: ca.SX, local: ca.SX) -> ca.SX:
        return ca.mtimes(ca.reshape(ambient, 3, 3), geometry.small_rotation(local))

    def move(self, ambient: Array, step: Array) -> Array:
        half = 0.5 * step
        square = np.einsum("ni,ni->n", half, half)[:, None, None]
        turn = (2.0 / (1.0 + square)) * (_skew(half) + _skew(half) @ _skew(half)) + np.eye(3)
        moved = _matrices(ambient) @ turn
        moved = 0.5 * moved @ (3.0 * np.eye(3) - moved.transpose(0, 2, 1) @ moved)  # stays orthonormal to rounding
        return _columns(moved)

    def difference(self, ambient: Array, origin: Array) -> Array:
        turn = _matrices(origin).transpose(0, 2, 1) @ _matrices(ambient)
        return 0.5 * np.stack(
            [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
        )

    def store(self, value: object) -> Array:
        return _columns(np.broadcast_to(np.asarray(value, float), self.shape).reshape(-1, 3, 3))

    def show(self, ambient: Array) -> Array:
        return _matrices(ambient).reshape(self.shape).copy()


def _skew(vectors: Array) -> Array:
    zero = np.zeros(len(vectors))
    x, y, z = vectors.T
    return np.stack([np.stack([zero, -z, y], 1), np.stack([z, zero, -x], 1), np.stack([-y, x, zero], 1)], 1)


class Direction(Unknown):
    """A unit vector; its uncertainty is two small angles across it, in radians.

    name: how messages call it; start: (3,) or (count, 3) vectors of any length; keys: names of the instances.
    Raises DeclarationError where a start vector has no length.
    """

    kind = "direction"

    def __init__(self, name: str, start: ArrayLike, keys: Sequence[object] | None = None, unit: str = "rad"):
        vectors = np.array(start, dtype=float)
        if np.any(np.linalg.norm(vectors.reshape(-1, 3), axis=1) == 0.0):
            raise DeclarationError(
                f"Direction '{name}': a start vector has length zero; give an approximate direction."
            )
        self._declare(name, self._frames(vectors.reshape(-1, 3)), vectors.shape, keys, [unit] * 2, ("1", "2"))

    @staticmethod
    def _frames(vectors: Array) -> Array:
        return _columns(np.stack([np.asarray(geometry.orthonormal_frame(v), float) for v in vectors]))

    def argument(self, ambient: ca.SX, local: ca.SX) -> ca.SX:
        return geometry.move_direction(ca.reshape(ambient, 3, 3), local)

    def move(self, ambient: Array, step: Array) -> Array:
        quarter = 0.25 * np.einsum("ni,ni->n", step, step)[:, None]
        local = np.concatenate([step, 1.0 - quarter], axis=1) / (1.0 + quarter)
        return self._frames(np.einsum("nij,nj->ni", _matrices(ambient), local))

    def difference(self, ambient: Array, origin: Array) -> Array:
        return np.einsum("nij,ni->nj", _matrices(origin), self._vectors(ambient))[:, :2]

    @staticmethod
    def _vectors(stored: Array) -> Array:
        return _matrices(stored)[:, :, 2]

    def store(self, value: object) -> Array:
        return self._frames(np.broadcast_to(np.asarray(value, float), self.shape).reshape(-1, 3))

    def show(self, ambient: Array) -> Array:
        return self._vectors(ambient).reshape(self.shape).copy()


class Pose(Unknown):
    """A rigid transform `a_from_b`: the position of b's origin in a and a rotation about the axes of b.

    name: how messages call it; rotation: (3, 3) or (count, 3, 3); translation: (3,) or (count, 3) [m];
    unit, angle_unit: display units; keys: names of the instances. A model receives a Transform.
    """

    kind = "pose"

    def __init__(
        self,
        name: str,
        rotation: ArrayLike | None = None,
        translation: ArrayLike = (0.0, 0.0, 0.0),
        unit: str = "m",
        angle_unit: str = "rad",
        keys: Sequence[object] | None = None,
    ):
        shift = np.array(translation, dtype=float)
        shifts = shift.reshape(-1, 3)
        turns = np.broadcast_to(np.eye(3) if rotation is None else np.asarray(rotation, float), (len(shifts), 3, 3))
        self._turn = Rotation(f"{name}.rotation", turns)
        self._declare(
            name,
            np.concatenate([shifts, self._turn.ambient], axis=1),
            shift.shape[:-1],
            keys,
            [unit] * 3 + [angle_unit] * 3,
            ("x", "y", "z", "rx", "ry", "rz"),
        )

    def argument(self, ambient: ca.SX, local: ca.SX) -> geometry.Transform:
        return geometry.Transform(self._turn.argument(ambient[3:], local[3:]), ambient[:3] + local[:3])

    def move(self, ambient: Array, step: Array) -> Array:
        return np.concatenate([ambient[:, :3] + step[:, :3], self._turn.move(ambient[:, 3:], step[:, 3:])], axis=1)

    def difference(self, ambient: Array, origin: Array) -> Array:
        return np.concatenate(
            [ambient[:, :3] - origin[:, :3], self._turn.difference(ambient[:, 3:], origin[:, 3:])], axis=1
        )

    def store(self, value: object) -> Array:
        poses = [value] if isinstance(value, geometry.Transform) else list(value)  # type: ignore[call-overload]
        turns = np.stack([np.asarray(p.rotation, float) for p in poses])
        return np.concatenate([np.stack([np.asarray(p.translation, float).ravel() for p in poses]), _columns(turns)], 1)

    def show(self, ambient: Array) -> object:
        poses = [
            geometry.Transform(r, t)
            for r, t in zip(_matrices(ambient[:, 3:]).copy(), ambient[:, :3].copy(), strict=True)
        ]
        return poses[0] if self.shape == () else poses
