"""Readings to points that stand in frames: the models and their uncertainty, with the frames that the points are in."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from casadi import vertcat
from numpy.typing import NDArray

from calib import Gaussian, Quantity, Unknown, direct
from calib.effect import positional_of, slots_of
from problems.network import frames

if TYPE_CHECKING:
    from problems.network.survey import Survey

SHOWN = 200      # places of points in frames that are results of their own


class OnFrames:
    """A model whose points may stand in frames: after its own arguments it takes, for each of `levels` (number of the
    argument of the point, whether only some rows are in it), the frame, and then which rows are.

    parts: the coordinates that points have.
    """

    def __init__(self, model: Callable[..., Any], levels: Sequence[tuple[int, bool]], parts: str):
        self.model, self.levels, self.parts = model, tuple(levels), parts
        own = positional_of(model)
        self.own = len(own)
        self.names = [name for k, (end, mixed) in enumerate(levels)
                      for name in (f"{own[end]}_frame_{k}", *([f"{own[end]}_inside_{k}"] if mixed else []))]
        self.ends = {own[end] for end, _ in levels}
        kind = inspect.Parameter
        self.__signature__ = inspect.Signature(
            [kind(name, kind.POSITIONAL_ONLY) for name in (*own, *self.names)]
            + [kind(slot, kind.KEYWORD_ONLY, default=direct) for slot in slots_of(model)])
        self.__name__ = getattr(model, "__name__", "model")

    def __call__(self, *given: Any, **slots: Any) -> Any:
        arguments = list(given[: self.own])
        for end, point in self.placed(arguments, given[self.own :]).items():
            arguments[end] = vertcat(*(c for c, part in zip(point, "xyz") if part in self.parts))
        return self.model(*arguments, **slots)

    def placed(self, arguments: Sequence[Any], further: Sequence[Any]) -> dict[int, list[Any]]:
        """Where the points stand: {number of the argument: x, y, z}."""
        found: dict[int, list[Any]] = {}
        rest = iter(further)
        for end, mixed in self.levels:
            if end not in found:
                own = dict(zip(self.parts, (arguments[end][i] for i in range(len(self.parts)))))
                found[end] = [own.get(part, 0.0) for part in "xyz"]
            there = frames.moved(found[end], next(rest))
            share = next(rest) if mixed else None
            found[end] = list(there) if share is None else [
                share * new + (1 - share) * old for new, old in zip(there, found[end])]
        return found


class CarriedNoise(Gaussian):
    """An uncertainty that depends on where points are, for a model on frames."""

    def __init__(self, stated: Gaussian, model: OnFrames):
        self.stated, self.model = stated, model

    @property
    def needs(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.stated.needs, *self.model.names)))

    def kept(self, keep: NDArray[np.bool_]) -> Gaussian:
        return CarriedNoise(self.stated.kept(keep), self.model)

    def weighting(self, n, dim, where, quantities=None):  # type: ignore[no-untyped-def]
        own = positional_of(self.model.model)

        def standing(name: str) -> Any:
            if name not in self.model.ends:
                return quantities(name)
            arguments = [quantities(one).T if one in self.model.ends else None for one in own]
            further = [value if len(value) > 1 else value[0] for value in
                       (quantities(one).T for one in self.model.names)]
            point = self.model.placed(arguments, further)[own.index(name)]
            return np.column_stack([np.broadcast_to(c, n) for c, part in zip(point, "xyz") if part in self.model.parts])

        return self.stated.weighting(n, dim, where, standing)


def on_frames(
    model: Callable[..., Any], ends: Sequence[tuple[int, Any]], epochs: Any, survey: Survey, frame: Unknown | None
) -> tuple[Callable[..., Any], list[Any]]:
    """A model with the frames that its points stand in, and the arguments it then takes after its own.

    ends: (number of the argument, keys (n,)) of the points; epochs: (n,) or None; frame: the unknown of all frames.
    """
    levels: list[tuple[int, bool]] = []
    further: list[Any] = []
    if frame is None:
        return model, further
    for end, keys in ends:
        inside = frames.standing(survey, keys, epochs)
        for depth in range(max(map(len, inside), default=0)):
            rows = np.array([len(one) > depth for one in inside])
            levels.append((end, not rows.all()))
            further.append(frame[np.array([one[depth] if len(one) > depth else 0 for one in inside])])
            further += [] if rows.all() else [rows.astype(float)]
    return (OnFrames(model, levels, survey.parts) if levels else model), further


def with_noise(u: Any, model: Callable[..., Any]) -> Gaussian:
    """The uncertainty of readings of a model that may stand on frames."""
    stated = u if isinstance(u, Gaussian) else Gaussian.standard(u)
    return CarriedNoise(stated, model) if isinstance(model, OnFrames) and model.ends & set(stated.needs) else stated


def frame_unknown(survey: Survey) -> Unknown | None:
    """The unknown `frame`: six numbers of every frame in every epoch."""
    if not survey.frames:
        return None
    return Unknown("frame", np.array([one.place for one in survey.frames], float), frames.UNITS, frames.PARTS,
                   [one.key for one in survey.frames])


def held(survey: Survey, frame: Unknown) -> list[Any]:
    """What of the frames does not move."""
    still = [(i, [part for part in frames.PARTS if part not in one.free]) for i, one in enumerate(survey.frames)]
    return [frame[i].part(*parts) for i, parts in still if parts]


def positions(survey: Survey, point: Unknown, frame: Unknown) -> list[Quantity]:
    """The derived result `position`: where points of frames stand in the network, in every epoch they are read in."""
    taken = frames.places_taken(survey)
    depths = {len(inside) for _, inside in taken.values()}
    found = []
    for depth in sorted(depths) if len(taken) <= SHOWN else ():
        chosen = {name: one for name, one in taken.items() if len(one[1]) == depth}
        model = OnFrames(_itself, [(0, False)] * depth, survey.parts)
        found.append(Quantity(
            "position" if len(depths) == 1 else f"position_{depth}", model,
            point[np.array([point.keys.index(key) for key, _ in chosen.values()])],
            *(frame[np.array([inside[level] for _, inside in chosen.values()])] for level in range(depth)),
            unit="m", parts=tuple(survey.parts), keys=list(chosen)))
    return found


def _itself(point: Any) -> Any:
    return point
