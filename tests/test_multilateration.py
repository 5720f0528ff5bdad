"""Several trackers: calibrated on known targets or by themselves, and what that does to measured coordinates."""

import numpy as np
import pytest
from folders import put

import calib
from calib.errors import InputError
from calib.job import Job
from calib.units import um
from problems import multilateration
from problems.multilateration import Calibration, Ranges

TRACKERS = {"A": (0.0, 0.0, 0.0), "B": (1.6, 0.1, 0.0), "C": (0.2, 1.5, 0.1), "D": (0.6, 0.5, 1.4)}
FLAT = {key: (*place[:2], 0.0) for key, place in TRACKERS.items()}


def cloud(count, seed=5):
    places = np.random.default_rng(seed).uniform((0.2, 0.2, 0.3), (1.4, 1.4, 1.2), (count, 3))
    return {f"T{k:02d}": place for k, place in enumerate(places)}


def self_calibrated(count, trackers=TRACKERS, u=0.5 * um):
    targets = cloud(count)
    return multilateration.declare(Ranges.every(tuple(trackers), tuple(targets), u), trackers, targets)


LINES = {f"L{k:02d}": place for k, place in enumerate(np.vstack(
    [np.column_stack(line) for line in ((np.linspace(0, 1.5, 8), np.zeros(8), np.full(8, 0.1)),
                                        (np.full(8, 1.5), np.linspace(0.1, 1.5, 8), np.full(8, 0.1)),
                                        (np.full(8, 1.5), np.full(8, 1.5), np.linspace(0.2, 1.2, 8)))]))}


def on_lines(u_known=None):
    ranges = Ranges.every(tuple(TRACKERS), tuple(LINES), 0.5 * um)
    return multilateration.declare(ranges, TRACKERS, LINES, known=tuple(LINES), u_known=u_known)


def distances(points):
    points = np.asarray(points)
    return np.linalg.norm(points[:, None] - points[None], axis=2)


# --- self-calibration ---------------------------------------------------------------------------------------------


def test_four_trackers_calibrate_themselves_from_rough_positions():
    plan, targets = self_calibrated(16), cloud(16)
    drawn = calib.simulate(plan, None, 2)
    generator = np.random.default_rng(7)
    rough = {key: place + generator.normal(0.0, 2e-3, 3) for key, place in targets.items()}
    begin = {key: np.array(place) + generator.normal(0.0, 2e-3, 3) for key, place in TRACKERS.items()}
    ranges = Ranges(drawn.observations[0].covariates["tracker"], drawn.observations[0].covariates["target"],
                    drawn.observations[0].readings[:, 0], 0.5 * um)
    estimate = calib.solve(multilateration.declare(ranges, begin, rough))
    assert estimate.certificate.passed and estimate.p_value > 0.001 and estimate.dof == 64 - (16 - 6) - 48
    # the frame is that of the rough trackers: only lengths compare with the truth
    u = calib.covariance(calib.linearise(estimate), "target").u.max()
    assert np.abs(distances(estimate["target"]) - distances(list(targets.values()))).max() < 6 * u


def test_ten_targets_leave_nothing_unknown_and_nine_do():
    assert calib.estimability(calib.linearise(self_calibrated(10))).defect == 0
    assert calib.estimability(calib.linearise(self_calibrated(9))).defect == 1


@pytest.mark.parametrize("count, hidden", [(4, 2), (5, 1), (6, 0)])
def test_trackers_in_one_plane_cannot_calibrate_themselves_up_to_six(count, hidden):
    generator = np.random.default_rng(count)
    flat = {f"S{k}": (*generator.uniform(0.0, 1.6, 2), 0.0) for k in range(count)}
    fit = calib.linearise(self_calibrated(40, flat))
    assert calib.estimability(fit).defect == hidden
    words = multilateration.unseen_by(np.array(list(flat.values())))
    assert any("one plane" in sentence for sentence in words) == bool(hidden)


