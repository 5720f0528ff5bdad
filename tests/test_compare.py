"""One problem under many formulations: the same where they are the same, judged on common ground, refused in words."""

from __future__ import annotations

import json

import numpy as np
import pytest
from folders import put

import calib
from calib import Observations, Problem, Quantity, Unknown
from calib.geometry import norm
from calib.job import Job
from calib.workflow.compare.answer import placed
from calib.workflow.compare.formulation import ClosedForm, Redeclared
from calib.workflow.compare.side_by_side import DECLARED, Effort, compare
from calib.workflow.compare.starts import region, starts
from problems import base_point, circle
from tests.command import runner
from tests.declared import line

ONE = {"Gauss-Newton": calib.GaussNewton()}
QUICK = Effort(starts=12, draws=12, seconds=2.0)


@pytest.fixture
def calib_command(capsys):
    return runner(capsys)


def job_of(module, folder, seed=1):
    put(folder, module.example_job(seed))
    return folder / "job.toml"


def by(comparison, formulation, method=None):
    return next(one for one in comparison.lines
                if one.formulation == formulation and method in (None, one.method))


def test_all_methods_that_minimise_squares_agree_on_a_line_and_other_losses_differ():
    problem, offset, slope = line([0.05, 1.1, 1.9, 3.2, 3.9])
    found = compare(problem, [offset, slope], {}, QUICK)
    assert len(found.lines) == 7 and not found.refused
    for name in ("Gauss-Newton", "IPOPT, exact Hessian", "IPOPT, Gauss-Newton Hessian", "convex, least squares"):
        one = by(found, DECLARED, name)
        assert max(abs(d) for d in one.difference.values()) < 1e-6 and one.certificate.passed
        assert one.u_from == "stated uncertainties"
    least = found.reference.objective
    for name in ("convex, L1", "convex, minimum zone"):
        one = by(found, DECLARED, name)
        assert one.objective > least and max(abs(d) for d in one.difference.values()) > 0.01
        assert "simulation" in one.u_from


def test_a_linear_problem_is_found_from_every_start():
    problem, offset, slope = line([0.05, 1.1, 1.9, 3.2, 3.9])
    found = compare(problem, [offset, slope], {}, Effort(starts=12, draws=2))
    assert found.reference.starts.successes == 12 and found.reference.starts.safe == pytest.approx(10.0)
    assert by(found, DECLARED, "convex, L1").starts is None


def point_to(place, point):
    return norm(place - point)


def test_a_mirror_image_is_counted_as_another_place():
    places = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]])
    point = Unknown("point", [0.3, 0.4, 1.0])
    readings = np.linalg.norm(places - [0.3, 0.4, 1.0], axis=1)
    problem = Problem([Observations(point_to, places, point, readings=readings, u=1e-5, group="ranges")])
    best = calib.solve(problem)
    found = starts(problem, calib.GaussNewton(), best, region(best), 40, 3, 30.0)
    assert 0 < found.elsewhere < found.successes
    assert np.all(np.diff(found.reach) > 0)


def test_starts_too_far_away_fail_and_the_reach_says_from_where():
    x = np.linspace(0.0, 3.0, 30)
    rate = Unknown("rate", 9.0)

    def wave(rate, x):
        from casadi import sin
        return sin(rate * x)
    problem = Problem([Observations(wave, rate, x, readings=np.sin(9.0 * x), u=0.01, group="wave")])
    best = calib.solve(problem)
    found = starts(problem, calib.GaussNewton(), best, region(best, {"rate": 9.0}), 60, 1, 30.0)
    assert 0 < found.successes < 60 and 0.01 < found.safe < 1.0


def test_the_declared_objective_at_an_answer_leaves_the_rest_free():
    problem, offset, slope = line([0.05, 1.1, 1.9, 3.2, 3.9])
    best = calib.solve(problem)
    assert placed(problem, {"offset": best[offset], "slope": best[slope]}, best).objective == pytest.approx(
        best.objective)
    u = calib.covariance(calib.linearise(best), offset).u[0]
    # moved by one u of its own, with the slope free, v'Pv grows by one
    assert placed(problem, {"offset": best[offset] + u}, best).objective == pytest.approx(best.objective + 1.0)
    assert placed(problem, {"unheard of": 1.0}, best).objective is None


def test_a_closed_form_that_is_the_estimate_has_its_u_by_simulation():
    problem, offset, slope = line(list(3.0 + 0.5 * np.arange(5.0)))

    def by_hand(declared):
        return dict(zip(("slope", "offset"), np.polyfit(np.arange(5.0), declared.observations[0].readings.ravel(), 1)))
    found = compare(problem, [offset, slope], {"by hand": ClosedForm(by_hand)}, Effort(starts=0, draws=400),
                    under=ONE)
    mine = by(found, "by hand")
    assert max(abs(d) for d in mine.difference.values()) < 1e-6
    for name, u in mine.u.items():      # 400 draws: the spread is known to 3.5 %
        assert u == pytest.approx(found.reference.u[name], rel=0.15)


def test_another_declaration_reports_no_result_that_it_holds():
    problem, offset, slope = line([0.05, 1.1, 1.9, 3.2, 3.9])
    found = compare(problem, [offset, slope], {"through zero": problem.hold(offset)}, QUICK, under=ONE)
    held = by(found, "through zero")
    assert "offset" not in held.values and "slope" in held.values


def test_a_formulation_that_cannot_take_the_readings_says_why():
    def refuses(declared):
        raise calib.errors.InputError("five readings are too few for this fit")
    problem, offset, _ = line([0.05, 1.1, 1.9, 3.2, 3.9])
    found = compare(problem, [offset], {"picky": ClosedForm(refuses), "other": Redeclared(refuses)}, QUICK, under=ONE)
    assert [one.why for one in found.refused] == ["five readings are too few for this fit"] * 2


