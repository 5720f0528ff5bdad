"""The turntable: model, effects, positioning error, the paper's angles, and the published comparison."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from folders import put

import calib
from calib.errors import InputError
from calib.job import Job
from calib.table import shipped
from calib.units import arcsec, degree, mm, ppm, um
from instruments import laser_tracker
from problems import circle, turntable
from problems.turntable import paper

EXAMPLE = turntable.example(7)
SIZES = {"arcsec": 20.0 * arcsec, "ppm": 60.0 * ppm, "um": 40.0 * um, "ppm/K": 60.0 * ppm, "um/K": 60.0 * um,
         "arcsec/h": 60.0 * arcsec / 3600.0, "um/h": 400.0 * um / 3600.0}


def test_the_nominal_model_is_the_circle_that_it_says():
    """P = C + R (cos(theta + t) u + sin(theta + t) v) + h n with u, v, n right-handed, written out for one point."""
    axis = np.array([0.0, 0.0, 1.0])
    centre, reference = ca.DM([1.0, 2.0, 3.0]), ca.DM([1.0, 0.0, 0.0])
    found = turntable.reflector(0.3, 0.0, centre, ca.DM(axis), 0.5, 0.2, 0.1, 0.0, reference)
    assert np.allclose(np.array(found).ravel(), [1.0 + 0.5 * np.cos(0.5), 2.0 + 0.5 * np.sin(0.5), 3.1])


def test_the_example_is_explained_and_its_geometry_found():
    estimate = calib.solve(EXAMPLE)
    fit = calib.linearise(estimate)
    truth = np.concatenate([turntable.EXAMPLE["centre"], turntable.EXAMPLE["radius"]])
    known = calib.covariance(fit, "centre", "radius")
    assert estimate.certificate.passed and estimate.p_value > 0.001
    assert np.abs((known.values - truth) / known.u).max() < 4.5


@pytest.mark.parametrize("label", [effect.label for effect in EXAMPLE.effects])
def test_an_effect_that_is_there_is_found_with_its_size(label):
    effect = EXAMPLE.attached_effect(label).effect
    size = np.array([SIZES[p.unit] * (1.0 + 0.5 * k) for k, p in enumerate(effect.parameters)])
    unknown = EXAMPLE.parameters(effect)
    measured = calib.simulate(EXAMPLE, {unknown: size}, 11).free(effect)
    estimate = calib.solve(measured)
    u = calib.covariance(calib.linearise(estimate), effect).u
    assert estimate.certificate.passed
    assert np.abs((estimate[effect] - size) / u).max() < 4.5


def test_gauss_newton_and_ipopt_agree_on_the_turntable():
    one, two = calib.solve(EXAMPLE), calib.solve(EXAMPLE, calib.Ipopt())
    known = calib.covariance(calib.linearise(one), "centre", "radius", "phase")
    there = np.concatenate([two["centre"], two["radius"].ravel(), two["phase"].ravel()])
    assert np.abs((there - known.values) / known.u).max() < 1e-8


def stops_with_deviations(deviation, seed=1):
    command = np.arange(13) * 30.0 * degree
    angle = command + deviation
    points = np.column_stack([2.0 + 0.3 * np.cos(angle), -1.0 + 0.3 * np.sin(angle), np.full(13, -0.2)])
    readings = laser_tracker.polar_readings(points) + np.random.default_rng(seed).normal(0.0, 1.0, (13, 3)) * [
        2.0 * um, 0.5 * arcsec, 0.5 * arcsec]
    return turntable.declare(command, readings, [2.0 * um, 0.5 * arcsec, 0.5 * arcsec], axis=[0, 0, 1],
                             stops=np.arange(13))


def test_the_positioning_error_of_every_stop_is_found_within_its_u():
    truth = np.random.default_rng(2).normal(0.0, 30.0, 13) * arcsec
    truth -= truth[0]
    estimate = calib.solve(stops_with_deviations(truth))
    u = calib.covariance(calib.linearise(estimate), estimate.problem.select("deviation").unknown[np.arange(1, 13)]).u
    error = (estimate["deviation"].ravel() - truth)[1:] / u
    assert estimate["deviation"][0, 0] == 0.0
    assert np.abs(error).max() < 4.0 and 0.2 < np.mean(error**2) < 2.5


def test_two_reflectors_make_the_positioning_error_surer_than_one():
    stops = turntable.consecutive_stops(EXAMPLE.observations[0].covariates["command"],
                                        EXAMPLE.observations[0].covariates["direction"])
    seen = EXAMPLE.observations[0]
    both = turntable.declare(seen.covariates["command"], seen.readings, [4 * um, arcsec, arcsec],
                             seen.covariates["reflector"], [0, 0, 1], stops)
    one = seen.covariates["reflector"] == "2"
    single = turntable.declare(seen.covariates["command"][one], seen.readings[one], [4 * um, arcsec, arcsec], None,
                               [0, 0, 1], stops[one])
    u_both, u_one = (np.median(calib.covariance(calib.linearise(calib.solve(p)), "deviation").u[1:])
                     for p in (both, single))
    assert u_both < 0.95 * u_one


def test_stops_that_do_not_make_a_circle_are_refused():
    with pytest.raises(InputError, match="reflector 1: all 5 points are at one position"):
        turntable.declare(np.zeros(5), np.tile([3.0, 0.1, 1.5], (5, 1)), [um, arcsec, arcsec])


def test_an_axis_of_the_wrong_sense_is_named():
    seen = EXAMPLE.observations[0]
    with pytest.raises(InputError, match="reverse the axis direction"):
        turntable.declare(seen.covariates["command"], seen.readings, [um, arcsec, arcsec], seen.covariates["reflector"],
                          -np.array(turntable.EXAMPLE["axis"]))


# --- the paper's frame and angles --------------------------------------------------------------------------------


def exact_points(command):
    normal = np.array([0.2, -0.1, 1.0]) / np.linalg.norm([0.2, -0.1, 1.0])
    first, second = circle.in_plane(normal, np.array([1.0, 0.3, 0.0]))
    outward = np.cos(command)[:, None] * first + np.sin(command)[:, None] * second
    return np.array([1.5, 0.4, -0.2]) + 0.1 * outward, normal


def test_the_papers_procedure_gives_the_turned_angles_and_no_axial_part_on_exact_points():
    command = np.arange(12) * 30.0 * degree
    points, _ = exact_points(command)
    angles = calib.solve(paper.declare(points))["angles"]
    sense = np.sign(angles[1, 0])
    assert np.allclose(np.mod(sense * angles[:, 0] + 1e-9, 2 * np.pi), command + 1e-9, atol=1e-8)
    assert np.abs(angles[:, 1]).max() < 1e-9 and np.allclose(angles[:, 2], 0.1)


def test_an_axial_displacement_leaves_the_angle_turned_but_not_the_angle_between_the_vectors():
    """At half a turn the angle between two vectors loses the axial angle at first order: pi - 10 um/100 mm."""
    command = np.arange(12) * 30.0 * degree
    points, normal = exact_points(command)
    centre = np.array([1.5, 0.4, -0.2])
    points[6] += 10.0 * um * normal
    seen = paper.angles_in_table(ca.DM(points[6]), ca.DM(points[0]), ca.DM(centre), ca.DM(normal))
    between = np.arccos((points[6] - centre) @ (points[0] - centre) / np.prod(
        [np.linalg.norm(points[k] - centre) for k in (0, 6)]))
    assert abs(abs(float(seen[0])) - np.pi) < 1e-9
    assert np.pi - between == pytest.approx(10.0 * um / 0.1, rel=1e-3)


def test_equation_17_is_a_product_of_rotations_of_the_frame_not_of_the_table():
    from calib.geometry import rotation_x, rotation_y, rotation_z

    a, b, g = 0.3, 0.5, 0.7
    (ca_, sa), (cb, sb), (cg, sg) = ((np.cos(x), np.sin(x)) for x in (a, b, g))
    printed = np.array([[cb * cg, cb * sg, -sb], [sa * sb * cg - ca_ * sg, sa * sb * sg + ca_ * cg, sa * cb],
                        [ca_ * sb * cg + sa * sg, ca_ * sb * sg - sa * cg, ca_ * cb]])
    assert np.allclose(printed, rotation_x(a).T @ rotation_y(b).T @ rotation_z(g).T)
    assert np.abs(printed - rotation_x(a) @ rotation_y(b) @ rotation_z(g)).max() > 1.0


def test_equation_18_loses_the_quadrant_and_calls_the_zenith_angle_an_error():
    x, y, z = (0.1 * np.cos(120 * degree), 0.1 * np.sin(120 * degree), 0.0)
    printed_turn = 2 * np.pi - np.arctan(y / x)
    printed_axial = np.pi / 2 - np.arctan(z / np.hypot(x, y))
    assert printed_turn / degree == pytest.approx(420.0)          # 60 modulo 360, for a turn of 120 (or of -120)
    assert printed_axial / degree == pytest.approx(90.0)          # zero is meant: the point lies in the plane


# --- the published comparison ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def reproduction():
    return turntable.reproduce()


def test_every_demanded_key_is_there(reproduction):
    keys = {item.key for item in reproduction.items}
    demanded = set(shipped("turntable/published_values.csv").text("key"))
    demanded |= {f"T1_{column}_{i}" for column in ("A1-B1", "A1-B2") for i in range(1, 14)}
    columns = [("T1", c) for c in ("A1", "B1", "B2", "A1-B1", "A1-B2")]
    columns += [("T2", c) for c in ("horizontal", "pitch", "spin")]
    demanded |= {f"{table}_{c}_{what}" for table, c in columns for what in ("rms", "slope_ppm", "closure")}
    assert keys == demanded


def test_all_printed_differences_agree_and_what_is_not_printed_stays_unknown(reproduction):
    for item in reproduction.items:
        if item.key.startswith("T1_A1-B") and item.printed is not None:
            assert item.verdict == "agrees"
        if item.key.startswith(("tracker_", "cmm_", "sim_", "fig9_", "repeats")):
            assert item.value is None and item.verdict == "not determinable" and item.why
    assert reproduction["step_table2_text"].verdict == "differs"


@pytest.mark.parametrize("column, table", [("A1", "T1"), ("B1", "T1"), ("B2", "T1"), ("pitch", "T2"), ("spin", "T2")])
def test_slopes_are_those_of_a_straight_line_through_the_printed_numbers(reproduction, column, table):
    data = shipped({"T1": "turntable/table1_one_axis.csv", "T2": "turntable/table2_three_axis.csv"}[table])
    command, errors = data.number("nominal", "angle"), data.number(column, "angle") - data.number("nominal", "angle")
    line, covariance = np.polyfit(command, errors, 1, cov=True)
    assert reproduction[f"{table}_{column}_slope_ppm"].value == pytest.approx(line[0] / ppm, rel=1e-7)
    assert reproduction[f"{table}_{column}_slope_ppm"].u_vc == pytest.approx(np.sqrt(covariance[0, 0]) / ppm, rel=1e-6)
    assert reproduction[f"{table}_{column}_rms"].value == pytest.approx(np.sqrt(np.mean(errors**2)) / degree, rel=1e-12)


def test_the_edge_grows_against_the_polygon_and_the_rod_does_not(reproduction):
    growth = reproduction.studies["growth and radius"]["growth_against_polygon_ppm"]
    (edge, u_edge), (rod, u_rod) = growth["B1"], growth["B2"]
    assert edge / u_edge > 10.0 and abs(rod) / u_rod < 3.0


def test_one_way_readings_cannot_tell_scale_drift_and_slip_apart(reproduction):
    answers = reproduction.studies["told apart"]
    assert len(answers["table 1, one way"]["cannot_be_known"]) == 2
    assert answers["and back after an hour"]["cannot_be_known"] == []


def test_the_page_of_slips_carries_the_numbers_of_the_reproduction(reproduction):
    page = (Path(__file__).parents[1] / "docs" / "slips" / "turntable.md").read_text(encoding="utf-8")
    studies = reproduction.studies
    growth, left = (studies["growth and radius"][k]
                    for k in ("growth_against_polygon_ppm", "left_of_the_radius_law_ppm"))
    scatter = studies["agreement"]["scatter_in_stated_u"]
    e_n = {(r["method"], r["distance_m"]): r["largest_E_n"] for r in studies["agreement"]["rows"]}
    closings = [reproduction[f"{c}_closure"].value * 3600 for c in
                ("T1_A1", "T1_B1", "T1_B2", "T2_horizontal", "T2_pitch", "T2_spin")]
    apart = studies["told apart"]["and back after an hour"]["separability"]
    for words in (
            f"B1 grows by {growth['B1'][0]:.1f} ± {growth['B1'][1]:.1f} ppm, B2 by {growth['B2'][0]:.1f} ± "
            f"{growth['B2'][1]:.1f} ppm", f"= {left['polygon'][0]:.0f} ± {left['polygon'][1]:.0f} ppm",
            f"({left['command'][0]:.0f} ± {left['command'][1]:.0f} ppm)",
            f"{scatter['B1'][0]:.2f} ± {scatter['B1'][1]:.2f} (B1) and "
            f"{scatter['B2'][0]:.2f} ± {scatter['B2'][1]:.2f} (B2)",
            f"{e_n['B1', 3.0]:.2f} (B1), {e_n['B2', 3.0]:.2f} (B2) at 3 m; "
            f"{e_n['B1', 1.5]:.2f} and {e_n['B2', 1.5]:.2f}",
            '{:.0f}, {:.0f}, {:.0f}" (A1, B1, B2); {:.0f}, {:.0f}, {:.0f}" (table 2)'.format(*closings),
            f"hour {apart['drift (reading)']:.2f} for drift and slip"):
        assert words in page


def test_figures_are_drawn(reproduction):
    for draw in reproduction.figures.values():
        assert draw().axes


# --- jobs --------------------------------------------------------------------------------------------------------


def test_the_example_job_gives_the_deviation_of_every_stop(tmp_path):
    job = Job.read(put(tmp_path, turntable.example_job(3)))
    estimate = calib.solve(turntable.from_job(job))
    job.refuse_unknown_keys()
    assert estimate.certificate.passed and len(estimate["deviation"]) == 26
    assert np.abs(estimate["deviation"]).max() < 15 * arcsec


CASE = """format = 1
case = "turn"
scenario = "turntable_tracker"
[instruments.tracker]
sigma_range_um = 4.0
sigma_azimuth_arcsec = 1.0
sigma_zenith_arcsec = 1.0
[known]
reference_temperature_C = 20.0
coordinates = "cartesian"
axis_direction_approx = [0.0, 0.0, 1.0]
table_centre_approx_mm = [2400.0, -900.0, -300.0]
"""


def test_a_case_folder_with_cartesian_readings_finds_its_hidden_encoder_error(tmp_path):
    effect = EXAMPLE.attached_effect("encoder_2nd (theta)").effect
    hidden = np.array([25.0, -40.0]) * arcsec
    seen = calib.simulate(EXAMPLE, {EXAMPLE.parameters(effect): hidden}, 5).observations[0]
    points = laser_tracker.cartesian_readings(seen.readings) / mm
    given = seen.covariates
    rows = [f"{k + 1},fit,{given['reflector'][k]},{given['block'][k]},1,{given['direction'][k]},1,"
            f"{given['command'][k] / degree:.3f},"
            f"{given['time'][k] / 60.0:.3f},{20.0 + given['temperature_difference'][k]:.4f},{x:.5f},{y:.5f},{z:.5f}"
            for k, (x, y, z) in enumerate(points)]
    header = "row,split,smr,block,sweep,direction,repeat,command_deg,time_min,temp_C,x_mm,y_mm,z_mm"
    (tmp_path / "case.toml").write_text(CASE)
    (tmp_path / "measurements.csv").write_text("\n".join([header, *rows]) + "\n")
    problem = turntable.from_job(Job.read(tmp_path))
    problem = problem.free("encoder_2nd (theta)")
    estimate = calib.solve(problem)
    found = calib.covariance(calib.linearise(estimate), problem.parameters("encoder_2nd (theta)"))
    assert np.abs((found.values - hidden) / found.u).max() < 4.0
    assert estimate.p_value > 0.001
