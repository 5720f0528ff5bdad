"""Power for one weak effect: what a test can reach that does not know which effect it looks for.

python benchmarks/discrepancy_power.py [--designs 25] [--first 90000] [--scenario NAME ...] [--out benchmarks/results]

All powers are means over designs, candidates (each name alike, then each channel) and directions, at a level of 1 %:
knows which effect, not its size (chi-squared); knows the list, how often each is there and how large it is, but not
which (ratio of the mean likelihood, the most powerful test there is: Neyman and Pearson 1933); the largest drop among
all candidates, corrected for the looks, as the workflow takes it.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import chndtr, gammaincc, logsumexp
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from discrepancy_cases import SEEN, stage
from discrepancy_designs import DESIGNS

from calib.analyse.score import orthonormal

SCENARIOS = ("level_plumb", "theodolite_target", "basepoint_multilateration", "turntable_tracker")
SIZES = (0.3, 0.5, 1.0)
LEVEL = 0.01
DRAWS = 10_000  # of pure noise, for the thresholds
CASES = 60  # of each candidate and size
ATOMS = 48  # directions over which the likelihood of an effect of several parameters is averaged
TESTS = ("knows which", "knows the list and the sizes", "largest drop")


def powers(scenario: str, seed: int) -> NDArray[np.float64] | None:
    """Power of each test (columns) at each size (rows) in one design; None where no effect can be seen in it."""
    g = np.random.default_rng([seed, 81])
    here = stage(DESIGNS[scenario](g))
    sizes = [np.linalg.norm(whole, axis=0) for whole in here.whole]
    frames = [orthonormal(s, z) for s, z in zip(here.signals, sizes, strict=True)]
    names = {i: one.effect.name for i, one in enumerate(here.chosen)
             if np.linalg.norm(here.signals[i]) > SEEN * np.linalg.norm(here.whole[i]) and one.effect.name != "cyclic"}
    if not names:
        return None
    often = {i: 1 / len(set(names.values())) / list(names.values()).count(name) for i, name in names.items()}
    space = orthonormal(np.concatenate(frames, axis=1), np.ones(sum(f.shape[1] for f in frames)))
    seen = [space.T @ f for f in frames if f.shape[1]]

    def drawn(i: int, count: int) -> NDArray[np.float64]:
        """Signals of a candidate of the size of the noise, in random directions of its parameters."""
        directions = g.normal(size=(len(sizes[i]), count)) / np.maximum(sizes[i], 1e-300)[:, None]
        if here.chosen[i].effect.parameters[0].lower == 0.0:
            directions = np.abs(directions)
        net, raw = here.signals[i] @ directions, here.whole[i] @ directions
        touched = np.sum(np.abs(raw) > 1e-9 * np.abs(raw).max(axis=0), axis=0)
        return np.asarray(space.T @ net * np.sqrt(touched / np.sum(net**2, axis=0)))

    atoms = {i: drawn(i, ATOMS if len(sizes[i]) > 1 else 1) for i in names}

    def likelihood(readings: NDArray[np.float64], size: float) -> NDArray[np.float64]:
        """Logarithm of the mean likelihood over candidates, directions and signs, over that of pure noise."""
        logs = []
        for i, share in often.items():
            signals = size * atoms[i]
            along = signals.T @ readings
            if here.chosen[i].effect.parameters[0].lower != 0.0:
                along = np.logaddexp(along, -along) - np.log(2)
            logs.append(along - 0.5 * np.sum(signals**2, axis=0)[:, None] + np.log(share / signals.shape[1]))
        return np.asarray(logsumexp(np.concatenate(logs), axis=0))

    def rarest(readings: NDArray[np.float64]) -> NDArray[np.float64]:
        """Smallest tail probability among the candidates."""
        return np.min([gammaincc(f.shape[1] / 2, np.sum((f.T @ readings) ** 2, axis=0) / 2) for f in seen], axis=0)

    noise = g.normal(size=(space.shape[1], DRAWS))
    smallest, found = rarest(noise), np.zeros((len(SIZES), len(TESTS)))
    for row, size in enumerate(SIZES):
        beyond = np.quantile(likelihood(noise, size), 1 - LEVEL)
        for i, share in often.items():
            signals, dof = size * drawn(i, CASES), frames[i].shape[1]
            readings = signals + g.normal(size=signals.shape)
            rare = rarest(readings)
            found[row] += share * np.array([
                np.mean(1 - chndtr(chi2.ppf(1 - LEVEL, dof), dof, np.sum(signals**2, axis=0))),
                np.mean(likelihood(readings, size) > beyond),
                np.mean(rare < np.quantile(smallest, LEVEL)),
            ])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--designs", type=int, default=25)
    parser.add_argument("--first", type=int, default=90_000)
    parser.add_argument("--scenario", nargs="*", default=list(SCENARIOS))
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    chosen = parser.parse_args()
    with (chosen.out / "discrepancy_power.csv").open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(("scenario", "size", "designs", *TESTS))
        for scenario in chosen.scenario:
            trials = [powers(scenario, seed) for seed in range(chosen.first, chosen.first + chosen.designs)]
            found = [one for one in trials if one is not None]
            for size, row in zip(SIZES, np.mean(found, axis=0), strict=True):
                line = (scenario, size, len(found), *(f"{p:.3f}" for p in row))
                table.writerow(line)
                print(*line, sep="\t", flush=True)


if __name__ == "__main__":
    main()
