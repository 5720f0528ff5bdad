"""What a method is: an object with typed fields that takes a system and values and returns values."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from calib.blocks import Array
from calib.errors import MethodRefusal
from calib.problem import Problem
from calib.system import System, Values
from calib.unknown import Unknown


@dataclass(frozen=True)
class Outcome:
    """What a method hands back: stored values, whether it stopped by itself, steps taken, and a sentence.

    gap: bound on the distance of the objective from its minimum, where the method proves one (else None).
    """

    values: dict[Unknown, Array]
    converged: bool
    iterations: int
    message: str
    gap: float | None = None
    notes: dict[str, float] = field(default_factory=dict)


class Method(ABC):
    """A way to solve a declared problem."""

    name: str = "method"
    least_squares: bool = True  # whether it minimises v'Pv; another loss is judged by its duality gap

    @abstractmethod
    def refusal(self, system: System) -> str | None:
        """Why this method cannot take the problem, as a sentence; None where it can."""

    @abstractmethod
    def minimise(self, system: System, start: Values) -> Outcome:
        """Minimise the declared objective from start values."""

    def accept(self, system: System) -> None:
        """Raise MethodRefusal where the problem is not for this method."""
        why = self.refusal(system)
        if why is not None:
            raise MethodRefusal(f"{self.name} does not accept {system.problem.name}: {why}")


def missing_readings(problem: Problem) -> str | None:
    """A sentence naming observations without readings, which can be planned but not solved."""
    empty = [o.group for o in problem.observations if o.readings is None]
    return (
        f"observations '{empty[0]}' have no readings; give readings, or linearise(problem, values) to plan"
        if empty
        else None
    )
