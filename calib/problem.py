"""The problem: observations, constraints, quantities, effects and what is held, as one frozen declaration."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.effect import Effect
from calib.errors import DeclarationError
from calib.frozen import Frozen
from calib.observations import Constraint, Observations, Quantity
from calib.trace import offered
from calib.unknown import Selection, Unknown


@dataclass(frozen=True, eq=False)
class Attached:
    """An effect in a problem: its parameters as an unknown, one instance for each key, and where it acts."""

    effect: Effect
    unknown: Unknown
    keys: tuple[str, ...]
    places: tuple[str, ...]

    def index(self, observations: Observations) -> NDArray[np.int64]:
        """Instance of the parameters for each row."""
        if self.effect.per is None:
            return np.zeros(observations.n, dtype=np.int64)
        place = {key: i for i, key in enumerate(self.keys)}
        return np.array([place[str(key)] for key in observations.covariates[self.effect.per]], dtype=np.int64)


def _acts_on(effect: Effect, observations: Observations) -> bool:
    if effect.groups is not None and observations.group not in effect.groups:
        return False
    if effect.slot not in observations.slots or (effect.per is not None and effect.per not in observations.covariates):
        return False
    names = offered(observations).get(effect.slot)
    return names is not None and all(name in names for name in effect.inputs)


def _attach(effect: Effect, observations: Sequence[Observations]) -> Attached:
    places = [o for o in observations if _acts_on(effect, o)]
    if not places:
        there = {
            f"{o.group}: {slot}({', '.join(sorted(names))})" for o in observations for slot, names in offered(o).items()
        }
        needs = ", ".join([*effect.inputs, *([effect.per] if effect.per else [])]) or "nothing"
        raise DeclarationError(
            f"effect '{effect.label}' acts nowhere: no observations have slot '{effect.slot}' and offer "
            f"{needs}. There are: {'; '.join(sorted(there)) or 'no slots'}."
        )
    keys: dict[str, None] = {}
    if effect.per is not None:
        for o in places:
            keys.update(dict.fromkeys(str(k) for k in o.covariates[effect.per]))
    names = [p.name for p in effect.parameters]
    unknown = Unknown(
        effect.label,
        np.zeros((max(len(keys), 1), len(names))),
        parts=names,
        keys=tuple(keys) or None,
        unit=[p.unit for p in effect.parameters],
        lower=[p.lower for p in effect.parameters],
        upper=[p.upper for p in effect.parameters],
    )
    return Attached(effect, unknown, tuple(keys), tuple(o.group for o in places))


class Problem(Frozen):
    """One declared estimation problem; `free`, `hold` and the `with_` methods return a new one.

    observations: with priors among them; constraints; quantities: derived results to report; effects: attached, zero
    and held; held: unknowns, instances, parts or effects that stay at their start; name: how reports call it.
    Raises DeclarationError for two unknowns, groups or quantities of one name, or an effect that acts nowhere.
    """

    def __init__(
        self,
        observations: Sequence[Observations],
        constraints: Sequence[Constraint] = (),
        quantities: Sequence[Quantity] = (),
        effects: Sequence[Effect] = (),
        held: Sequence[Any] = (),
        name: str = "problem",
    ):
        self.name = name
        self.observations, self.constraints, self.quantities = (
            tuple(observations),
            tuple(constraints),
            tuple(quantities),
        )
        self.attached: tuple[Attached, ...] = ()
        self.held_masks: Mapping[Unknown, NDArray[np.bool_]] = {}
        if not self.observations:
            raise DeclarationError(f"{name}: no observations; a problem needs at least one.")
        self._check_names()
        if effects:
            self.__dict__.update(self.with_effects(*effects).__dict__)
        if held:
            self.__dict__.update(self.hold(*held).__dict__)

    def _check_names(self) -> None:
        for what, names in (
            ("unknowns", [u.name for u in self.unknowns]),
            ("groups", [o.group for o in self.observations]),
            ("quantities", [q.name for q in self.quantities]),
        ):
            twice = {n for n in names if names.count(n) > 1}
            if twice:
                raise DeclarationError(
                    f"{self.name}: two {what} are called '{sorted(twice)[0]}'; give each its own name."
                )

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The attached effects."""
        return tuple(a.effect for a in self.attached)

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """All unknowns in order of appearance, the parameters of effects last."""
        seen: dict[Unknown, None] = {}
        for bound in (*self.observations, *self.constraints, *self.quantities):
            seen.update(dict.fromkeys(bound.unknowns))
        seen.update(dict.fromkeys(a.unknown for a in self.attached))
        return tuple(seen)

    def attached_effect(self, effect: Effect | str) -> Attached:
        """The attached form of an effect or of its label."""
        for attached in self.attached:
            if attached.effect is effect or effect in (attached.effect.name, attached.effect.label):
                return attached
        name = effect if isinstance(effect, str) else effect.label
        raise DeclarationError(
            f"{self.name} has no effect '{name}'; {self._known([a.effect.label for a in self.attached], name)}"
        )

    @staticmethod
    def _known(names: Sequence[str], wanted: str) -> str:
        near = difflib.get_close_matches(wanted, names, 1)
        return (f"did you mean '{near[0]}'? " if near else "") + f"There are: {', '.join(names) or 'none'}."

    def parameters(self, effect: Effect | str) -> Unknown:
        """The unknown that holds the parameters of an attached effect (for priors and selections)."""
        return self.attached_effect(effect).unknown

    def select(self, what: Any) -> Selection:
        """The selection that an unknown, a selection, an effect or a name points to."""
        if isinstance(what, Selection):
            selection = what
        elif isinstance(what, Unknown):
            selection = Selection(what)
        elif isinstance(what, Effect):
            selection = Selection(self.parameters(what))
        else:
            by_name = {u.name: u for u in self.unknowns}
            if what not in by_name:
                raise DeclarationError(f"{self.name} has no unknown '{what}'; {self._known(list(by_name), str(what))}")
            selection = Selection(by_name[what])
        if selection.unknown not in self.unknowns:
            if selection.unknown.name in [u.name for u in self.unknowns]:
                raise DeclarationError(
                    f"'{selection.unknown.name}' of {self.name} is another unknown of the same name; use the "
                    "handle that this problem was declared with, or its name."
                )
            raise DeclarationError(
                f"unknown '{selection.unknown.name}' does not occur in {self.name}; "
                f"{self._known([u.name for u in self.unknowns], selection.unknown.name)}"
            )
        return selection

    def _with(self, **changes: Any) -> Problem:
        copy = object.__new__(Problem)
        copy.__dict__.update(self.__dict__, **changes)
        copy._check_names()
        return copy

    def _masked(self, what: Sequence[Any], held: bool) -> Problem:
        masks = dict(self.held_masks)
        for item in what:
            selection = self.select(item)
            mask = masks.get(
                selection.unknown, np.zeros((selection.unknown.count, selection.unknown.freedom), bool)
            ).copy()
            mask[selection.mask()] = held
            mask.flags.writeable = False
            masks[selection.unknown] = mask
        return self._with(held_masks=masks)

    def hold(self, *what: Any) -> Problem:
        """Hold unknowns, instances, parts or effects at their values."""
        return self._masked(what, True)

    def free(self, *what: Any) -> Problem:
        """Free unknowns, instances, parts or effects, so that they are estimated."""
        return self._masked(what, False)

    def is_held(self, unknown: Unknown) -> NDArray[np.bool_]:
        """Boolean (count, freedom): what of an unknown is held."""
        mask = self.held_masks.get(unknown)
        return np.zeros((unknown.count, unknown.freedom), bool) if mask is None else mask

    def acting(self, effects: Sequence[Effect]) -> tuple[Effect, ...]:
        """Those of several effects that would act somewhere: slot and inputs are there."""
        return tuple(e for e in effects if any(_acts_on(e, o) for o in self.observations))

    def with_effects(self, *effects: Effect) -> Problem:
        """Attach effects, zero and held."""
        new = tuple(_attach(e, self.observations) for e in effects if e not in self.effects)
        return self._with(attached=self.attached + new).hold(*[a.unknown for a in new])

    def with_observations(self, *observations: Observations) -> Problem:
        """Add observations, such as priors."""
        bigger = self._with(observations=self.observations + tuple(observations), attached=())
        again = []
        for attached in self.attached:
            anew = _attach(attached.effect, bigger.observations)
            again.append(
                Attached(attached.effect, attached.unknown, attached.keys, anew.places)
                if anew.keys == attached.keys
                else anew
            )
        return bigger._with(attached=tuple(again))

    def with_quantities(self, *quantities: Quantity) -> Problem:
        """Add derived quantities."""
        return self._with(quantities=self.quantities + tuple(quantities))

    def with_addition(self, group: Observations | str, coefficients: Unknown, columns: ArrayLike) -> Problem:
        """The same problem with a sum without physics added to the predictions of a group; see Observations."""
        name = self._group(group)
        return self._replaced(lambda o: o.with_addition(coefficients, columns) if o.group == name else o)

    def _replaced(self, change: Callable[[Observations], Observations | None]) -> Problem:
        return self._with(observations=tuple(n for n in (change(o) for o in self.observations) if n is not None))

    def _group(self, key: Observations | str) -> str:
        name = key.group if isinstance(key, Observations) else key
        groups = [o.group for o in self.observations]
        if name not in groups:
            raise DeclarationError(f"{self.name} has no observations '{name}'; {self._known(groups, name)}")
        return name

    def with_readings(self, readings: Mapping[Any, ArrayLike]) -> Problem:
        """The same problem with other readings: {group or observations: (n,) or (n, dim) in SI}."""
        new = {self._group(key): values for key, values in readings.items()}
        return self._replaced(lambda o: o.with_readings(new[o.group]) if o.group in new else o)

    def with_uncertainty(self, uncertainties: Mapping[Any, Any]) -> Problem:
        """The same problem with other Gaussians: {group or observations: Gaussian}."""
        new = {self._group(key): u for key, u in uncertainties.items()}
        return self._replaced(
            lambda o: o.with_readings(None if o.readings is None else o.readings, new[o.group]) if o.group in new else o
        )

    def keep(self, rows: Mapping[Any, NDArray[np.bool_]]) -> Problem:
        """The same problem with only some rows: {group or observations: (n,) true where a row stays}.

        A group of which nothing stays is left out. Effects keep their parameters.
        """
        masks = {self._group(key): np.asarray(mask, bool) for key, mask in rows.items()}
        return self._replaced(
            lambda o: o if o.group not in masks else o.keep(masks[o.group]) if masks[o.group].any() else None
        )

    def without(self, *groups: Any) -> Problem:
        """The same problem without some groups of observations."""
        names = {self._group(g) for g in groups}
        return self._replaced(lambda o: None if o.group in names else o)

    def __repr__(self) -> str:
        return (
            f"Problem('{self.name}', {len(self.observations)} groups, "
            f"{sum(o.n for o in self.observations)} rows, {len(self.unknowns)} unknowns)"
        )
