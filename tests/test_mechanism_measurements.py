"""Every kind of measurement identifies a mechanism, alone and together with others, each with its own frame and
uncertainty: what it can know is found by itself and comes back within its stated uncertainty."""

import numpy as np
import pytest

import calib
from calib import Direction, Observations, Pose, Problem, Shared, Unknown, covariance, linearise
from calib.effect import slots_of
from calib.geometry import rotation_from_rpy
from calib.mechanism import Frame, Linear, Mechanism, Rotary, location_errors, observe, scale
from calib.mechanism.statement import minimal
from calib.mechanism.tolerance import tolerances
from calib.units import arcsec, mrad, um
from instruments import laser_tracker, theodolite

# a table that turns and tilts on a slide, with room for all instruments
STAND = Mechanism("stand", axes=[Linear("X", (1, 0, 0), limits=(-0.5, 0.5)), Rotary("C", (0, 0, 1), carried_by="X"),
                                 Rotary("A", (1, 0, 0), (0, 0, 0.3), carried_by="C", limits=(-1.5, 1.5))],
                  frames=[Frame("table", (0, 0, 0.4), carried_by="A"), Frame("column", (0.5, 0.5, 0.0))])
ARM = Mechanism("arm", axes=[Rotary("J1", (0, 0, 1)), Rotary("J2", (0, 1, 0), (0, 0, 0.3), "J1"),
                             Rotary("J3", (0, 1, 0), (0, 0, 0.7), "J2"), Rotary("J4", (0, 0, 1), (0, 0, 0.9), "J3"),
                             Rotary("J5", (0, 1, 0), (0, 0, 1.0), "J4")],
                frames=[Frame("hand", (0, 0, 1.2), carried_by="J5")])
TABLE = STAND.pose("table")
EFFECTS = (*location_errors(STAND), *(scale(axis) for axis in STAND.axes), *location_errors(ARM))
SIZES = {"E": 0.3e-3, "s": 2e-4}      # metres or radians; ratio


def positions(seed=1, n=40):
    generator = np.random.default_rng(seed)
    return generator.uniform([-0.5, -3.0, -1.4], [0.5, 3.0, 1.4], (n, 3))


def places(count, seed=2):
    return np.random.default_rng(seed).uniform(-0.3, 0.3, (count, 3))


def index(count, n=40):
    return np.arange(n) % count


def frame(name, rpy, place):
    return Pose(name, rotation_from_rpy(*rpy), np.asarray(place, float), unit="mm", angle_unit="arcsec")


def poses():
    q, rotations = positions(), STAND.poses("table", positions())[0]
    return [Observations(observe.measured_pose(TABLE), frame("camera", (0.2, 0.1, 2.0), (1.0, -2.0, 1.5)), q,
                         frame("target", (0, 0, 0), (0.1, 0.2, 0.0)), rotation_from_rpy(0.2, 0.1, 2.0) @ rotations,
                         u=[20 * um] * 3 + [40e-6] * 3, group="poses")]


def points():
    reflector = Unknown("reflector", places(3), "mm")
    return [Observations(observe.measured_point(TABLE), frame("tracker", (0.1, 0, 1), (3, 0, 1)), positions(),
                         reflector[index(3)], u=10 * um, group="points")]


def distances():
    """A ball bar from three sockets on the floor to two on the table; nobody knows where any of them is."""
    sockets = Unknown("socket", [[1.5, 0, 0], [-0.5, 1.5, 0.1], [0, -1.2, 0.8]], "mm")
    balls, n = Unknown("ball", places(2), "mm"), 160
    return [Observations(observe.measured_distance(TABLE), sockets[index(3, n)], positions(3, n), balls[index(2, n)],
                         u=2 * um, group="ball bar")]


def distances_of_two_frames():
    """The other end of the bar on a part of the mechanism itself."""
    here, there = Unknown("here", [[0.0, 0, 0], [0, 0.4, 0.9]], "mm"), Unknown("there", places(2), "mm")
    pose = STAND.pose("table", seen_from="column")
    return [Observations(observe.measured_distance(pose), here[index(2, 120)], positions(4, 120), there[index(2, 120)],
                         u=2 * um, group="bar")]


