"""Base point by lines: published numbers, start and sense, what is not seen, effects, jobs, and the paper's slips."""

import numpy as np
import pytest

import calib
from calib.errors import InputError, RankDefect
from calib.job import Job
from calib.solve.convex import Convex
from calib.table import shipped
from calib.units import hour, mm, nm, ppm, um, urad
from problems import algebraic_base_point, base_point, base_point_published
from problems.base_point import (
    LENGTHENING,
    SHORTENING,
    AbsoluteRange,
    AdjustedCoordinates,
    ExactCoordinates,
    FreeStart,
    ProjectedCoordinates,
    TiedStart,
)
from problems.base_point_lines import Lines

EXPERIMENT = base_point_published.experiment("d")
TIED = calib.solve(base_point.declare(EXPERIMENT, TiedStart(), sense=SHORTENING))
FREE = calib.solve(base_point.declare(EXPERIMENT, FreeStart((0.0, 0.0, 0.0)), sense=SHORTENING))
PUBLISHED = base_point_published.reproduce()
BASE = np.array([-0.21, 1.38, -0.3])


def box(corner=0.8, n=9):
    """Points and directions of lines along x, y and z of a machine."""
    run, zero, far = np.linspace(0.0, corner, n), np.zeros(n), np.full(n, corner)
    points = np.vstack([np.column_stack(line) for line in ((run, zero, zero), (far, run, zero), (far, zero, run))])
    return points, np.repeat(np.eye(3), n, axis=0)


def simulated(seed=1, u=0.5 * um, sense=LENGTHENING, **more):
    """Lines with simulated readings of one tracker at BASE."""
    points, along = box()
    lines = Lines(points, None, u, along, 0.2 * um, **more)
    drawn = calib.simulate(base_point.declare(lines, sense=sense, begin=BASE), None, seed)
    return Lines(points, drawn.observations[0].readings[:, 0], u, along, 0.2 * um, **more)


# --- published numbers --------------------------------------------------------------------------------------------


def test_the_tied_fit_gives_all_32_printed_residuals():
    printed = shipped("base_point/table2_experiment.csv").number("delta", "length")
    assert np.abs(TIED.residuals["tracker"][:, 0] - printed).max() < 0.06 * um


def test_every_key_of_the_published_table_is_there_once():
    keys = shipped("base_point/published_values.csv").text("key")
    assert [item.key for item in PUBLISHED.items] == keys.tolist()


@pytest.mark.parametrize("key, verdict", [
    ("base_x", "agrees"), ("base_y", "agrees"), ("base_z", "agrees"), ("ssq", "agrees"), ("s", "agrees"),
    ("n_points", "agrees"), ("sim_C_sym_x", "agrees"), ("sim_C_sym_y", "agrees"), ("sim_noise_printed", "differs"),
    ("sigma_x_sym", "agrees"), ("sigma_x_half", "agrees"), ("ratio", "agrees"), ("theta_sym", "differs"),
    ("theta_half", "agrees"), ("min_sqrt_Q", "differs"), ("sim_C_half_x", "not determinable")])
def test_a_published_number_gets_its_verdict(key, verdict):
    assert PUBLISHED[key].verdict == verdict


def test_the_readings_refuse_a_start_tied_to_the_zero_point():
    ratio = (TIED.objective - FREE.objective) / (FREE.objective / FREE.dof)
    start, u = calib.covariance(calib.linearise(FREE), "start_reading")["start_reading"]
    assert ratio == pytest.approx(68.9, abs=0.1)
    assert start == pytest.approx(3.883 * um, abs=0.001 * um) and u == pytest.approx(0.657 * um, abs=0.001 * um)


def test_the_simulated_spread_of_x_is_the_linear_one():
    for foot in base_point_published.FEET.values():
        linear = base_point_published.sigma_x(foot, 1.0 * um)
        drawn = base_point_published.simulated_sigma_x(foot, 1.0 * um, 2000, 5)
        assert drawn == pytest.approx(linear, rel=4.0 / np.sqrt(2 * 2000))


