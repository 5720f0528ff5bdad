"""How a choice is searched: each method is an object with its fields."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Greedy:
    """Take again and again the candidate that helps most."""

    name = "greedy"


@dataclass(frozen=True)
class Exchange:
    """Greedy, then Fedorov's exchange; and the rounded relaxation, then exchange; the better of both.

    swaps: at most.
    """

    swaps: int = 10_000
    name = "exchange"


@dataclass(frozen=True)
class Relaxation:
    """The convex relaxation by the framework's own interior point, rounded, then exchange."""

    name = "relaxation"


@dataclass(frozen=True)
class Conic:
    """The convex relaxation as a conic program of CVXPY, solved by Clarabel, rounded, then exchange; for hundreds of
    candidates at most. Its bound is recomputed at the weights it returns."""

    name = "conic"


@dataclass(frozen=True)
class Exhaustive:
    """Every subset; refused where there are more than `most`."""

    most: int = 5_000_000
    name = "exhaustive"


@dataclass(frozen=True)
class BranchAndBound:
    """Proven optimum by relaxations of ever smaller parts; nodes, seconds: at most, then the bound that was reached.

    tolerance: gap in the logarithm of the criterion that counts as none.
    """

    nodes: int = 20_000
    seconds: float = 60.0
    tolerance: float = 1e-7
    name = "branch and bound"


Method = Greedy | Exchange | Relaxation | Conic | Exhaustive | BranchAndBound
