"""The published numbers of the three-axis locators beside what the declared model gives: tables 3 and 6, section 4.

Source: Li Chen, Fang Qiang, Li Jiangxiong 2010. No guide length, stroke, mounting edge or tolerance of a ball centre is
printed, so the sigmas of table 6 cannot be recomputed; what can be said of them without lengths is said.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib import solve
from calib.geometry import Transform
from calib.units import arcsec, factor, mm
from calib.workflow.reproduce import DIFFERS, Item, Printed, Reproduction, verdict
from problems.locators import figures, paper, sensitivity, spread
from problems.locators.errors import AXES
from problems.locators.measured import Setup
from problems.locators.pose_error import COMPONENT_UNITS, COMPONENTS, LinearForm, choice, conditioning, linear_form
from problems.locators.trials import Trials, draw, normality

SEED = 20100306
COVERAGE_95 = 1.959963984540054
LONG = 100.0               # lever arm [mm] with which an angle counts
WELL = 100.0               # condition number below which six axes determine the pose
SEARCHED = {name: (0.1, 3.0) if name.startswith("guide") else (0.02, 1.0) for name in spread.LENGTHS}     # [m]
NOT_PRINTED = ("the guide lengths, strokes and mounting edges that the tolerances of table 4 refer to and the "
               "tolerance "
               "of the ball centres are not printed")


def reproduce() -> Reproduction:
    """Every printed number of the paper with its verdict. Takes no arguments; a few seconds at most."""
    mechanism, poses = paper.setup(), paper.part_poses()
    form = linear_form(mechanism, poses["target"], paper.DRIVEN)
    assumed = spread_study(mechanism, poses["target"], form)
    items = [*table_3(mechanism, poses), *table_6(assumed), *section_4(mechanism, poses, form)]
    found = sensitivity.sensitivities(form, paper.strokes(mechanism, poses["target"]))
    studies = {"table_6": assumed.study, "driving_choices": driving_choices(mechanism, poses, assumed.half_widths),
               "sensitivities_with_strokes_of_table_3": sensitivity.table(found)}
    return Reproduction("locators", tuple(items), studies=studies, figures=figures.of(assumed.trials, found))


@dataclass(frozen=True)
class Assumed:
    """Table 6 under the first of the named assumptions: sigmas and means (6,) [mm, deg], half widths, trials, study."""

    name: str
    sigmas: NDArray[np.float64]
    means: NDArray[np.float64]
    half_widths: NDArray[np.float64]
    trials: Trials
    study: dict[str, Any]


def spread_study(mechanism: Setup, target: Transform, form: LinearForm) -> Assumed:
    """Which lengths give the six printed sigmas, and the paper's Monte Carlo with one such set."""
    tolerances = paper.tolerances()
    fitted = {a: solve(spread.declare(form, tolerances, a)) for a in spread.ASSUMPTIONS}
    rows = [{"assumption": a.name, "v'Pv": e.objective, "dof": e.dof, "p_value": e.p_value,
             "all six within 95%": bool(np.all(np.abs(e.residuals["table 6"][:, 0] / relative_u()) < COVERAGE_95)),
             **{f"{q.name} [{q.unit}]": np.atleast_1d(e[q] / factor(str(q.unit))) for q in e.problem.quantities},
             "sigmas [mm, deg]": spread.component_sigmas(form, tolerances, a, e)} for a, e in fitted.items()]
    ranges = {}
    for full, roll in ((False, False), (False, True), (True, False), (True, True)):
        free = replace(spread.ALL_LENGTHS, full_width=full, roll_by_parallelism=roll)
        words = f"indices as {'full' if full else 'half'} widths, roll from {'parallelism' if roll else 'straightness'}"
        found = spread.length_ranges(form, tolerances, free, SEARCHED)
        ranges[words] = None if found is None else {k: [v[0] / mm, v[1] / mm] for k, v in found.items()}
    assumption, estimate = next(iter(fitted.items()))
    widths = spread.half_widths(form, tolerances, assumption, estimate)
    trials = draw(mechanism, target, paper.DRIVEN, form, widths, spread.SAMPLES, SEED)
    shapes = {c: normality(trials.exact[:, i]) for i, c in enumerate(COMPONENTS)}
    study = {
        "without lengths": spread.control_point_sigmas(form), "assumptions": rows,
        "ranges [mm] of each length by itself, ball tolerance too": ranges,
        "searched [mm]": {k: [v[0] / mm, v[1] / mm] for k, v in SEARCHED.items()},
        "seed": SEED, "samples": spread.SAMPLES,
        "nearly normal, under the first assumption": shapes, "sigmas of the exact model [mm, deg]": trials.sigmas,
        "largest departure of the linear form [mm, deg]": np.abs(trials.exact - trials.linear).max(0)}
    return Assumed(assumption.name, spread.component_sigmas(form, tolerances, assumption, estimate), trials.means,
                   widths, trials, study)