# --- start, sense and coordinates ---------------------------------------------------------------------------------


def test_the_certificate_and_both_methods_agree():
    for zero in (TiedStart(), FreeStart()):
        problem = base_point.declare(EXPERIMENT, zero, sense=SHORTENING)
        one, two = calib.solve(problem), calib.solve(problem, calib.Ipopt())
        u = calib.covariance(calib.linearise(one), "base_point").u
        assert one.certificate.passed and two.certificate.passed
        assert np.abs((one["base_point"] - two["base_point"]) / u).max() < 1e-8


@pytest.mark.parametrize("sense, wrong", [(LENGTHENING, "shortening"), (SHORTENING, "lengthening")])
def test_a_wrong_counting_sense_is_detected_and_the_right_one_named(sense, wrong):
    lines = simulated(sense=sense)
    right = "lengthening" if sense > 0 else "shortening"
    assert algebraic_base_point.counting_sense(lines.points, lines.readings) == sense
    assert calib.solve(base_point.declare(lines, sense=sense)).p_value > 0.001
    with pytest.raises(InputError, match=f'wrong counting sense: counts = "{wrong}".*set counts = "{right}"'):
        base_point.declare(lines, sense=-sense)


def test_a_wrong_sense_is_found_with_the_start_tied_too():
    with pytest.raises(InputError, match='set counts = "shortening"'):
        base_point.declare(EXPERIMENT, TiedStart(), sense=LENGTHENING)


def test_a_short_line_leaves_the_sense_undecided_and_is_not_refused():
    points = np.column_stack([np.linspace(0.0, 2e-6, 8), np.zeros((8, 2))])
    readings = np.linalg.norm(points - BASE, axis=1) - 1.4 + np.random.default_rng(2).normal(0.0, 5 * nm, 8)
    assert algebraic_base_point.counting_sense(points, readings) == 0.0


def test_adjusted_and_projected_coordinates_give_the_same_base_point():
    lines = simulated(3)
    one, two = (calib.solve(base_point.declare(lines, coordinates=choice))
                for choice in (ProjectedCoordinates(), AdjustedCoordinates()))
    known = [calib.covariance(calib.linearise(e), "base_point") for e in (one, two)]
    assert np.abs((known[0].values - known[1].values) / known[0].u).max() < 1e-4
    assert known[0].u == pytest.approx(known[1].u, rel=1e-4) and one.dof == two.dof
    assert one.objective == pytest.approx(two.objective, rel=1e-4)


def test_exact_coordinates_leave_the_uncertainty_of_the_lines_out():
    lines = simulated(3)
    u = [calib.covariance(calib.linearise(base_point.declare(lines, coordinates=c)), "base_point").u
         for c in (ExactCoordinates(), ProjectedCoordinates())]
    assert np.all(u[0] < u[1])


def test_an_absolute_range_needs_no_start():
    points, along = box()
    readings = np.linalg.norm(points - BASE, axis=1)
    estimate = calib.solve(base_point.declare(Lines(points, readings, 0.5 * um, along), AbsoluteRange()))
    assert estimate["base_point"] == pytest.approx(BASE, abs=1e-12) and estimate["dead_path"] == 0.0


def test_several_trackers_and_zeroings_are_solved_together_and_apart_alike():
    points, along = box()
    bases = {"A": BASE, "B": np.array([0.9, -0.4, -0.5]), "C": np.array([0.3, 0.4, 1.6])}
    tracker = np.repeat(list(bases), len(points))
    everywhere, ways = np.tile(points, (3, 1)), np.tile(along, (3, 1))
    zeroing = np.where(np.arange(len(tracker)) % len(points) < 9, "morning", "noon")
    path = np.linalg.norm(everywhere - np.array([bases[t] for t in tracker]), axis=1)
    start = np.where(zeroing == "morning", 1.1, 0.7)
    readings = path - start + np.random.default_rng(4).normal(0.0, 0.5 * um, len(path))
    lines = Lines(everywhere, readings, 0.5 * um, ways, tracker=tracker, zeroing=zeroing)
    together = calib.solve(base_point.declare(lines))
    fit = calib.linearise(together)
    assert len(fit.groups) == 6 and together.dof == len(path) - 9 - 6
    known = calib.covariance(fit, "base_point")
    assert np.abs((known.values - np.concatenate(list(bases.values()))) / known.u).max() < 4.5
    for k, (name, base) in enumerate(bases.items()):
        i = tracker == name
        alone = calib.solve(base_point.declare(Lines(points, readings[i], 0.5 * um, along, zeroing=zeroing[i])))
        assert np.abs((alone["base_point"] - together["base_point"][k]) / known.u[3 * k:3 * k + 3]).max() < 1e-8
        assert np.linalg.norm(alone["base_point"] - base) < 20 * um


