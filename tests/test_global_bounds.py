"""Global lower bounds: proven where they are tight, honest where they are not, and never above the objective."""

from __future__ import annotations

import numpy as np
import pytest

import calib
from calib import Gaussian, Observations, Pose, Problem, Unknown
from calib.geometry import Transform, norm, rotation_about
from calib.solve.globally.bound import Bound, best
from calib.solve.globally.increments import bisection_bound
from calib.solve.globally.quadratic import QuadraticProgram, lower_bound
from calib.solve.globally.ranges import convexity_bound, relaxation_bound, squared_ranges
from calib.solve.globally.rotation import closed_form, pose_bound
from calib.solve.globally.spheres import sphere_bound
from calib.units import um


def carried(pose, point):
    return pose @ point


def distance(point, place):
    return norm(place - point)


def change(point, length, place):
    return norm(place - point) - length


def off_circle(centre, radius, place):
    return norm(place - centre) - radius


def aligned(seed: int, noise: float, count: int = 8) -> tuple[calib.Estimate, Pose, np.ndarray, np.ndarray, np.ndarray]:
    """Points carried by an unknown pose, each with its own long and thin covariance; the solved problem."""
    generator = np.random.default_rng(seed)
    points = generator.normal(size=(count, 3))
    root = noise * generator.normal(size=(count, 3, 3))
    covariance = root @ root.transpose(0, 2, 1) + 1e-2 * noise**2 * np.eye(3)
    axis = generator.normal(size=3)
    turn = np.asarray(rotation_about(axis / np.linalg.norm(axis), generator.uniform(0.0, np.pi)), float)
    exact = points @ turn.T + generator.normal(size=3)
    seen = exact + np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), generator.normal(size=(count, 3)))
    rotation, translation = closed_form(points, seen)
    pose = Pose("pose", rotation, translation)
    problem = Problem([Observations(carried, pose, points, readings=seen, u=Gaussian.matrix(covariance), group="seen")])
    return calib.solve(problem), pose, points, seen, covariance


def ranged(seed: int, u: float, count: int = 10) -> tuple[calib.Estimate, np.ndarray, np.ndarray, Unknown]:
    """A point from its distances to points of a volume, solved from the trust region of squared ranges."""
    generator = np.random.default_rng(seed)
    places, truth = generator.uniform(-1, 1, (count, 3)), generator.uniform(-2, 2, 3)
    readings = np.linalg.norm(places - truth, axis=1) + u * generator.normal(size=count)
    point = Unknown("point", squared_ranges(places, readings, u))
    problem = Problem([Observations(distance, point, places, readings=readings, u=u, group="ranges")])
    return calib.solve(problem), places, readings, point


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("noise", [1e-5, 1e-3, 1e-1])
def test_a_pose_with_anisotropic_covariances_is_proven_global(seed, noise):
    estimate, pose, points, seen, covariance = aligned(seed, noise)
    bound = pose_bound(points, seen, covariance, estimate[pose].rotation)
    assert bound.proven and "global minimum, proven" in bound.sentence
    assert bound.objective == pytest.approx(estimate.objective, rel=1e-9)


def test_a_rotation_that_is_not_the_best_is_not_proven():
    estimate, pose, points, seen, covariance = aligned(1, 1e-3)
    axis = np.array([0.0, 0.0, 1.0])
    turned = np.asarray(rotation_about(axis, 0.5), float) @ estimate[pose].rotation
    bound = pose_bound(points, seen, covariance, turned)
    assert not bound.proven and "Not proven" in bound.sentence
    assert bound.lower <= estimate.objective * (1 + 1e-9)


def test_the_relaxation_of_ranges_is_loose_about_every_second_time_and_says_so():
    loose = []
    for seed in range(20):
        estimate, places, readings, point = ranged(seed, 10.0 * um)
        bound = relaxation_bound(places, readings, 10.0 * um, estimate[point])
        assert bound.lower <= estimate.objective
        loose.append(bound.gap > 1e-4)
        assert ("not tight" in bound.sentence) is not bound.proven
    assert 4 <= sum(loose) <= 16


@pytest.mark.parametrize("seed", range(20))
def test_convexity_proves_the_ranges_where_the_relaxation_does_not(seed):
    estimate, places, readings, point = ranged(seed, 10.0 * um)
    assert convexity_bound(places, readings, 10.0 * um, estimate[point]).proven


