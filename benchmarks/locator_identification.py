"""Identification of locator errors from measured poses: pose error of poses held out, and coverage of the intervals.

    python benchmarks/locator_identification.py [--campaigns 24] [--coverage 500] [--out FILE]

Errors are drawn from what is known beforehand (`Knowledge`), the declared model simulates the campaigns. Each line of
the first table is the root mean square over the campaigns; 12 poses of each are for checking only and are seen by their
axes alone. "perfect" is the error that remains when the true errors are known: noise of the axes, or none if driven.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib import Problem, covariance, linearise, solve
from calib.units import um
from problems.locators import campaign
from problems.locators.identification import (
    Knowledge,
    combinations,
    functions_in,
    give_in_joints,
    identified,
    identify,
    leaders_only,
    pose_error,
    poses_from_axes,
    with_error_functions,
)
from problems.locators.measured import Setup, declare
from problems.locators.paper import DRIVEN
from problems.locators.vocabulary import error_functions

KNOWLEDGE = Knowledge()
FUNCTIONS = tuple(function for key in "ABC" for function in error_functions(key))
CHECKS = 12
SCHEMES = ("nine axes read, tracker", "six axes read, tracker", "nine axes driven, tracker",
           "nine axes read, no tracker")


def drawn_errors(seed: int) -> dict[str, np.ndarray]:
    """True errors of one campaign."""
    generator = np.random.default_rng([seed, 2])
    return {function.label: generator.normal(0.0, KNOWLEDGE.u(function)) for function in FUNCTIONS}


def campaign_of(scheme: str, poses: int, seed: int, truth: dict[str, np.ndarray]) -> campaign.Campaign:
    """One simulated campaign with `poses` for fitting and CHECKS for checking."""
    where = campaign.drawn_poses(poses + CHECKS, seed)
    if "driven" in scheme:
        return campaign.drive(where, seed, truth, further=FUNCTIONS, checks=CHECKS)
    return campaign.measure(where, seed, truth, further=FUNCTIONS, checks=CHECKS)


def problem_of(scheme: str, measured: campaign.Campaign) -> tuple[Setup, Problem]:
    """Setup and problem of a scheme with all errors free, from the poses for fitting."""
    setup = replace(measured.setup, axes=DRIVEN) if "six" in scheme else measured.setup
    axes = measured.axes.where(measured.axes.split == "fit")
    targets = None if "no tracker" in scheme else measured.targets.where(measured.targets.split == "fit")
    u_axis = 1 * um if "driven" in scheme else campaign.U_AXIS
    problem = declare(setup, axes, targets, u_axis=u_axis, u_tracker=campaign.U_TRACKER)
    if "driven" in scheme:
        problem = give_in_joints(problem, setup)
    return setup, with_error_functions(problem)


def held_out(scheme: str, poses: int, seed: int) -> tuple[float, float, float, int]:
    """Pose error [um] before, after and with the true errors, and the number of combinations that are seen."""
    truth = drawn_errors(seed)
    measured = campaign_of(scheme, poses, seed, truth)
    setup, problem = problem_of(scheme, measured)
    checks, part = measured.axes.where(measured.axes.split == "check"), measured.part[-CHECKS:]
    known = {function: truth[function.label] for function in functions_in(problem)}
    errors = [pose_error(setup, poses_from_axes(setup, checks, campaign.U_AXIS, functions), part) / um
              for functions in (None, identified(identify(problem, KNOWLEDGE)), known)]
    seen = 0 if "driven" in scheme else len(combinations(linearise(problem), KNOWLEDGE))
    return (*errors, seen)


def covered(scheme: str, poses: int, seed: int) -> tuple[float, float]:
    """Share of the 144 true errors within their 95% intervals, and mean square of the standardised errors."""
    truth = drawn_errors(seed)
    _, problem = problem_of(scheme, campaign_of(scheme, poses, seed, truth))
    fit = linearise(identify(problem, KNOWLEDGE))
    functions = functions_in(problem)
    found = covariance(fit, *(problem.parameters(function) for function in functions))
    deviation = (found.values - np.concatenate([truth[function.label] for function in functions])) / found.u
    return float(np.mean(np.abs(deviation) < 1.959964)), float(np.mean(deviation ** 2))


def tables(campaigns: int, repetitions: int) -> str:
    """Both tables as text."""
    lines = ["# Identification of locator errors", "", f"Root mean square over {campaigns} campaigns, {CHECKS} poses "
                                                       f"held out.",
             "", "| scheme | poses | before [um] | after [um] | perfect [um] | combinations seen |",
             "|---|---|---|---|---|---|"]
    for scheme in SCHEMES:
        for poses in (10, 20, 40):
            results = np.array([held_out(scheme, poses, seed) for seed in range(campaigns)])
            before, after, perfect = np.sqrt(np.mean(results[:, :3] ** 2, axis=0))
            seen = "-" if "driven" in scheme else f"{results[:, 3].mean():.0f}"
            lines.append(f"| {scheme} | {poses} | {before:.1f} | {after:.1f} | {perfect:.1f} | {seen} |")
    lines += ["", f"Coverage of 95% intervals of the 144 errors, {repetitions} campaigns of 20 poses.", "",
              "| scheme | covered | standard error | mean square of standardised errors |", "|---|---|---|---|"]
    for scheme in (SCHEMES[0], SCHEMES[2]):
        shares = np.array([covered(scheme, 20, 1000 + seed) for seed in range(repetitions)])
        error = shares[:, 0].std(ddof=1) / np.sqrt(repetitions)
        lines.append(f"| {scheme} | {shares[:, 0].mean():.4f} | {error:.4f} | {shares[:, 1].mean():.3f} |")
    return "\n".join(lines) + "\n"


def seen_in_words(poses: int, seed: int) -> str:
    """The combinations of errors that each scheme sees, in words, of one campaign."""
    lines = [f"# What {poses} poses see", "",
             "Combinations of errors of which the readings tell more than was known beforehand, with u from the",
             "readings alone. f = travel/half range; an error is constant + slope f + bow f^2.", ""]
    truth = drawn_errors(seed)
    for scheme in (SCHEMES[0], SCHEMES[1], SCHEMES[3]):
        _, problem = problem_of(scheme, campaign_of(scheme, poses, seed, truth))
        found = combinations(linearise(problem), KNOWLEDGE)
        u = covariance(linearise(solve(leaders_only(problem, found))), *(one.leader for one in found)).displayed
        lines += [f"## {scheme}: {len(found)} combinations", ""]
        lines += [f"- u = {size:.2g} {unit}: {one.words}" for one, (_, _, size, unit) in zip(found, u, strict=True)]
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    """Print the tables, and write them where asked."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--campaigns", type=int, default=24)
    parser.add_argument("--coverage", type=int, default=500)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    began = time.perf_counter()
    text = tables(arguments.campaigns, arguments.coverage) + "\n" + seen_in_words(20, 1)
    print(text)
    print(f"{time.perf_counter() - began:.0f} s")
    if arguments.out:
        arguments.out.write_text(text)


if __name__ == "__main__":
    main()
