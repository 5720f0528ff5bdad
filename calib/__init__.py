"""Optimisation-based calibration: declare a measurement once, get the estimate, its uncertainty and its reliability."""

from calib.effect import Effect, Parameter, direct, hands_slots_to
from calib.linearisation import Linearisation, linearise
from calib.observations import Constraint, Observations, Quantity, Shared, prior
from calib.problem import Problem
from calib.solve.estimate import Estimate, predict, simulate, solve
from calib.solve.gauss_newton import GaussNewton
from calib.uncertainty import Gaussian
from calib.unknown import Direction, Pose, Rotation, Unknown

__all__ = [
    "Constraint", "Direction", "Effect", "Estimate", "Gaussian", "GaussNewton", "Linearisation", "Observations", "Parameter",
    "Pose", "Problem", "Quantity", "Rotation", "Shared", "Unknown", "direct", "hands_slots_to", "linearise", "predict",
    "prior", "simulate", "solve",
]
