"""Epochs beside each other, for people: sentences, epochs.json, shifts.csv and a page with the shifts as arrows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calib import files
from calib.analyse.congruence import POWER, Congruence
from calib.analyse.ellipse import PLANE_95, ellipse
from calib.report import numbers, plots
from calib.report.provenance import Provenance
from calib.report.template import Cell, Drawing, Grid, render
from calib.solve.estimate import Estimate
from calib.units import gon, mm
from calib.workflow.epochs import EpochComparison

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = ("first", "second", "point", "dx_mm", "dy_mm", "dz_mm", "u_dx_mm", "u_dy_mm", "u_dz_mm", "ellipse95_a_mm",
           "ellipse95_b_mm", "ellipse_bearing_gon", "p_value", "p_value_of_all", "detectable_mm", "moved")
LONGEST = 0.18             # of the width of the picture: the longest arrow
FAR = 20.0                 # times the median size of a shift or ellipse, beyond which an arrow is cut
HEAD = 0.012               # of the width of the picture: the shortest arrow with a head
LISTED = 30                # points in a sentence
DOUBTFUL = 0.001           # probability of an epoch's scatter below which a comparison is warned of


def sentences(one: EpochComparison) -> list[str]:
    """What came of a comparison, with what limits it."""
    said = one.found.sentences()
    for name, estimate in zip(one.names, one.estimates):
        if not (estimate.certificate.passed and estimate.converged):
            said.append(f"{name} is NOT CERTIFIED: {estimate.certificate.why}. The comparison is no result.")
        elif estimate.p_value is not None and estimate.p_value < DOUBTFUL and one.scatter == 1.0:
            said.append(f"The readings of {name} scatter more than stated (v'Pv = {numbers.plain(estimate.objective)} "
                        f"for {estimate.dof}, p = {numbers.probability(estimate.p_value)}): mend that first, or "
                        "compare with --a-posteriori.")
    if one.fixed:
        said.append(f"Taken as still and not tested: {_listed(one.fixed)} (fixed in both; --release tests them).")
    if one.alone:
        said.append(f"In one epoch only: {_listed(one.alone)}.")
    return said


def _listed(keys: Sequence[str]) -> str:
    return ", ".join(keys[:LISTED]) + (f" and {len(keys) - LISTED} more" if len(keys) > LISTED else "")


def content(comparisons: Sequence[EpochComparison], level: float, provenance: Provenance) -> dict[str, Any]:
    """The content of epochs.json.

    comparisons; level: of all of them together; provenance: of the run.
    """
    return {"format": 1, "level": level, "power": POWER,
            "comparisons": [_entry(one) for one in comparisons], "provenance": provenance.content()}


def _entry(one: EpochComparison) -> dict[str, Any]:
    found = one.found
    return {
        "first": one.names[0], "second": one.names[1], "level": found.level, "variance_factor": one.scatter,
        "epochs": [_epoch(name, estimate) for name, estimate in zip(one.names, one.estimates)],
        "global_test": files.plain(found.steps[0]), "steps": [files.plain(step) for step in found.steps],
        "settled": found.settled, "block": found.block, "stable": list(found.stable), "moved": list(found.moved),
        "fixed": list(one.fixed), "in_one_epoch": list(one.alone),
        "points": [dict(zip(COLUMNS[2:], line[2:])) | {"covariance_mm2": (matrix / mm**2).tolist()}
                   for line, matrix in zip(lines([one]), found.covariance)],
        "sentences": sentences(one),
    }


def _epoch(name: str, estimate: Estimate) -> dict[str, Any]:
    return {"name": name, "vtpv": estimate.objective, "dof": estimate.dof, "p_value": estimate.p_value,
            "certificate": files.plain(estimate.certificate), "converged": estimate.converged}


def lines(comparisons: Sequence[EpochComparison]) -> Iterator[list[Any]]:
    """The lines of shifts.csv, one a point and comparison; None where a point has no such coordinate."""
    for one in comparisons:
        found = one.found
        for i, key in enumerate(found.points):
            values = {part: (found.shift[i, j] / mm, found.u[i, j] / mm) for j, part in enumerate(found.parts)}
            shift, u = ([_number(values[p][k]) if p in values else None for p in "xyz"] for k in (0, 1))
            yield [*one.names, key, *shift, *u, *_ellipse(found, i), found.p_value[i], found.adjusted[i],
                   _number(found.detectable[i] / mm), int(key in found.moved)]


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _ellipse(found: Congruence, i: int) -> list[float | None]:
    """Semi-axes [mm] of the ellipse of 95 % of a shift in plan, and the bearing of the longer one from x to y [gon]."""
    if not {"x", "y"} <= set(found.parts) or not np.isfinite(found.shift[i, :2]).all():
        return [None, None, None]
    own = ellipse(found.covariance[i][:2, :2])
    return [PLANE_95 * own.major / mm, PLANE_95 * own.minor / mm, own.bearing / gon]


# --- the page ---------------------------------------------------------------------------------------------------------


def write(comparisons: Sequence[EpochComparison], level: float, provenance: Provenance, path: str | Path) -> Path:
    """Write report.html, whole or not at all.

    comparisons; level: of all of them together; provenance: of the run; path: of the file.
    return: the path.
    raises InputError where it cannot be written.
    """
    return files.write_text(path, html(comparisons, level, provenance))


def html(comparisons: Sequence[EpochComparison], level: float, provenance: Provenance) -> str:
    """The page as text; arguments as for `write`."""
    certified = all(e.certificate.passed and e.converged for one in comparisons for e in one.estimates)
    return render(
        "epochs.html.j2", title="Which points moved",
        subtitle=f"{len(comparisons)} comparison{'s' if len(comparisons) > 1 else ''} of epochs, level {level:g}",
        passed=certified, level=numbers.plain(level), share=numbers.plain(comparisons[0].found.level),
        power=numbers.plain(100 * POWER), provenance=provenance.lines(),
        comparisons=[{
            "title": f"{one.names[0]} to {one.names[1]}", "sentences": sentences(one), "points": _points(one),
            "steps": _steps(one.found), "epochs": _epochs(one), "drawings": list(_drawings(one, number)),
            "scatter": "" if one.scatter == 1.0 else numbers.plain(one.scatter),
        } for number, one in enumerate(comparisons)],
    )


def _points(one: EpochComparison) -> Grid:
    found, rows = one.found, []
    for i, key in enumerate(found.points):
        row: list[str | Cell] = [key]
        for j in range(len(found.parts)):
            shift, u = found.shift[i, j] / mm, found.u[i, j] / mm
            row += list(numbers.with_uncertainty(shift, u)) if np.isfinite(shift) else ["", ""]
        row += [numbers.probability(float(found.p_value[i])), numbers.probability(float(found.adjusted[i])),
                numbers.plain(found.detectable[i] / mm, 2)]
        row.append(Cell("moved", "warning") if key in found.moved else Cell("still", "good"))
        rows.append(row)
    header = ["point", *(name for part in found.parts for name in (f"d{part} / mm", "u")), "p", "p among all",
              "detectable / mm", ""]
    return Grid(header, rows)


def _steps(found: Congruence) -> Grid:
    rows, before = [], set(found.points)
    for step in found.steps:
        now = set(step.stable)
        changed = [f"without {key}" for key in found.points if key in before - now]
        changed += [f"with {key} again" for key in found.points if key in now - before]
        rows.append([", ".join(changed) or "all points", str(len(step.stable)), numbers.plain(step.quantity),
                     str(step.dof), numbers.probability(step.p_value)])
        before = now
    return Grid(["one figure?", "points", "test quantity", "degrees of freedom", "p"], rows)


def _epochs(one: EpochComparison) -> Grid:
    rows = [[name, numbers.plain(e.objective), str(e.dof), numbers.probability(e.p_value),
             "certified" if e.certificate.passed and e.converged else "NOT certified"]
            for name, e in zip(one.names, one.estimates)]
    return Grid(["epoch", "v′Pv", "degrees of freedom", "p", ""], rows)


def _drawings(one: EpochComparison, number: int) -> Iterator[Drawing]:
    found = one.found
    if {"x", "y"} <= set(found.parts) and np.isfinite(found.shift[:, :2]).all(axis=1).any():
        figure, times, cut = _plan(one)
        yield Drawing.of(figure, f"plan {number}", f"Shifts in plan, {numbers.plain(times, 3)} times enlarged, with "
                         "their ellipses of 95 %; points that moved in the colour of warnings. "
                         + ("Dotted arrows are cut: these points moved much further. " if cut else "")
                         + ("x up, y to the right." if one.mirrored else "x to the right, y up."))
    if "z" in found.parts:
        yield Drawing.of(_heights(found), f"heights {number}", "Shifts in height with U (k = 2).")


def _plan(one: EpochComparison) -> tuple[Figure, float, bool]:
    """Points, shifts and ellipses in plan, how many times the shifts are enlarged, and whether any is cut."""
    from matplotlib.patches import Ellipse

    found = one.found
    order = [1, 0] if one.mirrored else [0, 1]
    there = np.flatnonzero(np.isfinite(one.places[:, :2]).all(axis=1) & np.isfinite(found.shift[:, :2]).all(axis=1))
    places, shift = one.places[there][:, order], found.shift[there][:, order]
    extent = float(np.ptp(places, axis=0).max(initial=0.0)) or 1.0
    ellipses = [ellipse(found.covariance[i][np.ix_(order, order)]) for i in there]
    lengths = np.hypot(*shift.T)
    sizes = np.maximum(lengths, [PLANE_95 * own.major for own in ellipses])
    # What was set up anew may have moved by metres: its arrow is cut, so that the others can be seen.
    longest = float(sizes[sizes <= FAR * np.median(sizes)].max(initial=0.0))
    times = _round(LONGEST * extent / longest) if longest > 0 else 1.0
    cut = np.minimum(1.0, longest / np.maximum(lengths, longest)) if longest > 0 else np.ones(len(there))
    figure, axes = plots.canvas(min(9.0, max(3.0, 6.4 * float(np.ptp(places[:, 1])) / extent + 1.4)))
    for place, step, own, i, part in zip(places, shift, ellipses, there, cut):
        moved = found.points[i] in found.moved
        colour = plots.WARNING if moved else plots.SERIES[0]
        end = place + times * part * step
        axes.plot(*place, marker="o", color=plots.INK, markersize=3)
        axes.annotate("", xy=tuple(end), xytext=tuple(place),
                      arrowprops={"arrowstyle": "-|>" if times * part * np.hypot(*step) > HEAD * extent else "-",
                                  "color": colour, "linewidth": 1.6 if moved else 1.0,
                                  "linestyle": "-" if part == 1.0 else ":", "shrinkA": 0, "shrinkB": 0})
        if part == 1.0:
            width, height = (2.0 * times * PLANE_95 * semi for semi in (own.major, own.minor))
            axes.add_patch(Ellipse(tuple(end), width, height, angle=float(np.degrees(own.bearing)), fill=False,
                                   edgecolor=colour, linewidth=0.9))
        axes.annotate(plots.worded(found.points[i]), xy=tuple(place), xytext=(5, 5), textcoords="offset points",
                      fontsize=8, color=plots.INK)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.12)
    axes.set_xlabel("y / m" if one.mirrored else "x / m")
    axes.set_ylabel("x / m" if one.mirrored else "y / m")
    return figure, times, bool((cut < 1.0).any())


def _round(value: float) -> float:
    """The next smaller of 1, 2, 5, 10, 20 ..."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1, 2, 5) if step <= value / power * (1 + 1e-12)))


def _heights(found: Congruence) -> Figure:
    column = found.parts.index("z")
    there = np.flatnonzero(np.isfinite(found.shift[:, column]))
    figure, axes = plots.canvas(2.6, fitted=True)
    for moved, colour in ((False, plots.SERIES[0]), (True, plots.WARNING)):
        chosen = [k for k, i in enumerate(there) if (found.points[i] in found.moved) == moved]
        own = there[chosen]
        axes.errorbar(chosen, found.shift[own, column] / mm, 2.0 * found.u[own, column] / mm, fmt="o", color=colour,
                      markersize=4, linewidth=1.0)
    axes.axhline(0.0, color=plots.FAINT, linewidth=0.8)
    shown = range(len(there)) if len(there) <= plots.TOLD_APART else ()
    axes.set_xticks(list(shown), [plots.worded(found.points[there[k]]) for k in shown], rotation=35, ha="right")
    axes.set_ylabel("dz / mm")
    return figure
