"""Reliability floors, planning, and what is said where a request cannot be met."""

from __future__ import annotations

from itertools import combinations

import casadi as ca
import numpy as np
import pytest
from test_selection import curve, scattered

import calib
from calib import (
    A,
    C,
    D,
    Ds,
    Effect,
    Exchange,
    Exhaustive,
    Floors,
    Observations,
    Parameter,
    Problem,
    Quantity,
    Unknown,
    direct,
    prior,
    select,
)
from calib.analyse.selection.planning import along, next_best, over
from calib.errors import DeclarationError, InputError, RankDefect
from calib.units import mm


def checked(problem, choice):
    """Reliability of the kept readings, from the analysis that every user has."""
    return calib.reliability(calib.linearise(problem.keep(choice.masks)))


@pytest.mark.parametrize("method", [Exhaustive(), Exchange()])
def test_every_kept_reading_of_a_choice_with_floors_meets_them(method):
    problem, _ = curve(scattered(14, 1))
    fit = calib.linearise(problem)
    free = select(fit, 7, D(), method=method)
    assert checked(problem, free).redundancy.min() < 0.2
    safe = select(fit, 7, D(), floors=Floors(redundancy=0.2), method=method)
    assert checked(problem, safe).redundancy.min() >= 0.2
    assert safe.value < free.value
    assert isinstance(method, Exhaustive) or safe.bound >= free.value * (1 - 1e-9)


def test_limits_of_hidden_biases_and_their_influence_hold_in_the_kept_readings():
    problem, _ = curve(scattered(16, 2), u=0.01 * mm)
    fit = calib.linearise(problem)
    free = checked(problem, select(fit, 8, C("middle")))
    limit_mdb, limit_influence = 0.7 * free.mdb.max(), 0.8 * free.influence["middle"].__abs__().max()
    floors = Floors(mdb={"curve": limit_mdb}, influence={"middle": limit_influence})
    kept = checked(problem, select(fit, 8, C("middle"), floors=floors))
    assert kept.mdb.max() <= limit_mdb * (1 + 1e-9)
    assert np.abs(kept.influence["middle"]).max() <= limit_influence * (1 + 1e-9)


def test_the_bound_says_that_it_leaves_the_floors_out():
    problem, _ = curve(scattered(14, 1))
    choice = select(calib.linearise(problem), 8, D(), floors=Floors(redundancy=0.2))
    assert any("leaves the floors out" in remark for remark in choice.remarks)


def test_a_floor_out_of_reach_is_refused_with_what_can_be_reached():
    problem, _ = curve(scattered(14, 1))
    fit = calib.linearise(problem)
    with pytest.raises(InputError, match=r"no choice of 8 or more of the 14 candidates can reach more than (0\.\d+)"):
        select(fit, 8, D(), floors=Floors(redundancy=0.9))
    with pytest.raises(InputError, match=r"keep more \(at least 6"):
        select(fit, 5, D(), floors=Floors(redundancy=0.3))


def test_what_a_refusal_calls_out_of_reach_no_subset_reaches():
    problem, _ = curve(scattered(11, 1))
    fit = calib.linearise(problem)
    with pytest.raises(InputError) as refused:
        select(fit, 7, D(), floors=Floors(redundancy=0.95))
    limit = float(refused.value.sentence.split("more than ")[1].split(":")[0])
    rows = fit.rows[0].toarray()
    least = [1 - np.max(np.sum((np.linalg.qr(rows[list(c)])[0]) ** 2, axis=1)) for c in combinations(range(11), 7)]
    assert max(least) <= limit + 1e-3
    with pytest.raises(InputError):
        select(fit, 7, D(), floors=Floors(redundancy=max(least) + 1e-6), method=Exhaustive())
    choice = select(fit, 7, D(), floors=Floors(redundancy=max(least) - 1e-6), method=Exhaustive())
    assert checked(problem, choice).redundancy.min() >= max(least) - 1e-6


def test_a_floor_that_contradicts_itself_is_refused():
    with pytest.raises(InputError, match="below 1"):
        Floors(redundancy=1.2)
    with pytest.raises(InputError, match="must be positive"):
        Floors(mdb={"curve": -1.0})
    problem, _ = curve(scattered(9, 1))
    with pytest.raises(InputError, match="no group 'kurve'; there are curve"):
        select(calib.linearise(problem), 6, D(), floors=Floors(mdb={"kurve": 1.0}))