def relative_u() -> NDArray[np.float64]:
    """Standard uncertainties (6,) of the printed variances, relative."""
    sigma, u = spread.printed_sigmas()
    return 2.0 * u / sigma


def table_3(mechanism: Setup, poses: dict[str, Transform]) -> list[Item]:
    """The nine strokes of table 3 from tables 2 and 5 (eq 1-2)."""
    travel = (paper.strokes(mechanism, poses["target"]) - paper.strokes(mechanism, poses["initial"])) / mm
    items = []
    for key, printed in Printed.read("locators/table3_strokes.csv", value="stroke_mm", unit=None).items():
        _, axis, locator = key.split("_")
        value = float(travel[paper.LOCATORS.index(locator), AXES.index(axis)])
        why = ""
        if verdict(value, printed) == DIFFERS:
            why = (f"printed one last digit low: tables 2 and 5 give {value:.5f}, which rounds to {value:.3f}; it is "
                   "printed as if cut off, but y_A and z_B are not; no rounding of the rotation matrix or of the "
                   "angles "
                   "explains all nine strokes (r_i changed by some 0.01 mm would)")
        items.append(Item(key, f"stroke of axis {axis} of locator {locator}", "mm", printed, value=value, why=why))
    return items


def table_6(assumed: Assumed) -> list[Item]:
    """Mean, sigma and 3 sigma of the six components of the pose error."""
    printed = Printed.read("locators/table6_pose_error.csv")
    items = []
    for i, (component, unit) in enumerate(zip(COMPONENTS, COMPONENT_UNITS, strict=True)):
        sigma = float(printed[f"T6_{component}_sigma"].text)
        items.append(Item(
            f"T6_{component}_mean", f"mean of {component} over {spread.SAMPLES} samples", unit,
            printed[f"T6_{component}_mean"], value=assumed.means[i],
            sampling=COVERAGE_95 * sigma / np.sqrt(spread.SAMPLES),
            why="errors uniform about zero leave no mean in a linear model, whatever the lengths; the value is what "
                "the "
                f"exact model adds under the assumption '{assumed.name}', compared within the sampling interval of the "
                "printed sigma"))
        for statistic, times in (("sigma", 1.0), ("three_sigma", 3.0)):
            under = times * assumed.sigmas[i]
            why = (f"{NOT_PRINTED}. Under the assumption '{assumed.name}', fitted to the six sigmas, it is "
                   f"{under:.3g} {unit}")
            if times == 3.0:
                why += "; the printed number is three times the printed sigma"
            items.append(Item(
                f"T6_{component}_{statistic}", f"{statistic.replace('_', ' ')} of {component}", unit,
                printed[f"T6_{component}_{statistic}"], rounded=times * sigma if times == 3.0 else None, why=why,
                assumption=assumed.name, value_under_assumption=under))
    return items


