"""The published comparison: every printed number, recomputed the paper's way and from all readings jointly."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from calib import budget, montecarlo
from calib.units import arcsec, um
from calib.workflow.reproduce import Item, Printed, Reproduction

from . import adjustment, figures, paper_uncertainty, reasons, step_by_step, tracker_simulation
from .readings import published
from .results import ITEMS, JOINT, STEP, TO_THE_PLUMB_LINE, USUAL, Fit, Fits, Place, fits
from .rounded import along_printed

NAME = "five-axis"
# Trials and seed of the Monte Carlo check of the linear propagation: 400 trials know a standard deviation to 3.5 %.
TRIALS, SEED = 400, 2015
_SIGMA_OF = {
    "s1": "it1",
    "s2": "it2",
    "s3": "it3",
    "s4": "it4",
    "s5": "it5",
    "s6": "it6",
    "s7": "it7",
    "s8": "it8b",
    "s9a": "it9a",
    "s9b": "it9b",
    "s10": "it10",
}
_PRINTED_U = {
    **{item: sigma for sigma, item in _SIGMA_OF.items()},
    "it8a": "s8", "lev_par": "lev_parsig", "dX": "s9a", "dY": "s9b",
    **{f"lev{table}_th{part}": "lev_sig1" for table in "32" for part in "xy"},
    **{f"{sight}_hz": f"{sight}_sig" for sight in ("T1_S3", "T1_S2", "T2_S3", "T2_S2")},
    **{f"{target}_{circle}": f"{pair}_sig" for pair in ("AB", "CD") for target in pair for circle in ("hz", "v")},
}


def reproduce() -> Reproduction:
    """Recompute every printed number of the paper from its tables.

    Returns the comparison; its studies are sharing tests, joint results, budgets, Monte Carlo, tracker and advice.
    """
    printed = Printed.read("five_axis/claims.csv", key="key")
    numbers = {key: one.number for key, one in printed.items() if one.number is not None}
    found = fits(published())
    as_printed = Fit.of(step_by_step.declare(published(as_printed=True)))
    rounded = along_printed(numbers, published())
    special = {**_stated(found.step), **_paper_sigmas(found.step, numbers), **_worked_example(found.step), **_tracker()}
    items = [
        _fitted(key, one, found, as_printed, rounded, numbers)
        if key in STEP
        else _special(key, one, special[key], rounded, found.step, printed)
        for key, one in printed.items()
    ]
    return Reproduction(
        NAME, tuple(items), studies=_studies(found, numbers, printed), figures=figures.of(found, numbers)
    )


def _fitted(
    key: str, printed: Printed, found: Fits, as_printed: Fit, rounded: Mapping[str, float], numbers: Mapping[str, float]
) -> Item:
    value, u, u_vc = found.step.at(STEP[key], printed.unit)
    more: dict[str, Any] = {}
    unrepaired = as_printed.at(STEP[key], printed.unit)[0]
    if abs(unrepaired - value) > 1e-9 * max(1.0, abs(value)):
        more["value_as_printed"] = unrepaired
    joint: tuple[float, float, float] | tuple[None, None, None] = (None, None, None)
    if key in JOINT:
        joint = found.joint.at(JOINT[key], printed.unit)
        more["joint_alternatives"] = _alternatives(key, printed.unit, found)
    why = [reasons.WHY.get(key, ""), reasons.lies(key, value)]
    return Item(
        key, printed.quantity, printed.unit, printed, value=value, rounded=rounded.get(key), u=u, u_vc=u_vc,
        joint=joint[0], joint_u=joint[1], joint_u_vc=joint[2], why=". ".join(w for w in why if w),
        printed_u=_printed_u(key, numbers, printed.unit), **more)


def _printed_u(key: str, numbers: Mapping[str, float], unit: str) -> float | None:
    if key not in _PRINTED_U:
        return None
    return numbers[_PRINTED_U[key]] * (1e-3 if unit == "mm" else 1.0)


def _alternatives(key: str, unit: str, found: Fits) -> dict[str, dict[str, float]]:
    named = {name: fit.at(JOINT[key], unit) for name, fit in found.alternatives.items()}
    if key in TO_THE_PLUMB_LINE:
        named["yaw axes taken as plumb, as the paper does"] = found.joint.at(TO_THE_PLUMB_LINE[key], unit)
    return {name: {"joint": value, "u": u, "u_vc": u_vc} for name, (value, u, u_vc) in named.items()}


# --- numbers that are no function of the fitted centres
# ---------------------------------------------------------------------


def _stated(step: Fit) -> dict[str, dict[str, Any]]:
    """Uncertainties of section 2 and of the last rows of tables 2 to 4, from the stated u of a reading."""
    plumb = [step.stated["plumb[three_axis].x"][1] / arcsec, step.stated["plumb[three_axis].y"][1] / arcsec]
    found = {
        "lev_sig1": {"value": plumb[0]},
        "lev_parsig": {"value": math.hypot(*plumb)},
        "s8": {"value": math.hypot(*plumb)},
    }
    for key, name in (
        ("T1_S3_sig", "T1 S3"), ("T1_S2_sig", "T1 S2"), ("T2_S3_sig", "T2 S3"), ("T2_S2_sig", "T2 S2"),
        ("AB_sig", "A H"), ("CD_sig", "C H")):
        found[key] = {"value": step.stated[f"reading[{name}]"][1] / arcsec}
    return found


def _paper_sigmas(step: Fit, numbers: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Keys s*: the paper's own propagation; `rounded` with 2.3 arcsec taken as 1.15e-5 rad."""
    readings = published()
    index, yaw = readings.index[0], step.stated["reading[T1 S3]"][0]
    near_far = {"pitch": "AB", "roll": "CD", "two_axis_pitch": "EF"}
    angles = {
        f"{axis} {circle}": tuple(step.stated[f"reading[{t} {circle}]"][0] - zero for t in pair)
        for axis, pair in near_far.items()
        for circle, zero in (("H", yaw), ("V", index))
    }
    u_yaw = {name: step.stated[f"reading[{name}]"][1] for name in ("T1 S3", "T1 S2", "T2 S3", "T2 S2")}
    to_yaw = {name: readings.distance[name][0] for name in ("T1", "T2")}
    full, along = (
        paper_uncertainty.propagate(readings, angles, u)
        for u in (paper_uncertainty.U_CENTRE, paper_uncertainty.U_CENTRE_PRINTED)
    )
    sigmas, rounded = (paper_uncertainty.printed_sigmas(one, u_yaw, to_yaw) for one in (full, along))
    partial = {
        "s3": full.partial["pitch H"],
        "s5": full.partial["roll H"],
        "s4": float(np.hypot(full.partial["pitch V"], full.partial["roll V"])),
        "s10": float(np.hypot(full.partial["pitch V"], full.partial["two_axis_pitch V"])),
    }
    scale = {key: arcsec if key in ("s1", "s2", "s6") else um for key in sigmas}
    found = {
        key: {"value": sigmas[key] / scale[key], "why": reasons.WHY.get(key, reasons.SIGMA.get(key, ""))}
        for key in sigmas
    }
    for key, value in partial.items():
        found[key] |= {"rounded": rounded[key] / um, "value_by_partial_derivatives": value / um}
    return found | {"ex_prad": {"value": sigmas["s1"]}}