def test_without_any_solution_every_line_says_why():
    offset, twin = Unknown("offset", 0.0), Unknown("twin", 0.0)
    problem = Problem([Observations(lambda a, b, x: a + b + 0 * x, offset, twin, np.arange(3.0),
                                    readings=np.zeros(3), u=1.0, group="sum")],
                      quantities=[Quantity("double", lambda a: 2 * a, offset)])
    found = compare(problem, [problem.quantities[0]], {"other": problem}, QUICK)
    assert found.reference is None and len(found.refused) == len(found.lines)
    assert "cannot be known" in found.lines[0].why


@pytest.mark.slow
def test_the_formulations_of_the_circle_are_compared_on_the_declared_objective(tmp_path):
    job = Job.read(job_of(circle, tmp_path))
    problem = circle.from_job(job)
    names = ("centre", "radius")
    found = compare(problem, [problem.select(name).unknown for name in names], circle.formulations(job),
                    Effort(starts=0, draws=8))
    assert {one.method for one in found.lines if one.formulation == "Kasa"} == {"closed form"}
    least = found.reference.objective
    for one in found.lines:
        if one.accepted:
            assert one.objective >= least * (1 - 1e-9)
    bound = by(found, "eigenvalue bound").bound
    assert 0.0 < bound.lower < least and not bound.proven       # the covariances are long and thin
    assert all("not affine" in one.why for one in found.refused)


@pytest.mark.parametrize("start", ["free", "tied"])
def test_a_base_point_on_two_lines_is_proven_global_where_its_start_is_free(tmp_path, start):
    path = job_of(base_point, tmp_path)
    text = path.read_text().replace('start_reading = "free"', f'start_reading = "{start}"')
    path.write_text(text)
    job = Job.read(path)
    problem = base_point.from_job(job)
    bound = base_point.formulations(job)["global bound"].bound(calib.solve(problem))
    assert bound.proven is (start == "free") and 0.0 < bound.lower <= bound.objective * (1 + 1e-12)


def test_coordinates_with_an_uncertainty_bring_errors_in_variables_beside_ordinary_least_squares(tmp_path):
    path = job_of(base_point, tmp_path)
    text = path.read_text().replace("[options]", '[instruments.laser]\nkind = "interferometer"\nu = "2 um"\n[options]\n'
                                    'line_instrument = "laser"')
    path.write_text(text)
    job = Job.read(path)
    found = {name: calib.solve(problem) for name, problem in base_point.formulations(job).items()
             if name.startswith("coordinates")}
    u = {name: calib.covariance(calib.linearise(one), "base_point").u for name, one in found.items()}
    assert set(found) == {"coordinates exact", "coordinates projected", "coordinates adjusted"}
    assert np.all(u["coordinates projected"] > 1.2 * u["coordinates exact"])
    # with every coordinate read once, projecting is what adjusting does to first order
    away = found["coordinates adjusted"]["base_point"] - found["coordinates projected"]["base_point"]
    assert np.abs(away / u["coordinates adjusted"]).max() < 0.1
    assert u["coordinates adjusted"] == pytest.approx(u["coordinates projected"], rel=0.02)


def test_an_absolute_base_point_starts_from_the_trust_region_and_is_proven(tmp_path):
    path = job_of(base_point, tmp_path)
    truth = np.array([-0.2, 1.4, -0.23])
    places = np.random.default_rng(4).uniform(0.0, 0.8, (20, 3)) * [1, 1, 1]
    rows = [f"{n},{'XYZ'[n % 3]},{1e3 * x:.6f},{1e3 * y:.6f},{1e3 * z:.6f},{1e3 * d:.6f}" for n, ((x, y, z), d) in
            enumerate(zip(places, np.linalg.norm(places - truth, axis=1), strict=True), start=1)]
    (tmp_path / "lines.csv").write_text("\n".join(["# source: simulated", "row,line,x_mm,y_mm,z_mm,d_mm", *rows, ""]))
    text = path.read_text().replace('"free"', '"absolute"').replace("shortening", "lengthening")
    path.write_text(text.replace("start_point_mm = [0.0, 0.0, 0.0]\n", ""))
    job = Job.read(path)
    formulation = base_point.formulations(job)["global bound"]
    problem = base_point.from_job(job)
    assert formulation.begin(problem)["base_point"] == pytest.approx(truth, abs=1e-6)
    assert formulation.bound(calib.solve(problem)).proven


@pytest.mark.slow
def test_the_command_writes_the_comparison_and_a_page(tmp_path, calib_command):
    path = job_of(base_point, tmp_path)
    answer = calib_command("compare", path, "--out", tmp_path / "out", "--starts", 10, "--draws", 5, "--seconds", 1)
    assert answer.status == 0, answer.error
    assert "global minimum, proven" in " ".join(answer.out.split())
    content = json.loads((tmp_path / "out" / "comparison.json").read_text(encoding="utf-8"))
    keys = {"formulation", "method", "accepted", "why", "value", "u", "objective", "certificate", "iterations",
            "seconds"}
    assert all(keys <= set(one) for one in content)
    refused = [one for one in content if not one["accepted"]]
    assert len(refused) == 4 and all(one["why"] for one in refused)
    first = content[0]
    assert first["value"]["base_point.x"] == pytest.approx(-200.0, abs=0.05) and first["unit"]["base_point.x"] == "mm"
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Who refuses, and why" in page and "<svg" in page and "://" not in page.replace("http://www.w3.org", "")
