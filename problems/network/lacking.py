"""The errors of what cannot be adjusted, with its names for a caller who wants to go on without it."""

from __future__ import annotations

from collections.abc import Sequence

from calib.errors import InputError


class Lacking(InputError):
    """Points lack readings; `points` are their names, of points in frames those of the places where they lack them."""

    def __init__(self, message: str, points: Sequence[str]):
        super().__init__(message)
        self.points = tuple(points)


class Contradicting(InputError):
    """Readings contradict all others by their unit; `groups` are their names."""

    def __init__(self, message: str, groups: Sequence[str]):
        super().__init__(message)
        self.groups = tuple(groups)
