"""What the tables of the turntable paper say beyond their numbers: agreement of the methods, causes, contradictions.

Source: Li, Cao, Qu 2020, Metrology and Measurement Technology 40(2), 14-19, sections 2.2 and 3.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from calib.table import Table
from calib.units import arcsec, degree, hour, minute, mm, ppm, um
from problems import positioning
from problems.turntable.tables import RADIUS, U_POLYGON, Methods, growth_of, harmonics_of, tracker_angles

SINGLE = ("angle_scale (theta)", "drift (reading)", "slip (reading)")


def studies(tables: dict[str, Table], joint: Methods) -> dict[str, Any]:
    """All findings, by name, as JSON knows them.

    tables: {"T1": table 1, "T2": table 2}; joint: table 1 as one problem.
    """
    return {"agreement": agreement(tables["T1"], joint), "harmonics": harmonics(tables),
            "growth and radius": growth_and_radius(tables["T1"], joint), "told apart": told_apart(tables["T1"]),
            "contradictions": contradictions(tables, joint)}


def agreement(table: Table, joint: Methods) -> dict[str, Any]:
    """Largest |E_n| of tracker against polygon for plausible distances, and the scatter in units of the stated u.

    E_n = (A1 - B)/sqrt(U_A1^2 + U_B^2) with U = 2 u, which must not exceed 1. Source: ISO/IEC 17043:2010, B.3.1.3.
    """
    polygon, command, rows = table.number("A1", "angle"), joint.command, []
    for distance in (1.5, 3.0, 6.0):
        for name, radius in RADIUS.items():
            u = np.sqrt(np.diag(tracker_angles(command, radius, distance)) + 2.0 * U_POLYGON**2)[1:]
            e_n = np.abs((polygon - table.number(name, "angle"))[1:]) / (2.0 * u)
            rows.append({"method": name, "distance_m": distance, "radius_mm": radius / mm,
                         "largest_E_n": float(e_n.max()),
                         "at_deg": float(np.round(command[np.argmax(e_n) + 1] / degree))})
    times = {name: 1.0 / joint.factor[name] for name in RADIUS}
    return {"rows": rows, "scatter_in_stated_u": {name: [f, joint.u_factor[name]] for name, f in joint.factor.items()},
            "said": "Under the stated U of the tracker, |E_n| of the rod is below 1 at every distance, that of the "
                    f"edge only from about 3 m on. The scatter of B1 and B2 is {times['B1']:.0f} and {times['B2']:.0f} "
                    "times smaller than that U allows: a small E_n does not show that the growth of B1 is harmless."}


def harmonics(tables: dict[str, Table]) -> dict[str, Any]:
    """Harmonics of every column and of both differences beside zero and growth: three in table 1, one in table 2."""
    found = {}
    for name, columns, orders in (("T1", ("A1", "B1", "B2", "A1-B1", "A1-B2"), (1, 2, 3)),
                                  ("T2", ("horizontal", "pitch", "spin"), (1,))):
        command = tables[name].number("nominal", "angle")
        for column in columns:
            read = tables[name].number(column, "angle")
            found[f"{name}_{column}"] = harmonics_of(command, read if "-" in column else read - command, orders)
    looks = [(wave.p_value, column, wave) for column, waves in found.items() for wave in waves]
    least, column, wave = min(looks, key=lambda look: look[0])
    stands = "stands out" if len(looks) * least < 0.05 else "does not stand out, and so none does"
    listed = {name: [{"order": w.order, "amplitude_arcsec": w.amplitude / arcsec, "u_arcsec": w.u / arcsec,
                      "phase_deg": w.phase / degree, "p_value": w.p_value} for w in waves]
              for name, waves in found.items()}
    return {**listed, "said": f"The smallest of {len(looks)} p-values is {least:.3f} (order {wave.order} of {column}, "
                              f"{wave.amplitude / arcsec:.1f} +- {wave.u / arcsec:.1f} arcsec); corrected for these "
                              f"looks it {stands}."}


def growth_and_radius(table: Table, joint: Methods) -> dict[str, Any]:
    """Growth of each method against the polygon and against the command, and what a cause at the radius demands."""
    command = joint.command
    against_polygon = {name: joint.growth(name, joint.by_scatter) for name in RADIUS}
    polygon, edge, rod = (table.number(name, "angle") for name in ("A1", *RADIUS))
    against_command = {name: growth_of(command, read - command)[:2]
                       for name, read in (("A1", polygon), ("B1", edge), ("B2", rod))}
    ratio = RADIUS["B2"] / RADIUS["B1"]
    left = {name: growth_of(command, ratio * (rod - base) - (edge - base))[:2]
            for name, base in (("polygon", polygon), ("command", command))}
    said = {name: f"{value / ppm:.0f} +- {u / ppm:.0f} ppm" for name, (value, u) in left.items()}
    creep = against_command["B2"][0] * RADIUS["B2"]
    return {
        "growth_against_polygon_ppm": {k: [v / ppm, u / ppm] for k, (v, u) in against_polygon.items()},
        "growth_against_command_ppm": {k: [v / ppm, u / ppm] for k, (v, u) in against_command.items()},
        "radius_ratio_assumed": ratio,
        "left_of_the_radius_law_ppm": {k: [v / ppm, u / ppm] for k, (v, u) in left.items()},
        "said": "Noise of the tracker does not grow with the turn, so a larger radius alone explains neither "
                "difference. Against the polygon B1 grows and B2 does not: a displacement common to edge and rod would "
                f"leave {ratio:g} growth(B2) - growth(B1) = 0, and {said['polygon']} is left. Read without the "
                f"polygon, both reflectors obey that law of the radius ({said['command']} left), as if each crept by "
                f"{creep * degree / um:.2f} um per degree. Table 1 cannot decide; a second turn, or the way back, "
                "would."}


def told_apart(table: Table) -> dict[str, Any]:
    """Scale of the table, drift in time and slip of the reflector, in table 1 as it is and with the way back."""
    once = table.number("nominal", "angle")
    both = np.concatenate([once, once[::-1]])
    answers = {}
    even = np.arange(len(both)) * minute
    for name, command, time in (("table 1, one way", once, even[:len(once)]), ("and back", both, even),
                                ("and back after an hour", both, even + (np.arange(len(both)) >= len(once)) * hour)):
        problem = positioning.declare(command, command, 1.0 * arcsec, {"time": (time, "min")})
        found, directions = positioning.told_apart(problem, *SINGLE)
        answers[name] = {"separability": {c.effect.label: c.separability for c in found},
                         "cannot_be_known": list(directions)}
    return {**answers, "said": "One turn at an even pace cannot tell scale, drift and slip apart: all three are "
                               "straight lines over the angle. The way back tells scale from the other two; a pause "
                               "tells drift from slip."}


def contradictions(tables: dict[str, Table], joint: Methods) -> list[dict[str, str]]:
    """Statements of the text that its tables contradict, each with the numbers."""
    one, two = tables["T1"], tables["T2"]
    closing = {name: (one.number(name, "angle")[-1] - 2.0 * np.pi) / arcsec for name in ("A1", "B1", "B2")}
    closing_two = {name: (two.number(name, "angle")[-1] - 2.0 * np.pi) / arcsec for name in two.names[2:]}
    ends = ", ".join(f"{name} {value:.0f}" for name, value in {**closing, **closing_two}.items())
    scatter = {name: joint.u(name, scatter=True)[1:].mean() / np.sqrt(2.0) for name in RADIUS}
    length = {name: scatter[name] * RADIUS[name] / um for name in RADIUS}
    moved = {name: closing[name] * arcsec * RADIUS[name] / um for name in RADIUS}
    apart = np.abs(one.number("A1-B2", "angle")).max() / arcsec
    u_rod = joint.u("B2", scatter=True)[1:].mean() / arcsec
    return [
        {"text": "section 3.2: every 30 degrees", "table": "table 2 lists every 60 degrees"},
        {"text": "section 3.1: the table is turned until the next face is collimated",
         "table": f"then stop 13 shows face 1 again and A1 must end at 360; it ends {closing['A1']:.0f} arcsec beyond. "
                  "Either A1 is what the autocollimator read at commanded stops, or the polygon or its reference "
                  "moved"},
        {"text": "tables 1 and 2: angles after a full turn",
         "table": f"no column closes: {ends} arcsec. A circle fitted to points cannot make a closing error: the "
                  f"reflector stood elsewhere, on radii of {RADIUS['B1'] / mm:g} and {RADIUS['B2'] / mm:g} mm by "
                  f"{moved['B1']:.0f} and {moved['B2']:.0f} um"},
        {"text": "section 2.2: with the same error of measurement, a larger radius gives a smaller error of angle",
         "table": "about the common table error an angle scatters by "
                  f"{scatter['B1'] / arcsec:.1f} arcsec on the edge and {scatter['B2'] / arcsec:.1f} on the rod, a "
                  f"factor {scatter['B1'] / scatter['B2']:.1f} where the radii promise "
                  f"{RADIUS['B2'] / RADIUS['B1']:g}; as lengths {length['B1']:.1f} and {length['B2']:.1f} um"},
        {"text": "section 3.1 and conclusion: on the rod the accuracy is close to that of polygon and autocollimator",
         "table": f"B2 agrees with A1 to {apart:.0f} arcsec, and an angle of B2 from the first stop has u = "
                  f"{u_rod:.1f} arcsec by its scatter; polygons are certified to some tenths of an arcsecond"},
        {"text": "table 1: the columns A1-B1 and A1-B2 are called error of indication",
         "table": "an error of indication is indication less reference (JCGM 200:2012, 4.20 and 2.16): the printed "
                  "columns have the opposite sign"}]


def figures(table: Table) -> dict[str, Callable[[], Any]]:
    """Plots by title: differences against the turn, and what is left of them beside growth."""
    command = table.number("nominal", "angle")

    def differences() -> Any:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7.0, 6.0), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True)
        for column, mark in (("A1-B1", "o"), ("A1-B2", "s")):
            errors = table.number(column, "angle")
            slope = growth_of(command, errors)[0]
            line = slope * (command - command.mean()) + errors.mean()
            above.plot(command / degree, errors / arcsec, mark, label=column)
            above.plot(command / degree, line / arcsec, "-", linewidth=0.8, color="grey")
            below.plot(command / degree, (errors - line) / arcsec, mark + "-", linewidth=0.8)
        above.set_ylabel("polygon less tracker [arcsec]")
        below.set_ylabel("beside growth [arcsec]")
        below.set_xlabel("commanded angle [deg]")
        above.legend()
        return figure
    return {"Table 1: polygon less tracker": differences}
