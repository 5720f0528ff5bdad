"""Limits of a choice, each against every subset: kinds, costs, exclusions, what is always there, floors."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from test_selection import curve, network, scattered

import calib
from calib import A, BranchAndBound, C, D, E, Exchange, Exhaustive, Floors, G, Greedy, Relaxation, WorstCase, select
from calib.analyse.selection.floors import Checked
from calib.analyse.selection.planning import lowers_most, next_best
from calib.analyse.selection.request import requested
from calib.errors import InputError

X = scattered(11, 21)
COST = np.random.default_rng(3).uniform(1.0, 3.0, 11)
LIMITS = {
    "at most two of a kind": {"at_most": {"kind": 2}},
    "excluding pairs": {"exclusive": [(0, 1), (2, 3, 4), (5, 6)]},
    "a budget": {"costs": COST, "budget": 9.0},
    "rows that are there": {"always": {"curve": [1, 5]}},
    "everything": {"always": {"curve": [2]}, "at_most": {"kind": 2}, "budget": 9.5, "costs": COST[:10],
                   "exclusive": [("curve row 3", "curve row 4")]},
}


def plan():
    return curve(X, kind=np.arange(11) % 4)


def within(choice, limits):
    """Whether a choice respects its limits, by the plainest means."""
    rows = [int(label.split()[-1]) for label in choice.labels]
    there = set(limits.get("always", {}).get("curve", []))
    kinds = [(row - 1) % 4 for row in rows]
    costs = limits.get("costs")
    open_rows = [row for row in range(1, 12) if row not in there]
    paid = sum(costs[open_rows.index(row)] for row in rows) if costs is not None else 0.0
    sets = [[int(one.split()[-1]) if isinstance(one, str) else one + 1 for one in each]
            for each in limits.get("exclusive", ())]
    return (len(rows) == 5 and not there & set(rows) and paid <= limits.get("budget", np.inf) + 1e-9
            and max(kinds.count(k) for k in kinds) <= limits.get("at_most", {}).get("kind", 11)
            and all(len(set(each) & set(rows)) <= 1 for each in sets))


@pytest.mark.slow
@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.parametrize("criterion", [D(), C("middle"), G()], ids=["D", "c", "G"])
def test_every_method_respects_the_limits_and_none_beats_the_best_of_all_subsets(name, criterion):
    fit, limits = calib.linearise(plan()[0]), LIMITS[name]
    best = select(fit, 5, criterion, method=Exhaustive(), **limits)
    assert within(best, limits)
    for method in (Greedy(), Exchange(), Relaxation(), BranchAndBound()):
        found = select(fit, 5, criterion, method=method, **limits)
        assert within(found, limits)
        if criterion.largest_is_best:
            assert found.value <= best.value * (1 + 1e-9) <= found.bound * (1 + 2e-9)
        else:
            assert found.value >= best.value * (1 - 1e-9) >= found.bound * (1 - 2e-9)
    assert found.proven and found.value == pytest.approx(best.value, rel=1e-6)      # branch and bound


def test_keep_is_met_exactly_where_a_dear_candidate_would_leave_fewer():
    problem, _ = curve(np.linspace(-1, 1, 9), u=np.array([0.001, *[0.1] * 8]))
    fit = calib.linearise(problem)
    dear = np.array([5.0, *[1.0] * 8])
    for method in (Exhaustive(), Exchange(), Greedy(), BranchAndBound()):
        found = select(fit, 6, D(), costs=dear, budget=6.5, method=method)
        assert len(found.chosen) == 6 and 0 not in found.chosen


@pytest.mark.parametrize("floors", [Floors(redundancy=0.15), Floors(mdb={"curve": 0.95}),
                                    Floors(influence={"middle": 0.5}), Floors(0.1, {"curve": 1.1}, {"middle": 0.6})],
                         ids=["redundancy", "mdb", "influence", "all"])
def test_branch_and_bound_under_floors_finds_what_all_subsets_under_floors_say(floors):
    fit = calib.linearise(curve(scattered(12, 5))[0])
    best = select(fit, 7, D(), floors=floors, method=Exhaustive())
    proven = select(fit, 7, D(), floors=floors, method=BranchAndBound())
    assert proven.value == pytest.approx(best.value, rel=1e-6) and proven.proven
    free = select(fit, 7, D(), method=Exhaustive())
    assert best.value <= free.value


@pytest.mark.slow
def test_branch_and_bound_proves_that_no_choice_meets_floors():
    fit = calib.linearise(curve(scattered(11, 1))[0])
    with pytest.raises(InputError, match="no choice of 6 meets them") as refused:
        select(fit, 6, D(), floors=Floors(influence={"middle": 0.01}), method=BranchAndBound())
    assert "was found" not in refused.value.sentence.split("meets them")[0]
    with pytest.raises(InputError, match="no choice of 6 meets them"):
        select(fit, 6, D(), floors=Floors(influence={"middle": 0.01}), method=Exhaustive())


def reliability_agrees(problem, choice, checked):
    """Redundancy and detectable bias of a choice as the reliability analysis of the kept rows has them."""
    kept, redundancy, mdb = checked._state(checked.candidates.indicator(choice.chosen))
    theirs = calib.reliability(calib.linearise(problem.keep(choice.masks)))
    mine = ~np.char.startswith(theirs.group.astype(str), "prior")
    np.testing.assert_allclose(redundancy, theirs.redundancy[mine], atol=1e-9)
    seen = theirs.redundancy[mine] > 1e-6
    np.testing.assert_allclose(mdb[seen], theirs.mdb[mine][seen], rtol=1e-6)
    assert kept.sum() == mine.sum()


def test_floors_of_candidates_with_unknowns_of_their_own_are_those_of_the_reliability_analysis():
    # Stations with an orientation of their own: eliminated with their station, yet their readings check each other.
    problem, _, point = network(6, 7, 4)
    fit = calib.linearise(problem)
    request = requested(fit, 3, A(point), by="station", always={"polar": range(1, 8)}, floors=Floors(0.05))
    assert not request.candidates.shared.all()
    choice = select(fit, 3, A(point), by="station", always={"polar": range(1, 8)}, method=Exhaustive())
    reliability_agrees(problem, choice, request.checked)


def test_floors_of_correlated_readings_are_those_of_the_reliability_analysis():
    from calib.uncertainty import Gaussian

    x, pair = scattered(16, 9), np.repeat(np.arange(8), 2)
    model, unknown = curve(x)[0].observations[0].model, calib.Unknown("c", np.zeros(4), "mm", parts="abcd")
    covariance = {k: 0.01 * (np.eye(2) + 0.5) for k in range(8)}
    problem = calib.Problem([calib.Observations(model, unknown, x, u=Gaussian.groups(pair, covariance), group="curve",
                                                covariates={"pair": pair})])
    fit = calib.linearise(problem)
    choice = select(fit, 5, D(), by="pair", floors=Floors(redundancy=0.1))
    request = requested(fit, 5, D(), by="pair", floors=Floors(redundancy=0.1))
    assert not request.checked.readings.independent and request.checked.margin(choice.chosen).excess <= 0
    reliability_agrees(problem, choice, request.checked)


def test_what_possible_rules_out_no_choice_that_meets_the_floors_holds():
    fit = calib.linearise(curve(scattered(10, 6))[0])
    request = requested(fit, 6, D(), floors=Floors(redundancy=0.3))
    checked: Checked = request.checked
    possible = checked.possible() > 0.5
    for chosen in combinations(range(10), 6):
        if checked.margin(chosen).excess <= 0:
            assert possible[list(chosen)].all()


@pytest.mark.parametrize("criterion", [D(), C("middle"), E("c"), G()], ids=["D", "c", "E", "G"])
def test_the_worst_of_three_configurations_is_proven_by_branch_and_bound(criterion):
    fits = [calib.linearise(curve(scattered(10, seed))[0]) for seed in (30, 31, 32)]
    worst = WorstCase(criterion, fits[1:])
    best = select(fits[0], 6, worst, method=Exhaustive())
    proven = select(fits[0], 6, worst, method=BranchAndBound())
    assert proven.value == pytest.approx(best.value, rel=1e-6) and proven.proven
    single = [select(one, 6, criterion, method=Exhaustive()).value for one in fits]
    assert best.value <= min(single) * (1 + 1e-9) if criterion.largest_is_best else \
        best.value >= max(single) * (1 - 1e-9)


def test_the_next_best_measurement_for_a_determinant_counts_as_a_gain_too():
    fit = calib.linearise(curve(scattered(12, 7))[0])
    ranking = next_best(fit, D(), made={"curve": range(1, 7)})
    assert ranking[0].value == max(one.value for one in ranking) and ranking[0].ratio < 1
    again = lowers_most(fit, "middle", made={"curve": range(1, 7)})
    assert again == next_best(fit, C("middle"), made={"curve": range(1, 7)})


def test_before_a_quantity_is_known_every_single_candidate_is_named_with_what_it_achieves():
    fit = calib.linearise(curve(np.linspace(-1, 1, 8))[0])
    ranking = lowers_most(fit, "c.d", made={"curve": [1, 2, 3]})
    assert len(ranking) == 5 and all(np.isfinite(one.value) and one.ratio == 0.0 for one in ranking)
    few = lowers_most(fit, "c.d", made={"curve": [1, 2]})
    assert all(not np.isfinite(one.value) and one.ratio == 1.0 for one in few)


def test_duplicated_candidates_are_named_and_may_be_excluded():
    x = np.append(X, X[:2])
    fit = calib.linearise(curve(x)[0])
    choice = select(fit, 6, D(), exclusive=[("curve row 1", "curve row 12"), ("curve row 2", "curve row 13")])
    rows = set(choice.rows["curve"].tolist())
    assert not {1, 12} <= rows and not {2, 13} <= rows
    assert any("2 candidates repeat others exactly" in remark for remark in choice.remarks)
