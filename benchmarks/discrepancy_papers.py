"""`calib.explain` on every table of readings of the four papers: what is missing, and what could have been seen.

python benchmarks/discrepancy_papers.py [--out benchmarks/results] [--docs docs]

Models are those of the problem modules, candidates those of their instruments and axes. The tables are small: beside
every verdict stands what the smallest p-value is after correction for all looks, and how large an effect would have to
be to show in four of five such tables. Writes a table, the results as JSON, and the figures of docs.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import calib
from calib import Gaussian, Problem, covariance, linearise, solve
from calib.analyse.score import candidates, field_of, orthonormal
from calib.table import shipped
from calib.units import arcsec, minute, mm, um
from calib.workflow.discrepancy.power import detectable
from problems import axis_points, base_point, plumb, positioning
from problems.base_point import LENGTHENING, SHORTENING, FreeStart, TiedStart
from problems.base_point import paper as tables_of_2007
from problems.base_point.lines import Lines
from problems.five_axis import jobs
from problems.five_axis.readings import Circle, Readings, published
from problems.turntable.tables import RADIUS, U_POLYGON

U_TRACKER_CHORD = 16.5 * um  # of a point at 3 m across the beam, by the stated (15 um + 6 um/m)/2; distance assumed
DRAWS = 20_000  # simulated residuals behind every p-value of the look at table 2 of the base point


@dataclass(frozen=True)
class Case:
    """One table or part of it: paper, name, its problem with candidates, and what the reader has to know."""

    paper: str
    name: str
    problem: Problem
    note: str = ""


# --- the tables -------------------------------------------------------------------------------------------------------


def five_axis() -> Iterator[Case]:
    """Level readings, filaments, both circles of pitch and roll targets; then everything in one problem."""
    r, paper = published(), "five-axis simulator (2015)"
    level = plumb.declare(np.tile(r.level_angle, 2), r.level.T.ravel(), r.u_level,
                          np.repeat(["three-axis", "two-axis"], len(r.level_angle)), None, {})
    yield Case(paper, "table 1, level on two yaw axes", with_what_acts(level, plumb.effects()),
               "u = 0.2 arcsec; a quarter turn")
    wires = [f"{i} {w}" for i, w in zip(r.wires.instrument, r.wires.target, strict=True)]
    filaments = axis_points.declare_filaments(
        r.wires.reading[:, 0] if r.wires.reading.ndim > 1 else r.wires.reading, wires, r.wires.angle,
        distance={w: _length(r, w.split()[0]) for w in wires}, u=r.u_circle)
    yield Case(paper, "table 2, filaments", with_what_acts(filaments, _of_one_face()), "u = 1 arcsec")
    for name, circle in (("3, targets of the pitch axes", r.pitch), ("4, targets of the roll axis", r.roll)):
        yield Case(paper, f"table {name}", with_what_acts(_targets(r, circle), _of_one_face()),
                   "u = 1 arcsec; one face")
    yield Case(paper, "tables 1 to 4 jointly", jobs.declare(r), "circles shared where the readings accept it")


def with_what_acts(problem: Problem, offered: Any) -> Problem:
    """The problem with those of the offered effects that can act on its readings."""
    return problem.with_effects(*problem.acting(offered))


def _of_one_face() -> list[Any]:
    """Effects of theodolite and axis; the standing axis and the circles are not seen in so narrow a field."""
    return [e for e in axis_points.effects() if e.name not in ("standing_axis_tilt", "circle_eccentricity")]


def _length(r: Readings, instrument: str) -> float:
    return r.distance[{"T1": "L_x", "T2": "L_y"}.get(instrument, instrument)][0] if "L_x" in r.distance else \
        next(value for key, (value, _) in r.distance.items() if key == instrument)


def _targets(r: Readings, circle: Circle) -> Problem:
    return axis_points.declare(circle.reading, circle.target, circle.angle,
                               distance={t: r.distance[t][0] for t in dict.fromkeys(circle.target)},
                               u=[r.u_circle, r.u_circle], shared=())


def turntable() -> Iterator[Case]:
    """Every column of both tables as a positioning of its table, in the order of the rows."""
    paper = "turntable (2020)"
    one, three = shipped("turntable/table1_one_axis.csv"), shipped("turntable/table2_three_axis.csv")
    command = one.number("nominal", "angle")
    u = {"A1": U_POLYGON, **{name: U_TRACKER_CHORD / radius for name, radius in RADIUS.items()}}
    for name in ("A1", "B1", "B2"):
        yield Case(paper, f"table 1, {name}", positioning.declare(command, one.number(name, "angle"), u[name]),
                   f"u = {u[name] / arcsec:.2g} arcsec a stop, the statement of the instrument")
    for name in ("A1-B1", "A1-B2"):
        yield Case(paper, f"table 1, {name}", positioning.declare(
            command, command + one.number(name, "angle"), float(np.hypot(u["A1"], u[name[3:]]))),
            "difference of two methods, the table itself drops out")
    command = three.number("nominal", "angle")
    for name in ("horizontal", "pitch", "spin"):
        yield Case(paper, f"table 2, {name}", positioning.declare(command, three.number(name, "angle"), u["B2"]),
                   "radius not printed, 200 mm assumed")


def base_points() -> Iterator[Case]:
    """Table 1 with its noise added; table 2 with the start tied, as in the paper, and free, as printed and repaired."""
    paper, simulated = "base point (2007)", shipped("base_point/table1_symmetric_simulation.csv")
    travel = simulated.number("b", "length")
    points = np.column_stack([travel, np.zeros((len(travel), 2))])
    lines = Lines(points, simulated.number("a", "length") + simulated.number("e", "length"), 1 * um,
                  np.tile([1.0, 0.0, 0.0], (len(travel), 1)))
    one = base_point.declare_one_line(lines.points[:, 0], lines.readings, 1 * um, LENGTHENING, begin=(0.7, 0.5))
    yield Case(paper, "table 1, simulation on one line", with_what_acts(one, base_point.effects()),
               "made by the paper without any effect, u = 1 um")
    for column, words in (("d", "digits repaired"), ("d_printed", "as printed")):
        for zero, start in ((TiedStart(tables_of_2007.ZERO_POINT), "start tied"),
                            (FreeStart(tables_of_2007.ZERO_POINT), "start free")):
            yield Case(paper, f"table 2, {start}, {words}", experiment(column, zero), "no u is printed: 1 um")


def experiment(column: str, zero: base_point.Zero) -> Problem:
    """Table 2 with what can be said of its rows: order of the lines (an even pace assumed), line, travel on it."""
    lines = tables_of_2007.experiment(column)
    line = shipped("base_point/table2_experiment.csv").text("line")
    travel = np.where(line == "X", lines.points[:, 0], lines.points[:, 1])
    lines = replace(lines, covariates={"line": line, "travel": (travel, "mm"), "block": 1 + (line == "Y"),
                                       "time": (np.arange(len(line)) * minute, "min")})
    low, high = lines.points.min(axis=0), lines.points.max(axis=0)
    half = np.where(high > low, (high - low) / 2, 1.0)
    return base_point.with_recorded_effects(
        base_point.declare(lines, zero, sense=SHORTENING), lines, (low + high) / 2, half)


def every_case() -> Iterator[Case]:
    """All tables of readings of the papers; the paper on locators prints none."""
    yield from five_axis()
    yield from turntable()
    yield from base_points()


# --- what is said of each ---------------------------------------------------------------------------------------------


def said(case: Case, level: float = 0.01) -> dict[str, Any]:
    """The finding on one table as JSON knows it."""
    found = calib.explain(case.problem, level)
    fit = linearise(found.before)
    offered = candidates(fit)
    sizes = detectable(field_of(fit, offered), offered, level)
    could = [s for s in sizes if s.size <= s.usual[1]]
    return {
        "paper": case.paper, "table": case.name, "note": case.note, "readings": sum(g.size for g in fit.groups),
        "dof": fit.dof, "verdict": found.verdict, "sentence": found.sentence,
        "rms": list(found.rms), "p_of_size": size_p(found),
        "effects": [{"name": e.name, "channel": e.channel, "p_value": e.p_value, "alias": e.aliases,
                     "parameters": e.parameters} for e in found.effects],
        "noise": [[t.what, t.where, t.figure, t.p_value] for t in found.noise],
        "where": [[p.channel, p.covariate, p.shape, p.p_value] for p in found.where[:3]],
        "best": [[r.label, r.drop, r.dof] for r in found.ranking[:3] if r.dof],
        "candidates": len(offered), "seen": sum(1 for r in found.ranking if r.dof),
        "could_be_seen": [[s.effect, s.parameter, s.size, s.usual[1], s.unit] for s in could],
        "too_small_to_be_seen": sorted({s.effect for s in sizes} - {s.effect for s in could}),
    }


def size_p(found: Any) -> float:
    """Probability of a sum of squares as far out, both tails."""
    from scipy.special import gammainc, gammaincc

    half, squares = found.before.dof / 2, found.before.objective / 2
    return float(min(1.0, 2 * min(gammainc(half, squares), gammaincc(half, squares)))) if half else 1.0


# --- the correlation of table 2 of the base point ---------------------------------------------------------------------


def correlation_of_table_2(seed: int = 1) -> dict[str, Any]:
    """Looks at what stays from reading to reading with the start free: how rare, and what shape explains it."""
    problem = experiment("d", FreeStart(tables_of_2007.ZERO_POINT))
    estimate = solve(problem)
    fit = linearise(estimate)
    field = field_of(fit, ())
    drawn = field.draw(seed, DRAWS)
    residual = field.residual / np.sqrt(field.squares / field.dof)
    drawn /= np.sqrt(np.sum(drawn**2, axis=0) / field.dof)  # compared in shape alone: no u is printed

    def lag(v: np.ndarray, places: Any = slice(None)) -> Any:
        return np.sum(v[places][1:] * v[places][:-1], axis=0) / np.sum(v[places] ** 2, axis=0)

    observed = problem.observations[0]
    line, travel = observed.covariates["line"], np.asarray(observed.covariates["travel"], float)
    x, y = line == "X", line == "Y"
    looks: list[tuple[str, np.ndarray]] = []
    for degree_ in (3, 4, 5, 6):
        whole = np.polynomial.legendre.legvander(np.linspace(-1, 1, len(line)), degree_)[:, 1:]
        looks.append((f"order of reading (or direction of sight), polynomial of degree {degree_}", whole))
        each = []
        for name, on in (("X", x), ("Y", y)):
            scaled = 2 * (travel[on] - travel[on].min()) / np.ptp(travel[on]) - 1
            columns = np.zeros((len(line), degree_ - 1))
            columns[on] = np.polynomial.legendre.legvander(scaled, degree_)[:, 2:]
            each.append(columns)
            looks.append((f"travel on line {name}, polynomial of degree {degree_}", columns))
        looks.append((f"travel on both lines, polynomials of degree {degree_}", np.concatenate(each, axis=1)))
    drops = []
    for name, columns in looks:
        frame = orthonormal(field.outside(columns), np.linalg.norm(columns, axis=0))
        own, others = float(np.sum((frame.T @ residual) ** 2)), np.sum((frame.T @ drawn) ** 2, axis=0)
        drops.append((name, own, frame.shape[1], np.sort(others)))
    p = [1 - np.searchsorted(d[3], d[1]) / DRAWS for d in drops]
    best = min(range(len(p)), key=lambda i: p[i])
    ranks = np.array([1 - np.searchsorted(d[3], np.sum(
        (orthonormal(field.outside(c), np.linalg.norm(c, axis=0)).T @ drawn) ** 2, axis=0)) / DRAWS
        for d, (_, c) in zip(drops, looks, strict=True)])
    corrected = float(np.mean(ranks.min(axis=0) <= p[best]))
    serial = _with_memory(problem, float(lag(residual)))
    return {
        "lag_one": float(lag(residual)), "p_lag_one": float(np.mean(lag(drawn) >= lag(residual))),
        "lag_one_on": {name: [float(lag(residual, np.flatnonzero(on))),
                              float(np.mean(lag(drawn, np.flatnonzero(on)) >= lag(residual, np.flatnonzero(on))))]
                       for name, on in (("X", x), ("Y", y))},
        "shapes": [[name, own, k, float(q)] for (name, own, k, _), q in zip(drops, p, strict=True)],
        "best": drops[best][0], "p_best": float(p[best]), "p_best_corrected": corrected, "looks": len(looks),
        "base_point": serial,
    }


def _with_memory(problem: Problem, correlation: float) -> dict[str, Any]:
    """The base point with readings taken as independent and as remembering the one before."""
    seen = problem.observations[0]
    order = np.arange(seen.n)
    scatter = float(np.sqrt(solve(problem).variance_factor)) * um
    plain = problem.with_uncertainty({seen.group: Gaussian.standard(np.full((seen.n, 1), scatter))})
    serial = problem.with_uncertainty({seen.group: Gaussian.serial(np.full(seen.n, scatter), correlation, order)})
    result = {}
    for name, one in (("independent", plain), ("with memory", serial)):
        known = covariance(linearise(solve(one)), "base_point")
        result[name] = {"value_mm": (known.values / mm).tolist(), "u_um": (known.u / um).tolist()}
    return result


def figure_of_table_2() -> Any:
    """Residuals of table 2 along both lines, start free, with polynomials of degree 4 in the travel."""
    import matplotlib
    from matplotlib.figure import Figure

    matplotlib.rcParams["svg.hashsalt"] = "table 2"  # the same file from the same numbers
    problem = experiment("d", FreeStart(tables_of_2007.ZERO_POINT))
    observed, residual = problem.observations[0], solve(problem).residuals
    line, travel = observed.covariates["line"], np.asarray(observed.covariates["travel"], float) / mm
    left = residual[observed.group][:, 0] / um
    figure = Figure(figsize=(7.5, 2.9), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for ax, name in zip(axes, "XY", strict=True):
        on = line == name
        fine = np.linspace(travel[on].min(), travel[on].max(), 200)
        shape = np.polynomial.Legendre.fit(travel[on], left[on], 4)
        ax.axhline(0, color="0.8", linewidth=0.8)
        ax.plot(fine, shape(fine), color="tab:orange", linewidth=1.2, label="degree 4")
        ax.plot(travel[on], left[on], "o", color="tab:blue", markersize=4, label="residual")
        ax.set(xlabel=f"travel on line {name} / mm", title=f"line {name}")
    axes[0].set_ylabel("residual, start free / um")
    axes[1].legend(frameon=False)
    return figure


# --- output -----------------------------------------------------------------------------------------------------------


def table(rows: list[dict[str, Any]]) -> str:
    """The findings as a table in Markdown."""
    lines = ["| table | readings | dof | rms of r/u | verdict | largest single candidate (drop of v'Pv) |",
             "| --- | --- | --- | --- | --- | --- |"]
    for r in rows:
        best = ", ".join(f"{label} {drop:.1f} ({dof})" for label, drop, dof in r["best"][:1]) or "none can be seen"
        cells = [f"{r['paper']}: {r['table']}", r["readings"], r["dof"], f"{r['rms'][0]:.2f}", r["verdict"], best]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--docs", type=Path, default=Path(__file__).parents[1] / "docs")
    chosen = parser.parse_args()
    rows = [said(case) for case in every_case()]
    study = correlation_of_table_2()
    (chosen.out / "discrepancy_papers.json").write_text(
        json.dumps({"tables": rows, "base point, table 2": study}, indent=1, default=float) + "\n", encoding="utf-8")
    (chosen.out / "discrepancy_papers.md").write_text(table(rows), encoding="utf-8")
    figure_of_table_2().savefig(chosen.docs / "discrepancy_papers_base_point.svg", metadata={"Date": None})
    print(table(rows))
    for r in rows:
        print(f"{r['paper']}, {r['table']}: {r['sentence']}")
    print(json.dumps(study, indent=1))


if __name__ == "__main__":
    main()
