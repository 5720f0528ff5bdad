"""What an axis may do wrong, each effect off, held and free: it changes nothing while off, moves points while held at a
size, and comes back from readings while free."""

import numpy as np
import pytest

import calib
from calib import Observations, Pose, Problem, Unknown, covariance, linearise
from calib.errors import DeclarationError
from calib.mechanism import (
    Frame,
    Linear,
    Load,
    Mechanism,
    Rotary,
    backlash,
    bending,
    encoder_harmonic,
    error_motion,
    location_errors,
    observe,
    periodic_error_motion,
    polynomial_error_motion,
    sag,
    sag_by_load,
    scale,
    thermal_growth,
    thermal_scale,
)
from calib.mechanism.basis import periodic_basis, polynomial_basis
from calib.units import mm, um

STAND = Mechanism(
    "stand", axes=[Linear("X", (1, 0, 0), limits=(0.0, 0.6)), Rotary("C", (0, 0, 1), (0.1, 0, 0.2), "X"),
                   Rotary("A", (1, 0, 0), (0.1, 0, 0.4), "C", limits=(-0.7, 0.9))],
    frames=[Frame("table", (0.1, 0, 0.5), carried_by="A")],
    loads=[Load("arm", (0.1, 0.2, 0.3), "C", 4.0), Load("work", (0.2, 0.3, 0.6), "A", 9.0)])
X, C, A = STAND.axes
TABLE = STAND.pose("table")
EFFECTS = (
    scale(X), scale(C), backlash(X), backlash(A), encoder_harmonic(C, 1), encoder_harmonic(C, 2),
    encoder_harmonic(A, 3),
    sag(STAND, A), sag_by_load(STAND, A), bending(STAND, A), bending(STAND, C), thermal_growth(C, "Z"),
    thermal_growth(C, "B"), thermal_scale(X), error_motion(X, "X"), error_motion(X, "Y"), error_motion(X, "C"),
    error_motion(C, "Z"), error_motion(C, "X", (2,)), error_motion(C, "A"), polynomial_error_motion(A, "X", (1, 2)),
    periodic_error_motion(X, "X", 5 * mm, (1, 2)), periodic_error_motion(X, "B", 0.1),
    polynomial_error_motion(A, "B"), polynomial_error_motion(A, "A", (1, 2)))


def declared(effects, n=150):
    generator = np.random.default_rng(1)
    q = generator.uniform([0.0, -3.1, -0.7], [0.6, 3.1, 0.9], (n, 3))
    reflector = Unknown("reflector", [[0.2, 0.1, 0.0], [-0.15, 0.2, 0.1], [0.0, -0.2, 0.25]], "mm")
    observations = Observations(
        observe.measured_point(TABLE), Pose("tracker", translation=(0.5, 2, 0)), q, reflector[np.arange(n) % 3],
        u=2 * um, group="points", covariates={"approach": generator.choice([-1.0, 1.0], n),
                                              "temperature_difference": (generator.uniform(-5, 5, n), "K")})
    return Problem([observations], effects=effects)


# one of four in the fast suite, all of them with -m slow
@pytest.mark.parametrize("effect", [pytest.param(e, id=e.label, marks=[pytest.mark.slow] if i % 4 else [])
                                    for i, e in enumerate(EFFECTS)])
def test_an_effect_is_off_held_or_free_at_will(effect):
    problem = declared([effect])
    unknown = problem.parameters(effect)
    bare, off = (calib.predict(p)["points"] for p in (declared([]), problem))
    np.testing.assert_array_equal(off, bare)
    size = np.array([min(0.3 * p.plausible[1], 2e-3) for p in effect.parameters]) * (-1.0) ** np.arange(unknown.freedom)
    held = calib.predict(problem, {unknown: size[None]})["points"]
    assert np.abs(held - bare).max() > 2 * um
    # held at its size it is part of the model, free it is estimated; a location error of its axis is free beside it
    freed = declared([effect, *location_errors(STAND, ["C", "A"])]).free("EA0A (A)", "EB0C (C)", effect)
    own = freed.parameters(effect)
    minimal_set = freed.hold(*_confounded(freed, own))
    drawn = calib.simulate(minimal_set, {own.name: size[None]}, seed=2)
    for problem_of in (drawn, drawn.hold(own)):
        estimate = calib.solve(problem_of, start={own.name: size[None]} if problem_of is not drawn else None)
        assert estimate.certificate.passed and estimate.objective < estimate.dof + 5 * np.sqrt(2 * estimate.dof)
        if problem_of is drawn:
            found = covariance(linearise(estimate), own)
            assert np.all(np.abs(found.values - size) < 4.5 * found.u) and np.all(found.u < 0.5 * np.abs(size))


def _confounded(problem, own):
    from calib.mechanism.statement import minimal
    statement = minimal(linearise(problem), prefer=[u for u in problem.unknowns if u.kind == "pose"] + [own])
    return [s for s in statement.to_hold if s.unknown is not own]


def test_waves_along_an_axis_are_no_location_error_over_the_travel():
    x = np.linspace(0.0, 0.6, 200001)
    for waves in (3, 120):
        basis = periodic_basis(X, 1, 0.6 / waves, (1,))
        overlap = np.trapezoid(np.array(basis.values(x)) * np.stack([np.ones_like(x), x])[:, None], x)
        assert np.abs(overlap).max() < 1e-9 and basis.names == ("c1", "s1")
    q = np.linspace(-0.7, 0.9, 200001)
    tilt = np.array(polynomial_basis(A, 4, (3, 4)).values(q))
    overlap = np.trapezoid(tilt * np.stack([np.ones_like(q), np.cos(q), np.sin(q)])[:, None], q)
    assert np.abs(overlap).max() < 1e-9


def test_error_motions_that_mean_nothing_are_refused():
    with pytest.raises(DeclarationError, match="give a linear axis, a positive period in metres"):
        periodic_error_motion(C, "X", 0.1)
    with pytest.raises(DeclarationError, match="a positive period"):
        periodic_error_motion(X, "X", 0.0)
    with pytest.raises(DeclarationError, match="orders from 3 upward"):
        polynomial_error_motion(A, "B", (2, 3))
