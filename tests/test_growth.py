"""Growth of a model from its nominal state: what is there is added, what is not there is left out."""

import os
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.errors import CalibrationError
from calib.units import mm
from calib.workflow.discrepancy.heldout import held_out
from calib.workflow.growth import blocks_of, grow
from problems import positioner, serial_arm

REAL = Path(os.environ.get("CALIB_REFERENCE_DATA", Path(__file__).parents[2] / "shared" / "reference_data"))


def nominal(problem):
    return problem.hold(*(a.unknown for a in problem.attached))


@pytest.mark.slow
def test_the_errors_that_are_there_are_added_and_blocks_left_out_are_then_met_to_the_noise():
    problem = nominal(positioner.example(4))
    growth = grow(problem, blocks_of(problem, positioner))
    names = {label for step in growth.steps for label in step.effects}
    assert {"EY0C (C)", "EB0C (C)", "scale_A (A)"} <= names and len(names) <= 5
    assert growth.before > 1.3 and growth.after == pytest.approx(1.0, abs=0.15)
    found = calib.covariance(growth.estimate.fit, problem.parameters("EY0C (C)"))
    assert abs(found.values[0] - 0.63 * mm) < 4 * found.u[0]


def test_nothing_is_added_to_a_model_that_lacks_nothing():
    problem = nominal(positioner.example(4))
    clean = calib.simulate(problem, {a.unknown: a.unknown.ambient for a in problem.attached}, seed=8)
    growth = grow(clean, blocks_of(clean, positioner))
    assert sum(len(step.effects) for step in growth.steps) <= 1
    assert growth.after == pytest.approx(1.0, abs=0.15)


def test_the_linear_picture_of_blocks_left_out_agrees_with_adjusting_without_them():
    problem = positioner.example(2)
    blocks = blocks_of(problem, positioner)
    predicted = grow(problem, blocks, most=0).before
    squares, count = 0.0, 0
    for block in np.unique(blocks["pose"]):
        judged = held_out(problem, {"pose": blocks["pose"] == block})
        squares, count = squares + judged.rms ** 2 * judged.readings, count + judged.readings
    assert predicted == pytest.approx(np.sqrt(squares / count), rel=1e-3)


def test_one_block_alone_cannot_be_left_out():
    problem = positioner.example(2)
    with pytest.raises(CalibrationError, match="all rows are in one block"):
        grow(problem, {"pose": np.zeros(48, int)})


@pytest.mark.slow
@pytest.mark.skipif(not (REAL / "panda").is_dir(), reason="the recorded machines are not here")
@pytest.mark.parametrize(("module", "name"), [(serial_arm, "serial_arm"), (positioner, "positioner")])
def test_a_real_machine_grown_from_its_nominal_state_is_predicted_where_it_was_not_measured(module, name):
    job = calib.job.Job.read(Path(__file__).parents[1] / "problems" / "data" / name / "nominal.toml", REAL)
    problem = module.from_job(job)
    growth = grow(problem, blocks_of(problem, module))
    assert growth.after < 0.8 * growth.before
    if module is positioner:
        (_, before, after, _), _ = positioner.heldout(job, growth.estimate)
        assert before == pytest.approx(0.482, abs=0.001) and after < 0.30
    else:
        read = serial_arm.setup(job)
        known = {x.name: growth.estimate[x] for x in growth.estimate.problem.unknowns if x.name != "socket"}
        errors, _ = serial_arm.distance_errors(read.arm, read.heldout["right"], read.arguments, known)
        assert errors.mean() < 0.45 * mm          # 7.99 mm before