def test_trackers_that_read_one_seating_share_its_coordinate():
    points, along = box()
    n = len(points)
    lines = Lines(np.tile(points, (2, 1)), None, 0.5 * um, np.tile(along, (2, 1)), 0.3 * um,
                  tracker=np.repeat(["A", "B"], n), seating=np.tile(np.arange(n), 2))
    plan = base_point.declare(lines, coordinates=AdjustedCoordinates(), begin=[BASE, -BASE])
    matrix = calib.covariance(calib.linearise(plan), "base_point").correlation
    assert sum(o.n for o in plan.observations if o.group == "coordinates") == n
    assert np.abs(matrix[:3, 3:]).max() > 0.05                # a shared coordinate correlates the two base points


# --- what is not seen ---------------------------------------------------------------------------------------------


def test_the_mirror_image_fits_as_well_and_is_said_in_words():
    mirrored = calib.solve(base_point.declare(EXPERIMENT, TiedStart(), sense=SHORTENING, begin=(-0.2, 1.4, 0.2)))
    assert mirrored["base_point"] * [1, 1, -1] == pytest.approx(TIED["base_point"], abs=1e-9)
    assert mirrored.objective == pytest.approx(TIED.objective, rel=1e-9)
    (sentence,) = algebraic_base_point.unseen(EXPERIMENT.points)
    assert "plane z = 0" in sentence and "sign of z is not observable" in sentence and "mirror image" in sentence


def test_one_line_leaves_the_turn_about_it_unknown():
    points = EXPERIMENT.points[:14]
    lines = Lines(points, EXPERIMENT.readings[:14], 1.0 * um)
    with pytest.raises(RankDefect, match="base_point"):
        calib.solve(base_point.declare(lines, sense=SHORTENING))
    (sentence,) = algebraic_base_point.unseen(points)
    assert "one line along x" in sentence and "turning the base point about that line" in sentence
    assert algebraic_base_point.unseen(box()[0]) == ()


def test_one_line_by_equation_1_gives_the_foot_and_the_distance_of_the_base_point():
    travel, base = EXPERIMENT.points[:14, 0], TIED["base_point"]
    plan = base_point.declare_one_line(travel, EXPERIMENT.readings[:14], 1.0 * um, SHORTENING, begin=(-0.3, 1.2))
    fit = calib.linearise(calib.solve(plan))
    known = calib.covariance(fit, "beside")
    assert np.abs((known.values - [base[0], np.hypot(base[1], base[2])]) / known.u).max() < 8.0


def test_targets_at_one_position_and_plans_without_a_base_point_are_refused():
    with pytest.raises(InputError, match="stand at one position"):
        base_point.declare(Lines(np.ones((5, 3)), np.zeros(5), 1.0 * um))
    with pytest.raises(InputError, match="approximate base points"):
        base_point.declare(Lines(box()[0], None, 1.0 * um))
    with pytest.raises(InputError, match="'readings' has shape"):
        Lines(box()[0], np.zeros(3), 1.0 * um)


def test_fewer_readings_than_unknowns_are_named():
    lines = simulated(5)
    few = Lines(lines.points[[0, 12, 20]], lines.readings[[0, 12, 20]], 0.5 * um)
    with pytest.raises(RankDefect, match="3 readings for 4 unknowns"):
        calib.solve(base_point.declare(few, begin=BASE))


