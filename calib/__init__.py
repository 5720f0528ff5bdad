"""Optimisation-based calibration: declare a measurement once, get the estimate, its uncertainty and its reliability."""

from calib.analyse.budget import Budget, budget
from calib.analyse.components import VarianceComponents, variance_components
from calib.analyse.covariance import Covariance, covariance
from calib.analyse.estimability import Estimability, estimability
from calib.analyse.reliability import Reliability, reliability
from calib.effect import Effect, Parameter, direct, hands_slots_to
from calib.linearisation import Linearisation, linearise
from calib.observations import Constraint, Observations, Quantity, Shared, prior
from calib.problem import Problem
from calib.solve.estimate import Estimate, predict, simulate, solve
from calib.solve.gauss_newton import GaussNewton
from calib.solve.ipopt import ExactHessian, GaussNewtonHessian, Ipopt
from calib.uncertainty import Gaussian
from calib.unknown import Direction, Pose, Rotation, Unknown
from calib.workflow.discrepancy.explain import Explanation, explain
from calib.workflow.montecarlo import MonteCarlo, montecarlo

__all__ = [
    "Budget",
    "Constraint",
    "Covariance",
    "Direction",
    "Effect",
    "Estimability",
    "Estimate",
    "ExactHessian",
    "Explanation",
    "GaussNewton",
    "GaussNewtonHessian",
    "Gaussian",
    "Ipopt",
    "Linearisation",
    "MonteCarlo",
    "Observations",
    "Parameter",
    "Pose",
    "Problem",
    "Quantity",
    "Reliability",
    "Rotation",
    "Shared",
    "Unknown",
    "VarianceComponents",
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
    "simulate",
    "solve",
    "variance_components",
]