# --- bad input ----------------------------------------------------------------------------------------------------


def test_too_few_for_the_unknowns_is_refused_with_the_number_that_would_do():
    problem, unknown = curve(scattered(9, 3))
    with pytest.raises(InputError, match=r"keep = 3 .*4 unknowns; keep at least 4"):
        select(calib.linearise(problem), 3, D())
    more = problem.with_observations(prior(unknown.part("d"), 0.0, 1.0))
    assert len(select(calib.linearise(more), 3, D()).chosen) == 3


def test_too_few_for_a_quantity_is_refused_in_the_words_of_the_problem():
    problem, unknown = curve(scattered(9, 3))
    with pytest.raises(RankDefect, match=r"c\.[abcd].*changes no reading.*keep 4 or more"):
        select(calib.linearise(problem), 2, A(unknown))


def test_nothing_estimable_is_refused():
    problem, unknown = curve(np.full(8, 0.4))
    with pytest.raises(RankDefect, match="changes no reading"):
        select(calib.linearise(problem), 5, D())
    with pytest.raises(RankDefect, match="cannot be known"):
        select(calib.linearise(problem), 5, A(unknown))
    assert select(calib.linearise(problem), 5, C("middle")).value == pytest.approx(0.1**2 / 5 / mm**2)
    with pytest.raises(InputError, match="every observation is fixed"):
        select(calib.linearise(problem), 1, D(), always="curve")


def test_more_than_there_are_and_unknown_names_are_refused():
    problem, unknown = curve(scattered(9, 3), side=np.arange(9) % 2)
    fit = calib.linearise(problem)
    with pytest.raises(InputError, match="there are 9 candidates; ask for 1 to 9"):
        select(fit, 10, D())
    with pytest.raises(InputError, match="how many candidates"):
        select(fit)
    with pytest.raises(InputError, match="no covariate 'sid'; did you mean 'side'"):
        select(fit, 1, D(), by="sid")
    with pytest.raises(DeclarationError, match="there are curve"):
        select(fit, 5, D(), always="kurve")
    with pytest.raises(InputError, match=r"'curve' has no row 12"):
        select(fit, 5, D(), always={"curve": [1, 12]})
    with pytest.raises(InputError, match="no candidate 'curve row 12'"):
        select(fit, 5, D(), exclusive=[("curve row 1", "curve row 12")])
    with pytest.raises(InputError, match="costs: 3 numbers for 9 candidates"):
        select(fit, 5, D(), costs=[1, 2, 3], budget=4.0)
    with pytest.raises(InputError, match="one scalar"):
        select(fit, 5, C(unknown))


def test_contradictory_limits_are_refused_with_the_nearest_number():
    problem, _ = curve(scattered(12, 4), side=np.arange(12) % 2)
    fit = calib.linearise(problem)
    with pytest.raises(InputError, match=r"keep = 7 contradicts .*at most 3 of side 0.*room for 6; ask for 6"):
        select(fit, 7, D(), at_most={"side": 3})
    with pytest.raises(InputError, match=r"budget of 4\.5.*ask for 4"):
        select(fit, 5, D(), costs=np.ones(12), budget=4.5)
    with pytest.raises(InputError, match=r"cheapest candidate.*costs 1"):
        select(fit, 5, D(), costs=np.ones(12), budget=0.5)


def test_a_row_that_stands_twice_is_refused_and_equal_candidates_are_named():
    x = scattered(9, 5)
    unknown = Unknown("c", np.zeros(4), "mm", parts="abcd")
    model = curve(x)[0].observations[0].model
    twice = Problem([Observations(model, unknown, x, u=0.1, group="curve", rows=[1, 2, 3, 4, 5, 6, 7, 8, 8])])
    with pytest.raises(InputError, match="curve row 8 stands twice"):
        select(calib.linearise(twice), 6, D())
    assert select(calib.linearise(twice), 6, D(), by="row").candidates == 8
    problem, _ = curve(np.append(x, x[0]))
    choice = select(calib.linearise(problem), 6, D())
    assert any("'curve row 10' repeats 'curve row 1'" in remark for remark in choice.remarks)


