"""Every shipped example under every method: one answer to 1e-8 of u, or a refusal that is due."""

import numpy as np
import pytest
from shipped import EXAMPLES, example

from calib import GaussNewton, Problem, linearise, solve
from calib.errors import MethodRefusal
from calib.observations import Constraint
from calib.solve.convex import L1, Convex, Huber, MinimumZone
from calib.solve.ipopt import ExactHessian, GaussNewtonHessian, Ipopt
from calib.system import System

MOST = 300        # unknowns up to which IPOPT is asked


def apart(first, second):
    """Differences of two estimates, and standard uncertainties and sizes of the first: (p,) over the free columns."""
    fit = linearise(first)
    layout, difference, size = fit.layout, [], []
    for unknown in layout.unknowns:
        difference.append(unknown.difference(second.values[unknown], first.values[unknown]).ravel())
        plain = unknown.kind == "vector"
        size.append(np.abs(first.values[unknown]).ravel() if plain else np.ones(unknown.count * unknown.freedom))
    free = layout.free_columns
    u = np.sqrt(np.diag(fit.factor.covariance(np.eye(len(free)))))
    return np.concatenate(difference)[free], u, np.concatenate(size)[free]


def assert_agreement(first, second):
    difference, u, size = apart(first, second)
    allowed = np.maximum(1e-8 * u, 4 * np.finfo(float).eps * size)
    worst = int(np.argmax(np.abs(difference) / allowed))
    label = linearise(first).layout.label(linearise(first).layout.free_columns[worst])
    assert abs(difference[worst]) <= allowed[worst], f"{label}: {difference[worst] / u[worst]:.2e} u apart"


def has_inequalities(problem):
    return any(not c.is_equality for c in problem.constraints)


@pytest.fixture(scope="module", params=EXAMPLES)
def adjusted(request):
    """An example and its least-squares estimate."""
    problem = example(request.param)
    return problem, solve(problem, Ipopt() if has_inequalities(problem) else GaussNewton())


def test_the_estimate_is_certified(adjusted):
    _, estimate = adjusted
    assert estimate.converged and estimate.certificate.passed, estimate.certificate.why


@pytest.mark.parametrize("hessian", [ExactHessian(), GaussNewtonHessian()], ids=["exact", "gauss-newton"])
def test_ipopt_gives_the_estimate(adjusted, hessian):
    problem, estimate = adjusted
    assert len(linearise(estimate).layout.free_columns) <= MOST, "an example is small: simulate fewer readings"
    found = solve(problem, Ipopt(hessian))
    assert found.converged and found.certificate.passed, found.certificate.why
    assert_agreement(estimate, found)


def is_affine_in_numbers(problem, start, seed):
    """Whether predictions and conditions at the middle of two far points are the mean of those at the points."""
    system, generator = System(problem), np.random.default_rng(seed)
    step = np.where(system.layout.free, generator.uniform(-0.3, 0.3, system.layout.size), 0.0)
    points = [system.layout.move(start, share * step) for share in (-1.0, 0.0, 1.0)]
    for term in (*system.terms, *system.conditions):
        before, middle, after = (term.predict(point) for point in points)
        size = max(np.abs(before).max(), np.abs(after).max(), np.abs(after - before).max())
        if not np.abs(0.5 * (before + after) - middle).max() <= 1e-12 * size:
            return False
    return True


def test_convex_gives_the_estimate_where_the_problem_is_affine_and_refuses_elsewhere(adjusted):
    problem, estimate = adjusted
    if not is_affine_in_numbers(problem, dict(estimate.values), seed=1):
        with pytest.raises(MethodRefusal, match="is not affine in argument"):
            solve(problem, Convex())
        return
    found = solve(problem, Convex())
    assert found.converged and found.certificate.passed and found.certificate.gap <= 1e-6
    assert_agreement(estimate, found)


@pytest.mark.parametrize("loss", [Huber(1.5), L1(), MinimumZone()], ids=["huber", "l1", "minimum zone"])
def test_other_losses_prove_their_answer_or_are_refused_with_the_reason(adjusted, loss):
    problem, estimate = adjusted
    if not is_affine_in_numbers(problem, dict(estimate.values), seed=1):
        with pytest.raises(MethodRefusal, match="is not affine in argument"):
            solve(problem, Convex(loss))
        return
    mixings = [m for w in System(problem).weightings(estimate.values) for m in w.whitening]
    if any(m.matrix.ndim == 3 and np.count_nonzero(m.matrix, axis=2).max() > 1 for m in mixings):
        with pytest.raises(MethodRefusal, match="correlated errors"):
            solve(problem, Convex(loss))
        return
    found = solve(problem, Convex(loss))
    assert found.converged and found.certificate.passed, found.certificate.why
    whitened = [(found.residuals[g.name] / g.weighting.u).ravel() for g in linearise(estimate).groups]
    plain = [(estimate.residuals[g.name] / g.weighting.u).ravel() for g in linearise(estimate).groups]
    ours, theirs = loss.value(np.concatenate(whitened)), loss.value(np.concatenate(plain))
    assert ours <= theirs * (1 + 1e-9)       # no worse than least squares in the loss that was asked for


def test_gauss_newton_refuses_an_inequality_and_every_method_missing_readings(adjusted):
    problem, estimate = adjusted
    group = problem.observations[0].group
    for method in (GaussNewton(), Ipopt(), Convex()):
        with pytest.raises(MethodRefusal):
            solve(problem.with_readings({group: None}), method)
    unknown = next(u for u in problem.unknowns if u.kind == "vector")
    value = estimate.values[unknown][0, 0]
    room = {"lower": value - 1.0, "upper": value + 1.0}
    limit = Constraint("limit", lambda x: x[0], unknown[np.array([0])], tolerance=1e-9, **room)
    limited = Problem(problem.observations, (*problem.constraints, limit))
    with pytest.raises(MethodRefusal, match="'limit' is an inequality"):
        solve(limited, GaussNewton())
