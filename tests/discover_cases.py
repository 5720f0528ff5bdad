"""Cases with effects hidden where several instruments meet: joint networks, survey networks, mechanisms.

A kind of case builds a problem from a seed, with nominal readings. `hide` draws effects among the candidates that the
problem itself offers, and readings with them. The truth goes into a folder of its own; `seal` makes a process unable
to open anything in there, and the analysis runs behind it.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calib import Observations, Pose, Problem, Unknown, geometry, linearise, simulate, solve, units
from calib.analyse.score import Candidate, Field, candidates, columns_of, field_of, orthonormal
from calib.job import Job
from calib.mechanism import (
    Frame,
    Linear,
    Mechanism,
    Rotary,
    backlash,
    encoder_harmonic,
    error_motion,
    location_errors,
    observe,
    thermal_growth,
    thermal_scale,
)
from calib.units import arcsec, minute, mm, um
from calib.workflow.discrepancy.alias import aliases
from calib.workflow.solution import declared
from instruments import laser_tracker
from problems import hexapod, multilateration, network, positioner, three_axis_turntable
from problems.network.survey import FIXED, Batch, Point, Survey

VISIBLE = 60.0  # sum of squares that a hidden effect raises at least: the ideal test misses one in a thousand of these
DRAWS = 60  # candidates that are tried before a design is said to show none of this size


# --- kinds of cases ---------------------------------------------------------------------------------------------------


def joint_network(seed: int) -> Problem:
    """Three trackers turned anyhow, an interferometer and a scale bar on 16 targets, with time and two settings."""
    g = np.random.default_rng(seed)
    targets = {f"T{i}": g.uniform([-4, -4, -1], [4, 4, 2]) for i in range(16)}
    count = len(targets)
    turns = [np.linalg.qr(g.normal(size=(3, 3)))[0] for _ in "ABC"]
    own = [np.array([t * np.linalg.det(t) @ (p - [5 * i - 5, 6, 1]) for p in targets.values()])
           for i, t in enumerate(turns)]
    half = np.arange(count) >= count / 2
    recorded = {"time": (np.arange(3 * count) * minute, "min"), "block": 1 + np.tile(half, 3)}
    drawn = {"time": (np.arange(count) * 2 * minute, "min"), "block": 1 + half}
    survey = Survey(
        {key: Point(tuple(place), "adjusted", "adjusted") for key, place in targets.items()},
        [Batch("slope distance", ["T0", "T2"], ["T1", "T3"], None, [3 * um] * 2, group="bar")],
        sightings=[network.Sightings(np.repeat(list("ABC"), count), np.tile(list(targets), 3),
                                     np.concatenate([laser_tracker.polar_readings(one) for one in own]),
                                     np.array([8 * um, 2 * arcsec, 2 * arcsec]), covariates=recorded)],
        ranging=[network.Ranging(["I"] * count, list(targets), np.linalg.norm(
            np.array(list(targets.values())) - [6.0, 1.0, 0.5], axis=1) - 2.0, 1 * um, covariates=drawn)])
    return simulate(network.with_candidates(network.declare(survey)), None, seed)


def survey_network(seed: int) -> Problem:
    """A .gkf file of six points, two of them fixed: directions, slope distances, zenith angles between all of them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "network.gkf"
        path.write_text(gkf(survey(seed)), encoding="utf-8")
        return declared(Job.read(path), network)