def test_the_mirror_image_of_everything_is_said_in_words():
    (sentence,) = multilateration.unseen_by(np.array(list(TRACKERS.values())))
    assert "mirror image of all trackers and targets" in sentence


def test_the_held_coordinates_fix_the_frame_whatever_way_the_trackers_stand():
    turn = np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))[0]
    turned = {key: turn @ np.array(place) for key, place in TRACKERS.items()}
    targets = {key: turn @ place for key, place in cloud(14).items()}
    plan = multilateration.declare(Ranges.every(tuple(turned), tuple(targets), 0.5 * um), turned, targets)
    assert calib.estimability(calib.linearise(plan)).defect == 0
    straight = multilateration.declare(Ranges.every(tuple(TRACKERS), tuple(cloud(14)), 0.5 * um), TRACKERS, cloud(14))
    apart = []
    for one in (plan, straight):
        target = one.select("target").unknown
        length = calib.Quantity("apart", multilateration.between, target[0], target[9])
        apart.append(calib.covariance(calib.linearise(one.with_quantities(length)), length).u[0])
    assert apart[0] == pytest.approx(apart[1], rel=1e-6)           # a length does not depend on the frame


def test_trackers_on_one_line_and_targets_without_position_are_refused():
    row = {key: (0.5 * k, 0.0, 0.0) for k, key in enumerate("ABCD")}
    with pytest.raises(InputError, match="not on one line"):
        self_calibrated(12, row)
    ranges = Ranges.every(tuple(TRACKERS), tuple(cloud(12)), 0.5 * um)
    with pytest.raises(InputError, match="target 'T03' is read but has no approximate position"):
        multilateration.declare(ranges, TRACKERS, {k: v for k, v in cloud(12).items() if k != "T03"})


def test_gauss_newton_and_ipopt_agree():
    problem = multilateration.example(2)
    one, two = calib.solve(problem), calib.solve(problem, calib.Ipopt())
    u = calib.covariance(calib.linearise(one), "target").u
    assert np.abs((one["target"] - two["target"]).ravel() / u).max() < 1e-8


# --- calibrated on lines, and what it does to measured coordinates ------------------------------------------------


def test_known_targets_calibrate_each_tracker_by_itself():
    fit = calib.linearise(on_lines())
    known = Calibration.of(fit)
    blocks = known.covariance.reshape(4, 4, 4, 4).transpose(0, 2, 1, 3)
    off = [np.abs(blocks[i, j]).max() for i in range(4) for j in range(4) if i != j]
    assert max(off) < 1e-9 * np.abs(known.covariance).max()


def test_uncertain_known_targets_correlate_the_trackers_and_add_uncertainty():
    exact, uncertain = (Calibration.of(calib.linearise(on_lines(u))) for u in (None, 0.5 * um))
    assert np.all(np.diag(uncertain.covariance) > np.diag(exact.covariance))
    assert np.abs(uncertain.covariance[:4, 4:8]).max() > 1e-3 * np.abs(uncertain.covariance).max()


def test_a_measured_coordinate_has_the_uncertainty_of_readings_and_trackers():
    calibration = Calibration.of(calib.linearise(on_lines()))
    corners = np.array([[x, y, z] for x in (0.2, 1.4) for y in (0.2, 1.4) for z in (0.2, 1.2)])
    volume = multilateration.over_volume(calibration, corners, 0.5 * um)
    better = Calibration(calibration.keys, calibration.values, calibration.covariance / 100)
    assert volume.u.shape == (8, 3) and np.all(volume.from_trackers > 0.05 * um)
    assert multilateration.over_volume(better, corners, 0.5 * um).from_trackers == pytest.approx(
        volume.from_trackers / 10, rel=1e-6)
    assert multilateration.over_volume(better, corners, 0.5 * um).from_readings == pytest.approx(volume.from_readings)


