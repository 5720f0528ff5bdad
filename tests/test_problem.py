"""Problems: holding, freeing, effects with their slots and keys, and what they refuse."""

import numpy as np
import pytest
from declared import line, network

from calib import (
    Effect,
    Gaussian,
    Observations,
    Parameter,
    Problem,
    Unknown,
    direct,
    hands_slots_to,
    linearise,
    prior,
    simulate,
    solve,
)
from calib.errors import DeclarationError
from calib.trace import offered


def sagging(height, slope, x, *, reading=direct):
    return reading(height + slope * x, arm=2 * x)


DRIFT = Effect("drift", "reading", lambda value, p, time: p.rate * time, (Parameter("rate", "mm/h", (1e-9, 1e-6)),))
LEVER = Effect("lever", "reading", lambda value, p, arm: p.k * arm, (Parameter("k", "1", (1e-6, 1e-3)),))
OFFSET = Effect("offset", "reading", lambda value, p: p.o, (Parameter("o", "mm", (1e-6, 1e-3)),), per="face")


def declare(**changes):
    x = np.linspace(0, 1, 12)
    height, slope = Unknown("height", 0.0, "mm"), Unknown("slope", 0.0, "mm/m")
    covariates = {"time": (np.tile([0.0, 3600.0, 7200.0], 4), "s"), "face": np.array(list("ababbaabbaba"))}
    o = Observations(
        sagging, height, slope, x, readings=0.01 * np.sin(7 * x), u=1e-3, group="sag", covariates=covariates | changes
    )
    return Problem([o], name="sagging beam"), height, slope


def test_holding_and_freeing_return_new_problems_and_leave_the_old_one_alone():
    problem, height, _ = declare()
    held = problem.hold(height)
    assert held.is_held(height).all()
    assert not problem.is_held(height).any()
    assert not held.free(height).is_held(height).any()
    with pytest.raises(AttributeError, match="frozen"):
        problem.name = "other"


def test_one_part_of_one_instance_can_be_held():
    problem, _, point = network(3, 6, 1)
    estimate = solve(problem.hold(point[2].part("y")))
    moved = estimate[point] - point.ambient
    assert moved[2, 1] == 0.0
    assert np.count_nonzero(moved == 0.0) == 1


def test_an_effect_is_off_until_it_is_freed_and_then_recovered():
    problem, height, slope = declare()
    off = problem.with_effects(DRIFT)
    assert solve(off).objective == pytest.approx(solve(problem).objective, rel=1e-12)
    truth = {height: 0.1, slope: 0.2, "drift (reading)": 2e-6}
    estimate = solve(simulate(off.free(DRIFT), truth, 3, noise=False))
    assert estimate[DRIFT] == pytest.approx([2e-6], rel=1e-9)


def test_contributions_at_one_slot_all_see_the_nominal_value():
    gain = Effect("gain", "reading", lambda value, p: p.k * value, (Parameter("k", "1", (1e-6, 1e-3)),))
    problem, height, slope = declare()
    both = problem.with_effects(gain, DRIFT)
    other = problem.with_effects(DRIFT, gain)
    values = {height: 1.0, slope: 0.5, "gain (reading)": 0.1, "drift (reading)": 1e-4}
    from calib import predict

    assert np.allclose(predict(both, values)["sag"], predict(other, values)["sag"], rtol=4e-16, atol=0)
    x, time = problem.observations[0].arguments[2].data, problem.observations[0].covariates["time"][:, None]
    assert np.allclose(predict(both, values)["sag"], (1 + 0.5 * x) * 1.1 + 1e-4 * time)


def test_an_effect_per_key_has_one_candidate_for_each_key():
    problem, *_ = declare()
    attached = problem.with_effects(OFFSET)
    offsets = attached.parameters(OFFSET)
    assert offsets.labels == ["offset (reading)[a]", "offset (reading)[b]"]
    assert linearise(attached.free(offsets[1])).layout.free.sum() == 3


def test_held_effects_keep_their_columns_in_the_linearisation():
    problem, *_ = declare()
    fit = linearise(solve(problem.with_effects(DRIFT, LEVER)))
    columns = [fit.layout.offset[fit.effects[e]] for e in (DRIFT, LEVER)]
    assert not fit.layout.free[columns].any()
    assert np.linalg.norm(fit.held_columns(columns), axis=0).min() > 0


