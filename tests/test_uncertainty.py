"""Stated uncertainties against the dense generalised least squares they stand for."""

import numpy as np
import pytest
from declared import straight

from calib import Gaussian, Observations, Problem, Unknown, covariance, linearise, reliability, solve
from calib.errors import DeclarationError

X = np.array([0.0, 1.0, 2.0, 3.5, 4.0, 6.0])
Y = np.array([0.1, 0.9, 2.2, 3.4, 4.3, 5.8])


def dense(sigma):
    """Generalised least squares written out: estimate, covariance, redundancy numbers, w."""
    a = np.stack([np.ones_like(X), X], axis=1)
    p = np.linalg.inv(sigma)
    c = np.linalg.inv(a.T @ p @ a)
    estimate = c @ a.T @ p @ Y
    v = Y - a @ estimate
    qvv = sigma - a @ c @ a.T
    return estimate, c, np.diag(qvv @ p), (p @ v) / np.sqrt(np.diag(p @ qvv @ p))


def lag(correlation):
    return correlation ** np.abs(np.subtract.outer(range(6), range(6)))


def block(generator):
    factor = generator.normal(size=(3, 3))
    return factor @ factor.T + np.eye(3)


STEPS = 0.1 * np.arange(1, 7)
CASES = {
    "one u for all": (0.1, 0.01 * np.eye(6)),
    "a u for each reading": (STEPS, np.diag(STEPS**2)),
    "serial correlation": (Gaussian.serial(0.1, 0.6, X), 0.01 * lag(0.6)),
    "negative serial correlation": (Gaussian.serial(STEPS, -0.4, X), np.outer(STEPS, STEPS) * lag(-0.4)),
    "serial correlation along another order": (Gaussian.serial(0.1, 0.6, -X), 0.01 * lag(0.6)),
    "two groups with full matrices": (
        Gaussian.groups(list("aaabbb"), {"a": block(np.random.default_rng(1)), "b": block(np.random.default_rng(2))}),
        np.block(
            [[block(np.random.default_rng(1)), np.zeros((3, 3))], [np.zeros((3, 3)), block(np.random.default_rng(2))]]
        ),
    ),
    "two chains of serial correlation": (
        Gaussian.serial(0.1, 0.6, X, chain=list("aaabbb")),
        0.01 * lag(0.6) * np.kron(np.eye(2), np.ones((3, 3))),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_every_uncertainty_gives_what_generalised_least_squares_gives(name):
    u, sigma = CASES[name]
    a, b = Unknown("a"), Unknown("b")
    estimate = solve(Problem([Observations(straight, a, b, X, readings=Y, u=u)]))
    fit = linearise(estimate)
    expected, c, redundancy, w = dense(sigma)
    assert np.allclose([estimate[a], estimate[b]], expected, rtol=1e-11)
    assert np.allclose(covariance(fit, a, b).matrix, c, rtol=1e-11)
    assert np.allclose(reliability(fit).redundancy, redundancy, atol=1e-11)
    assert np.allclose(reliability(fit).w, w, atol=1e-10)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.slow
def test_drawn_errors_have_the_stated_covariance(name):
    u, sigma = CASES[name]
    weighting = (u if isinstance(u, Gaussian) else Gaussian.standard(u)).weighting(6, 1, "drawn")
    generator = np.random.default_rng(7)
    errors = np.stack([weighting.draw(generator)[:, 0] for _ in range(20000)])
    scale = np.sqrt(np.outer(np.diag(sigma), np.diag(sigma)))
    assert np.abs((errors.T @ errors / len(errors) - sigma) / scale).max() < 0.045  # 4 standard errors of 20000 draws


def test_a_matrix_for_each_row_is_used_row_by_row():
    matrices = np.stack([np.array([[1.0, 0.5], [0.5, 1.0]]), np.array([[4.0, -1.0], [-1.0, 2.0]])])
    p = Unknown("p", [0.0, 0.0])
    fit = linearise(
        solve(Problem([Observations(lambda p: p, p, readings=[[1.0, 2.0], [3.0, 1.0]], u=Gaussian.matrix(matrices))]))
    )
    assert np.allclose(
        covariance(fit, p).matrix, np.linalg.inv(np.linalg.inv(matrices[0]) + np.linalg.inv(matrices[1]))
    )


@pytest.mark.parametrize(
    "u, words",
    [
        (Gaussian.matrix(np.array([[1.0, 2.0], [2.0, 1.0]])), "not positive definite"),
        (Gaussian.groups(["a", "b"], {"a": np.eye(2)}), "group 'b' is missing"),
        (Gaussian.serial(1.0, 1.5, [0, 1]), "declared for scalar readings"),
    ],
)
def test_a_covariance_that_cannot_be_is_named(u, words):
    with pytest.raises(DeclarationError, match=words):
        solve(Problem([Observations(lambda p: p, Unknown("p", [0.0, 0.0]), readings=[[1.0, 2.0], [3.0, 1.0]], u=u)]))
