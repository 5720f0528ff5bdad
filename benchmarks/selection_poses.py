"""Poses that identify the errors of the locators: how many, which, and the pose error that remains."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import calib
from calib import A, D, Problem
from calib.units import um
from problems.locators import campaign, identification
from problems.locators.measured import declare as declare_measured
from problems.locators.vocabulary import error_functions

Rows = list[dict[str, object]]
CHECKS, POSES = 12, 30
DRAWS = 3      # random choices a campaign


def measured_campaign(seed: int, known: identification.Knowledge) -> campaign.Campaign:
    """POSES poses for identification and CHECKS for checking, with errors as large as is known beforehand."""
    functions = tuple(f for key in "ABC" for f in error_functions(key))
    generator = np.random.default_rng([seed, 2])
    truth = {f.label: generator.normal(0.0, known.u(f)) for f in functions}
    return campaign.measure(campaign.drawn_poses(POSES + CHECKS, seed), seed, truth, further=functions, checks=CHECKS)


def identification_poses(campaigns: int = 6, keeps: Sequence[int] = (6, 10, 16)) -> Rows:
    """Which of 30 poses identify the errors: chosen by the pose error to come in 12 poses that nobody fitted, by D, and
    at random; the error that remains there, predicted and found."""
    known = identification.Knowledge()
    left: dict[tuple[int, str], list[float]] = {}
    chosen: dict[int, str] = {}
    gap: dict[int, float] = {}
    for seed in range(campaigns):
        measured = measured_campaign(seed, known)
        fit = calib.linearise(identification.with_knowledge(of_poses(measured, None), known))
        to_come = pose_error(fit, measured)
        noise = axis_noise(measured)
        poses = np.unique(measured.axes.where(measured.axes.split == "fit").pose)
        for keep in keeps:
            for words, criterion in (("pose error", A(to_come)), ("D", D())):
                choice = calib.select(fit, keep, criterion, by="pose")
                some = [int(label.removeprefix("pose ")) for label in choice.labels]
                left.setdefault((keep, words), []).append(remaining(measured, some, known))
                if words == "pose error":
                    predicted = float(np.hypot(np.sqrt(choice.value), noise))
                    left.setdefault((keep, "predicted"), []).append(predicted)
                    gap[keep] = max(gap.get(keep, 0.0), choice.gap)
                    chosen.setdefault(keep, ", ".join(map(str, some)))
            for draw in range(DRAWS):
                some = np.random.default_rng([seed, draw, 9]).choice(poses, keep, replace=False).tolist()
                left.setdefault((keep, "random"), []).append(remaining(measured, some, known))
    rms = {key: float(np.sqrt(np.mean(np.square(errors)))) for key, errors in left.items()}
    return [{"poses": keep, "predicted [um]": rms[keep, "predicted"],
             "chosen by pose error [um]": rms[keep, "pose error"], "chosen by D [um]": rms[keep, "D"],
             "random [um]": rms[keep, "random"], "gap to the bound": gap[keep],
             "chosen in the first campaign": chosen[keep]} for keep in keeps]


def pose_error(fit: calib.Linearisation, measured: campaign.Campaign) -> Any:
    """What criterion A is about: the pose error to come in the poses for checking."""
    checks = measured.axes.where(measured.axes.split == "check")
    return identification.pose_error_to_come(fit, measured.setup, checks, campaign.U_AXIS)


def of_poses(measured: campaign.Campaign, poses: Sequence[int] | None) -> Problem:
    """The problem of some poses of a campaign, or of all that are for fitting, with all error functions free."""
    def fitted(readings: Any) -> Any:
        return readings.where(readings.split == "fit" if poses is None else np.isin(readings.pose, poses))

    return identification.with_error_functions(declare_measured(
        measured.setup, fitted(measured.axes), fitted(measured.targets), u_axis=campaign.U_AXIS,
        u_tracker=campaign.U_TRACKER))


def remaining(measured: campaign.Campaign, poses: Sequence[int], known: identification.Knowledge) -> float:
    """Pose error [um] in the poses for checking, after identification in some poses."""
    checks = measured.axes.where(measured.axes.split == "check")
    found = identification.identified(identification.identify(of_poses(measured, poses), known))
    estimated = identification.poses_from_axes(measured.setup, checks, campaign.U_AXIS, found)
    return identification.pose_error(measured.setup, estimated, measured.part[-CHECKS:]) / um


def axis_noise(measured: campaign.Campaign) -> float:
    """Root mean square distance [um] of the targets that the noise of the axes alone leaves."""
    checks = measured.axes.where(measured.axes.split == "check")
    plain = declare_measured(measured.setup, checks, None, u_axis=campaign.U_AXIS)
    part = next(u for u in plain.unknowns if u.name == "part")
    points = np.array(list(measured.setup.targets.values()))
    where = calib.Quantity("target", identification.target_in_hall, part[np.repeat(np.arange(part.count), len(points))],
                           np.tile(points, (part.count, 1)), unit="mm", parts=("x", "y", "z"))
    u = calib.covariance(calib.linearise(plain.with_quantities(where)), where).u.reshape(-1, 3)
    return float(np.sqrt(np.mean(np.sum(u**2, axis=1)))) / um

