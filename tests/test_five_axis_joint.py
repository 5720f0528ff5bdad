"""All tables of the five-axis paper as one world; its jobs and what they advise."""

import dataclasses
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from folders import put

from calib import GaussNewton, covariance, linearise, predict, simulate, solve
from calib.errors import InputError, RankDefect
from calib.job import Job
from calib.table import shipped
from calib.units import arcsec, mm
from calib.workflow.reproduce import Printed
from problems import five_axis
from problems.five_axis import joint, results, step_by_step, world
from problems.five_axis.joint import Sharing
from problems.five_axis.readings import from_tables, published

PRINTED = Printed.read("five_axis/claims.csv", key="key")


@cache
def reproduction():
    return five_axis.reproduce()


@cache
def fits():
    return results.fits(published())


# --- one world -------------------------------------------------------------------------------------------------------


def test_with_nothing_shared_the_joint_estimate_is_the_step_by_step_one():
    apart = fits().alternatives["nothing shared"]
    for key in results.ITEMS:
        unit = PRINTED[key].unit
        place = results.TO_THE_PLUMB_LINE.get(key, results.JOINT[key])
        step, found = fits().step.at(results.STEP[key], unit), apart.at(place, unit)
        assert found[0] == pytest.approx(step[0], abs=0.01 * step[1]), key


def test_sharing_is_accepted_for_the_targets_and_refused_for_one_filament():
    assert {one.target: one.accepted for one in fits().circles} == dict.fromkeys("ABCD", True)
    assert {one.target: one.accepted for one in fits().wires} == {"S3": True, "S2": False}


@pytest.mark.slow
def test_sharing_reduces_u_of_the_centres_fourfold_and_moves_them_by_no_more_than_their_scatter():
    for key in ("A_hz", "A_v", "B_hz", "B_v"):
        item = reproduction()[key]
        assert item.joint_u < item.u / 4
        assert abs(item.joint - item.value) < 2.58 * math.sqrt(item.u_vc ** 2 - item.joint_u_vc ** 2), key


@pytest.mark.slow
def test_what_the_paper_does_not_print_appears_in_the_budgets():
    budgets = reproduction().studies["budgets"]
    labels = {key: {line["contribution"] for line in lines} for key, lines in budgets.items()}
    assert {"vertical index", "standing axes", "table 1", "table 3"} <= labels["it1"]
    assert "yaw turn" in labels["it2"]
    assert "wire heights" in labels["it9a"] and "wire heights" in labels["it9b"]
    assert "level azimuth" in labels["it8a"]
    for key, lines in budgets.items():
        assert sum(line["share"] for line in lines) == pytest.approx(1.0, abs=2e-3), key
        assert math.sqrt(sum(line["u"] ** 2 for line in lines)) == pytest.approx(reproduction()[key].joint_u, rel=1e-3)


def known_world(up):
    """A joint problem with readings of a world whose axes are known, without noise, and its true values."""
    problem = joint.declare(published(), Sharing("ABCD", up=up))
    unknown = {u.name: u for u in problem.unknowns}
    truth = {
        unknown["plumb"]: np.array([[30.0, -20.0], [-10.0, 40.0]]) * arcsec,
        unknown["axis_point"]: np.array([[0.2, -0.1], [0.05, 0.3], [-0.15, 0.25]]) * mm,
        unknown["axis_slope"]: np.array([[50.0, 60.0], [-40.0, 10.0], [20.0, -70.0]]) * arcsec,
        unknown["yaw_offset"]: np.array([[0.0, 0.0], [0.4, -0.3]]) * mm,
        unknown["target_circle"]: np.array([[0.2, 0.1], [0.0, 0.05], [-0.1, 0.02], [0.03, 0.0]]) * mm,
        unknown["wire_circle"]: np.array([[0.05, 0.0], [0.0, 0.08], [0.02, -0.03], [0.1, 0.1]]) * mm,
    }
    return simulate(problem, truth, seed=0, noise=False), truth


@pytest.mark.parametrize("up", [1, -1])
def test_the_twelve_results_are_those_of_the_lines_in_space(up):
    problem, _ = known_world(up)
    c = covariance(linearise(solve(problem)))

    def angle(name):
        return c[name][0] / arcsec

    # by hand: slopes and tilts are small, so they add; products of two of them stay below 0.02 arcsec
    assert angle("square[pitch]") == pytest.approx(60 + up * -20, abs=2e-2)
    assert angle("square[two_axis_pitch]") == pytest.approx(-70 + up * 40, abs=2e-2)
    assert angle("square in plan") == pytest.approx(-40 - 50, abs=2e-2)
    assert c["intersection[pitch]"][0] / mm == pytest.approx(0.2, abs=1e-4)
    assert c["intersection[roll]"][0] / mm == pytest.approx(0.05, abs=1e-4)
    assert c["intersection[two_axis_pitch]"][0] / mm == pytest.approx(-0.15 + 0.3, abs=3e-4)
    assert c["roll over pitch"][0] / mm == pytest.approx(0.3 + 0.1, abs=1e-4)
    assert c["pitch over pitch"][0] / mm == pytest.approx(0.25 + 0.1, abs=3e-4)
    assert c["yaw offset.x"][0] / mm == pytest.approx(0.4, abs=1e-6)
    assert c["yaw offset.y"][0] / mm == pytest.approx(-0.3, abs=1e-6)