def test_the_budget_of_a_measured_coordinate_adds_up_to_the_volume():
    calibration = Calibration.of(calib.linearise(on_lines()))
    places = cloud(3)
    plan = multilateration.measure(calibration, Ranges.every(calibration.keys, tuple(places), 0.5 * um), places)
    volume = multilateration.over_volume(calibration, np.array(list(places.values())), 0.5 * um)
    lines = calib.budget(calib.linearise(plan), "target[T01].z")
    assert lines.u == pytest.approx(volume.u[1, 2], rel=1e-9)
    readings = sum(c.u**2 for c in lines.contributions if c.label == "ranges")
    assert np.sqrt(readings) == pytest.approx(volume.from_readings[1, 2], rel=1e-9)


@pytest.mark.slow
def test_monte_carlo_of_both_steps_confirms_the_uncertainty_of_measured_targets():
    """Calibrate on simulated lines, then measure with what came out: the spread of the coordinates about the truth."""
    plan, place = on_lines(), {"P": np.array([0.7, 0.9, 0.6])}
    read = Ranges.every(tuple(TRACKERS), ("P",), 0.5 * um)
    truth = multilateration.measure(Calibration.of(calib.linearise(plan)), read, place)
    stated = multilateration.over_volume(Calibration.of(calib.linearise(plan)), np.array([place["P"]]), 0.5 * um).u[0]
    errors = []
    for seed in range(150):
        found = Calibration.of(calib.linearise(calib.solve(calib.simulate(plan, None, seed))))
        readings = calib.simulate(truth, None, 1000 + seed).observations[0].readings[:, 0]
        ranges = Ranges(read.tracker, read.target, readings, 0.5 * um)
        measured = calib.solve(multilateration.measure(found, ranges, place))
        errors.append(measured["target"] - place["P"])
    spread = np.sqrt(np.mean(np.square(np.squeeze(errors)), axis=0))
    assert spread == pytest.approx(stated, rel=4.0 / np.sqrt(2 * 150))


def test_calibration_on_lines_serves_better_than_self_calibration():
    volume = np.array([[x, y, z] for x in (0.4, 1.2) for y in (0.4, 1.2) for z in (0.4, 1.0)])
    lines, alone = (multilateration.over_volume(Calibration.of(calib.linearise(p)), volume, 0.5 * um).u
                    for p in (on_lines(), self_calibrated(16)))
    assert np.median(alone) > 2 * np.median(lines)


# --- jobs ---------------------------------------------------------------------------------------------------------


def job_in(folder, known=False):
    files = dict(multilateration.example_job(3))
    if known:
        source, header, *rows = files["targets.csv"].split("\n")[:-1]
        marked = [f"{row},{int(k < 8)}" for k, row in enumerate(rows)]
        files["targets.csv"] = "\n".join([source, header + ",known", *marked, ""])
        files["job.toml"] += '[options]\nu_known = "1 mm"\n'
    return Job.read(put(folder, files))


@pytest.mark.parametrize("known", [False, True])
def test_the_example_job_is_solved_and_every_key_is_known(tmp_path, known):
    job = job_in(tmp_path, known)
    estimate = calib.solve(multilateration.from_job(job))
    job.refuse_unknown_keys()
    assert estimate.certificate.passed and estimate.p_value > 0.001
    assert multilateration.remarks(job) == () if known else "mirror image" in multilateration.remarks(job)[0]
    truth = multilateration.example(3).select("target").unknown.ambient
    u = calib.covariance(calib.linearise(estimate), "target").u.max()
    if not known:
        assert np.abs(distances(estimate["target"]) - distances(truth)).max() < 6 * u


def test_an_effect_of_one_tracker_is_found():
    problem = multilateration.example(4)
    effect = problem.attached_effect("step (d@2)").effect
    # a step of all readings of one tracker half-way through the targets
    size = np.zeros((4, 1))
    size[2] = 30.0 * um
    estimate = calib.solve(calib.simulate(problem, {problem.parameters(effect): size}, 5).free(effect))
    u = calib.covariance(calib.linearise(estimate), effect).u
    assert np.abs((estimate[effect] - size).ravel() / u).max() < 4.5
