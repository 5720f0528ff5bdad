"""Compensation, minimal parametrisation and closed loops."""

import numpy as np
import pytest

import calib
from calib import Observations, Pose, Problem, Shared, Unknown
from calib.errors import DeclarationError, InputError
from calib.geometry import Transform, rotation_from_rpy
from calib.mechanism import Frame, Mechanism, Rotary, location_errors, observe, scale, zero_offset
from calib.mechanism.compensation import commands_of, inverse_problem, pose_error, wanted_pose
from calib.mechanism.loop import check_closed, closed
from calib.mechanism.statement import minimal
from calib.units import mm, mrad


def arm() -> Mechanism:
    return Mechanism("arm", axes=[
        Rotary("J1", (0, 0, 1), limits=(-3, 3)), Rotary("J2", (0, 1, 0), (0, 0, 0.3), "J1", (-2, 2)),
        Rotary("J3", (0, 1, 0), (0, 0, 0.7), "J2", (-2, 2)), Rotary("J4", (0, 0, 1), (0, 0, 0.9), "J3", (-3, 3)),
        Rotary("J5", (0, 1, 0), (0, 0, 1.0), "J4", (-2, 2)), Rotary("J6", (0, 0, 1), (0, 0, 1.1), "J5", (-3, 3))],
        frames=[Frame("flange", (0.05, 0, 1.2), carried_by="J6")])


def calibrated(seed=1):
    """A simulated calibration of the arm by a tracker on a target, with all that can be known free, and its truth."""
    mechanism, generator = arm(), np.random.default_rng(seed)
    positions = generator.uniform(-1.2, 1.2, (60, 6))
    rotations, places = mechanism.poses("flange", positions)
    effects = location_errors(mechanism, ["J2", "J3", "J4", "J5", "J6"])
    observations = Observations(observe.measured_pose(mechanism.pose("flange")), Pose("world"), positions,
                                Pose("target"),
                                rotations, readings=observe.pose_readings(places, rotations), group="poses",
                                u=[0.02 * mm] * 3 + [0.05 * mrad] * 3)
    problem = Problem([observations], effects=effects).free(*effects)
    problem = problem.hold(*minimal(calib.linearise(problem)).to_hold,
                           *(u for u in problem.unknowns if u.name in ("world", "target")))
    truth = {problem.parameters(e).name: generator.normal(0, 0.5e-3, (1, 1))
             * ~problem.is_held(problem.parameters(e)) for e in effects}
    problem = calib.simulate(problem, truth, seed)
    return mechanism, problem, truth, calib.solve(problem)


@pytest.fixture(scope="module")
def arm_with_errors():
    return calibrated()


def test_commands_of_the_calibrated_arm_reach_the_wanted_pose(arm_with_errors):
    mechanism, problem, truth, estimate = arm_with_errors
    nominal = np.array([0.3, 0.5, 0.7, -0.4, 0.6, 0.2])
    wanted = wanted_pose(mechanism, "flange", nominal)
    inverse = inverse_problem(mechanism, "flange", wanted, nominal, problem, {e: estimate[e] for e in problem.effects},
                              place=1e-6, turn=1e-6)
    by_newton, by_ipopt = (calib.solve(inverse, method) for method in (calib.GaussNewton(), calib.Ipopt()))
    np.testing.assert_allclose(commands_of(by_newton), commands_of(by_ipopt), atol=1e-9)
    assert np.abs(by_newton.residuals["wanted pose"]).max() < 1e-10
    # what is left is what the calibration does not know, and it says so
    before, after = (pose_error(mechanism, "flange", wanted, q, problem) for q in (nominal, commands_of(by_newton)))
    found = {x: estimate[x] for x in problem.unknowns}
    real_before, real_after = (_known(problem, quantity, {**found, **truth}).values for quantity in (before, after))
    assert np.linalg.norm(real_before[:3]) > 20 * np.linalg.norm(real_after[:3])
    assert np.all(np.abs(real_after) < 5 * _known(problem, after, found).u)


def _known(problem, quantity, values):
    """Value and uncertainty of one more quantity at given values of the unknowns."""
    return calib.covariance(calib.linearise(problem.with_quantities(quantity), values), quantity)


def test_commands_stay_within_the_limits_and_the_miss_is_what_remains(arm_with_errors):
    mechanism, problem, _, estimate = arm_with_errors
    wanted = wanted_pose(mechanism, "flange", [0.3, 2.15, 0.1, 0.0, 0.6, 0.2])      # J2 would go beyond its limit of 2
    inverse = inverse_problem(mechanism, "flange", wanted, [0.3, 1.9, 0.1, 0.0, 0.6, 0.2], problem,
                              {e: estimate[e] for e in problem.effects}, place=1e-3, turn=None)
    free = calib.solve(inverse_problem(mechanism, "flange", wanted, [0.3, 1.9, 0.1, 0.0, 0.6, 0.2], problem,
                                       {e: estimate[e] for e in problem.effects}, place=1e-3, turn=None, stay=10.0),
                       calib.Ipopt())
    commands = commands_of(free)
    limits = np.array([axis.limits for axis in mechanism.axes])
    assert np.all(commands >= limits[:, 0]) and np.all(commands <= limits[:, 1])
    assert inverse.select("commands").unknown.upper[0, 1] == 2.0
    with pytest.raises(DeclarationError, match=r"start of 'J2' is 2\.1 rad, outside its limits"):
        inverse_problem(mechanism, "flange", wanted, [0.3, 2.1, 0.1, 0.0, 0.6, 0.2], problem, {}, place=1e-3, turn=None)