def test_slots_of_an_inner_model_are_slots_of_the_outer_one():
    @hands_slots_to(sagging)
    def outer(height, slope, **slots):
        return sagging(height, slope, 1.0, **slots)

    o = Observations(outer, Unknown("h"), Unknown("s"), readings=[1.0], u=1.0)
    assert o.slots == ("reading",)
    assert offered(o)["reading"] == {"arm", "height", "slope"}


@pytest.mark.parametrize(
    "effect, words",
    [
        (
            Effect("warm", "reading", lambda v, p, temperature: p.k * temperature, (Parameter("k", "1", (0, 1)),)),
            "no observations have slot 'reading' and offer temperature. There are: sag: reading\\(arm, height",
        ),
        (
            Effect("warm", "nowhere", lambda v, p: p.k, (Parameter("k", "1", (0, 1)),)),
            "no observations have slot 'nowhere'",
        ),
    ],
)
def test_an_effect_that_acts_nowhere_is_refused_with_what_there_is(effect, words):
    with pytest.raises(DeclarationError, match=words):
        declare()[0].with_effects(effect)


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda p: p.hold("hight"), "has no unknown 'hight'; did you mean 'height'"),
        (lambda p: p.hold(Unknown("weight")), "does not occur in sagging beam"),
        (lambda p: p.with_readings({"sagg": [1.0]}), "no observations 'sagg'; did you mean 'sag'"),
        (lambda p: Problem([]), "no observations"),
        (lambda p: Problem([*p.observations, *p.observations]), "two groups are called 'sag'"),
        (lambda p: p.with_observations(prior(Unknown("height"), 0.0, 1.0)), "two unknowns are called 'height'"),
        (lambda p: p.free("drift"), "has no unknown 'drift'"),
        (
            lambda p: p.with_effects(OFFSET).free(p.with_effects(OFFSET).parameters(OFFSET)),
            "another unknown of the same name",
        ),
    ],
)
def test_a_wrong_name_is_answered_with_the_right_ones(make, words):
    with pytest.raises(DeclarationError, match=words):
        make(declare()[0])


def test_a_start_may_come_from_an_earlier_estimate_or_by_name():
    problem, _, slope = line(readings=np.arange(5.0))
    estimate = solve(problem, start={"offset": 5.0, slope: -3.0})
    assert solve(problem, start=estimate).iterations <= estimate.iterations
    assert estimate["slope"] == pytest.approx(1.0)


def test_keeping_rows_keeps_their_readings_covariates_and_effects():
    problem, *_ = declare()
    problem = problem.with_effects(DRIFT, OFFSET).free(DRIFT)
    stays = np.arange(12) % 3 != 0
    kept = problem.keep({"sag": stays})
    assert list(kept.observations[0].rows) == [2, 3, 5, 6, 8, 9, 11, 12]
    assert kept.parameters(OFFSET) is problem.parameters(OFFSET)
    weights = np.where(stays, 1e-3, 1e6)
    heavy = problem.with_uncertainty({"sag": Gaussian.standard(weights)})
    assert solve(kept)[DRIFT] == pytest.approx(solve(heavy)[DRIFT], rel=1e-6)


@pytest.mark.parametrize(
    "u",
    [
        lambda n: np.linspace(1, 2, n),
        lambda n: Gaussian.matrix(np.linspace(1, 2, n)[:, None, None]),
        lambda n: Gaussian.serial(0.1, 0.5, np.arange(n), chain=np.arange(n) // 4),
        lambda n: Gaussian.groups(np.arange(n) // 4, {k: np.eye(4) + 0.3 for k in range(3)}),
    ],
)
def test_every_uncertainty_follows_the_rows_that_stay(u):
    problem, *_ = declare()
    kept = problem.with_uncertainty({"sag": u(12) if isinstance(u(12), Gaussian) else Gaussian.standard(u(12))}).keep(
        {"sag": np.arange(12) < 8}
    )
    whole = problem.with_uncertainty({"sag": u(12) if isinstance(u(12), Gaussian) else Gaussian.standard(u(12))})
    assert np.allclose(linearise(kept).groups[0].weighting.u, linearise(whole).groups[0].weighting.u[:8])
    assert solve(kept).certificate.passed
