"""Layouts of targets, of points on lines and on circles: what was chosen, the best choice, its bound."""

from __future__ import annotations

import numpy as np

import calib
from calib import A, C, Exhaustive
from calib.analyse.selection.planning import next_best, over
from calib.errors import RankDefect
from calib.solve.placement import as_settings, best_places
from calib.units import degree, mm, um
from problems import base_point, base_point_layout, circle
from problems.base_point import SHORTENING, FreeStart, TiedStart, paper
from problems.base_point.lines import Lines

Rows = list[dict[str, object]]


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
            own = base_point_layout.uncertainties(paper.layout_targets(), centre, zero, 1 * um)
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
    own = paper.experiment("d")
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


def placed() -> Rows:
    """Targets on a plane and readings on an arc, placed continuously by IPOPT, beside the choice from a grid."""
    rows: Rows = []
    begin = np.array([[1.0, 0.1], [0.2, 1.0], [-0.7, -0.3], [0.5, 0.5]])
    for words, zero, count in (("known", base_point_layout.KNOWN, 3), ("free", base_point_layout.FREE, 4)):
        plan, (target,) = as_settings(base_point_layout.planar(begin[:count], (0.0, 0.0), zero), "tracker",
                                      {"guide": ((-1, -1, 0), (1, 1, 0))})
        found = best_places(plan, [target], "base_point.x", "base_point.y", starts=3, seed=1)
        rows.append({"what": f"{count} targets, length at the zero {words}", "where they begin": found.begin,
                     "placed": found.value, "bound": base_point_layout.bound(count), "starts that led there":
                     f"{found.found} of {found.starts}"})
    return rows