def test_the_readings_of_a_known_world_are_those_of_elementary_geometry():
    problem, truth = known_world(1)
    seen = predict(problem, {**truth})
    point, slope = 0.2 * mm, 50 * arcsec
    angle = published().pitch.angle[3]
    across = (0.2 * math.cos(angle) - 0.1 * math.sin(angle)) * mm
    upward = (0.2 * math.sin(angle) + 0.1 * math.cos(angle)) * mm
    y = point + slope * (0.9875 - 1.417) + across
    z = -0.1 * mm + 60 * arcsec * (0.9875 - 1.417) + upward
    zero = problem.select("circle_zero").unknown.ambient[0, 0]
    assert seen["table 3"][3, 0] - zero == pytest.approx(math.atan2(y, 0.9875), abs=1e-12)
    elevation = math.atan2(z, math.hypot(0.9875, y))
    assert seen["table 3"][3, 1] - published().index[0] == pytest.approx(elevation, abs=1e-12)


def test_an_error_of_the_yaw_turn_turns_the_pitch_roll_angle_by_as_much():
    back = [float(world.square_in_plan(*[np.zeros(2)] * 6, turn, 1.0)) for turn in (0.0, 5 * arcsec)]
    assert back[1] - back[0] == pytest.approx(-5 * arcsec, rel=1e-9)


def test_the_solution_does_not_depend_on_where_it_starts():
    problem = joint.declare(published(), Sharing("ABCD"))
    first = solve(problem, GaussNewton())
    unknown = {u.name: u for u in problem.unknowns}
    far = {unknown["axis_point"]: np.full((3, 2), 5 * mm), unknown["plumb"]: np.full((2, 2), 500 * arcsec)}
    other = solve(problem, start=far)
    c = covariance(linearise(first))
    assert covariance(linearise(other)).values == pytest.approx(c.values, abs=1e-6 * c.u.min())
    assert first.certificate.passed and other.certificate.passed


@pytest.mark.slow
def test_ninety_five_per_cent_intervals_of_the_joint_estimate_cover_the_truth():
    from calib.workflow.coverage import coverage

    truth = solve(joint.declare(published(), Sharing("ABCD")))
    found = coverage(truth, range(50))
    assert found.failures == 0
    assert np.mean(found.covered) == pytest.approx(0.95, abs=0.02)
    assert np.mean(found.spread) == pytest.approx(1.0, abs=0.05)


def test_the_table_of_the_twelve_results_in_the_documentation_is_what_the_code_gives():
    page = (Path(__file__).parent.parent / "docs" / "five_axis.md").read_text(encoding="utf-8")
    lines = [line for line in page.splitlines() if line.startswith("| it") and not line.startswith("| item")]
    rows = [line.split("|")[1:-1] for line in lines]
    assert [row[0].strip() for row in rows] == list(results.ITEMS)
    for row in rows:
        item = reproduction()[row[0].strip()]
        stated = [Printed.of(text) for cell in (row[3], row[4]) for text in cell.split("±")] + [Printed.of(row[5])]
        found = (item.value, item.u, item.joint, item.joint_u, item.joint_u_vc)
        for one, value in zip(stated, found, strict=True):
            assert abs(one.number - value) <= one.half_digit * 1.001, (item.key, one.text, value)


# --- jobs, advice, section 7, documentation -----------------------------------------------------------------------


def test_the_example_job_is_solved_and_says_what_to_adjust(tmp_path):
    job = Job.read(put(tmp_path, five_axis.example_job(3)))
    problem = five_axis.from_job(job)
    job.refuse_unknown_keys()
    estimate = solve(problem)
    assert estimate.p_value > 0.001
    sentences = five_axis.advice(linearise(estimate))
    zero = estimate["level_zero"][0, 0] / arcsec
    assert sentences[0].startswith(f"three-axis table: set the level to {zero:.1f} arcsec (u = 0.4)")
    assert any("move" in sentence and "mm" in sentence and "seen from T2" in sentence for sentence in sentences)