def test_parallel_axes_and_doubled_zeros_are_named_as_confounded():
    mechanism = arm()
    positions = np.random.default_rng(1).uniform(-1.0, 1.0, (40, 6))
    effects = (*location_errors(mechanism, ["J2", "J3"]), zero_offset(mechanism.axis("J2")),
               scale(mechanism.axis("J1")))
    observations = Observations(observe.measured_point(mechanism.pose("flange")), Pose("world"), positions,
                                Unknown("target", np.zeros(3), "mm"), u=0.1 * mm, group="points")
    problem = Problem([observations], effects=effects).free(*effects)
    statement = minimal(calib.linearise(problem))
    held = {c.label: c.sentence for c in statement.confounded}
    # the zero of J2 is its location about its own axis; J3 is parallel to J2: one of their shifts along the arm is free
    assert "zero_J2 (J2)" in held and "EB0J2 (J2)" in held["zero_J2 (J2)"]
    assert "scale_J1 (J1)" in statement.kept and "world.x" in statement.kept
    problem = problem.hold(*statement.to_hold)
    assert calib.estimability(calib.linearise(problem)).defect == 0
    freed = problem.free(*[c.selection for c in statement.confounded][:1])
    assert calib.estimability(calib.linearise(freed)).defect == 1


def test_what_changes_no_reading_is_said_to_change_none():
    mechanism = Mechanism("spindle", [Rotary("C", (0, 0, 1))], [Frame("nose", carried_by="C")])
    effect = zero_offset(mechanism.axis("C"))
    observations = Observations(observe.measured_point(mechanism.pose("nose")), Pose("world"), [[0.0], [1.0]],
                                Shared((0.0, 0.0, 0.1)), u=1e-6, group="points")
    problem = Problem([observations], effects=[effect], held=[observations.unknowns[0]]).free(effect)
    statement = minimal(calib.linearise(problem))
    assert statement.confounded[0].sentence.startswith("zero_C (C) changes no reading")


def four_bar() -> Mechanism:
    """A planar four-bar linkage: crank of 0.1 m and coupler of 0.3 m on one side, rocker of 0.25 m on the other."""
    return Mechanism("four-bar", axes=[
        Rotary("crank", (0, 0, 1)), Rotary("coupler", (0, 0, 1), (0.1, 0, 0), "crank"),
        Rotary("rocker", (0, 0, 1), (0.3, 0, 0))],
        frames=[Frame("end", (0.4, 0, 0), carried_by="coupler"), Frame("pin", (0.55, 0, 0), carried_by="rocker")])


def test_a_closed_loop_finds_its_passive_joints():
    mechanism = four_bar()
    driven = np.deg2rad([20.0, 60.0, 110.0])
    positions = Unknown("positions", np.stack([driven, 0.8 - driven, np.full(3, 1.6)], axis=1), "deg",
                        parts=("crank", "coupler", "rocker"), keys=("1", "2", "3"))
    reading = Observations(lambda q: q[0], positions.each, readings=driven, u=1e-6, group="crank encoder")
    # in the plane the third component of the gap is zero whatever the joints do
    def gap(q):
        first, second = mechanism.pose("end")(q), mechanism.pose("pin")(q)
        return (first.translation - second.translation)[:2]
    loop = calib.Constraint("loop", gap, positions.each, tolerance=1e-10)
    estimate = calib.solve(Problem([reading], constraints=[loop]))
    q = estimate[positions]
    (_, end), (_, pin) = mechanism.poses("end", q), mechanism.poses("pin", q)
    np.testing.assert_allclose(end, pin, atol=1e-10)
    # the distance of the two pins by the law of cosines on either side
    across = np.sqrt(0.1 ** 2 + 0.3 ** 2 - 2 * 0.1 * 0.3 * np.cos(driven))
    tip = 0.1 * np.exp(1j * driven)
    np.testing.assert_allclose(np.abs(0.3 - tip), across, atol=1e-12)
    np.testing.assert_allclose(np.abs(tip + 0.3 * np.exp(1j * (q[:, 0] + q[:, 1])) - 0.3), 0.25, atol=1e-10)


def test_a_loop_that_is_not_closed_is_named_with_row_and_gap():
    mechanism = four_bar()
    with pytest.raises(InputError, match=r"the loop of 'end' and 'pin' is not closed: in row 2 the two ends are"):
        check_closed(mechanism, "end", "pin", [[0.0, 0.0, 0.0], [0.5, 0.5, 2.5]], (0, 0, 0), (-0.15, 0, 0), 1 * mm)
    positions = Unknown("positions", np.zeros((2, 3)), "rad")
    constraint = closed("loop", mechanism, "end", "pin", positions.each, (0, 0, 0), (-0.15, 0, 0))
    assert constraint.n == 2 and constraint.is_equality


def test_a_pose_of_a_frame_with_errors_is_what_the_model_says(arm_with_errors):
    mechanism, problem, _, _ = arm_with_errors
    quantity = pose_error(mechanism, "flange", Transform(rotation_from_rpy(0, 0, 0), np.zeros(3)), np.zeros(6), problem)
    assert quantity.parts(6) == ("dx", "dy", "dz", "rx", "ry", "rz")