def test_a_start_far_away_leads_to_the_base_point_or_its_mirror_image():
    estimate = calib.solve(base_point.declare(EXPERIMENT, FreeStart(), sense=SHORTENING, begin=(4.0, -3.0, 2.0)))
    assert estimate.certificate.passed
    assert np.abs(estimate["base_point"]) == pytest.approx(np.abs(FREE["base_point"]), abs=1e-9)


# --- uncertainty --------------------------------------------------------------------------------------------------


def test_the_covariance_agrees_with_monte_carlo():
    estimate = calib.solve(base_point.declare(simulated(6), FreeStart((0.0, 0.0, 0.0)), ProjectedCoordinates()))
    drawn = calib.montecarlo(estimate, 2000, 6)
    assert drawn.failures == 0
    assert drawn.u == pytest.approx(drawn.linear_u, rel=4.0 / np.sqrt(2 * 2000))


def test_intervals_of_the_base_point_cover_it():
    plan = base_point.declare(Lines(*_plan()), begin=BASE)
    errors = []
    for seed in range(60):
        estimate = calib.solve(calib.simulate(plan, None, seed))
        errors.append((estimate["base_point"] - BASE) / calib.covariance(calib.linearise(estimate), "base_point").u)
    assert 0.75 < np.std(errors) < 1.25                                    # 180 standardised, partly correlated errors


def _plan():
    points, along = box()
    return points, None, 0.5 * um, along


# --- effects ------------------------------------------------------------------------------------------------------

EXAMPLE = base_point.example(3)
MIDDLE = HALF = 0.4


def formula(label, parameters, x, along, cov, base, start):
    """Reading with one effect, written out from FORMAT.md section 4."""
    name, channel = label[:-1].split(" (", 1)
    axis = {a: k for k, a in enumerate("xyz")}
    point, p = x.copy(), parameters
    if name == "scale" and channel != "d":
        point[:, axis[channel]] *= 1 + p[0]
    elif name == "cosine":
        point[:, axis[channel]] *= 1 + p[0]                                # kappa = 1/cos(beta) - 1
    elif name == "pitch_abbe":
        point[:, axis[channel]] += cov[f"abbe_{channel}"] * p[0] * x[:, axis[channel]]
    elif name == "squareness":
        moved, of, sign = {"xy": (0, 1, -1), "yz": (1, 2, -1), "zx": (0, 2, 1)}[channel]
        point[:, moved] += sign * p[0] * x[:, of]
    elif name == "straightness":
        point[:, axis[channel[0]]] += p[0] * ((x[:, axis[channel[2]]] - MIDDLE) / HALF) ** 2
    elif name == "hysteresis":
        point[:, axis[channel]] += p[0] / 2 * cov[f"direction_{channel}"]
    sight = point - base
    d = np.linalg.norm(sight, axis=1) - start
    g = np.sum(sight * along, axis=1) / np.linalg.norm(sight, axis=1)
    psi = 4 * np.pi * d / (632.8 * nm)
    contribution = {
        "drift": lambda: p[0] * cov["time"], "thermal": lambda: p[0] * cov["temperature_difference"],
        "step": lambda: p[0] * (cov["block"] >= int(channel.split("@")[1])),
        "time_sync": lambda: p[0] * np.sum(cov["velocity"] * along, axis=1) * g,
        "cyclic": lambda: p[0] * np.cos(psi) + p[1] * np.sin(psi)}
    if name == "scale" and channel == "d":
        return d * (1 + p[0])
    return d + contribution.get(name, lambda: 0.0)()


SIZES = {"ppm": 20 * ppm, "1": 2e-6, "urad/m": 30 * urad, "urad": 50 * urad, "um": 15 * um, "um/h": 10 * um / hour,
         "um/K": 12 * um, "ms": 0.8e-3, "nm": 40 * nm}