def section_4(mechanism: Setup, poses: dict[str, Transform], form: LinearForm) -> list[Item]:
    """The numbering of the sources and the conclusions of section 4, each as a number that the model gives."""
    strokes = paper.strokes(mechanism, poses["target"])
    found = sensitivity.sensitivities(form, strokes)
    at_start = sensitivity.sensitivities(linear_form(mechanism, poses["initial"], paper.DRIVEN), strokes)
    groups = Printed.read("locators/section4_error_groups.csv", key="group", value="count", unit=None)
    reason = ("the errors that move the part at all under the six driven axes in the target pose; the rest of all 81 "
              f"has no lever arm there (in the initial pose {len(at_start)} would count)")
    items = [Item("S4_sources", "number of error sources", "1", Printed.of("48"), value=len(found), why=reason)]
    for (words, printed), (group, count) in zip(groups.items(), sensitivity.counts(found).items(), strict=True):
        items.append(Item(f"S4_sources_{group}", words, "1", printed, value=count, why=reason))
    longer = {length: sensitivity.angular_above_linear(sensitivity.sensitivities(form, np.full((3, 3), length)))
              for length in (0.1, 0.25, 0.6, 1.0)}
    levers = sensitivity.angle_levers(form) / mm
    in_arcseconds = sensitivity.attitude_below_position(found, arcsec)
    by_length = ", ".join(f"{length * 1e3:.0f} mm it is {number}" for length, number in longer.items())
    moved = ", ".join(name for name, lever in zip(COMPONENTS, levers, strict=True) if lever > LONG)
    short = max(lever for lever in levers if lever <= LONG)
    items += [
        Item("S4_attitude_below_position", "sources with attitude sensitivity [deg] below position sensitivity [mm]",
             "1", Printed("far below, for every source", 48.0, 0.5),
             value=sensitivity.attitude_below_position(found), printed_text="far below, for every source",
             why="true for degrees beside millimetres, and a matter of these units only: the same angles in "
                 f"arcseconds are below for {in_arcseconds} of 48"),
        Item("S4_angular_larger", "angular sources (34-48) that move the part more than every error of length does",
             "1", Printed("usually larger", None, 0.0, interval=(8.0, 15.0)),
             value=sensitivity.angular_above_linear(found),
             why="true by the definition 1/stroke with the small strokes of table 3 (some 10 mm against lever arms of "
                 f"250 to 815 mm); divided by a length of {by_length} of 15"),
        Item("S4_control_angles", "components of the pose that angles can move (lever arm over 100 mm)", "1",
             Printed("strict control of parallelism and squareness is needed", 6.0, 0.5),
             value=int(np.sum(levers > LONG)), printed_text="strict control of parallelism and squareness is needed",
             why=f"angles act on {moved}; the lever arms on the other components are at most {short:.1f} mm, the "
                 "strokes of table 3, so only positioning, straightness and the balls matter there")]
    return items


def driving_choices(mechanism: Setup, poses: dict[str, Transform], half_widths: NDArray[np.float64]) -> dict[str, Any]:
    """The 84 choices of six driven axes: which determine the pose, and the spread that the same errors then give."""
    study: dict[str, Any] = {}
    for name in ("initial", "target"):
        numbers = conditioning(mechanism, poses[name])
        regular = [six for six, number in numbers.items() if number < WELL]
        study[f"regular in the {name} pose (condition below {WELL:g})"] = len(regular)
    rows = []
    for six in regular:
        form = linear_form(mechanism, poses["target"], choice(six))
        rows.append({"driven": " ".join(f"{'XYZ'[n % 3]}_{'ABC'[n // 3]}" for n in six), "condition": numbers[six],
                     "sigmas [mm, deg]": np.sqrt(((form.response * half_widths) ** 2).sum(1) / 3.0)})
    everything = linear_form(mechanism, poses["target"])
    rows.append({"driven": "all nine by least squares", "condition": None,
                 "sigmas [mm, deg]": np.sqrt(((everything.response * half_widths) ** 2).sum(1) / 3.0)})
    return {**study, "choices": rows}
