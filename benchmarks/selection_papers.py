"""What the four papers chose among redundant measurements, axes and poses, beside the best choice and its bound.

    python benchmarks/selection_papers.py

Writes benchmarks/results/selection_papers.md. Every choice is made by `calib.select` on the declared problem of the
paper; nothing is read, only planned, except for the five-axis tables.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

import calib
from calib import A, C, D, Ds, E, Exhaustive, G, Observations, Pose, Problem, Quantity, Shared
from calib.analyse.selection.exact import enumerated
from calib.analyse.selection.planning import next_best, over
from calib.analyse.selection.request import requested
from calib.errors import RankDefect
from calib.units import arcsec, degree, mm, um
from problems import base_point, base_point_layout, base_point_published, circle
from problems.base_point import SHORTENING, FreeStart, TiedStart
from problems.base_point_lines import Lines
from problems.five_axis import results as five_axis_results
from problems.five_axis.readings import published
from problems.locators import campaign, identification, paper
from problems.locators.errors import AXES, SHIFTS
from problems.locators.kinematics import readings_of
from problems.locators.measured import declare as declare_measured
from problems.locators.pose_error import COMPONENTS, choice, conditioning, linear_form
from problems.locators.vocabulary import error_functions

RESULTS = Path(__file__).parent / "results"
Rows = list[dict[str, object]]
NEARLY, EXACTLY = 100.0, 1e12      # condition numbers: nearly singular, singular to rounding
LENGTH_ERROR, ANGLE_ERROR = 10 * um, 5 * arcsec      # of every source alike: the paper prints no lengths to its indices
PAPER_SIX = (0, 1, 2, 4, 5, 8)     # X_A Y_A Z_A Y_B Z_B Z_C


# --- 84 choices of six driven axes -----------------------------------------------------------------------------------


def ball(part_pose: Any, in_part: Any) -> Any:
    """Where a ball of the part is."""
    return part_pose @ in_part


def nine_axes(part_pose: Any) -> Problem:
    """The pose seen by nine axes of 1 um each, every axis a group of its own; quantity: the three balls."""
    mechanism = paper.setup()
    travel = paper.strokes(mechanism, part_pose)
    part = Pose("part", part_pose.rotation, part_pose.translation, "mm", "deg")
    axes = [Observations(readings_of((axis,)), part, Shared(locator.ball_in_part), Shared(locator.frames.matrix),
                         Shared(travel[i]), Shared(mechanism.half_range), Shared(np.zeros(3)),
                         Shared(np.zeros(len(SHIFTS))), Shared(np.zeros(12)), u=1 * um, group=f"{axis.upper()}_{key}",
                         unit="um")
            for i, (key, locator) in enumerate(zip("ABC", mechanism.locators)) for axis in AXES]
    balls = np.array([locator.ball_in_part for locator in mechanism.locators])
    # One argument with a row each says how many instances there are.
    return Problem(axes, quantities=[Quantity("ball", ball, part, balls, unit="mm", parts=AXES, keys="ABC")],
                   name="pose of nine axes")


def driving_criteria() -> dict[str, Any]:
    """The criteria of a choice of driven axes."""
    return {"D": D(), "A (balls)": A("ball"), "E (balls)": E("ball"), "G (balls)": G("ball"),
            "Ds (angles)": Ds("part.rx", "part.ry", "part.rz"), "Ds (position)": Ds("part.x", "part.y", "part.z")}


def driving(pose: str) -> tuple[Rows, dict[str, object]]:
    """All 84 choices in one pose by all criteria, best D first, and the counts of singular and regular ones."""
    fit = calib.linearise(nine_axes(paper.part_poses()[pose]))
    values: dict[tuple[int, ...], dict[str, object]] = {}
    condition = conditioning(paper.setup(), paper.part_poses()[pose])
    for name, criterion in driving_criteria().items():
        request = requested(fit, 6, criterion, by="group")
        for choices, losses in enumerated(request.objective, request.limits):
            for six, loss in zip(choices.tolist(), losses):
                values.setdefault(tuple(six), {})[name] = request.value(float(loss)) if np.isfinite(loss) else np.nan
    labels = requested(fit, 6, D(), by="group").candidates.labels
    kind = {six: "singular" if c > EXACTLY else "nearly singular" if c > NEARLY else "regular"
            for six, c in condition.items()}
    rows: Rows = [{"driven": " ".join(labels[i] for i in six), "kind": kind[six], "condition": condition[six],
                   "of the paper": "x" if six == PAPER_SIX else "", **values[six]} for six in values]
    rows.sort(key=lambda row: -np.nan_to_num(float(str(row["D"]))))
    mine = values[PAPER_SIX]
    ranks = {name: 1 + sum(float(str(v[name])) * (1 - 1e-6) > float(str(mine[name])) if name == "D" else
                           float(str(v[name])) * (1 + 1e-6) < float(str(mine[name])) for v in values.values())
             for name in mine}
    counts = {one: sum(k == one for k in kind.values()) for one in ("singular", "nearly singular", "regular")}
    return rows, {"pose": pose, **counts, **{f"rank of the paper by {name}": rank for name, rank in ranks.items()}}


def against_nine(pose: str) -> Rows:
    """Eq 47: the largest spread of each component over the regular choices, the paper's, and all nine axes."""
    mechanism, where = paper.setup(), paper.part_poses()[pose]
    condition = conditioning(mechanism, where)

    def spread(driven: Any) -> np.ndarray:
        form = linear_form(mechanism, where, driven)
        u = np.array([ANGLE_ERROR if is_angle(source) else LENGTH_ERROR for source in form.sources])
        return np.sqrt(((form.response * u) ** 2).sum(axis=1))

    regular = {six: spread(choice(six)) for six in combinations(range(9), 6) if condition[six] < NEARLY}
    lines = {"smallest of the regular choices": np.min(list(regular.values()), axis=0),
             "maximum of eq 47 over the regular choices": np.max(list(regular.values()), axis=0),
             "the paper's six": regular[PAPER_SIX], "all nine by least squares": spread(None)}
    units = ("mm", "mm", "mm", "deg", "deg", "deg")
    return [{"pose": pose, "driven": words, **{f"{c} [{u}]": v for c, u, v in zip(COMPONENTS, units, value)}}
            for words, value in lines.items()]