@pytest.mark.parametrize("label", [effect.label for effect in EXAMPLE.effects])
def test_an_effect_changes_the_reading_as_the_format_says(label):
    effect, read = EXAMPLE.attached_effect(label).effect, EXAMPLE.observations[0]
    values = np.array([SIZES[p.unit] * (1 + 0.3 * k) for k, p in enumerate(effect.parameters)])
    found = calib.predict(EXAMPLE, {EXAMPLE.parameters(effect): values})["tracker"][:, 0]
    position, guide, along, velocity = (a.data for a in read.arguments[2:6])
    base, start = (EXAMPLE.select(name).unknown.ambient[0] for name in ("base_point", "start_length"))
    recorded = {**read.covariates, "velocity": velocity}
    expected = formula(label, values, guide + along * position, along, recorded, base, start)
    assert np.abs(found - expected).max() < 1e-14 + 1e-9 * np.abs(expected).max() * (effect.name == "cyclic")


def test_every_effect_of_the_format_is_offered():
    names = {(e.name, e.channel) for e in base_point.effects(blocks=(2,))}
    assert {("scale", a) for a in "xyzd"} | {("cosine", a) for a in "xyz"} | {("pitch_abbe", a) for a in "xy"} <= names
    assert {("squareness", a) for a in ("xy", "yz", "zx")} | {("hysteresis", a) for a in "xyz"} <= names
    assert {("straightness", f"{b}({a})") for a in "xyz" for b in "xyz" if a != b} <= names
    assert {(n, "d") for n in ("drift", "thermal", "time_sync", "cyclic")} | {("step", "d@2")} <= names
    assert len(names) == 4 + 3 + 2 + 3 + 3 + 6 + 4 + 1


def test_a_reversal_error_is_found_with_its_size():
    effect = EXAMPLE.attached_effect("hysteresis (y)").effect
    measured = calib.simulate(EXAMPLE, {EXAMPLE.parameters(effect): 6.0 * um}, 8).free(effect)
    estimate = calib.solve(measured)
    u = calib.covariance(calib.linearise(estimate), effect).u
    assert abs(float(estimate[effect][0]) - 6.0 * um) < 4.5 * u[0] and estimate.p_value > 0.001


# --- jobs ---------------------------------------------------------------------------------------------------------


def job_in(folder, **changes):
    files = base_point.example_job(4)
    for old, new in changes.get("replace", {}).items():
        files = {name: text.replace(old, new) for name, text in files.items()}
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return Job.read(folder / "job.toml")


def test_the_example_job_is_solved_and_every_key_is_known(tmp_path):
    job = job_in(tmp_path)
    problem = base_point.from_job(job)
    estimate = calib.solve(problem)
    job.refuse_unknown_keys()
    known = calib.covariance(calib.linearise(estimate), "base_point")
    assert np.abs((known.values - [-0.2, 1.4, -0.23]) / known.u).max() < 4.5
    assert "sign of z" in base_point.remarks(job)[0]


def test_a_wrong_sense_in_a_job_is_named(tmp_path):
    job = job_in(tmp_path, replace={'counts = "shortening"': 'counts = "lengthening"'})
    with pytest.raises(InputError, match="wrong counting sense"):
        base_point.from_job(job)


def test_coordinates_with_uncertainty_need_an_instrument(tmp_path):
    job = job_in(tmp_path, replace={"[options]\n": '[options]\ncoordinates = "adjusted"\n'})
    with pytest.raises(InputError, match="line_instrument"):
        base_point.from_job(job)
    job = job_in(tmp_path, replace={"[options]\n": '[instruments.rail]\nu = "0.2 um"\n[options]\n'
                                    'coordinates = "adjusted"\nline_instrument = "rail"\n'})
    estimate = calib.solve(base_point.from_job(job))
    assert estimate.certificate.passed and "coordinates" in estimate.residuals


@pytest.mark.parametrize("old, new, message", [
    ("d_mm", "d", "column 'd': has no unit"), ("d_mm", "r_mm", "column 'd' is missing"),
    ('u = "0.5 um"\n', "", "u"), ('kind = "tracking_interferometer"', 'kind = "level"', "tracking_interferometer"),
    ('start_reading = "free"', 'start_reading = "loose"', "not known")])
