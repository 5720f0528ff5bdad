"""What a global formulation proves: a lower bound on v'Pv, and the gap to an answer."""

from __future__ import annotations

from dataclasses import dataclass

PROVEN = 1e-8  # relative gap up to which an answer is called the global minimum


@dataclass(frozen=True)
class Bound:
    """A lower bound on the objective of a problem over all values of its unknowns.

    lower: no values give less; objective: at the answer that was looked at; proof: what the bound stands on, a clause.
    """

    lower: float
    objective: float
    proof: str

    @property
    def gap(self) -> float:
        """By which share of the objective (of at least 1e-12) the bound stays below it; never negative."""
        return float(max(self.objective - self.lower, 0.0) / max(abs(self.objective), 1e-12))

    @property
    def proven(self) -> bool:
        """Whether the answer is the global minimum, to the relative gap `PROVEN`."""
        return self.gap <= PROVEN

    @property
    def sentence(self) -> str:
        """What the bound says, in words."""
        if self.proven:
            size = "1e-8" if self.gap > 1e-12 else "1e-12"
            return f"This is the global minimum, proven to a relative gap of {size}: {self.proof}."
        return (f"Not proven global: no values give v'Pv below {self.lower:.6g}, the answer has {self.objective:.6g}, "
                f"a relative gap of {self.gap:.1e} (the relaxation is not tight): {self.proof}.")


def best(*bounds: Bound) -> Bound:
    """The highest of several bounds on one objective."""
    return max(bounds, key=lambda bound: bound.lower)
