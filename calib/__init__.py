"""Optimisation-based calibration: declare a measurement once, get the estimate, its uncertainty and its reliability.

What declares and solves is imported here; analyses, further methods and workflows are loaded when first asked for.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING
from typing import Any as _Any

from calib.analyse.covariance import Covariance, covariance
from calib.effect import Effect, Parameter, direct, hands_slots_to
from calib.linearisation import Linearisation, linearise
from calib.observations import Constraint, Observations, Quantity, Shared, prior
from calib.problem import Problem
from calib.solve.estimate import Estimate, predict, simulate, solve
from calib.solve.gauss_newton import GaussNewton
from calib.uncertainty import Gaussian
from calib.unknown import Direction, Pose, Rotation, Unknown

if TYPE_CHECKING:
    from calib.analyse.budget import Budget, budget
    from calib.analyse.components import VarianceComponents, variance_components
    from calib.analyse.estimability import Estimability, estimability
    from calib.analyse.reliability import Reliability, reliability
    from calib.analyse.selection.criterion import A, C, D, Ds, E, G, I, WorstCase
    from calib.analyse.selection.floors import Floors
    from calib.analyse.selection.method import BranchAndBound, Conic, Exchange, Exhaustive, Greedy, Relaxation
    from calib.analyse.selection.select import Choice, select
    from calib.solve.convex import Convex
    from calib.solve.ipopt import ExactHessian, GaussNewtonHessian, Ipopt
    from calib.solve.loss import L1, Huber, LeastSquares, MinimumZone
    from calib.solve.robust import RobustEstimate, Truncated, robust
    from calib.workflow.discrepancy.explain import Explanation, explain
    from calib.workflow.montecarlo import Adaptive, MonteCarlo, montecarlo

_LATER = {
    "analyse.budget": ("Budget", "budget"),
    "analyse.components": ("VarianceComponents", "variance_components"),
    "analyse.estimability": ("Estimability", "estimability"),
    "analyse.reliability": ("Reliability", "reliability"),
    "analyse.selection.criterion": ("A", "C", "D", "Ds", "E", "G", "I", "WorstCase"),
    "analyse.selection.floors": ("Floors",),
    "analyse.selection.method": ("BranchAndBound", "Conic", "Exchange", "Exhaustive", "Greedy", "Relaxation"),
    "analyse.selection.select": ("Choice", "select"),
    "solve.convex": ("Convex",),
    "solve.ipopt": ("ExactHessian", "GaussNewtonHessian", "Ipopt"),
    "solve.loss": ("L1", "Huber", "LeastSquares", "MinimumZone"),
    "solve.robust": ("RobustEstimate", "Truncated", "robust"),
    "workflow.discrepancy.explain": ("Explanation", "explain"),
    "workflow.montecarlo": ("Adaptive", "MonteCarlo", "montecarlo"),
}
_WHERE = {name: f"calib.{module}" for module, names in _LATER.items() for name in names}


def __getattr__(name: str) -> _Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'calib' has no attribute '{name}'")
    return getattr(_import_module(_WHERE[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)


__all__ = [
    "L1",
    "A",
    "Adaptive",
    "BranchAndBound",
    "Budget",
    "C",
    "Choice",
    "Conic",
    "Constraint",
    "Convex",
    "Covariance",
    "D",
    "Direction",
    "Ds",
    "E",
    "Effect",
    "Estimability",
    "Estimate",
    "ExactHessian",
    "Exchange",
    "Exhaustive",
    "Explanation",
    "Floors",
    "G",
    "GaussNewton",
    "GaussNewtonHessian",
    "Gaussian",
    "Greedy",
    "Huber",
    "I",
    "Ipopt",
    "LeastSquares",
    "Linearisation",
    "MinimumZone",
    "MonteCarlo",
    "Observations",
    "Parameter",
    "Pose",
    "Problem",
    "Quantity",
    "Relaxation",
    "Reliability",
    "RobustEstimate",
    "Rotation",
    "Shared",
    "Truncated",
    "Unknown",
    "VarianceComponents",
    "WorstCase",
    "budget",
    "covariance",
    "direct",
    "estimability",
    "explain",
    "hands_slots_to",
    "linearise",
    "montecarlo",
    "predict",
    "prior",
    "reliability",
    "robust",
    "select",
    "simulate",
    "solve",
    "variance_components",
]
