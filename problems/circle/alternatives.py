"""Other ways to a space circle from the same points: algebraic fits, bisecting planes, mean of positions, a bound.

They stand beside the orthogonal distance of `problems.circle` for `calib compare`.
Source: of each fit at the fit; bisecting planes: Pan and Li, "vector method", as cited by Wang et al. 2015 (five-axis
paper), and its mean of four positions.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from calib import Estimate, Problem
from calib.errors import InputError
from calib.solve.globally.bound import Bound
from calib.solve.globally.spheres import eigenvalue
from calib.workflow.compare.formulation import ClosedForm, Formulation, Global, Redeclared, Values
from problems.circle import algebraic, pairwise

Array = NDArray[np.float64]
EVEN = 0.02      # departure of the steps from their mean, as a share, up to which positions count as evenly spread


def formulations(command: Array | None) -> dict[str, Formulation]:
    """The formulations of a space circle; command: (n,) [rad] commanded angles, where they are known."""
    return {
        "equation 8": Redeclared(lambda declared: pairwise.pairwise(points_of(declared)), PAPER),
        "equation 14": Redeclared(lambda declared: pairwise.weighted_pairwise(
            points_of(declared), weights_of(declared)), PAPER),
        "equation 14 repaired": Redeclared(lambda declared: pairwise.repaired_pairwise(
            points_of(declared), weights_of(declared)), PAPER),
        "Kasa": ClosedForm(fitted(algebraic.kasa, command), "Kasa 1976"),
        "Pratt": ClosedForm(fitted(algebraic.pratt, command), "Pratt 1987"),
        "Taubin": ClosedForm(fitted(algebraic.taubin, command), "Taubin 1991"),
        "bisecting planes": ClosedForm(bisecting_planes, "Pan and Li, vector method"),
        "mean of positions": ClosedForm(lambda declared: mean_of_positions(declared, command), "five-axis paper"),
        "eigenvalue bound": Global(lambda declared: {}, eigenvalue_bound, "Pratt 1987, as a bound"),
    }


PAPER = "Li, Cao, Qu 2020"


def points_of(declared: Problem) -> Array:
    """The points (n, 3) [m] of a declared circle."""
    return np.asarray(declared.observations[0].readings, float)


def weights_of(declared: Problem) -> Array:
    """The paper's weights (n,), from the stated covariances."""
    seen = declared.observations[0]
    return pairwise.weights(seen.uncertainty.weighting(seen.n, 3, "points").u)


def fitted(fit: Callable[[Array], Array], command: Array | None) -> Callable[[Problem], Values]:
    """Centre, normal and radius by an algebraic fit in the plane of least squares."""
    def values(declared: Problem) -> Values:
        found = algebraic.space_circle(points_of(declared), fit, command)
        return {"centre": found.centre, "normal": found.normal, "radius": found.radius}
    return values


def bisecting_planes(declared: Problem) -> Values:
    """Centre [m] where the planes that bisect all chords meet in the plane of the points; radius: mean distance."""
    points = points_of(declared)
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle)[2][2]
    i, j = np.triu_indices(len(points), 1)
    chords = np.vstack([points[j] - points[i], normal * np.ptp(points)])
    right = np.append(np.sum((points[j] - points[i]) * (points[i] + points[j]) / 2, axis=1),
                      normal @ middle * np.ptp(points))
    centre = np.linalg.lstsq(chords, right, rcond=None)[0]
    return {"centre": centre, "radius": float(np.linalg.norm(points - centre, axis=1).mean())}


def mean_of_positions(declared: Problem, command: Array | None) -> Values:
    """Centre [m] as the mean of points that divide the turn evenly; the last may repeat the first.

    Raises InputError where they do not: on a part of a turn the mean of the points is not the centre.
    """
    points = points_of(declared)
    if command is None:
        raise InputError("the commanded angles are not known, so that nothing says that the points divide the turn "
                         "evenly")
    turned = np.asarray(command, float) - command[0]
    last = len(points) - 1 if abs(abs(turned[-1]) - 2.0 * np.pi) < EVEN else len(points)
    steps = np.abs(np.diff(np.append(turned[:last], np.sign(turned[1]) * 2.0 * np.pi)))
    if np.any(np.abs(steps - steps.mean()) > EVEN * steps.mean()):
        raise InputError("the points do not divide the turn evenly, so that their mean is not the centre")
    centre = points[:last].mean(axis=0)
    return {"centre": centre, "radius": float(np.linalg.norm(points[:last] - centre, axis=1).mean())}


def eigenvalue_bound(estimate: Estimate) -> Bound:
    """A bound on v'Pv of a space circle: the offsets from the best plane and the distances from the best sphere.

    Of each covariance only the largest eigenvalue is used, so that the bound is loose where directions differ.
    """
    points = points_of(estimate.problem)
    u = np.zeros(len(points))
    for mixing in estimate.fit.groups[0].weighting.factors:
        longest = np.linalg.norm(mixing.matrix, 2, axis=(1, 2)) if mixing.matrix.ndim == 3 else (
            np.abs(mixing.matrix).max(axis=1))
        u[mixing.rows] = longest[:, None]
    objective = estimate.objective
    weight = u**-2
    middle = weight @ points / weight.sum()
    plane = float(np.linalg.eigvalsh(((points - middle) * weight[:, None]).T @ (points - middle))[0])
    away = u * np.sqrt(objective)
    smallest = 0.5 * float(np.linalg.norm(points[:, None] - points[None], axis=2).max()) - float(away.max())
    # the algebraic distance from a sphere through the circle differs from the distance by the square of the offset
    lost = float(np.linalg.norm(away**2 / (2.0 * smallest) / u)) if smallest > 0.0 else np.inf
    sphere = max(np.sqrt(max(eigenvalue(points, u), 0.0)) - lost, 0.0) ** 2
    return Bound(min(plane + sphere, objective), objective,
                 "the best plane and the best sphere by eigenvalues, each point with its largest uncertainty")