def level():
    sensitive = Direction("sensitive", [[1.0, 0.02, 0.0], [0.0, 1.0, 0.03]])
    q = positions(5) * [1, 1, 0.05]
    return [Observations(observe.level_on(TABLE), q, sensitive[index(2)], Shared([0.0, 0.0, -1.0]),
                         Unknown("zero", 0.0, "arcsec"), u=0.5 * arcsec, group="level")]


def mirror():
    """An autocollimator on a polygon of eight faces: only angles, and only near the faces."""
    faces, n = 8, 64
    q = np.zeros((n, 3))
    q[:, 1], q[:, 2] = -(index(faces, n)) * 2 * np.pi / faces, np.random.default_rng(6).uniform(-5e-3, 5e-3, n)
    q[:, 1] += np.random.default_rng(7).uniform(-5e-3, 5e-3, n)
    around = np.arange(faces) * 2 * np.pi / faces
    normal = Direction("face", np.stack([np.cos(around), np.sin(around), np.zeros(faces)], axis=1))
    # the autocollimator looks along -X of the base
    looking = Pose("autocollimator", np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]) @ np.diag([-1.0, 1, -1]))
    return [Observations(observe.sighted_mirror(TABLE), looking, q, normal[index(faces, n)], u=0.1 * arcsec,
                         group="mirror")]


def theodolite_alone():
    target = Unknown("target", places(3), "mm")
    return [Observations(observe.seen_by(TABLE, theodolite.circles), frame("theodolite", (0, 0, 0.4), (4, 1, 0.5)),
                         positions(8, 80), target[index(3, 80)], Shared(1.0), Shared([0.0, 0.0]), Shared([-1.0, 1.0]),
                         u=2 * arcsec, period=(2 * np.pi, 2 * np.pi), group="theodolite")]


def tracker():
    target = Unknown("target", places(3), "mm")
    return [Observations(observe.seen_by(TABLE, laser_tracker.polar), frame("tracker", (0, 0, 0.4), (4, 1, 0.5)),
                         positions(9), target[index(3)], u=[5 * um, 2 * arcsec, 2 * arcsec],
                         period=laser_tracker.PERIOD, group="tracker")]


BALL = np.array([0.1, 0.05, 0.1])


def sockets(known):
    """A ball on an arm is put into two sockets at unknown places, in postures from the nominal arm."""
    seats = np.array([[0.45, -0.05, 0.5], [0.45, 0.05, 0.5]])
    of, generator = np.repeat([0, 1], 30), np.random.default_rng(10)
    near = np.array([0.0, 0.6, 1.2, 0.0, 0.8]) + generator.normal(0, 0.4, (60, 5))
    contact, found = observe.contact(ARM.pose("hand")), near
    for _ in range(3):      # each time nearer to where the search before ended: no gap is left
        posture = Unknown("posture", found, "rad")
        search = [Observations(contact, seats[of], posture.each, Shared(BALL), readings=np.zeros((60, 3)), u=1e-4,
                               group="seats"), calib.prior(posture, found, 0.3)]
        found = calib.solve(Problem(search))[posture]
    place = Unknown("socket", seats, "mm")
    seated = Observations(contact, place[of], found, Unknown("ball", BALL, "mm"), readings=np.zeros((60, 3)), u=10 * um,
                          group="seats")
    apart = Observations(observe.distance_between, place[0], place[1], readings=[0.1], u=2 * um, group="apart")
    return [seated, apart] if known else [seated]


def together():
    """Points by a tracker, angles by a theodolite, a level, a ball bar: each its own frame and uncertainty."""
    return [*points(), *theodolite_alone()[:1], *level(), *distances()]


ALONE = (poses, points, distances, distances_of_two_frames, level, mirror, theodolite_alone, tracker)


def declared(observations):
    """Everything free that these readings can know, and the sentences on the rest."""
    acting = [e for e in EFFECTS if any(e.slot in o.slots for o in observations)]
    problem = Problem(observations, effects=acting).free(*acting)
    statement = minimal(linearise(problem))
    return problem.hold(*statement.to_hold), statement