def is_angle(source: str) -> bool:
    """Whether a source of `linear_form` is an angle."""
    name = source.split(".")[1]
    return name not in SHIFTS and not name.startswith("dr_")


# --- base point ---------------------------------------------------------------------------------------------------


def three_targets() -> Rows:
    """Three of 72 directions by branch and bound beside the continuous optimum of IPOPT and the printed layout."""
    angles = over(angle=np.arange(72) * 5 * degree)["angle"]
    rows: Rows = []
    for start in ("known", "free"):
        zero = {"known": base_point_layout.KNOWN, "free": base_point_layout.FREE}[start]
        targets = -np.column_stack([np.cos(angles), np.sin(angles)])
        fit = calib.linearise(base_point_layout.planar(targets, (0.0, 0.0), zero))
        found = calib.select(fit, 3, A("base_point.x", "base_point.y"), method=Exhaustive())
        best = base_point_layout.best_layout(zero, starts=3, seed=1)
        printed = np.radians([0.0, 60.0, -60.0])
        rows.append({
            "length at the zero": start, "chosen directions [deg]": ", ".join(f"{i * 5}" for i in found.chosen),
            "sqrt(Q11 + Q22), discrete": np.sqrt(found.value) * mm, "continuous (IPOPT)": best.value,
            "bound": best.bound, "printed layout": base_point_layout.root_of_trace(
                -np.column_stack([np.cos(printed), np.sin(printed)]), (0.0, 0.0), zero)})
    return rows


def symmetric_against_half() -> Rows:
    """Ten targets along 1.4 m, base point opposite the middle or opposite the end, and the best ten of 141."""
    rows: Rows = []
    travel = np.arange(141) * 10 * mm
    for start, zero in (("tied", base_point_layout.TIED), ("free", base_point_layout.FREE)):
        for foot, words in ((0.7, "symmetric"), (1.4, "half-symmetric")):
            centre = (foot, 0.5)
            own = base_point_layout.uncertainties(base_point_published.layout_targets(), centre, zero, 1 * um)
            grid = np.column_stack([travel[1:], np.zeros(140)])
            fit = calib.linearise(base_point_layout.planar(grid, centre, zero, 1 * um))
            best = calib.select(fit, 10, C("base_point.x"))
            rows.append({"start reading": start, "layout": words, "u_x, evenly spread [um]": own[0] / um,
                         "u_x, best ten [um]": best.u("base_point.x") / um,
                         "gap to the bound": best.gap,
                         "chosen [mm]": ", ".join(str(10 * (i + 1)) for i in best.chosen)})
    return rows


