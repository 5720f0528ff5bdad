"""Base point by lines: published numbers, start and sense, what is not seen, effects."""

import numpy as np
import pytest
from tracked_lines import BASE, box

import calib
from calib.errors import InputError, RankDefect
from calib.table import shipped
from calib.units import hour, nm, ppm, um, urad
from problems import base_point
from problems.base_point import (
    LENGTHENING,
    SHORTENING,
    AbsoluteRange,
    AdjustedCoordinates,
    ExactCoordinates,
    FreeStart,
    ProjectedCoordinates,
    TiedStart,
    algebraic,
    paper,
)
from problems.base_point.lines import Lines

EXPERIMENT = paper.experiment("d")
TIED = calib.solve(base_point.declare(EXPERIMENT, TiedStart(), sense=SHORTENING))
FREE = calib.solve(base_point.declare(EXPERIMENT, FreeStart((0.0, 0.0, 0.0)), sense=SHORTENING))
PUBLISHED = paper.reproduce()


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
    for foot in paper.FEET.values():
        linear = paper.sigma_x(foot, 1.0 * um)
        drawn = paper.simulated_sigma_x(foot, 1.0 * um, 2000, 5)
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
    assert algebraic.counting_sense(lines.points, lines.readings) == sense
    assert calib.solve(base_point.declare(lines, sense=sense)).p_value > 0.001
    with pytest.raises(InputError, match=f'wrong counting sense: counts = "{wrong}".*set counts = "{right}"'):
        base_point.declare(lines, sense=-sense)


def test_a_wrong_sense_is_found_with_the_start_tied_too():
    with pytest.raises(InputError, match='set counts = "shortening"'):
        base_point.declare(EXPERIMENT, TiedStart(), sense=LENGTHENING)


def test_a_short_line_leaves_the_sense_undecided_and_is_not_refused():
    points = np.column_stack([np.linspace(0.0, 2e-6, 8), np.zeros((8, 2))])
    readings = np.linalg.norm(points - BASE, axis=1) - 1.4 + np.random.default_rng(2).normal(0.0, 5 * nm, 8)
    assert algebraic.counting_sense(points, readings) == 0.0


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
    (sentence,) = algebraic.unseen(EXPERIMENT.points)
    assert "plane z = 0" in sentence and "sign of z is not observable" in sentence and "mirror image" in sentence


def test_one_line_leaves_the_turn_about_it_unknown():
    points = EXPERIMENT.points[:14]
    lines = Lines(points, EXPERIMENT.readings[:14], 1.0 * um)
    with pytest.raises(RankDefect, match="base_point"):
        calib.solve(base_point.declare(lines, sense=SHORTENING))
    (sentence,) = algebraic.unseen(points)
    assert "one line along x" in sentence and "turning the base point about that line" in sentence
    assert algebraic.unseen(box()[0]) == ()


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
