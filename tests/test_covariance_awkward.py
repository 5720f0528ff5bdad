"""Covariance at awkward places, each against a closed form or published numbers."""

import numpy as np
import pytest
from declared import straight

from calib import (
    L1,
    Constraint,
    Gaussian,
    Huber,
    Observations,
    Problem,
    Quantity,
    Unknown,
    covariance,
    estimability,
    linearise,
    reliability,
    robust,
    solve,
)

# Heights of three points from the three differences between them, each with u: N = J'J / u^2 has the eigenvalues
# 0, 3, 3, so that the inner solution has the covariance u^2/9 (3 I - 1 1') and every difference 2/3 u^2.
U = 0.5e-3
LOOP = np.array([[2.0, -1, -1], [-1, 2, -1], [-1, -1, 2]]) * U**2 / 9


def loop(**more):
    height = Unknown("height", [[0.1], [0.2], [-0.1]], "mm", keys="ABC")
    seen = Observations(lambda a, b: b - a, height[[0, 1, 2]], height[[1, 2, 0]],
                        readings=[1.0, 0.5, -1.5003], u=U)
    step = Quantity("step", lambda a, b: b - a, height[0], height[1])
    return height, Problem([seen], quantities=[step], **more)


def test_a_free_datum_by_inner_constraints_is_the_pseudo_inverse_and_estimable_functions_need_none():
    height, free = loop()
    planned = linearise(free)
    assert estimability(planned).defect == 1
    assert covariance(planned, "step").u[0] == pytest.approx(U * np.sqrt(2 / 3), rel=1e-12)
    centred = Constraint("centre", lambda a, b, c: a + b + c, height[0], height[1], height[2], tolerance=1e-9)
    inner = linearise(solve(Problem(free.observations, [centred], quantities=free.quantities)))
    assert covariance(inner, height).matrix == pytest.approx(LOOP, rel=1e-12)
    fixed = linearise(solve(free.hold(height[0])))
    for fit in (inner, fixed):
        assert covariance(fit, "step").u[0] == pytest.approx(U * np.sqrt(2 / 3), rel=1e-12)
        assert reliability(fit).redundancy[:3] == pytest.approx([1 / 3] * 3, rel=1e-12)


def test_at_an_active_bound_the_rest_has_the_covariance_it_has_where_the_bounded_is_known():
    x, a, b = np.arange(5.0), Unknown("a"), Unknown("b", 0.5, upper=0.8)
    estimate = solve(Problem([Observations(straight, a, b, x, readings=1.0 + x, u=0.1)]))
    assert estimate[b] == 0.8
    matrix = covariance(linearise(estimate), a, b).matrix
    assert matrix == pytest.approx(np.diag([0.1**2 / 5, 0.0]), abs=1e-17)  # the mean of five, as the slope is known


# Longley (1967), as certified by the NIST: y, six columns from 1e2 to 5e5 beside ones, condition 5e9 unscaled.
LONGLEY = np.array([
    [60323, 83.0, 234289, 2356, 1590, 107608, 1947], [61122, 88.5, 259426, 2325, 1456, 108632, 1948],
    [60171, 88.2, 258054, 3682, 1616, 109773, 1949], [61187, 89.5, 284599, 3351, 1650, 110929, 1950],
    [63221, 96.2, 328975, 2099, 3099, 112075, 1951], [63639, 98.1, 346999, 1932, 3594, 113270, 1952],
    [64989, 99.0, 365385, 1870, 3547, 115094, 1953], [63761, 100.0, 363112, 3578, 3350, 116219, 1954],
    [66019, 101.2, 397469, 2904, 3048, 117388, 1955], [67857, 104.6, 419180, 2822, 2857, 118734, 1956],
    [68169, 108.4, 442769, 2936, 2798, 120445, 1957], [66513, 110.8, 444546, 4681, 2637, 121950, 1958],
    [68655, 112.6, 482704, 3813, 2552, 123366, 1959], [69564, 114.2, 502601, 3931, 2514, 125368, 1960],
    [69331, 115.7, 518173, 4806, 2572, 127852, 1961], [70551, 116.9, 554894, 4007, 2827, 130081, 1962]])
CERTIFIED = np.array([
    [-3482258.63459582, 890420.383607373], [15.0618722713733, 84.9149257747669],
    [-0.358191792925910e-1, 0.334910077722432e-1], [-2.02022980381683, 0.488399681651699],
    [-1.03322686717359, 0.214274163161675], [-0.511041056535807e-1, 0.226073200069370],
    [1829.15146461355, 455.478499142212]])


def test_badly_scaled_and_nearly_collinear_columns_come_back_as_the_nist_certifies_them():
    b = Unknown("b", np.zeros(7))
    columns = np.column_stack([np.ones(16), LONGLEY[:, 1:]])
    observed = Observations(lambda b, x: b.T @ x, b, columns, readings=LONGLEY[:, 0], u=304.854073561965)
    estimate = solve(Problem([observed]))
    assert estimate.variance_factor == pytest.approx(1.0, rel=1e-12)
    assert estimate[b] == pytest.approx(CERTIFIED[:, 0], rel=1e-8)
    assert covariance(linearise(estimate), b).u == pytest.approx(CERTIFIED[:, 1], rel=1e-9)


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_the_unit_of_a_column_changes_no_relative_uncertainty(size):
    x, a, b = np.arange(5.0), Unknown("a"), Unknown("b")
    fit = linearise(solve(Problem([Observations(straight, a, b, size * x, readings=1 + x, u=0.1)])))
    c = covariance(fit, a, b)
    assert c.u == pytest.approx([0.1 * np.sqrt(1 / 5 + 4 / 10), 0.1 / np.sqrt(10) / size], rel=1e-12)
    assert c.correlation[0, 1] == pytest.approx(-0.2 / np.sqrt(0.06), rel=1e-12)


