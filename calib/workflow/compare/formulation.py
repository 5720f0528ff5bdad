"""What a problem module may offer beside its declared problem: `formulations(job) -> {name: Formulation}`.

A `Problem` is another declaration of the same readings, with uncertainties of its own. The three kinds here start from
the declared problem, so that they can be run again on simulated readings. Results are matched by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from calib.problem import Problem
from calib.solve.estimate import Estimate
from calib.solve.globally.bound import Bound

Values = Mapping[str, Any]  # by the name of an unknown or quantity of the declared problem, in its declared shape, SI


@dataclass(frozen=True)
class ClosedForm:
    """Values without iteration: an algebraic fit, an eigenvalue problem, a mean.

    values: from the declared problem to values by name. Raises CalibrationError where it does not take the readings.
    """

    values: Callable[[Problem], Values]
    source: str = ""


@dataclass(frozen=True)
class Redeclared:
    """Another objective for the same readings, whose weights are no uncertainties; u is then found by simulation."""

    declare: Callable[[Problem], Problem]
    source: str = ""


@dataclass(frozen=True)
class Global:
    """A start from anywhere, the declared problem solved from it, and a lower bound over all values.

    begin: from the declared problem to start values by name; bound: from the estimate to the bound on its objective.
    Either raises CalibrationError where it does not take the problem.
    """

    begin: Callable[[Problem], Values]
    bound: Callable[[Estimate], Bound]
    source: str = ""


Formulation = Problem | ClosedForm | Redeclared | Global
