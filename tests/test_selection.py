"""Choosing observations: all methods agree on small cases, the bound is never beaten, promises are kept."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from declared import network

import calib
from calib import (
    A,
    BranchAndBound,
    C,
    Conic,
    D,
    Ds,
    E,
    Exchange,
    Exhaustive,
    G,
    Greedy,
    I,
    Observations,
    Problem,
    Quantity,
    Relaxation,
    Unknown,
    WorstCase,
    prior,
    select,
)
from calib.analyse.selection.conic import conic
from calib.analyse.selection.limits import Limits
from calib.analyse.selection.objective import Objective
from calib.analyse.selection.relaxation import relax
from calib.analyse.selection.request import requested
from calib.analyse.selection.terms import Determinant, DeterminantOfSet, Trace
from calib.analyse.selection.worst import Largest, LargestOf
from calib.uncertainty import Gaussian


def polynomial(coefficients, x):
    return coefficients[0] + coefficients[1] * x + coefficients[2] * x**2 + coefficients[3] * x**3


def middle(coefficients):
    return polynomial(coefficients, 0.4)


def curve(x, u=0.1, quantities=True, **covariates):
    """A cubic with readings at x; quantity `middle` is its value at 0.4."""
    unknown = Unknown("c", np.zeros(4), "mm", parts="abcd")
    readings = Observations(polynomial, unknown, np.asarray(x, float), readings=np.zeros(len(x)), u=u, group="curve",
                            covariates=covariates)
    return Problem([readings], quantities=[Quantity("middle", middle, unknown, unit="mm")] if quantities else [],
                   name="cubic"), unknown


def scattered(n, seed):
    return np.random.default_rng(seed).uniform(-1, 1, n)


def by_hand(fit, keep, value, largest):
    """The best subset by the plainest means: every one of them, from the whitened rows themselves."""
    rows = fit.rows[0].toarray()
    best = None
    for chosen in combinations(range(len(rows)), keep):
        information = rows[list(chosen)].T @ rows[list(chosen)]
        if np.linalg.matrix_rank(information) == len(information):
            found = value(information)
            if best is None or (found > best[0]) == largest:
                best = found, chosen
    return best


@pytest.mark.parametrize("seed", [1, 2])
def test_d_and_a_of_ten_rows_are_those_of_all_subsets_by_hand(seed):
    problem, unknown = curve(scattered(10, seed))
    fit = calib.linearise(problem)
    found = select(fit, 6, D(), method=Exhaustive())
    value, chosen = by_hand(fit, 6, lambda m: np.linalg.det(m) ** 0.25, True)
    assert found.value == pytest.approx(value, rel=1e-9) and found.chosen == chosen and found.proven
    found = select(fit, 6, A(unknown), method=Exhaustive())
    value, chosen = by_hand(fit, 6, lambda m: np.trace(np.linalg.inv(m)) * 1e6, False)      # mm
    assert found.value == pytest.approx(value, rel=1e-9) and found.chosen == chosen


CRITERIA = {"D": lambda c: D(), "A": lambda c: A(c), "E": lambda c: E(c), "G": lambda c: G(), "I": lambda c: I(),
            "c": lambda c: C("middle"), "Ds": lambda c: Ds(c.part("c", "d"))}


@pytest.mark.parametrize("name", CRITERIA)
@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.slow
def test_branch_and_bound_finds_what_exhaustive_search_finds_and_no_bound_is_beaten(name, seed):
    problem, unknown = curve(scattered(14, seed))
    fit = calib.linearise(problem)
    criterion = CRITERIA[name](unknown)
    best = select(fit, 7, criterion, method=Exhaustive())
    proven = select(fit, 7, criterion, method=BranchAndBound())
    assert proven.value == pytest.approx(best.value, rel=1e-6)
    assert proven.proven
    for method in (Greedy(), Exchange(), Relaxation()):
        other = select(fit, 7, criterion, method=method)
        if criterion.largest_is_best:
            assert other.value <= best.value * (1 + 1e-9) <= other.bound * (1 + 2e-9)
            assert other.gap == pytest.approx(1 - other.value / other.bound, abs=1e-12)
        else:
            assert other.value >= best.value * (1 - 1e-9) >= other.bound * (1 - 2e-9)
            assert other.gap == pytest.approx(other.value / other.bound - 1, abs=1e-12)
    assert select(fit, 7, criterion, method=Exchange()).value == pytest.approx(best.value, rel=0.02)


@pytest.mark.parametrize("name", CRITERIA)
def test_the_conic_program_cannot_go_below_the_bound_of_our_own_relaxation_and_comes_close(name):
    problem, unknown = curve(scattered(16, 5))
    request = requested(calib.linearise(problem), 7, CRITERIA[name](unknown))
    ours = relax(request.objective, request.limits, np.arange(16) % 2)
    judge = conic(request.objective, request.limits)
    term = request.objective.terms[0]
    reached = float(term.loss(term.information(judge.weights)[None])[0])
    assert ours.bound <= reached + 1e-7
    assert reached - ours.bound < 1e-5
    assert reached - 1e-5 < judge.bound <= reached


def drawn(generator):
    """A random objective, its limits, and a random choice within them."""
    n, p = int(generator.integers(8, 16)), int(generator.integers(2, 5))
    width = int(generator.integers(1, 3))
    rows = generator.normal(size=(n, width, p)) * generator.lognormal(0, 0.5, (n, 1, 1))
    fixed = np.zeros((p, p)) if generator.random() < 0.5 else 0.1 * np.eye(p)
    functions = generator.normal(size=(2, p))
    terms = (Determinant(rows, fixed, 0.0), Trace(rows, fixed, functions), Largest(rows, fixed, functions),
             LargestOf(rows, fixed, rows.reshape(-1, p)), DeterminantOfSet(rows, fixed, functions))
    term = terms[int(generator.integers(5))]
    keep = int(generator.integers(p + 1, n - 1))
    matrix, most = [np.ones(n)], [float(keep)]
    if generator.random() < 0.3:
        matrix.append(generator.uniform(0.5, 2.0, n))
        most.append(1.2 * keep)
    # Beside a cost the number is one limit among others: a choice may then be smaller.
    return Objective((term,)), Limits(np.array(matrix), np.array(most), ("",) * len(most),
                                      keep if len(most) == 1 else None)


def rows_of(term):
    return term.rows.shape[1]


def a_choice(objective, limits, generator):
    taken = np.zeros(objective.count)
    for i in generator.permutation(objective.count):
        taken[i] = 1.0
        if not limits.allow(taken):
            taken[i] = 0.0
    return taken


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 10))])
def test_no_choice_beats_the_bound_in_a_hundred_random_problems(seed):
    generator = np.random.default_rng(seed)
    for _ in range(100):
        objective, limits = drawn(generator)
        n = objective.count
        # The bound holds for any dual matrix, so it is asked of those of a solver and of random ones.
        term = objective.terms[0]
        root, shares = generator.normal(size=(2, *term.fixed.shape)), generator.uniform(0.0, 1.0, n * rows_of(term))
        anywhere = max(term.support(r @ r.T, shares).bound(limits, np.zeros(n), np.ones(n)) for r in root)
        start = a_choice(objective, limits, generator)
        solved = relax(objective, limits, start, tolerance=1e-4).bound
        choices = [np.flatnonzero(a_choice(objective, limits, generator)).tolist() for _ in range(30)]
        losses = [objective.loss(chosen) for chosen in choices]
        assert min(losses) >= max(anywhere, solved) - 1e-9


@pytest.mark.parametrize("kind", ["D", "A", "G", "Ds"])
def test_gains_and_curvature_are_the_derivatives_of_the_losses(kind):
    generator = np.random.default_rng(8)
    rows, functions = generator.normal(size=(9, 2, 4)), generator.normal(size=(3, 4))
    fixed = np.zeros((4, 4))
    term = Determinant(rows, fixed, 0.3) if kind == "D" else {
        "A": Trace, "G": LargestOf, "Ds": DeterminantOfSet}[kind](rows, fixed, functions)
    weights, h = generator.uniform(0.3, 1.0, 9), 1e-5

    def at(where):
        return term.pieces(np.linalg.inv(term.information(where)))

    here = at(weights)
    multipliers, gains = generator.uniform(0.2, 1.0, len(here.losses)), here.gains(rows)
    curvature = here.curvature(rows, multipliers) - (gains.T * multipliers) @ gains
    for i in range(9):
        step = h * np.eye(9)[i]
        up, down = at(weights + step), at(weights - step)
        np.testing.assert_allclose(-(up.losses - down.losses) / (2 * h), gains[:, i], rtol=1e-6)
        change = -multipliers @ (up.gains(rows) - down.gains(rows)) / (2 * h)
        np.testing.assert_allclose(change, curvature[i], rtol=1e-5, atol=1e-8)


def test_a_choice_solved_again_with_simulated_readings_has_the_promised_u():
    problem, _, point = network(4, 8, 2)
    fit = calib.linearise(calib.solve(problem))
    found = select(fit, 22, D(), report=[point])
    kept = problem.keep(found.masks)
    again = calib.solve(calib.simulate(kept, {point: calib.solve(problem)[point]}, 5))
    u = calib.covariance(calib.linearise(again), point)
    assert [p.name for p in found.promises] == list(u.names)
    np.testing.assert_allclose([p.u_chosen for p in found.promises], u.u, rtol=1e-3)


def test_the_standardised_errors_of_a_chosen_subset_have_the_spread_that_was_promised():
    problem, unknown = curve(scattered(30, 6))
    found = select(calib.linearise(problem), 8, C("middle"))
    kept = problem.keep(found.masks)
    drawn_again = [calib.solve(calib.simulate(kept, {unknown: np.zeros(4)}, seed))["middle"] for seed in range(300)]
    spread = np.sqrt(np.mean(np.square(drawn_again))) / found.u("middle")
    assert abs(spread - 1) < 4 / np.sqrt(600)


def test_u_of_a_choice_contains_what_is_held_with_an_uncertainty():
    problem, unknown = curve(scattered(12, 7))
    problem = problem.with_observations(prior(unknown.part("a"), 0.0, 0.02)).hold(unknown.part("a"))
    fit = calib.linearise(problem)
    found = select(fit, 6, C("middle"))
    assert found.u("middle") == pytest.approx(calib.covariance(calib.linearise(problem.keep(found.masks)),
                                                               "middle").u[0], rel=1e-9)


def test_groups_are_chosen_whole_and_what_is_always_there_is_never_a_candidate():
    problem, _, point = network(5, 8, 3)
    fit = calib.linearise(calib.solve(problem))
    found = select(fit, 3, A(point), by="station", method=Exhaustive())
    assert len(found.rows["polar"]) == 24 and found.candidates == 5
    first = select(fit, 4, A(point), always={"polar": range(1, 17)}, method=Exchange())
    assert not set(first.rows["polar"]) & set(range(1, 17)) and first.candidates == 24
    assert first.masks["polar"].sum() == 20


def test_an_unknown_of_each_candidate_is_eliminated_and_the_choice_is_the_same():
    # Stations with an orientation of their own: they come and go with their station.
    problem, _, point = network(6, 7, 4)
    fit = calib.linearise(problem)
    found = select(fit, 3, A(point), by="station", always={"polar": range(1, 8)}, method=Exhaustive())
    values = {}
    for three in combinations(range(1, 6), 3):
        mask = np.isin(problem.observations[0].covariates["station"], [0, *three])
        kept = calib.linearise(problem.keep({"polar": mask}))
        values[three] = np.sum(calib.covariance(kept, point).u ** 2) * 1e6
    assert found.value == pytest.approx(min(values.values()), rel=1e-6)


def test_rows_with_correlated_errors_are_chosen_together_or_refused():
    x = scattered(12, 9)
    unknown = Unknown("c", np.zeros(4), "mm", parts="abcd")
    pair = np.repeat(np.arange(6), 2)
    covariance = {k: 0.01 * (np.eye(2) + 0.5) for k in range(6)}
    problem = Problem([Observations(polynomial, unknown, x, u=Gaussian.groups(pair, covariance), group="curve",
                                    covariates={"pair": pair})])
    fit = calib.linearise(problem)
    with pytest.raises(calib.errors.InputError, match="correlated"):
        select(fit, 6, D())
    found = select(fit, 4, D(), by="pair")
    kept = calib.linearise(problem.keep(found.masks))
    rows = kept.rows[0].toarray()
    assert found.value == pytest.approx(np.linalg.det(rows.T @ rows) ** 0.25, rel=1e-9)


def test_the_worst_of_two_configurations_is_the_one_that_counts():
    plans = [curve(scattered(12, seed), quantities=False)[0] for seed in (10, 11)]
    fits = [calib.linearise(plan) for plan in plans]
    best = select(fits[0], 7, WorstCase(D(), fits[1:]), method=Exhaustive())
    values = {c: min(np.linalg.det(f.rows[0].toarray()[list(c)].T @ f.rows[0].toarray()[list(c)]) ** 0.25 for f in fits)
              for c in combinations(range(12), 7)}
    assert best.value == pytest.approx(max(values.values()), rel=1e-8)
    other = select(fits[0], 7, WorstCase(D(), fits[1:]), method=Exchange())
    assert other.value <= best.value * (1 + 1e-9) <= other.bound * (1 + 2e-9)


def test_costs_kinds_and_exclusions_are_respected_and_the_optimum_under_them_is_proven():
    x = scattered(12, 12)
    problem, _ = curve(x, side=np.where(x > 0, "right", "left"))
    fit = calib.linearise(problem)
    cost = np.linspace(1.0, 2.0, 12)
    request = {"costs": cost, "budget": 9.5, "at_most": {"side": 4}, "exclusive": [(0, 1, 2)]}
    best = select(fit, 6, D(), method=Exhaustive(), **request)
    proven = select(fit, 6, D(), method=BranchAndBound(), **request)
    assert proven.value == pytest.approx(best.value, rel=1e-9) and proven.proven
    chosen = np.array(best.chosen)
    assert cost[chosen].sum() <= 9.5 and np.sum(x[chosen] > 0) <= 4 and len({0, 1, 2} & set(best.chosen)) <= 1
    other = select(fit, 6, D(), method=Conic(), **request)
    assert other.value <= best.value * (1 + 1e-9) <= other.bound * (1 + 2e-9)


def test_with_a_budget_alone_as_many_are_taken_as_it_pays_for():
    problem, _ = curve(scattered(9, 13))
    fit = calib.linearise(problem)
    cost = np.random.default_rng(1).uniform(1, 3, 9)
    best = select(fit, criterion=D(), costs=cost, budget=10.0, method=Exhaustive())
    proven = select(fit, criterion=D(), costs=cost, budget=10.0, method=BranchAndBound())
    assert cost[list(best.chosen)].sum() <= 10.0 and proven.value == pytest.approx(best.value, rel=1e-9)
