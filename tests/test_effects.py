import numpy as np
import pytest
from shipped import EXAMPLES, example_with_effects, modules, offered_effects, plausible_values

from calib import (
    Effect,
    Observations,
    Parameter,
    Problem,
    Unknown,
    covariance,
    direct,
    hands_slots_to,
    linearise,
    predict,
    simulate,
    solve,
)
from calib.errors import DeclarationError
from calib.system import System

FOUND = 4.5       # standard uncertainties: one of 150 000 draws lies beyond
EVERY = 6         # of the effects, one in so many is recovered in the fast suite, all of them with -m slow
ATTACHED = [(name, effect.label) for name in EXAMPLES for effect in example_with_effects(name).effects]


def truth_of(attached):
    """Parameters at the upper end of what is plausible, of either sign where that is allowed."""
    unknown = attached.unknown
    size = np.array([p.plausible[1] for p in attached.effect.parameters])
    turn = np.arange(unknown.count * len(size)).reshape(unknown.count, -1) % 2
    return (np.where((unknown.lower < 0.0) & (turn == 1), -1.0, 1.0) * size).reshape(unknown.shape)


@pytest.mark.parametrize("name", EXAMPLES)
def test_zero_parameters_contribute_exactly_zero(name):
    problem = example_with_effects(name)
    bare = Problem(problem.observations, problem.constraints, problem.quantities)
    values = plausible_values(problem, System(problem), seed=2, share=0.0)
    for attached in problem.attached:
        assert not np.any(values[attached.unknown])
    with_effects, without = System(problem), System(bare)
    for one, other in zip(with_effects.terms, without.terms, strict=True):
        np.testing.assert_array_equal(one.predict(values), other.predict(values))


def test_every_parameter_of_every_effect_changes_a_reading_at_once_in_some_example():
    """A derivative that vanishes at zero would hide the effect from every test that looks for it there."""
    change: dict[tuple[str, str], float] = {}
    for name in EXAMPLES:
        problem = example_with_effects(name)
        system = System(problem)
        values = plausible_values(problem, system, seed=3, share=0.0)
        largest = np.zeros(system.layout.size)
        for term, weighting in zip(system.terms, system.weightings(values), strict=True):
            for part in term.derive(values, held_too=True)[1]:
                in_units_of_u = np.abs(part.jacobian / weighting.u[:, :, None]).max(axis=1)
                np.maximum.at(largest, part.columns.ravel(), in_units_of_u.ravel())
        for attached in problem.attached:
            spans = largest[system.layout.span(attached.unknown)].reshape(attached.unknown.count, -1).max(axis=0)
            for parameter, size in zip(attached.effect.parameters, spans, strict=True):
                key = (attached.effect.label, parameter.name)
                change[key] = max(change.get(key, 0.0), size * parameter.plausible[1])
    unseen = {key: size for key, size in change.items() if not size > 1e-6}
    assert not unseen, "a plausible size changes no reading by a millionth of u"


def test_every_effect_that_a_module_offers_acts_in_some_example():
    acting = {label for _, label in ATTACHED}
    offered = {(module.__name__, e.label) for module in modules() for e in offered_effects(module.__name__)}
    assert [case for case in sorted(offered) if case[1] not in acting] == []


@pytest.mark.parametrize(("name", "label"), [
    pytest.param(*case, marks=() if number % EVERY == 0 else pytest.mark.slow) for number, case in enumerate(ATTACHED)])
def test_an_effect_of_plausible_size_is_found_within_its_uncertainty(name, label):
    problem = example_with_effects(name)
    attached = problem.attached_effect(label)
    truth, freed = truth_of(attached), problem.free(attached.effect)
    fit = linearise(freed, {attached.unknown: truth})
    if fit.factor.defect:
        pytest.skip("the free unknowns of this example absorb it")
    if np.min(np.abs(truth.ravel()) / covariance(fit, attached.effect).u) < 1.0:
        pytest.skip("smaller than its uncertainty in this example")
    estimate = solve(simulate(freed, {attached.unknown: truth}, seed=7))
    u = covariance(linearise(estimate), attached.effect).u
    at_bound = u == 0.0                       # a bound that holds leaves no uncertainty, and the truth lies near it
    missed = np.abs(estimate[attached.effect].ravel() - truth.ravel()) / np.where(at_bound, np.abs(truth.ravel()), u)
    assert estimate.certificate.passed, estimate.certificate.why
    assert np.all(missed <= FOUND)


# --- what an effect is made of, on small problems ---------------------------------------------------------------------


def inclined(tilt, place, *, reading=direct):
    return reading(tilt * place, distance=place)


@hands_slots_to(inclined)
def doubled(tilt, place, *, tilted=direct, **slots):
    return inclined(tilted(2.0 * tilt), place, **slots)


