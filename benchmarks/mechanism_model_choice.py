"""Which errors of a real arm to estimate, chosen on the placement used for the calibration alone.

Run: python benchmarks/mechanism_model_choice.py JOB [--data FOLDER]. The postures of the used placement are put into
clusters of like joint angles; each cluster is predicted from the others. That asks for extrapolation, as another
placement will. The placements held out in the job are not read.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np

import calib
from calib.job import Job
from calib.units import mm, mrad
from problems import serial_arm


def clusters(positions: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Cluster (n,) of each posture (n, axes) by k-means of the sines and cosines of its joints."""
    places = np.concatenate([np.cos(positions), np.sin(positions)], axis=1)
    centres = places[np.random.default_rng(seed).choice(len(places), count, replace=False)]
    for _ in range(50):
        found = np.argmin(((places[:, None] - centres) ** 2).sum(axis=2), axis=1)
        centres = np.array([places[found == k].mean(axis=0) if np.any(found == k) else centres[k]
                            for k in range(count)])
    return found


def left_out_error(setup: serial_arm.Setup, sizes: serial_arm.Tolerances, seeds: int = 2) -> float:
    """Mean distance [m] of balls of left-out clusters from the sockets found with the others."""
    (name, seats), = setup.used.items()
    positions = np.concatenate(seats)
    socket = np.repeat(np.arange(len(seats)), [len(seat) for seat in seats])
    arguments, missed = {**setup.arguments, "sizes": sizes}, []
    for seed in range(seeds):
        cluster = clusters(positions, 5, seed)
        for k in np.unique(cluster):
            kept = [positions[(socket == i) & (cluster != k)] for i in range(len(seats))]
            left = [positions[(socket == i) & (cluster == k)] for i in range(len(seats))]
            if any(len(rows) < 3 for rows in kept):
                continue
            estimate = calib.solve(serial_arm.declare(setup.arm, {name: kept}, **arguments))
            values = {x.name: estimate[x] for x in estimate.problem.unknowns}
            for i, rows in enumerate(left):
                if len(rows):
                    one = serial_arm.declare(setup.arm, {name: [rows]}, **{**arguments, "distance": None})
                    found = calib.predict(one, {**values, "socket": [values["socket"][i]]})["seat"]
                    missed += list(np.linalg.norm(found, axis=1))
    return float(np.mean(missed))


def main() -> None:
    arguments = sys.argv[1:]
    folder = Path(arguments.pop(arguments.index("--data") + 1)) if "--data" in arguments else None
    setup = serial_arm.setup(Job.read(arguments[0], folder))
    stated = setup.arguments["sizes"]
    bare = dataclasses.replace(stated, sag=None, sag_between=None, bending=None, encoder=None)
    sag = dataclasses.replace(bare, sag=16 * mrad)
    alike = dataclasses.replace(sag, sag_between=3.3 * mrad)
    choices = {
        "geometry": bare,
        "geometry, lengths to 0.1 mm": dataclasses.replace(bare, length=0.1 * mm, tilt=1 * mrad),
        "and drives under load": sag,
        "and drives of one size alike": alike,
        "and encoder harmonics": dataclasses.replace(alike, encoder=0.3 * mrad),
        "alike, and bending of links": dataclasses.replace(alike, bending=2 * mrad),
        "alike, bending, lengths to 0.3 mm": dataclasses.replace(alike, bending=2 * mrad, length=0.3 * mm),
        "as stated in the job": stated,
    }
    for words, sizes in choices.items():
        print(f"{words:36s} {left_out_error(setup, sizes) / mm:7.3f} mm", flush=True)


if __name__ == "__main__":
    main()