def test_a_mirror_image_that_is_only_nearly_as_good_is_not_proven():
    places = np.array([[x, y, 0.02 * x * y] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
    readings, u = np.linalg.norm(places - [0.3, 0.2, 1.0], axis=1), 1.0 * um
    point = Unknown("point", [0.3, 0.2, -1.0])
    problem = Problem([Observations(distance, point, places, readings=readings, u=u, group="ranges")])
    mirrored = calib.solve(problem)
    assert mirrored[point][2] < 0.0 and mirrored.objective > 1.0
    found = best(convexity_bound(places, readings, u, mirrored[point]),
                 relaxation_bound(places, readings, u, mirrored[point]))
    assert not found.proven and found.lower <= 1.0


@pytest.mark.parametrize("lines", [2, 3])
@pytest.mark.parametrize("seed", range(10))
def test_increments_along_lines_are_proven_global_in_a_plane_and_in_a_volume(lines, seed):
    run, zero, far = np.linspace(0.05, 0.75, 15), np.zeros(15), np.full(15, 0.75)
    places = np.vstack([np.column_stack(one) for one in ((run, zero, zero), (far, run, zero), (far, far, run))[:lines]])
    truth, u = np.array([-0.2, 1.4, -0.23]), 0.5 * um
    generator = np.random.default_rng(seed)
    readings = np.linalg.norm(places - truth, axis=1) - np.linalg.norm(truth) + u * generator.normal(size=len(places))
    point, length = Unknown("point", truth), Unknown("length", np.linalg.norm(truth))
    problem = Problem([Observations(change, point, length, places, readings=readings, u=u, group="increments")])
    estimate = calib.solve(problem)
    bound = bisection_bound(places, readings, u, estimate[point], estimate[length])
    assert bound.proven and bound.objective == pytest.approx(estimate.objective, rel=1e-6)
    # a worse point is not proven, and the bound from there still holds for the best one
    worse = bisection_bound(places, readings, u, estimate[point] + 100 * um, estimate[length])
    assert not worse.proven and worse.lower <= estimate.objective * (1 + 1e-9)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_eigenvalue_bound_of_circle_and_sphere_leaves_a_gap_of_the_size_of_u_over_the_radius(dimension):
    generator = np.random.default_rng(dimension)
    direction = generator.normal(size=(20, dimension))
    places = 0.2 * direction / np.linalg.norm(direction, axis=1)[:, None] + 1.0 * um * generator.normal(
        size=(20, dimension))
    centre, radius = Unknown("centre", np.zeros(dimension)), Unknown("radius", 0.2)
    estimate = calib.solve(Problem([Observations(off_circle, centre, radius, places, readings=np.zeros(20), u=1.0 * um,
                                                 group="off")]))
    bound = sphere_bound(places, 1.0 * um, estimate[centre], estimate[radius])
    assert bound.objective == pytest.approx(estimate.objective, rel=1e-9)
    assert 0.0 < bound.gap < 1e-4 and bound.lower < estimate.objective


@pytest.mark.slow
def test_no_bound_is_above_the_objective_in_200_random_problems():
    generator = np.random.default_rng(7)
    for _ in range(50):
        size, u = 10 ** generator.uniform(-2, 1), 10 ** generator.uniform(-6, -1)
        count = int(generator.integers(5, 12))
        places, truth = size * generator.normal(size=(count, 3)), 2 * size * generator.normal(size=3)
        spread = u * size * generator.uniform(0.5, 2.0, count)
        readings = np.abs(np.linalg.norm(places - truth, axis=1) + spread * generator.normal(size=count))
        # the truth is feasible: no bound, from whatever candidate, may be above its objective
        at_truth = float(np.sum(((np.linalg.norm(places - truth, axis=1) - readings) / spread) ** 2))
        candidate = squared_ranges(places, readings, spread)
        length = float(generator.uniform(0.5, 1.5) * size)
        circle = float(np.sum(((np.linalg.norm(places - truth, axis=1) - length) / spread) ** 2))
        for bound, limit in (
            (convexity_bound(places, readings, spread, candidate), at_truth),
            (relaxation_bound(places, readings, spread, candidate), at_truth),
            (bisection_bound(places, readings - length, spread, candidate, length), at_truth),
            (sphere_bound(places, spread, candidate, length), circle),
        ):
            assert bound.lower <= bound.objective * (1 + 1e-9)
            # the convexity bound speaks of what is no worse than its candidate
            assert bound.lower <= max(limit, 0.0) * (1 + 1e-6) + 1e-9 or bound.objective <= limit


def test_a_quadratic_under_a_quadratic_equation_is_solved_exactly():
    # the nearest point of the unit circle to (2, 0) is (1, 0), at squared distance 1
    program = QuadraticProgram(np.eye(2), np.array([-1.0, 0.0]), 1.0, np.eye(2)[None], np.array([[1.0, 0.0]]), 2.0)
    assert lower_bound(program, "a circle").gap < 1e-12
    # from the far side (-1, 0), at squared distance 9, the bound is still that of the nearest point
    far = QuadraticProgram(np.eye(2), np.array([-3.0, 0.0]), 9.0, np.eye(2)[None], np.array([[-1.0, 0.0]]), 2.0)
    assert lower_bound(far, "a circle").lower == pytest.approx(1.0, rel=1e-4)


def test_a_bound_says_its_gap():
    assert Bound(9.0, 10.0, "x").gap == pytest.approx(0.1)
    assert not Bound(9.0, 10.0, "x").proven and "1.0e-01" in Bound(9.0, 10.0, "x").sentence
    assert best(Bound(1.0, 10.0, "x"), Bound(2.0, 10.0, "y")).proof == "y"


def test_the_closed_form_carries_points_exactly():
    generator = np.random.default_rng(3)
    points = generator.normal(size=(5, 3))
    turn = np.asarray(rotation_about(np.array([0.0, 0.6, 0.8]), 2.0), float)
    moved = Transform(turn, np.array([1.0, 2.0, 3.0]))
    rotation, translation = closed_form(points, points @ turn.T + np.ravel(moved.translation))
    assert rotation == pytest.approx(turn, abs=1e-12) and translation == pytest.approx([1.0, 2.0, 3.0], abs=1e-12)