def test_bad_input_is_named(tmp_path, old, new, message):
    with pytest.raises(InputError, match=message):
        base_point.from_job(job_in(tmp_path, replace={old: new}))


def test_a_job_of_two_trackers_with_absolute_ranges_and_all_columns(tmp_path):
    points, _ = box(n=6)
    bases = {"A": BASE, "B": np.array([0.9, -0.4, -0.5])}
    names = np.repeat(["x", "y", "z"], 6)
    rows = [f"{1 + 18 * k + i},{name},{names[i]},{1 + i // 6},1,{i},20.5," + ",".join(f"{c / mm:.5f}" for c in point)
            + f",{np.linalg.norm(point - base) / mm:.5f}"
            for k, (name, base) in enumerate(bases.items()) for i, point in enumerate(points)]
    header = "row,tracker,line,block,direction,time_min,temperature_C,x_mm,y_mm,z_mm,d_mm"
    (tmp_path / "lines.csv").write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    (tmp_path / "job.toml").write_text(base_point.EXAMPLE_JOB.replace('"shortening"', '"lengthening"').replace(
        '"free"\nstart_point_mm = [0.0, 0.0, 0.0]', '"absolute"'), encoding="utf-8")
    job = Job.read(tmp_path / "job.toml")
    problem = base_point.from_job(job)
    estimate = calib.solve(problem)
    job.refuse_unknown_keys()
    assert estimate["base_point"] == pytest.approx(np.array(list(bases.values())), abs=0.1 * um)
    assert np.all(estimate["dead_path"] == 0.0) and estimate.dof == 36 - 6
    labels = {effect.label for effect in problem.effects}
    assert {"drift (d)", "thermal (d)", "step (d@2)", "hysteresis (x)", "squareness (xy)"} <= labels
    assert "pitch_abbe (x)" not in labels                        # the Abbe offsets were not recorded


def test_the_formulations_of_a_job_agree_where_they_say_the_same(tmp_path):
    found = base_point.formulations(job_in(tmp_path))
    free, tied, squares = (calib.solve(found[name]) for name in ("start free", "start tied", "difference of squares"))
    u = calib.covariance(calib.linearise(free), "base_point").u
    convex = calib.solve(found["difference of squares"], Convex())
    assert np.abs((squares["base_point"] - free["base_point"]) / u)[:2].max() < 0.01       # z is not in the linear one
    assert np.abs((squares["base_point"] - convex["base_point"]) / u)[:2].max() < 1e-6
    assert np.abs((tied["base_point"] - free["base_point"]) / u).max() < 4.5 and tied.dof == free.dof + 1


CASE = """format = 1
case = "made"
scenario = "basepoint_multilateration"
[instruments]
[known]
reference_temperature_C = 20.0
wavelength_nm = 632.8
base_point_approx_mm = [-205.0, 1385.0, -290.0]
[known.axis_range_mm]
x = [0.0, 800.0]
y = [0.0, 800.0]
z = [0.0, 800.0]
"""