def experiment_against_best() -> Rows:
    """The layout of the experiment against the best 30 points on the same two lines, and the next best points."""
    own = base_point_published.experiment("d")
    begin = calib.solve(base_point.declare(own, sense=SHORTENING))["base_point"]
    on_x = own.along[:, 0] > 0
    dense = []
    for line in (on_x, ~on_x):
        low, high = own.points[line].min(axis=0), own.points[line].max(axis=0)
        dense.append(low + np.linspace(0, 1, 101)[:, None] * (high - low))
    points = np.vstack(dense)
    rows: Rows = []
    for start, zero in (("tied", TiedStart()), ("free", FreeStart())):
        plan = base_point.declare(Lines(own.points, None, 1 * um), zero, begin=begin)
        try:
            u = calib.covariance(calib.linearise(plan), "base_point").u / um
        except RankDefect as error:
            rows.append({"start": start, "layout": f"not determined: {error.directions[0]}"})
            continue
        grid = calib.linearise(base_point.declare(Lines(points, None, 1 * um), zero, begin=begin))
        best = calib.select(grid, len(own.points), A("base_point"))
        value = [p.u_chosen / um for p in best.promises]
        rows.append({"start": start, "u of the experiment [um]": " ".join(f"{x:.2f}" for x in u),
                     "u of the best layout [um]": " ".join(f"{x:.2f}" for x in value), "gap to the bound": best.gap,
                     "ratio": float(np.linalg.norm(u) / np.linalg.norm(value)),
                     "different places": len(np.unique(np.round(points[list(best.chosen)], 6), axis=0))})
    return rows


def first_point() -> Rows:
    """Which single further point on the line x or y lowers u of the base point most, after the line x alone."""
    base = np.array([-0.2, 1.4, 0.3])
    run = np.linspace(0.08, 0.8, 10)
    places = over(x=np.linspace(0.0, 0.8, 9), y=np.linspace(0.0, 0.8, 9), z=[0.0, 0.3])
    further = np.column_stack(list(places.values()))
    points = np.vstack([np.column_stack([run, 0 * run, 0 * run]), np.column_stack([0 * run, run, 0 * run]), further])
    plan = base_point.declare(Lines(points, None, 1 * um), FreeStart(), begin=base)
    ranking = next_best(calib.linearise(plan), A("base_point"), made={"tracker": range(1, 21)})
    return [{"place": " ".join(f"{x:.1f}" for x in points[int(one.label.split()[-1]) - 1]) + " m",
             "trace of the covariance against without it": one.ratio} for one in (*ranking[:3], ranking[-1])]


# --- turntable ----------------------------------------------------------------------------------------------------


def arcs() -> Rows:
    """u of centre and radius by arc, number of points and radius, readings of 10 um; and the best of a dense circle."""
    rows: Rows = []
    for radius in (0.2, 0.4):
        for arc in (90, 180, 270, 360):
            for count in (6, 13, 25):
                at = np.linspace(0, arc, count, endpoint=arc < 360) * degree
                plan = circle.declare(_on_circle(at, radius), 10 * um, at)
                u = calib.covariance(calib.linearise(plan), "centre", "radius").u / um
                rows.append({"radius [m]": radius, "arc [deg]": arc, "points": count,
                             "u centre in plane [um]": float(np.hypot(u[0], u[1])), "u radius [um]": u[3]})
    return rows


def best_on_arc() -> Rows:
    """Eight of 37 points on an arc: the choice for the centre against eight evenly spread ones."""
    rows: Rows = []
    for arc in (90, 180, 270, 360):
        at = np.linspace(0, arc, 37, endpoint=arc < 360) * degree
        fit = calib.linearise(circle.declare(_on_circle(at, 0.2), 10 * um, at))
        best = calib.select(fit, 8, A("centre.x", "centre.y"))
        even = np.linspace(0, arc, 8, endpoint=arc < 360) * degree
        u = calib.covariance(calib.linearise(circle.declare(_on_circle(even, 0.2), 10 * um, even)), "centre").u
        rows.append({"arc [deg]": arc, "u centre, evenly spread [um]": float(np.hypot(u[0], u[1])) / um,
                     "u centre, chosen [um]": np.sqrt(best.value) * mm / um, "gap to the bound": best.gap,
                     "chosen [deg]": ", ".join(f"{at[i] / degree:.0f}" for i in best.chosen)})
    return rows


def _on_circle(at: np.ndarray, radius: float) -> np.ndarray:
    return np.column_stack([radius * np.cos(at), radius * np.sin(at), np.zeros(len(at))])


# --- five-axis tables ---------------------------------------------------------------------------------------------


def five_axis_positions() -> Rows:
    """For each result of the joint estimate: how few of the readings hold u within 10 %, and in which groups."""
    fit = calib.linearise(five_axis_results.fits(published()).joint.estimate)
    rows: Rows = []
    for functions in fit.results.values():
        for k, label in enumerate(functions.labels):
            one = type(functions)((label,), (functions.units[k],), functions.values[k : k + 1],
                                  functions.derivatives[k : k + 1])
            rows.append(_few_enough(fit, one))
    return rows


def _few_enough(fit: calib.Linearisation, one: Any) -> dict[str, object]:
    total = sum(len(g.rows) for g in fit.groups if not g.is_prior)
    for keep in (8, 12, 16, 24, 32, 48, 64, 96, 128):
        if keep >= total:
            break
        try:
            found = calib.select(fit, keep, C(one), by="row", report=[one])
        except RankDefect:
            continue
        promise = found.promises[0]
        if promise.u_chosen <= 1.1 * promise.u_all:
            where = ", ".join(f"{name}: {len(rows)}" for name, rows in found.rows.items())
            return {"result": one.labels[0], "readings": f"{keep} of {total}", "u against all":
                    promise.u_chosen / promise.u_all, "gap to the bound": found.gap, "where they stand": where}
    return {"result": one.labels[0], "readings": f"more than 128 of {total}"}