def _worked_example(step: Fit) -> dict[str, dict[str, Any]]:
    index = published().index[0]
    return {
        "ex_thA": {"value": step.stated["reading[A V]"][0] - index},
        "ex_thB": {"value": step.stated["reading[B V]"][0] - index},
        "ex_sigrad": {"value": paper_uncertainty.U_CENTRE},
    }


def _tracker() -> dict[str, dict[str, Any]]:
    """Section 7; the scatter of the simulated results depends on distances that are not printed."""
    square, apart = tracker_simulation.printed_lines()
    found: dict[str, dict[str, Any]] = {
        "tr_perp": {"value": square / arcsec},
        "tr_int": {"value": apart * 1e3, "why": "with the coordinates of (16) in mm; in metres it would be 294 mm"},
    }
    assumed = tracker_simulation.Assumed()
    simulated = tracker_simulation.simulated(assumed, SEED)
    for key, value in tracker_simulation.scatter(assumed).items():
        found[key] = {
            "value": None,
            "why": tracker_simulation.NOT_PRINTED,
            "assumption": str(assumed),
            "value_under_assumption": value,
            "fifteen_simulated_trials": simulated[key],
            "sampling_interval_under_assumption": [value * factor for factor in tracker_simulation.SAMPLING],
        }
    return found


