"""The 84 choices of six driven axes out of nine, in both poses of the paper and in the worse of them."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

import calib
from calib import A, D, Ds, E, G, Observations, Pose, Problem, Quantity, Shared, WorstCase
from calib.analyse.selection.exact import enumerated
from calib.analyse.selection.request import requested
from calib.units import arcsec, um
from problems.locators import paper
from problems.locators.errors import AXES, SHIFTS
from problems.locators.kinematics import readings_of
from problems.locators.pose_error import COMPONENTS, choice, conditioning, linear_form

Rows = list[dict[str, object]]
NEARLY, EXACTLY = 100.0, 1e12      # condition numbers: nearly singular, singular to rounding
LENGTH_ERROR, ANGLE_ERROR = 10 * um, 5 * arcsec      # of every source alike: the paper prints no lengths to its indices
PAPER_SIX = (0, 1, 2, 4, 5, 8)     # X_A Y_A Z_A Y_B Z_B Z_C


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


def worse_of_both_poses() -> Rows:
    """The best six axes where the worse of the two poses counts, beside the paper's."""
    fits = [calib.linearise(nine_axes(paper.part_poses()[pose])) for pose in ("initial", "target")]
    rows: Rows = []
    for name, criterion in driving_criteria().items():
        worst = WorstCase(criterion, fits[1:])
        best = calib.select(fits[0], 6, worst, by="group", method=calib.Exhaustive())
        proven = calib.select(fits[0], 6, worst, by="group", method=calib.BranchAndBound())
        request = requested(fits[0], 6, worst, by="group")
        own = request.value(request.objective.loss(list(PAPER_SIX)))
        rows.append({"criterion": name, "best": " ".join(best.labels), "value": best.value,
                     "branch and bound": proven.value, "its bound": proven.bound, "the paper's six": own})
    return rows
