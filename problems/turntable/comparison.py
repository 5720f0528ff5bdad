"""The turntable paper from its own tables: differences, growth with the turn, harmonics, and what cannot be known.

The coordinates, the radii of section 3 and the distance of the tracker are not printed, so no angle is recomputed from
coordinates. Where an uncertainty needs them, the assumption is a named constant and stands in every answer.
Source: Li, Cao, Qu 2020, Metrology and Measurement Technology 40(2), 14-19, doi 10.11823/j.issn.1674-5795.2020.02.03.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from calib.table import Table, shipped
from calib.units import arcsec, degree, mm, ppm
from calib.workflow.reproduce import Item, Printed, Reproduction
from problems import circle
from problems.circle import pairwise
from problems.turntable import findings
from problems.turntable.tables import DISTANCE, RADIUS, U_POLYGON, Methods, compare_methods, growth_of

ASSUMED = (f"u assumes the tracker {DISTANCE:g} m away with its stated U = 0.015 mm + 0.006 mm/m L (k = 2) on each "
           f"coordinate, reflectors at {RADIUS['B1'] / mm:g} mm (edge) and {RADIUS['B2'] / mm:g} mm (rod), and u = "
           f"{U_POLYGON / arcsec:g} arcsec for the polygon; none of the four is printed for section 3")
COLUMNS = {"T1": ("A1", "B1", "B2", "A1-B1", "A1-B2"), "T2": ("horizontal", "pitch", "spin")}
FILES = {"T1": "turntable/table1_one_axis.csv", "T2": "turntable/table2_three_axis.csv"}


def difference_items(table: Table, joint: Methods) -> Iterator[Item]:
    """Every printed difference A1-B1 and A1-B2, with E_n and with the difference that growth alone leaves."""
    polygon = table.number("A1", "angle")
    for name in ("B1", "B2"):
        column = f"A1-{name}"
        texts = table.text(column)
        difference = polygon - table.number(name, "angle")
        u, u_scatter = joint.u(column), joint.u(column, scatter=True)
        growth, u_growth = joint.growth(name, joint.by_statement)
        growth_scatter, u_growth_scatter = joint.growth(name, joint.by_scatter)
        for i, turn in enumerate(joint.command):
            first = i == 0
            yield Item(
                f"T1_{column}_{i + 1}", f"polygon less tracker at stop {i + 1}", "deg",
                Printed.of(str(texts[i]), "deg"), value=difference[i] / degree, u=u[i] / degree,
                u_vc=u_scatter[i] / degree, joint=0.0 if first else -growth * turn / degree,
                joint_u=u_growth * turn / degree, joint_u_vc=u_growth_scatter * turn / degree,
                why="zero by definition: both methods count from the first stop" if first else
                    f"difference of the printed angles. {ASSUMED}. joint: what growth with the turn alone gives",
                E_n=None if first else float(difference[i] / (2.0 * u[i])),
                joint_alternatives={"weighed by variance components": 0.0 if first else
                                    float(-growth_scatter * turn / degree)})


# --- columns of both tables --------------------------------------------------------------------------------------


def column_items(name: str, table: Table, joint: Methods) -> Iterator[Item]:
    """Root mean square, growth and closure of each column of a table, of the angle read less the angle commanded."""
    command = table.number("nominal", "angle")
    for column in COLUMNS[name]:
        errors = table.number(column, "angle") - (0.0 if "-" in column else command)
        slope, u_slope, scatter = growth_of(command, errors)
        stated, what = None, f"{column} less the commanded angle" if "-" not in column else f"difference {column}"
        missing = "radius and distance of the tracker are not printed for this table, so no u is stated"
        if name == "T1":
            weights = (command - command.mean()) / np.sum((command - command.mean()) ** 2)
            stated = {"slope": np.sqrt(sum(weights @ joint.stated[m] @ weights for m in column.split("-"))),
                      "closure": joint.u(column)[-1]}
            missing = ASSUMED
        nothing = "nothing is printed to compare with; "
        yield Item(f"{name}_{column}_rms", f"root mean square of {what}, all {len(command)} stops", "deg", None,
                   value=np.sqrt(np.mean(errors**2)) / degree, why=f"{nothing}computed from the printed column")
        yield Item(f"{name}_{column}_slope_ppm", f"slope of {what}, with a free zero", "ppm", None, value=slope / ppm,
                   u=stated["slope"] / ppm if stated else None, u_vc=u_slope / ppm,
                   why=f"{nothing}least squares of the printed column; u_vc from its scatter about the line. {missing}",
                   slope_through_start=float(errors @ command / (command @ command) / ppm),
                   scatter_arcsec=scatter / arcsec)
        yield Item(f"{name}_{column}_closure", f"{what} after a full turn", "deg", None,
                   value=(errors[-1] - errors[0]) / degree,
                   u=stated["closure"] / degree if stated else None, u_vc=np.sqrt(2.0) * scatter / degree,
                   why=f"{nothing}a table that came back to its mark would close to zero; these data do not tell a "
                       f"table that turned too far from a slip or a drift. {missing}")


# --- settings of the paper ---------------------------------------------------------------------------------------


def setting_items(tables: dict[str, Table], joint: Methods) -> Iterator[Item]:
    """What published_values.csv holds: statements about instruments, and what the tables say about the settings."""
    scatter = ", ".join(f"{name}: {joint.factor[name]:.2f} +- {joint.u_factor[name]:.2f}" for name in RADIUS)
    unprinted = {
        "tracker_U_const": "a statement of the maker; no coordinate is printed. The scatter of table 1 about a common "
                           f"table error and a growth is this fraction of the stated u: {scatter}",
        "tracker_U_prop": "a statement of the maker; it needs readings at several distances, and no distance is "
                          "printed",
        "tracker_k": "the convention of the statement, nothing to compute",
        "cmm_U": "a statement about an instrument that was not used",
        "sim_radius": "a setting of the simulation; noise and number of points are not printed",
        "fig9_radius_1": "a setting of figure 9, which is a picture without numbers",
        "fig9_radius_2": "a setting of figure 9, which is a picture without numbers",
        "fig9_radius_3": "a setting of figure 9, which is a picture without numbers",
        "repeats": "a setting; the repeated readings are not printed"}
    steps = {name: float(np.mean(np.diff(table.number("nominal", "angle")))) / degree for name, table in tables.items()}
    texts = shipped("turntable/published_values.csv").text("value")
    for text, (key, printed) in zip(texts, Printed.read("turntable/published_values.csv").items()):
        value, why = None, unprinted.get(key, "")
        more: dict[str, Any] = {}
        if key.startswith("step_"):
            value = steps["T1" if key == "step_table1" else "T2"]
            why = "the text says 30 deg, table 2 lists every 60 deg" if key.endswith("text") else ""
        if key == "n_equations":
            n = len(joint.command)
            begin = circle.example_points(0)[0]
            value = float(sum(o.n for o in pairwise.pairwise(begin[:n]).observations))
            printed = Printed(str(text), n * (n - 1) / 2 + n, 0.5, "1", printed.quantity)
            more = {"evaluated_for_N": n, "independent_equations": 2 * n - 1, "printed_text": str(text)}
            why = (f"printed as a formula, evaluated for the N = {n} of table 1. As a count of rows it holds; only N - "
                   f"1 of the differences and N distances are independent, {2 * n - 1} equations, and they fix 5 of "
                   "the 7 unknowns")
        yield Item(key, printed.quantity or key, printed.unit, printed, value=value, why=why, **more)


def reproduce() -> Reproduction:
    """Every printed number of the paper beside what its own tables give, with studies and figures."""
    tables = {name: shipped(file) for name, file in FILES.items()}
    joint = compare_methods(tables["T1"])
    items = [*setting_items(tables, joint), *difference_items(tables["T1"], joint),
             *(item for name, table in tables.items() for item in column_items(name, table, joint))]
    return Reproduction("turntable", tuple(items), findings.studies(tables, joint),
                        findings.figures(tables["T1"]))