def _special(
    key: str, printed: Printed, given: Mapping[str, Any], rounded: Mapping[str, float], step: Fit,
    all_printed: Mapping[str, Printed]
) -> Item:
    more = dict(given)
    if key in _SIGMA_OF:
        item = _SIGMA_OF[key]
        unit = all_printed[item].unit
        more["proper"] = step.at(STEP[item], unit)[1] * (1e3 if unit == "mm" else 1.0)
    why = more.pop("why", "") or reasons.WHY.get(key, "") or reasons.SIGMA.get(key, "")
    return Item(
        key, printed.quantity, printed.unit, printed, rounded=more.pop("rounded", rounded.get(key)), why=why, **more
    )


# --- studies
# -------------------------------------------------------------------------------------------------------------------


def _studies(found: Fits, numbers: Mapping[str, float], printed: Mapping[str, Printed]) -> dict[str, Any]:
    return {
        "sharing": [one._asdict() for one in (*found.circles, *found.wires)],
        "variance_components": [
            {"group": name, "factor_of_u": f, "u_of_factor": u, "dof": d}
            for name, f, u, d in zip(
                found.step.scatter.names,
                *map(
                    np.ndarray.tolist, (found.step.scatter.factor, found.step.scatter.u_factor, found.step.scatter.dof)
                ),
            )
        ],
        "joint": joint_table(found, printed),
        "budgets": {key: _budget(found.joint, key, printed[key].unit) for key in ITEMS},
        "montecarlo": [
            *_montecarlo("step by step", found.step, STEP, printed),
            *_montecarlo("jointly", found.joint, JOINT, printed),
        ],
        "tracker": tracker_simulation.sweep({key: numbers[key] for key in tracker_simulation.PRINTED}),
        "advice": list(adjustment.advice(found.alternatives[USUAL].linear)),
    }


def joint_table(found: Fits, printed: Mapping[str, Printed]) -> list[dict[str, Any]]:
    """The twelve results step by step and jointly, each with its change in units of the u of the change.

    The joint estimate uses all readings the step-by-step one uses, so the u of their difference is the root of the
    difference of their variances, apart from the priors that only the joint problem has. Source: Hausman (1978),
    Econometrica 46, 1251.
    """
    rows = []
    for key in ITEMS:
        unit = printed[key].unit
        step, joint, apart = found.step.at(STEP[key], unit), found.joint.at(JOINT[key], unit), None
        if "nothing shared" in found.alternatives:
            apart = found.alternatives["nothing shared"].at(JOINT[key], unit)
        change = None if apart is None else joint[0] - apart[0]
        u_change = None if apart is None else float(np.sqrt(max(apart[2] ** 2 - joint[2] ** 2, 0.0)))
        rows.append(
            {
                "key": key,
                "quantity": printed[key].quantity,
                "unit": unit,
                "printed": printed[key].number,
                "step_by_step": step[0],
                "u": step[1],
                "u_vc": step[2],
                "joint": joint[0],
                "joint_u": joint[1],
                "joint_u_vc": joint[2],
                "change_by_sharing": change,
                "u_vc_of_change": u_change,
            }
        )
    return rows


def _budget(fit: Fit, key: str, unit: str) -> list[dict[str, Any]]:
    ((name, _),) = JOINT[key].items()
    scale = arcsec if unit == "arcsec" else 1e-3
    return [
        {"contribution": line.label, "u": line.u / scale, "share": line.share}
        for line in budget(fit.linear, _scalar(fit, name)).contributions
        if line.share > 1e-4
    ]


def _scalar(fit: Fit, name: str) -> Any:
    functions = fit.linear.functions(*fit.linear.results)
    place = functions.labels.index(name)
    one = slice(place, place + 1)
    return type(functions)(
        functions.labels[one], functions.units[one], functions.values[one], functions.derivatives[one]
    )


def _montecarlo(
    procedure: str, fit: Fit, places: Mapping[str, Place], printed: Mapping[str, Printed]
) -> list[dict[str, Any]]:
    """u of the twelve results by the linear propagation and as the spread of re-estimates (JCGM 101:2008, 8)."""
    drawn = montecarlo(fit.estimate, TRIALS, SEED)
    rows = []
    for key in ITEMS:
        ((name, _),) = places[key].items()
        place = drawn.names.index(name)
        scale = arcsec if printed[key].unit == "arcsec" else 1e-3
        rows.append(
            {
                "key": key,
                "procedure": procedure,
                "unit": printed[key].unit,
                "u_linear": fit.at(places[key], printed[key].unit)[1],
                "u_montecarlo": float(drawn.samples[:, place].std(ddof=1)) / scale,
                "trials": TRIALS,
            }
        )
    return rows