def test_quantities_of_different_units_do_not_add():
    length, angle = Unknown("length", 0.0, "mm"), Unknown("angle", 0.0, "arcsec")
    plan = Problem([Observations(lambda a, b, x: a + b * x, length, angle, scattered(8, 6), u=1e-3, group="lever")])
    fit = calib.linearise(plan)
    with pytest.raises(InputError, match="arcsec and mm do not add"):
        select(fit, 4, A(length, angle))
    assert select(fit, 4, Ds(length, angle), method=Exhaustive()).chosen == select(fit, 4, D(),
                                                                                 method=Exhaustive()).chosen


# --- planning -----------------------------------------------------------------------------------------------------


def test_settings_over_their_ranges_are_all_combinations():
    settings = over(azimuth=np.linspace(0, 1, 3), height=[0.1, 0.2])
    assert len(settings["azimuth"]) == 6 and set(zip(*settings.values())) == {
        (a, h) for a in (0.0, 0.5, 1.0) for h in (0.1, 0.2)}


def reading_of_angle(level, wobble, angle, *, encoder=direct):
    reading = encoder(angle, angle=angle)
    return level + wobble * ca.sin(reading)


def tilted(value, p, angle):
    return p.c * ca.cos(angle)


def doubled(value, p, angle):
    return p.c * ca.cos(3 * angle)


def test_the_next_best_measurement_lowers_u_most_and_as_promised():
    problem, _ = curve(scattered(12, 7))
    fit = calib.linearise(problem)
    ranking = next_best(fit, C("middle"), made={"curve": range(1, 7)})
    assert len(ranking) == 6 and ranking[0].ratio == min(r.ratio for r in ranking) < 1
    row = int(ranking[0].label.split()[-1])
    with_it = problem.keep({"curve": np.isin(np.arange(1, 13), [*range(1, 7), row])})
    u = calib.covariance(calib.linearise(with_it), "middle").u[0]
    assert ranking[0].value == pytest.approx((u / mm) ** 2, rel=1e-9)


def test_the_next_best_measurement_separates_two_effects_that_the_present_data_cannot_tell_apart():
    settings = over(angle=np.concatenate([np.arange(4) * np.pi / 2, [0.1, np.pi / 4, 1.0, 1.5]]))
    level, wobble = Unknown("level", 0.0, "mm"), Unknown("wobble", 1.0, "mm")
    observations = Observations(reading_of_angle, level, wobble, settings["angle"], u=1e-5, group="probe", unit="mm")
    first = Effect("first order", "encoder", tilted, (Parameter("c", "urad", (1e-6, 1e-3)),))
    third = Effect("third order", "encoder", doubled, (Parameter("c", "urad", (1e-6, 1e-3)),))
    problem = Problem([observations]).with_effects(first, third).free(first, third)
    ranking = next_best(calib.linearise(problem), Ds(first, third), made={"probe": [1, 2, 3, 4]})
    best = [r for r in ranking if np.isfinite(r.value)]
    assert best and best[0].ratio == 0.0      # without it the two are not told apart
    # cos^2 x and cos 3x cos x differ by 4 cos^2 x sin^2 x, most at 45 degrees.
    assert best[0].label == "probe row 6"


def test_more_kept_is_never_worse_and_the_bound_stays_ahead():
    problem, unknown = curve(scattered(20, 8))
    steps = along(calib.linearise(problem), A(unknown), range(2, 21, 3))
    values, first = [s.value for s in steps], steps[0].keep
    assert first >= 4 and values == sorted(values, reverse=True)
    assert all(s.bound <= s.value * (1 + 1e-9) for s in steps)


def test_a_plan_without_readings_can_be_chosen_from():
    unknown = Unknown("c", np.zeros(4), "mm", parts="abcd")
    model = curve(scattered(4, 1))[0].observations[0].model
    grid = over(x=np.linspace(-1, 1, 41))
    plan = Problem([Observations(model, unknown, grid["x"], u=0.1, group="curve", covariates=grid)],
                   quantities=[Quantity("middle", lambda c: c[0], unknown, unit="mm")])
    choice = select(calib.linearise(plan), 4, D())
    # The D-optimal places of a cubic on [-1, 1]: the ends and +-1/sqrt 5.
    np.testing.assert_allclose(grid["x"][list(choice.chosen)], [-1, -0.45, 0.45, 1], atol=1e-12)