def survey(seed: int) -> Survey:
    """Six points on a hillside, some 200 m apart, all of them stations; without blunders or effects."""
    g = np.random.default_rng(seed)
    angle = np.arange(5) * 2 * np.pi / 5 + g.uniform(-0.3, 0.3, 5)
    places = [np.zeros(3), *(np.array([200 * np.cos(a), 200 * np.sin(a), z])
                             for a, z in zip(angle, g.uniform(-40, 60, 5), strict=True))]
    points = {f"P{i}": Point(tuple(p), FIXED if i < 2 else "adjusted", FIXED if i < 2 else "adjusted")
              for i, p in enumerate(places)}
    ends = [(a, b) for a in points for b in points if a != b]
    station, target = (np.array(keys) for keys in zip(*ends, strict=True))
    n = len(ends)
    plan = Survey(points, [
        Batch("direction", station, target, None, np.full(n, 1.5 * arcsec), orientation=station, group="direction",
              unit="gon"),
        Batch("slope distance", station, target, None, np.full(n, 1 * mm), group="slope distance"),
        Batch("zenith angle", station, target, None, np.full(n, 2 * arcsec), group="zenith angle", unit="gon")])
    drawn = simulate(network.declare(plan), None, seed)
    readings = {o.group: np.asarray(o.readings) for o in drawn.observations}
    return replace(plan, batches=[replace(b, readings=readings[b.group]) for b in plan.batches])


def gkf(found: Survey) -> str:
    """A survey of directions, slope distances and zenith angles in the format of GNU Gama."""
    gon, by_station = np.pi / 200, {}
    names = {"direction": ("direction", 1 / gon, 1e4 / gon), "slope distance": ("s-distance", 1.0, 1e3),
             "zenith angle": ("z-angle", 1 / gon, 1e4 / gon)}
    for batch in found.batches:
        tag, scale, fine = names[batch.kind]
        for a, b, value, u in zip(*batch.ends, np.ravel(batch.readings), np.asarray(batch.u), strict=True):
            shown = value * scale % 400.0 if tag != "s-distance" else value
            by_station.setdefault(a, []).append(f'<{tag} to="{b}" val="{shown:.8f}" stdev="{u * fine:.6f}"/>')
    points = "".join(
        f'<point id="{key}" x="{p.position[0]:.6f}" y="{p.position[1]:.6f}" z="{p.position[2]:.6f}" '
        f'{"fix" if p.plane == FIXED else "adj"}="xyz"/>\n' for key, p in found.points.items())
    sights = "".join(f'<obs from="{key}">\n' + "\n".join(lines) + "\n</obs>\n" for key, lines in by_station.items())
    return ('<?xml version="1.0"?>\n<gama-local xmlns="http://www.gnu.org/software/gama/gama-local">\n'
            '<network axes-xy="ne" angles="left-handed">\n<parameters sigma-apr="1" sigma-act="apriori"/>\n'
            f"<points-observations>\n{points}{sights}</points-observations>\n</network>\n</gama-local>\n")