def recovered(observations, seed, tolerance=None):
    """Standardised errors of all errors of axes that are free, and what these readings cannot know.

    tolerance: where it is stated for every error, all stay free."""
    problem, statement = declared(observations)
    if tolerance is not None:
        problem = problem.free(*problem.effects).with_observations(
            tolerances(problem, dict.fromkeys(problem.effects, tolerance), "tolerances"))
    generator, truth = np.random.default_rng([seed, 3]), {}
    for effect in problem.effects:
        unknown = problem.parameters(effect)
        if not problem.is_held(unknown).any():
            truth[unknown.name] = [[generator.normal(0, SIZES[effect.name[0]])]]
    estimate = calib.solve(calib.simulate(problem, truth, seed))
    assert estimate.certificate.passed, estimate.certificate.why
    free = [problem.parameters(name) for name in truth]
    found = covariance(linearise(estimate), *free)
    return (found.values - np.ravel(list(truth.values()))) / found.u, statement


@pytest.mark.parametrize("kind", ALONE, ids=lambda k: k.__name__)
def test_errors_come_back_from_one_kind_of_measurement_alone(kind):
    errors, statement = recovered(kind(), seed=1)
    assert len(errors) >= 2 and statement.confounded
    assert np.abs(errors).max() < 4.0 and np.sqrt(np.mean(errors ** 2)) < 1.9


def test_angles_alone_know_no_distance_and_say_so():
    _, statement = recovered(mirror(), seed=2)
    lost = {c.label: c.sentence for c in statement.confounded}
    assert lost["EY0A (A)"].startswith("EY0A (A) changes no reading")
    assert {"autocollimator.x", "autocollimator.y", "autocollimator.z"} <= set(lost)


def test_more_kinds_of_measurement_together_know_at_least_what_each_knows_alone():
    kept = set(declared(together())[1].kept)
    for kind in (points, theodolite_alone, level, distances):
        alone = {label for label in declared(kind())[1].kept if label.endswith(")")}
        assert len(alone) <= len({label for label in kept if label.endswith(")")})
    errors, _ = recovered(together(), seed=3)
    assert np.abs(errors).max() < 4.0


def test_a_known_distance_of_two_sockets_gives_the_scale_that_contact_alone_does_not():
    with_distance, without = (declared(sockets(known))[1] for known in (True, False))
    assert len(with_distance.kept) == len(without.kept) + 1


def test_seats_in_two_sockets_and_tolerances_give_errors_within_their_uncertainty():
    errors, _ = recovered(sockets(known=True), seed=1, tolerance=SIZES["E"])
    assert len(errors) > 20 and np.abs(errors).max() < 4.0 and np.sqrt(np.mean(errors ** 2)) < 1.5


def test_noisy_encoders_are_readings_of_their_own():
    """Against a good tracker the encoders are the weaker instrument: positions become unknowns that both read."""
    q = positions(11, 20)
    unknown = Unknown("positions", q, ["mm", "mrad", "mrad"], parts=("X", "C", "A"), keys=[str(i) for i in range(20)])
    reflector = Unknown("reflector", places(3), "mm")
    of = np.repeat(np.arange(20), 3)
    u = np.array([20 * um, 0.1 * mrad, 0.1 * mrad])
    observations = [
        Observations(observe.encoders((0, 1, 2)), unknown.each, readings=q, u=u, group="encoders"),
        Observations(observe.measured_point(TABLE), frame("tracker", (0, 0, 0), (0, 0, 0)), unknown[of],
                     reflector[np.tile(np.arange(3), 20)], u=5 * um, group="points")]
    errors, _ = recovered(observations, seed=4)
    assert np.abs(errors).max() < 4.0 and np.sqrt(np.mean(errors ** 2)) < 1.9


def test_a_point_seen_by_an_instrument_offers_the_slots_of_both():
    model = observe.seen_by(TABLE, theodolite.circles)
    assert {"A_location", "table_mounting", "sight_line", "zenith"} <= set(slots_of(model))
    collimation = next(e for e in theodolite.effects() if e.name == "collimation")
    problem = Problem(theodolite_alone(), effects=[*EFFECTS[:13], collimation]).free("EB0A (A)", collimation)
    problem = problem.hold(*minimal(linearise(problem)).to_hold)
    estimate = calib.solve(calib.simulate(problem, {problem.parameters(collimation): [[2e-3]]}, seed=5))
    found = covariance(linearise(estimate), collimation)
    assert abs(found.values[0] - 2e-3) < 4 * found.u[0] < 2e-3