def case_in(folder, width):
    """A case folder whose y axis has a reversal error of some width [m]."""
    points, along = box()
    points, along = np.vstack([points, points[::-1]]), np.vstack([along, along[::-1]])
    fine = np.column_stack([0.7 + np.arange(12) * 0.1e-6, np.zeros((12, 2))])
    points, along = np.vstack([points, fine]), np.vstack([along, np.tile([1.0, 0.0, 0.0], (12, 1))])
    line = np.array([*np.repeat(["X1", "Y1", "Z1"], 9), *np.repeat(["Z1", "Y1", "X1"], 9), *["F1"] * 12])
    way = np.repeat([1, -1, 1], [27, 27, 12])
    is_fine = line == "F1"
    true = points + np.outer(0.5 * width * way * along[:, 1], [0.0, 1.0, 0.0])
    noise = np.random.default_rng(9).normal(0.0, 1.0, len(points)) * np.where(is_fine, 5 * nm, 0.5 * um)
    d = np.linalg.norm(true - BASE, axis=1) - np.where(is_fine, 1.7, 1.4) + noise
    rows = [f"{k + 1},fit,{line[k]},{1 + k // 9},1,{way[k]},0.0,{k * 0.5:.1f},20.1,"
            + ",".join(f"{v / mm:.7f}" for v in (*points[k], d[k])) for k in range(len(d))]
    header = "row,split,line,block,sweep,direction,speed_mm_s,time_min,temp_C,x_mm,y_mm,z_mm,d_mm"
    (folder / "measurements.csv").write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    described = "".join(f"""[[known.lines]]
id = "{name}"
kind = "{kind}"
axis = "{axis}"
abbe_x_mm = 90.0
abbe_y_mm = 70.0
sigma_axis_um = {0.001 if kind == "fine" else 0.05}
sigma_d_um = {0.005 if kind == "fine" else 0.5}
""" for name, kind, axis in (("X1", "long", "x"), ("Y1", "long", "y"), ("Z1", "long", "z"), ("F1", "fine", "x")))
    (folder / "case.toml").write_text(CASE + described, encoding="utf-8")
    return Job.read(folder)


def test_a_case_folder_is_a_job_with_a_zeroing_of_its_own_for_a_fine_line(tmp_path):
    problem = base_point.from_job(case_in(tmp_path, 0.0))
    estimate = calib.solve(problem)
    assert {o.group for o in problem.observations} == {"tracker long", "tracker F1"}
    known = calib.covariance(calib.linearise(estimate), "base_point")
    assert np.abs((known.values - BASE) / known.u).max() < 4.5 and estimate.dof == 66 - 5
    assert estimate.p_value > 0.001


def test_the_effect_of_a_case_is_found_in_its_units(tmp_path):
    problem = base_point.from_job(case_in(tmp_path, 12.0 * um))
    effect = problem.attached_effect("hysteresis (y)").effect
    before, after = calib.solve(problem), calib.solve(problem.free(effect))
    u = calib.covariance(calib.linearise(after), effect).u[0]
    assert before.p_value < 1e-6 and after.p_value > 0.001
    assert abs(after[effect][0] - 12.0 * um) < 4.5 * u


# --- the slips of docs/slips/base_point.md ------------------------------------------------------------------------

C = np.array([-203.8742, 1400.9193, -228.9421]) * mm


def test_the_printed_signs_of_equation_6_have_no_root():
    square = (EXPERIMENT.points - C) ** 2
    radicand = square[:, 0] - square[:, 1] - square[:, 2]
    assert radicand[0] / mm**2 == pytest.approx(-1948969, abs=1) and np.sum(radicand < 0) == 23
    assert np.sqrt(radicand[31]) / mm == pytest.approx(759.5, abs=0.05)
    assert np.sqrt(square[31].sum()) / mm == pytest.approx(1087.0, abs=0.05)


def test_the_reading_of_table_2_grows_when_the_path_shortens():
    path, length, d = np.linalg.norm(EXPERIMENT.points[13] - C), np.linalg.norm(C), EXPERIMENT.readings[13]
    assert (path - (length + d)) / mm == pytest.approx(534.35, abs=0.01)
    assert (path - (length - d)) / mm == pytest.approx(0.0012, abs=0.0001)


def test_the_cosine_of_equation_1_has_plus_for_the_beam_and_minus_for_the_triangle():
    table = shipped("base_point/table1_symmetric_simulation.csv")
    a, b = table.number("a", "length")[0] / mm, table.number("b", "length")[0] / mm
    length, cosine = np.hypot(700.0, 500.0), 700.0 / np.hypot(700.0, 500.0)
    assert np.degrees(np.arccos(cosine)) == pytest.approx(35.54, abs=0.005)
    assert np.sqrt(length**2 + b**2 - 2 * length * b * cosine) - length == pytest.approx(a, abs=1e-4)
    assert np.sqrt(length**2 + b**2 + 2 * length * b * cosine) - length == pytest.approx(109.8915, abs=1e-4)