def gain(name="gain", **options):
    return Effect(name, "reading", lambda value, p: p.k * value, (Parameter("k", "1", (1e-4, 1e-2)),), **options)


def level_readings(model=inclined, group="level", **options):
    tilt = Unknown("tilt", 2.0, "rad")
    place = np.linspace(1.0, 3.0, 6)
    return Observations(model, tilt, place, u=1e-3, readings=np.zeros(6), group=group, **options)


def with_values(problem, **values):
    return predict(problem, {problem.parameters(name): value for name, value in values.items()})


def test_contributions_at_one_slot_see_the_nominal_value_and_their_order_does_not_matter():
    offset = Effect("offset", "reading", lambda value, p: p.o, (Parameter("o", "rad", (1e-6, 1e-3)),))
    observations = level_readings()
    for effects in ((gain(), offset), (offset, gain())):
        problem = Problem([observations], effects=effects)
        found = with_values(problem, gain=[[0.5]], offset=[[10.0]])["level"][:, 0]
        np.testing.assert_allclose(found, 2.0 * np.linspace(1.0, 3.0, 6) * 1.5 + 10.0, rtol=1e-15)


def test_an_effect_may_ask_for_slot_quantities_arguments_and_covariates_by_name():
    def weighted(value, p, distance, tilt, time):
        return p.a * (distance + 10.0 * tilt + 100.0 * time)

    names = Effect("sum", "reading", weighted, (Parameter("a", "1", (1e-6, 1.0)),))
    time = np.arange(6.0)
    problem = Problem([level_readings(covariates={"time": (time, "s"), "operator": ["a"] * 6})], effects=[names])
    place = np.linspace(1.0, 3.0, 6)
    found = with_values(problem, sum=[[1.0]])["level"][:, 0] - 2.0 * place
    np.testing.assert_allclose(found, place + 20.0 + 100.0 * time, rtol=1e-15)


def test_per_gives_every_key_of_a_covariate_parameters_of_its_own():
    problem = Problem([level_readings(covariates={"target": list("ABABCA")})], effects=[gain(per="target")])
    attached = problem.attached_effect("gain")
    assert attached.keys == ("A", "B", "C") and attached.unknown.count == 3
    found = with_values(problem, gain=[[1.0], [2.0], [3.0]])["level"][:, 0]
    np.testing.assert_allclose(found, 2.0 * np.linspace(1.0, 3.0, 6) * (1.0 + np.array([1, 2, 1, 2, 3, 1])), rtol=1e-15)


def test_an_effect_keeps_to_its_groups_and_slots_are_handed_on():
    tilt, place = Unknown("tilt", 2.0, "rad"), np.linspace(1.0, 3.0, 6)
    both = [Observations(m, tilt, place, u=1e-3, group=g) for m, g in ((inclined, "plain"), (doubled, "through"))]
    upstream = Effect("upstream", "tilted", lambda value, p: p.a, (Parameter("a", "rad", (1e-6, 1.0)),))
    problem = Problem(both, effects=[gain(groups=("through",)), upstream])
    assert problem.attached_effect("gain").places == ("through",) == problem.attached_effect("upstream").places
    found = with_values(problem, gain=[[1.0]], upstream=[[0.5]])
    np.testing.assert_array_equal(found["plain"][:, 0], 2.0 * place)
    np.testing.assert_allclose(found["through"][:, 0], 4.5 * place * 2.0, rtol=1e-15)


def test_effects_start_held_and_are_freed_and_held_by_handle():
    problem = Problem([level_readings()], effects=[effect := gain()])
    assert problem.is_held(problem.parameters(effect)).all()
    assert not problem.free(effect).is_held(problem.parameters(effect)).any()
    assert problem.free(effect).hold(effect).is_held(problem.parameters(effect)).all()
    assert problem.is_held(problem.parameters("gain")).all()


ONE = (Parameter("k", "1", (0.1, 1.0)),)


@pytest.mark.parametrize(("effect", "words"), [
    (Effect("lost", "redaing", lambda value, p: p.k, ONE), "acts nowhere.*redaing"),
    (Effect("lost", "reading", lambda value, p, warmth: p.k * warmth, ONE), "warmth.*distance"),
    (gain(per="target"), "target"),
    (gain(groups=("levle",)), "acts nowhere"),
])
def test_an_effect_that_acts_nowhere_raises_with_the_names_that_exist(effect, words):
    with pytest.raises(DeclarationError, match=words):
        Problem([level_readings()], effects=[effect])


def test_an_effect_without_parameters_or_with_a_wrong_function_is_refused():
    with pytest.raises(DeclarationError, match="no parameter"):
        Effect("nothing", "reading", lambda value, p: 0.0)
    with pytest.raises(DeclarationError, match="must take"):
        Effect("wrong", "reading", lambda value: 0.0, (Parameter("k", "1", (0.1, 1.0)),))