# --- identification poses of the locators -------------------------------------------------------------------------


def identification_poses(campaigns: int = 2) -> Rows:
    """Which of 30 poses identify the errors, and the pose error that remains in 12 poses nobody fitted: the choice by D
    against as many poses taken at random."""
    functions = tuple(f for key in "ABC" for f in error_functions(key))
    known = identification.Knowledge()
    rows: Rows = []
    for keep in (6, 10, 16):
        left: dict[str, list[float]] = {"chosen": [], "random": []}
        choices = []
        for seed in range(campaigns):
            generator = np.random.default_rng([seed, 2])
            truth = {f.label: generator.normal(0.0, known.u(f)) for f in functions}
            measured = campaign.measure(campaign.drawn_poses(42, seed), seed, truth, further=functions, checks=12)
            fit = calib.linearise(identification.with_knowledge(_of_poses(measured, None), known))
            choices.append(calib.select(fit, keep, D(), by="pose"))
            chosen = [int(label.removeprefix("pose ")) for label in choices[-1].labels]
            poses = np.unique(measured.axes.where(measured.axes.split == "fit").pose)
            for words, some in (("chosen", chosen), ("random", poses[:keep].tolist())):      # drawn at random anyway
                left[words].append(_remaining(measured, some, known))
        rms = {words: float(np.sqrt(np.mean(np.square(errors)))) for words, errors in left.items()}
        rows.append({"poses": keep, "pose error, chosen [um]": rms["chosen"], "pose error, random [um]": rms["random"],
                     "gap to the bound": max(c.gap for c in choices),
                     "chosen in the first campaign": ", ".join(x.removeprefix("pose ") for x in choices[0].labels)})
    return rows


def _of_poses(measured: campaign.Campaign, poses: Sequence[int] | None) -> Problem:
    """The problem of some poses of a campaign, or of all that are for fitting, with all error functions free."""
    def fitted(readings: Any) -> Any:
        return readings.where(readings.split == "fit" if poses is None else np.isin(readings.pose, poses))

    return identification.with_error_functions(declare_measured(
        measured.setup, fitted(measured.axes), fitted(measured.targets), u_axis=campaign.U_AXIS,
        u_tracker=campaign.U_TRACKER))


def _remaining(measured: campaign.Campaign, poses: Sequence[int], known: identification.Knowledge) -> float:
    """Pose error [um] in the poses for checking, after identification in some poses."""
    found = identification.identified(identification.identify(_of_poses(measured, poses), known))
    checks = measured.axes.where(measured.axes.split == "check")
    estimated = identification.poses_from_axes(measured.setup, checks, campaign.U_AXIS, found)
    return identification.pose_error(measured.setup, estimated, measured.part[-12:]) / um


# --- files --------------------------------------------------------------------------------------------------------


def table(rows: Sequence[dict[str, object]]) -> str:
    """Rows as a Markdown table."""
    def cell(value: object) -> str:
        return f"{value:.4g}" if isinstance(value, (float, np.floating)) else str(value)
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = ["| " + " | ".join(names) + " |", "|" + " --- |" * len(names)]
    return "\n".join([*lines, *("| " + " | ".join(cell(row.get(n, "")) for n in names) + " |" for row in rows)])


def main() -> None:
    """Run all studies and write the tables."""
    both = {pose: driving(pose) for pose in ("initial", "target")}
    parts = [("Six of nine axes: how many choices are what", [both[pose][1] for pose in both])]
    parts += [(f"All 84 choices in the {pose} pose", both[pose][0]) for pose in both]
    parts += [("Eq 47, every length error 10 um, every angle error 5 arcsec",
               [*against_nine("initial"), *against_nine("target")]),
              ("Three targets", three_targets()), ("Symmetric against half-symmetric", symmetric_against_half()),
              ("The experiment against the best layout on its lines", experiment_against_best()),
              ("The next best point after two lines", first_point()),
              ("Turntable: arc, number, radius", arcs()), ("Turntable: the best eight of 37", best_on_arc()),
              ("Five-axis: the fewest readings found that hold u of each result within 10 %", five_axis_positions()),
              ("Locators: identification poses", identification_poses())]
    text = "\n\n".join(f"## {title}\n\n{table(rows)}" for title, rows in parts)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "selection_papers.md").write_text(
        "# Redundancy as a decision: the papers\n\n`python benchmarks/selection_papers.py`\n\n" + text + "\n",
        encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
