"""The two tables of the turntable paper as declared problems: three methods on one table, growth and harmonics.

Radii and distances of section 3 are not printed; where an uncertainty needs them, the assumption is a named constant.
Source: Li, Cao, Qu 2020, Metrology and Measurement Technology 40(2), 14-19, sections 2.2 and 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib import Gaussian, Linearisation, covariance, linearise, solve, variance_components
from calib.table import Table, shipped
from calib.units import arcsec, mm
from instruments import laser_tracker
from problems import circle, positioning

Array = NDArray[np.float64]

DISTANCE = 3.0                              # m, tracker to table: assumed, not printed
RADIUS = {"B1": 0.100, "B2": 0.200}         # m, edge and rod of section 2.2 taken for those of section 3: assumed
U_POLYGON = 0.5 * arcsec                    # autocollimator with polygon: assumed, not printed


def tracker_angles(command: Array, radius: float, distance: float = DISTANCE) -> Array:
    """Covariance (n, n) [rad^2] of angles from the first stop, by a fitted circle and the stated U of the tracker.

    command: (n,) [rad]; radius, distance: of the reflector from the axis and of the table from the tracker [m].
    """
    statement = shipped("turntable/published_values.csv")
    fixed, rate = (float(statement.text("value")[statement.text("key") == f"tracker_U_{name}"][0])
                   for name in ("const", "prop"))
    points = np.column_stack([distance + radius * np.cos(command), radius * np.sin(command), np.zeros_like(command)])
    polar = laser_tracker.polar_readings(points)
    u = laser_tracker.from_coordinate_statement(fixed * mm, rate * mm, 2.0).at(polar)
    fit = linearise(circle.declare(points, Gaussian.matrix(laser_tracker.cartesian_covariance(polar, u)), command))
    matrix = np.zeros((len(command), len(command)))
    matrix[1:, 1:] = covariance(fit, "angle").matrix
    return matrix


# --- table 1: three methods on one table -------------------------------------------------------------------------


@dataclass(frozen=True)
class Methods:
    """The methods of table 1 in one problem, weighed by their stated u and by estimated variance components.

    command: (n,) [rad]; stated: {method: (n, n) covariance [rad^2] of the angles from the first stop};
    by_statement, by_scatter: the two linearisations; factor, u_factor: of the stated u of each method.
    """

    command: Array
    stated: dict[str, Array]
    by_statement: Linearisation
    by_scatter: Linearisation
    factor: dict[str, float]
    u_factor: dict[str, float]

    def growth(self, name: str, fit: Linearisation) -> tuple[float, float]:
        """Growth of a method against the polygon with its standard uncertainty [1]."""
        return covariance(fit, "growth")[f"growth[{name}]"]

    def u(self, names: str, scatter: bool = False) -> Array:
        """Standard uncertainties (n,) [rad] of a column such as "B1" or "A1-B1", stated or from the scatter."""
        return np.sqrt(sum(np.diag(self.stated[name]) * (self.factor[name] ** 2 if scatter else 1.0)
                           for name in names.split("-")))


def compare_methods(table: Table) -> Methods:
    """Table 1 as one problem: common deviations of the table at each stop, and what grows with the turn."""
    command = table.number("nominal", "angle")
    stated = {"A1": U_POLYGON**2 * (np.eye(len(command)) + 1.0),
              **{name: tracker_angles(command, radius) for name, radius in RADIUS.items()}}

    def weighed(factors: dict[str, float]) -> dict[str, Gaussian]:
        stops = np.zeros(len(command) - 1, dtype=int)
        return {name: Gaussian.groups(stops, {"0": stated[name][1:, 1:] * factors[name] ** 2}) for name in stated}
    readings = {name: table.number(name, "angle") for name in stated}
    problem = positioning.declare_methods(command, readings, weighed(dict.fromkeys(stated, 1.0)))
    by_statement = linearise(solve(problem))
    components = variance_components(by_statement)
    factor = dict(components.factors)
    by_scatter = linearise(solve(problem.with_uncertainty(weighed(factor))))
    return Methods(command, stated, by_statement, by_scatter, factor,
                   dict(zip(components.names, components.u_factor.tolist())))


def growth_of(command: Array, errors: Array) -> tuple[float, float, float]:
    """Slope of errors [1] against the commanded angle, its u from the scatter, and the scatter [rad]."""
    problem = positioning.declare(command, command + errors, 1.0 * arcsec)
    scale = problem.attached_effect("angle_scale (theta)").effect
    estimate = solve(problem.free(scale))
    factor = np.sqrt(estimate.variance_factor)
    u = covariance(linearise(estimate), scale).u[0] * factor
    return float(estimate[scale][0]), float(u), float(factor * arcsec)


@dataclass(frozen=True)
class Wave:
    """One harmonic of a difference: order, amplitude and its u [rad], phase [rad], p-value of "there is none"."""

    order: int
    amplitude: float
    u: float
    phase: float
    p_value: float


def harmonics_of(command: Array, errors: Array, orders: tuple[int, ...] = (1, 2, 3)) -> tuple[Wave, ...]:
    """Harmonics of errors (n,) [rad] beside a zero and a growth, with u from the scatter that is left.

    The p-value is that of the F test with 2 and the left degrees of freedom, not corrected for the number of orders.
    """
    problem = positioning.declare(command, command + errors, 1.0 * arcsec, orders=orders[2:])
    names = {1: "encoder_ecc (theta)", 2: "encoder_2nd (theta)", **{k: f"harmonic_{k} (theta)" for k in orders[2:]}}
    waves = [problem.attached_effect(names[k]).effect for k in orders]
    estimate = solve(problem.free(problem.attached_effect("angle_scale (theta)").effect, *waves))
    fit, found = linearise(estimate), []
    for order, wave in zip(orders, waves):
        c, s = estimate[wave]
        known = covariance(fit, wave)
        matrix, amplitude = known.matrix * estimate.variance_factor, float(np.hypot(c, s))
        along = np.array([c, s]) / amplitude
        f = known.values @ np.linalg.solve(matrix, known.values) / 2.0
        found.append(Wave(order, amplitude, float(np.sqrt(along @ matrix @ along)), float(np.arctan2(s, c)),
                          float((1.0 + 2.0 * f / estimate.dof) ** (-estimate.dof / 2.0))))
    return tuple(found)