def table_on_slide(seed: int) -> Problem:
    """A linear axis carries a tilting one and that a turning one; a tracker reads two reflectors. Declared by hand."""
    g = np.random.default_rng(seed)
    mechanism = Mechanism("table on a slide", axes=[Linear("X", (1, 0, 0), limits=(0.0, 0.8)),
                                                    Rotary("A", (0, 1, 0), carried_by="X"),
                                                    Rotary("C", (0, 0, 1), carried_by="A")],
                          frames=[Frame("table", carried_by="C")])
    drive = {"X": g.uniform(0, 0.8, 70), "A": g.uniform(-0.9, 0.9, 70), "C": g.uniform(-np.pi, np.pi, 70)}
    rows = np.repeat(np.stack(list(drive.values()), axis=1), 2, axis=0)
    n = len(rows)
    covariates: dict[str, Any] = {name: (rows[:, i], "m" if i == 0 else "rad") for i, name in enumerate("XAC")}
    covariates |= {f"approach_{name}": np.repeat(g.choice([-1, 1], n // 2), 2) for name in "XAC"}
    covariates |= {"time": (np.arange(n) * minute, "min"),
                   "temperature_difference": (np.sin(np.arange(n) / 25.0) + g.normal(0, 0.1, n), "K"),
                   "reflector": np.tile(["1", "2"], n // 2)}
    world = Pose("tracker_from_base", geometry.rotation_from_rpy(0.02, -0.01, 1.0), np.array([2.5, 0.4, 0.3]), "mm")
    place = Unknown("reflector", np.array([[0.25, 0.0, 0.1], [-0.1, 0.15, 0.2]]), "mm", keys=("1", "2"))
    read = Observations(observe.measured_point(mechanism.pose("table")), world, rows, place[np.tile([0, 1], n // 2)],
                        u=4 * um, group="points", unit="um", components=tuple("xyz"), covariates=covariates)
    offered = [
        *(e for e in location_errors(mechanism, ["A", "C"]) if e.name in ("EC0A", "EA0C", "EX0C")),
        *(encoder_harmonic(axis, order) for axis in mechanism.axes[1:] for order in (1, 2)),
        *(error_motion(mechanism.axis("C"), part, (2,)) for part in "XYZAB"),
        *(error_motion(mechanism.axis("X"), part) for part in "XYZABC"),
        *(backlash(axis, f"approach_{axis.name}") for axis in mechanism.axes),
        *(thermal_growth(mechanism.axis("A"), part) for part in "XYZ"), thermal_scale(mechanism.axis("X"))]
    return simulate(Problem([read], effects=offered, name="table on a slide"), None, seed)


KINDS: dict[str, Callable[[int], Problem]] = {
    "joint network": joint_network,
    "survey network (.gkf)": survey_network,
    "self-calibrating multilateration": multilateration.example,
    "table on a slide, declared by hand": table_on_slide,
    "three-axis turntable": three_axis_turntable.example,
    "hexapod": hexapod.example,
    "two-axis positioner": positioner.example,
}


# --- hiding and finding -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Hidden:
    """Effects put into readings: [(name, channel, {parameter: value SI})], the readings {group: (n, dim)} SI, and
    whether no other candidate could stand in for one of them."""

    effects: list[tuple[str, str, dict[str, float]]]
    readings: dict[str, np.ndarray]
    separable: bool


def hide(problem: Problem, seed: int, count: int, size: float) -> Hidden | None:
    """Draw effects among the candidates of a problem, and readings with them; None where none of this size can show.

    size: root mean square of each effect over the readings that it changes, in u.
    """
    g = np.random.default_rng([seed, count, int(10 * size)])
    estimate = solve(problem)
    fit = linearise(estimate)
    offered = candidates(fit)
    field = field_of(fit, offered)
    chosen: list[tuple[Candidate, np.ndarray]] = []
    for one in (offered[i] for i in g.integers(len(offered), size=DRAWS) if offered):
        if len(chosen) == count or one.label in [c.label for c, _ in chosen]:
            continue
        columns = fit.held_columns(one.columns)
        usual = np.array([p.plausible[1] for p in one.effect.parameters])
        lower = np.array([p.lower for p in one.effect.parameters])
        direction = usual * np.where(lower >= 0, np.abs(g.normal(size=len(usual))), g.normal(size=len(usual)))
        signal = columns @ direction
        moved = np.abs(signal) > 1e-9 * np.abs(signal).max(initial=0.0)
        if not moved.any():
            continue
        values = direction * size / np.sqrt(np.mean(signal[moved] ** 2))
        together = [*((c, fit.held_columns(c.columns), v) for c, v in chosen), (one, columns, values)]
        if all(_shown(field, k, together) >= VISIBLE for k in range(len(together))):
            chosen.append((one, values))
    if len(chosen) < count:
        return None
    places = [offered.index(one) for one, _ in chosen]
    positive = frozenset(i for i, one in enumerate(offered) if [p.lower for p in one.effect.parameters] == [0.0])
    others = aliases(field, places, {i: v for i, (_, v) in zip(places, chosen, strict=True)},
                     columns_of(fit, offered), positive, estimated=False)
    truth: dict[Any, Any] = {u: estimate[u] for u in problem.unknowns}
    for one, values in chosen:
        whole = np.reshape(np.array(truth[one.unknown], float), (one.unknown.count, -1))
        whole[one.instance] = values
        truth[one.unknown] = whole.reshape(one.unknown.shape)
    drawn = simulate(problem, truth, seed + 500_000)
    readings = {o.group: np.asarray(o.readings) for o in drawn.observations if not o.is_prior}
    return Hidden([(one.effect.name, one.channel, dict(zip([p.name for p in one.effect.parameters], values.tolist(),
                                                            strict=True))) for one, values in chosen], readings,
                  not any(others.values()))


def _shown(field: Field, k: int, together: list[tuple[Candidate, np.ndarray, np.ndarray]]) -> float:
    """Sum of squares that an effect raises beside the others, which may take its place as far as they can."""
    for number, (_, columns, _) in enumerate(together):
        if number != k:
            field = field.taking(orthonormal(field.outside(columns), np.linalg.norm(columns, axis=0)))
    _, columns, values = together[k]
    return float(np.sum(field.outside(columns @ values[:, None]) ** 2))


def write(kind: str, seed: int, count: int, size: float, cases: Path, truths: Path) -> bool:
    """Write one case into its folder and its truth into another. Returns whether there is one."""
    hidden = hide(KINDS[kind](seed), seed, count, size)
    if hidden is None:
        return False
    name = f"{kind}-{seed}-{count}-{size:g}"
    stored: dict[str, Any] = {group.replace("/", "_"): values for group, values in hidden.readings.items()}
    np.savez(cases / f"{name}.npz", **stored)
    (truths / f"{name}.json").write_text(json.dumps({
        "kind": kind, "seed": seed, "size": size, "effects": hidden.effects, "separable": hidden.separable}),
        encoding="utf-8")
    return True


def seal(folder: Path) -> None:
    """From here on this process cannot open a file in a folder, nor list it; there is no way back."""
    closed = str(folder.resolve())

    def refuse(event: str, arguments: tuple[Any, ...]) -> None:
        if event in ("open", "os.listdir", "os.scandir") and isinstance(arguments[0], (str, bytes, Path)):
            asked = arguments[0].decode() if isinstance(arguments[0], bytes) else str(arguments[0])
            if str(Path(asked).absolute()).startswith(closed):
                raise PermissionError(f"{asked}: holds the truth, which the analysis does not see")

    sys.addaudithook(refuse)


def problem_of(case: Path) -> Problem:
    """The problem of a written case, with its readings."""
    kind, seed, _, _ = case.stem.rsplit("-", 3)
    problem = KINDS[kind](int(seed))
    with np.load(case) as stored:
        return problem.with_readings({o.group: stored[o.group.replace("/", "_")] for o in problem.observations
                                      if not o.is_prior})



@dataclass(frozen=True)
class Outcome:
    """How an answer compares with the truth: what was named, exactly or as a set of aliases, parameters within 2u."""

    alarmed: bool
    verdict: str
    any_of_them: bool
    all_or_alias: bool
    exact: bool
    within_2u: tuple[bool, ...]
    rms: tuple[float, float]


def judged(truth: dict[str, Any], answer: dict[str, Any]) -> Outcome:
    """Compare an answer (as of `answer.json`) with the truth of its case."""
    hidden = {(name, channel): parameters for name, channel, parameters in truth["effects"]}
    named = {(e["name"], e["channel"]): e for e in answer["effects"]}
    sets = [{key, *((a["name"], a["channel"]) for a in e["alias"])} for key, e in named.items()]
    covered = all(any(key in one for one in sets) for key in hidden) and len(sets) == len(hidden)
    within = []
    for key in hidden.keys() & named.keys():
        for name, found in named[key]["parameters"].items():
            miss = found["value"] - hidden[key][name] / units.factor(found["unit"])
            within.append(abs(miss) <= 2 * found["u"])
    return Outcome(answer["verdict"] != "consistent", answer["verdict"],
                   any(key in one for key in hidden for one in sets), covered, set(hidden) == set(named),
                   tuple(within), (answer["rms"]["before"], answer["rms"]["after"]))
