"""The errors of the framework: each is one sentence of what is wrong, with names and numbers, then what to do."""

from __future__ import annotations

from collections.abc import Iterable


class CalibrationError(Exception):
    """Anything that the framework refuses; `str(error)` and `error.sentence` are what a person reads.

    sentence: what is wrong with names and numbers, then what to do.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(sentence)
        self.sentence = sentence


class InputError(CalibrationError):
    """A file, table, unit or text that cannot be used as it stands."""


class DeclarationError(CalibrationError):
    """A declaration in Python that contradicts itself: a wrong length, an unknown name, a slot that does not exist."""


class RankDefect(CalibrationError):
    """Directions of the free unknowns that no reading, prior or constraint sees.

    sentence: as for every error; directions: one text for each unseen direction, in the words of the declaration.
    """

    def __init__(self, sentence: str, directions: Iterable[object] = ()) -> None:
        super().__init__(sentence)
        self.directions = tuple(directions)


class MethodRefusal(CalibrationError):
    """A method that does not solve this kind of problem, with the reason and the method that does."""


class ModelBreakdown(CalibrationError):
    """A model that gives no finite number at the present values of the unknowns."""