def test_feet_are_raised_on_the_side_to_which_the_axis_leans(tmp_path):
    files = five_axis.example_job(3)
    files["feet.csv"] = "table,foot,x_mm,y_mm\nthree_axis,east,500,0\nthree_axis,north,0,500\ntwo_axis,west,-500,0\n"
    level = "[instruments.level]"
    files["job.toml"] = files["job.toml"].replace(level, f'[data.feet]\nfile = "feet.csv"\n\n{level}')
    estimate = solve(five_axis.from_job(Job.read(put(tmp_path, files))))
    (x, y), (_, y_two) = estimate["plumb"]
    # turning the table back by its tilt lifts a point at (px, py) by theta_y px - theta_x py
    assert estimate["foot"] == pytest.approx([0.5 * y, -0.5 * x, -0.5 * y_two], rel=1e-9)
    assert any(sentence.startswith("foot east of the three-axis table: raise by") for sentence in
               five_axis.advice(linearise(estimate)))


def test_the_advice_turns_about_with_the_make_of_the_circles():
    usual, paper = (five_axis.advice(fit.linear) for fit in (fits().alternatives[results.USUAL], fits().joint))
    assert any(s.startswith("two-axis table: raise by 0.240 mm") for s in usual)
    assert any(s.startswith("two-axis table: lower by 0.240 mm") for s in paper)
    assert "two-axis table: move 0.228 mm (u = 0.033) to the right, seen from T1." in usual
    assert five_axis.advice(fits().step.linear) == ()


def test_the_procedure_step_by_step_is_an_option_of_the_job(tmp_path):
    files = five_axis.example_job(3)
    files["job.toml"] = files["job.toml"].replace('shared = "tested"', 'procedure = "step by step"')
    assert five_axis.from_job(Job.read(put(tmp_path, files))).name == "five-axis, step by step"


@pytest.mark.parametrize("table, remove, message", [
    ("pitch", "B", r"table3_pitch.csv: no row of target 'B'"),
    ("wires", "S2", r"table2_filaments.csv: no row of target 'T1 S2'"),
    ("distances", "D", r"distances.csv: the distance of D is missing"),
])
def test_a_missing_target_or_distance_is_named(table, remove, message):
    tables = {name: shipped(f"five_axis/{file}") for name, file in
              (("level", "table1_level.csv"), ("wires", "table2_filaments.csv"), ("pitch", "table3_pitch.csv"),
               ("roll", "table4_roll.csv"), ("distances", "distances.csv"))}
    tables[table] = tables[table].where(tables[table].text("target") != remove)
    with pytest.raises(InputError, match=message):
        from_tables(tables)


def test_without_the_two_axis_pitch_targets_the_other_results_stand():
    lengths = {k: v for k, v in published().distance.items() if k not in "EF"}
    readings = dataclasses.replace(published(), centre={}, distance=lengths)
    for problem in (joint.declare(readings, Sharing("ABCD")), step_by_step.declare(readings)):
        c = covariance(linearise(solve(problem)))
        assert not any("two_axis_pitch" in name for name in c.names)
        place = "square to the plumb line[pitch]" if problem.name.endswith("jointly") else "square[pitch]"
        assert np.isfinite(c[place][1])


def turned(circle, by):
    """Readings of a circle with the horizontal circle turned."""
    reading = circle.reading + (by if circle.reading.ndim == 1 else np.array([by, 0.0]))
    return dataclasses.replace(circle, reading=reading % (2 * np.pi))


def test_a_horizontal_circle_whose_zero_lies_between_the_targets_gives_the_same_results():
    r = published()
    by = -fits().step.stated["reading[A H]"][0]       # the zero falls between the readings of A
    moved = dataclasses.replace(
        r, wires=turned(r.wires, by), pitch=turned(r.pitch, by), roll=turned(r.roll, by),
        centre={t: ((h + by) % (2 * np.pi), v, u) for t, (h, v, u) in r.centre.items()})
    assert np.ptp(moved.pitch.reading[:, 0]) > 6
    problems = (step_by_step.declare(moved), joint.declare(moved, Sharing("ABCD")))
    for fit, problem in zip((fits().step, fits().joint), problems, strict=True):
        found = results.Fit.of(problem)
        for name in (n for n in fit.stated.names if "reading" not in n):
            value, u = fit.stated[name]
            assert found.stated[name] == pytest.approx((value, u), abs=1e-5 * u), name


def test_a_target_far_off_the_axes_is_named():
    r = published()
    with pytest.raises(InputError, match=r"target A is read at 95.50 deg, H along the axes is 185.49 deg"):
        joint.declare(dataclasses.replace(r, pitch=turned(r.pitch, -np.pi / 2)), Sharing("ABCD"))


def test_too_few_positions_to_test_sharing_say_how_to_go_on(tmp_path):
    files = five_axis.example_job(3)
    lines = files["table4_roll.csv"].splitlines()
    files["table4_roll.csv"] = "\n".join([*lines[:4], *lines[6:8]]) + "\n"        # two positions of C and of D
    path = put(tmp_path, files)
    with pytest.raises(RankDefect, match=r"cannot be tested.*shared = .all"):
        five_axis.from_job(Job.read(path))
    path.write_text(files["job.toml"].replace('shared = "tested"', 'shared = "all"'), encoding="utf-8")
    assert solve(five_axis.from_job(Job.read(path))).certificate.passed