@pytest.mark.parametrize("rho", [-0.1, 0.5, 0.99])
def test_the_mean_of_alike_correlated_readings_has_its_closed_form(rho):
    mean, n = Unknown("mean"), 8
    matrix = 0.1**2 * ((1 - rho) * np.eye(n) + rho)
    observed = Observations(lambda m: m, mean[np.zeros(n, int)], readings=np.arange(n) * 0.1,
                            u=Gaussian.groups(np.zeros(n, int), {0: matrix}))
    fit = linearise(solve(Problem([observed])))
    assert covariance(fit, mean).u[0] == pytest.approx(0.1 * np.sqrt((1 + (n - 1) * rho) / n), rel=1e-12)
    assert reliability(fit).redundancy.sum() == pytest.approx(n - 1, rel=1e-12)


@pytest.mark.parametrize("rho", [-0.5, 0.3, 0.95])
def test_the_mean_of_a_serially_correlated_chain_has_its_closed_form(rho):
    mean, n = Unknown("mean"), 12  # 1' R^-1 1 = (n - (n - 2) rho) / (1 + rho)
    observed = Observations(lambda m: m, mean[np.zeros(n, int)], readings=np.sin(np.arange(n)),
                            u=Gaussian.serial(0.1, rho, np.arange(n)))
    fit = linearise(solve(Problem([observed])))
    assert covariance(fit, mean).u[0] == pytest.approx(0.1 * np.sqrt((1 + rho) / (n - (n - 2) * rho)), rel=1e-12)


@pytest.mark.parametrize(("loss", "efficiency"), [(Huber(1.345), 0.95), (L1(), 2 / np.pi)])
def test_robust_losses_have_the_published_efficiency_under_gaussian_errors(loss, efficiency):
    # Huber (1964): 95 % at 1.345; the median has 2/pi. With 2,000 readings the share beyond the threshold is known to
    # one per cent, and so is the slope of the pull.
    mean, n = Unknown("mean"), 2000
    readings = 0.1 * np.random.default_rng(5).standard_normal(n)
    estimate = robust(Problem([Observations(lambda m: m, mean[np.zeros(n, int)], readings=readings, u=0.1)]), loss)
    matrix = estimate.covariance(mean)[1]
    assert matrix[0, 0] == pytest.approx(0.1**2 / n / efficiency, rel=0.04)


@pytest.mark.parametrize("apart", [1e-2, 1e-4, 1e-5])
def test_nearly_parallel_columns_have_their_closed_form_and_the_condition_says_so(apart):
    x, a, b = np.array([-1.0, 0.0, 1.0, 2.0, -2.0]), Unknown("a"), Unknown("b")
    observed = Observations(lambda a, b, x: a + b * (1 + apart * x), a, b, x, readings=1 + x, u=0.1)
    fit = linearise(solve(Problem([observed])))
    c = covariance(fit, a, b)
    far = 0.1 / np.sqrt(10) / apart  # sum x^2 = 10, and sum x = 0: b as a slope over apart x, a = mean - b
    assert c.u == pytest.approx([np.hypot(0.1 / np.sqrt(5), far), far], rel=1e-14 / apart**2 + 1e-11)
    share = 1 / np.sqrt(1 + 2 * apart**2)  # cosine between the columns: 5 / sqrt(5 (5 + 10 apart^2))
    assert estimability(fit).condition == pytest.approx(np.sqrt((1 + share) / (1 - share)), rel=1e-3)


def test_a_reading_that_alone_determines_an_unknown_has_no_redundancy_and_no_detectable_bias():
    a, b, c = Unknown("a"), Unknown("b"), Unknown("c")
    problem = Problem([
        Observations(straight, a, b, np.arange(4.0), readings=[0.1, 1.0, 2.1, 2.9], u=0.1, group="line"),
        Observations(lambda a, c: a + c, a, c, readings=[5.0], u=0.2, group="alone")],
        quantities=[Quantity("c", lambda c: c, c)])
    fit = linearise(solve(problem))
    tests = reliability(fit)
    alone, rest = tests.of("alone"), tests.of("line")
    assert abs(tests.redundancy[alone][0]) < 1e-12
    assert (tests.w[alone][0], tests.p_value[alone][0], tests.mdb[alone][0]) == (0.0, 1.0, np.inf)
    # the line: 1 - 1/n - (x - mean)^2 / Sxx with Sxx = 5
    assert tests.redundancy[rest] == pytest.approx(0.75 - np.array([2.25, 0.25, 0.25, 2.25]) / 5, rel=1e-12)
    assert covariance(fit, "c").u[0] == pytest.approx(np.sqrt(0.2**2 + 0.1**2 * (1 / 4 + 2.25 / 5)), rel=1e-12)