def test_equation_3_has_the_wrong_sign_of_the_correction():
    target, begin, correction = np.array([131.3487, 0.0]), np.array([700.0, 500.0]), np.array([1.0, 1.0])
    path = np.linalg.norm(begin - target)
    grown = np.linalg.norm(begin + correction - target) - path
    slope = (begin - target) @ correction / path
    assert grown == pytest.approx(1.41131, abs=1e-5) and abs(slope - grown) < 6e-6
    assert abs(-slope - grown) == pytest.approx(2.82, abs=0.01)


def test_the_noise_of_table_1_is_a_micrometre_and_is_not_in_its_readings():
    table = shipped("base_point/table1_symmetric_simulation.csv")
    a, b, e = (table.number(name, "length") for name in ("a", "b", "e"))
    exact = np.hypot(0.7 - b, 0.5) - np.hypot(0.7, 0.5)
    assert np.sum((e / (0.1 * um)) ** 2) == pytest.approx(684, abs=1)
    assert np.sum((e / um) ** 2) == pytest.approx(6.84, abs=0.01)
    assert np.abs(a - exact).max() < 0.12 * um and np.abs(a - exact - e).max() > 2.0 * um
    for name, printed, needed in (("sym", 0.040, 0.40), ("half", 0.26, 2.58)):
        foot = base_point_published.FEET[name]
        assert base_point_published.sigma_x(foot, 0.1 * um) == pytest.approx(printed, abs=0.005)
        assert base_point_published.sigma_x(foot, 1.0 * um) == pytest.approx(needed, abs=0.005)


def test_two_or_three_unknowns_print_the_same_s():
    assert PUBLISHED["s"].value == pytest.approx(1.279, abs=0.001)
    assert PUBLISHED["s"].more["value_with_three_unknowns"] == pytest.approx(1.301, abs=0.001)


def test_the_digit_repairs_move_the_base_point_by_tens_of_micrometres():
    assert PUBLISHED["base_x"].more["value_as_printed"] == pytest.approx(-203.8702, abs=0.0001)
    assert PUBLISHED["base_z"].more["value_as_printed"] == pytest.approx(-228.9151, abs=0.0001)
    assert FREE["base_point"] - TIED["base_point"] == pytest.approx(np.array([-32, 50, -91]) * um, abs=0.6 * um)


def test_the_printed_decimals_are_beyond_what_the_readings_carry():
    u = calib.covariance(calib.linearise(TIED), "base_point").u
    assert u / um == pytest.approx([5.4, 11.3, 33.2], abs=0.05)
    assert PUBLISHED.studies["lag_one_correlation_of_joint_residuals"] == pytest.approx(0.44, abs=0.005)


def test_the_digit_repairs_are_where_the_printed_residuals_do_not_fit():
    table = shipped("base_point/table2_experiment.csv")
    residuals, row = TIED.residuals["tracker"][:, 0], table.whole("i")
    repaired, shift = table.text("repaired"), table.number("d_printed", "length") - table.number("d", "length")
    misfit = residuals + shift - table.number("delta_printed", "length")      # a longer d is a larger residual
    found = {int(row[k]): abs(misfit[k]) / um for k in np.flatnonzero(np.abs(misfit) > 0.06 * um)}
    assert sorted(found) == row[repaired != "no"].tolist() == [5, 14, 19, 25]
    assert [found[k] for k in (14, 25, 5, 19)] == pytest.approx([0.8, 2.7, 0.32, 0.85], abs=0.05)


def test_the_coordinate_across_the_line_gains_little_from_symmetry():
    rows = {(r["layout"], r["start"]): r["u_y_um"] for r in PUBLISHED.studies["layouts"]}
    tied = [rows[name, "tied to the zero point"] for name in ("sym", "half")]
    assert tied == pytest.approx([1.57, 2.72], abs=0.005) and tied[1] / tied[0] == pytest.approx(1.73, abs=0.005)
