"""Problems with mechanisms: every one recovers simulated errors within their stated uncertainty, also from its own
job."""

import importlib

import numpy as np
import pytest
from folders import put
from shipped import modules

import calib
from calib.job import Job

# every problem that tells its simulated errors in TRUTH: a new one is tested without being listed
NAMES = tuple(m.__name__.removeprefix("problems.") for m in modules()
              if hasattr(m, "TRUTH") and hasattr(m, "example"))
LONGER = ("locator_carrier", "motion_simulator")      # over a second on a busy machine
QUICK_FIRST = [pytest.param(n, marks=[pytest.mark.slow] if n in LONGER else []) for n in NAMES]
REPEATED = ("three_axis_turntable", "machine_21", "hexapod")      # test_coverage repeats all of them in another way


def standardised(module, problem, estimate):
    found = [problem.parameters(n) if "(" in n else problem.select(n) for n in module.TRUTH]
    covariance = calib.covariance(calib.linearise(estimate), *found)
    return (covariance.values - np.concatenate([np.ravel(v) for v in module.TRUTH.values()])) / covariance.u


@pytest.mark.parametrize("name", QUICK_FIRST)
def test_simulated_errors_come_back_within_their_uncertainty(name):
    module = importlib.import_module(f"problems.{name}")
    problem = module.example(1)
    estimate = calib.solve(problem)
    assert estimate.certificate.passed
    errors = standardised(module, problem, estimate)
    assert np.abs(errors).max() < 4.0 and np.sqrt(np.mean(errors ** 2)) < 1.7


@pytest.mark.parametrize("name", QUICK_FIRST)
def test_the_example_job_runs(name, tmp_path):
    module = importlib.import_module(f"problems.{name}")
    put(tmp_path, module.example_job(2))
    estimate = calib.solve(module.from_job(Job.read(tmp_path / "job.toml")))
    assert estimate.certificate.passed and 0.7 < estimate.variance_factor < 1.35


@pytest.mark.slow
@pytest.mark.parametrize("name", REPEATED)
def test_the_stated_intervals_cover_the_truth_in_fifty_repetitions(name):
    module = importlib.import_module(f"problems.{name}")
    problem = module.example(1)
    design = {o.group: o.readings for o in problem.observations if o.is_prior}
    start = calib.solve(problem)
    truth = {(problem.parameters(n) if "(" in n else problem.select(n).unknown).name: np.atleast_2d(v) for n,
             v in module.TRUTH.items()}
    errors = []
    for seed in range(50):
        drawn = calib.simulate(problem, truth, seed)
        if name == "hexapod":
            drawn = drawn.with_readings(design)
        errors.append(standardised(module, drawn, calib.solve(drawn, start=start)))
    inside = np.mean(np.abs(errors) < 1.96)
    assert inside == pytest.approx(0.95, abs=0.04)


def test_a_hexapod_is_commanded_by_its_calibrated_joints():
    from calib.geometry import Transform, rotation_from_rpy
    from problems import hexapod
    problem = hexapod.example(1)
    wanted = Transform(rotation_from_rpy(0.05, -0.1, 0.02), np.array([0.01, -0.02, 0.56]))
    quantity = hexapod.commands(problem, wanted)
    estimate = calib.solve(problem.with_quantities(quantity))
    found = calib.covariance(calib.linearise(estimate), quantity)
    base, top, zero = (hexapod.TRUTH[n] for n in ("base_joint", "platform_joint", "zero"))
    true = np.linalg.norm(wanted @ top - base, axis=1) - zero[:, 0]
    nominal = np.linalg.norm(wanted @ hexapod.joints()[1] - hexapod.joints()[0], axis=1) - 0.30
    assert np.all(np.abs(found.values - true) < 4 * found.u)
    assert np.abs(found.values - true).max() < 0.05 * np.abs(nominal - true).max()


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in NAMES if hasattr(importlib.import_module(f"problems.{n}"), "heldout")])
def test_readings_that_were_not_used_are_predicted_better_by_the_identified_mechanism(name, tmp_path):
    module = importlib.import_module(f"problems.{name}")
    job = Job.read(put(tmp_path, module.example_job(3)))
    for quantity, before, after, unit in module.heldout(job, calib.solve(module.from_job(job))):
        assert after < 0.7 * before, f"{quantity}: {before} {unit} before, {after} {unit} after"


def test_an_effect_of_several_parameters_is_switched_on_by_one_of_them(tmp_path):
    from calib.errors import InputError
    from calib.workflow.simulated import simulated
    from problems import gimbal
    job = Job.read(put(tmp_path, gimbal.example_job(2)))
    problem = gimbal.from_job(job)
    with pytest.raises(InputError, match=r"say which: encoder_2x_C\.c, encoder_2x_C\.s"):
        simulated(job, problem, calib.solve(problem), 5, {"encoder_2x_C": "5 arcsec"})


def test_pointing_of_the_calibrated_gimbal_brings_targets_into_the_middle():
    from calib.units import arcsec
    from problems import gimbal
    problem = gimbal.example(4)
    estimate = calib.solve(problem)
    commands, targets, _ = gimbal.plan()
    truth = {problem.parameters(n).name: np.atleast_2d(v) for n, v in gimbal.TRUTH.items()}
    truth["field_from_base"] = gimbal.FIELD_FROM_BASE
    for row in (3, 90):     # in the middle by the design, one in each face
        pointed = gimbal.pointing(estimate, targets[row], commands[row])
        aimed = np.stack([commands[row], pointed])
        both = gimbal.declare(aimed, targets[[row, row]], None, 1.0, gimbal.FIELD_FROM_BASE)
        missed = np.linalg.norm(calib.predict(both, truth)["images"], axis=1)
        assert missed[1] < 10 * arcsec < 100 * arcsec < missed[0]


def test_simulated_readings_of_a_hexapod_stand_in_the_columns_of_its_job(tmp_path):
    from calib.workflow.simulated import simulated
    from problems import hexapod
    job = Job.read(put(tmp_path, hexapod.example_job(2)))
    problem = hexapod.from_job(job)
    found = simulated(job, problem, calib.solve(problem), 5, {"scale": "300 ppm"}, hexapod.in_columns)
    assert not found.loose
    for table in found.tables.values():
        table.write(tmp_path / "poses.csv")
    again = hexapod.from_job(Job.read(tmp_path / "job.toml"))
    freed = again.free(again.parameters("scale"))
    estimate = calib.solve(freed)
    found_scale = calib.covariance(calib.linearise(estimate), again.parameters("scale"))
    assert estimate.certificate.passed and abs(found_scale.values[0] - 300e-6) < 4 * found_scale.u[0]
