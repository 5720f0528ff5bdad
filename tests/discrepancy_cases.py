"""Cases with something hidden in them: effects of the problem modules, structure of no name, peculiar noise, blunders.

Sizes are the root mean square of what the unknowns leave of the hidden signal over the readings that it touches, in
units of the stated standard uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from discrepancy_designs import DESIGNS, Design

from calib import Problem, linearise, predict
from calib.analyse.score import Candidate, candidates, field_of
from calib.units import nm
from calib.workflow.discrepancy.readings import Channel, channels, row_numbers

SEEN = 0.05  # share of a signal that the unknowns must leave for an effect to be hidden in a case
APART = 0.5  # share of its signal that an effect must keep beside the others of its case
FEWEST = 28  # rows of a case
DRAWS = 60  # designs that are drawn before one of this size is given up
FEW = 12  # rows of a small one, of the size of published tables: as many as there are below FEWEST
SHAPES = ("triangle", "fourth", "fifth", "bump", "product", "wave in time", "saturating", "growing hysteresis",
          "step within", "lagging", "square of temperature", "different by direction")
NOISES = ("larger", "smaller", "channel", "block", "growing", "heavy", "heavy of stated size", "serial")


@dataclass(frozen=True)
class Case:
    """Readings with something hidden: problem, held-out rows, and the truth apart from them.

    effects: {(name, channel): parameters (k,) SI}; rows: blundered rows; verdict: the right one; what: in words;
    factor: of the noise to the stated one.
    """

    problem: Problem
    check: dict[str, np.ndarray]
    verdict: str
    what: str
    effects: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)
    rows: tuple[int, ...] = ()
    labels: tuple[str, ...] = ()
    factor: float = 1.0


@dataclass(frozen=True)
class _Stage:
    """A design at its truth: what each candidate shows, and how whitened rows map to readings."""

    design: Design
    plan: Problem
    exact: dict[str, np.ndarray]
    chosen: list[Candidate]
    whole: list[np.ndarray]
    signals: tuple[np.ndarray, ...]
    basis: np.ndarray
    channels: list[Channel]
    numbers: np.ndarray
    u: dict[str, np.ndarray]

    def readings(self, exact: dict[str, np.ndarray], whitened: np.ndarray) -> dict[str, np.ndarray]:
        """Readings of all groups with whitened errors added."""
        found, begin = {}, 0
        for o in self.plan.observations:
            size = exact[o.group].size
            errors = whitened[begin:begin + size].reshape(exact[o.group].shape)
            found[o.group] = exact[o.group] + errors * self.u[o.group]
            begin += size
        return found


def stage(design: Design) -> _Stage:
    """Lay a design out and linearise it at its truth."""
    plan = design.build(None)
    exact = predict(plan, design.truth)
    plan = plan.with_readings(exact)
    fit = linearise(plan, design.truth)
    chosen = candidates(fit)
    whole = [fit.held_columns(c.columns) for c in chosen]
    taken = field_of(fit, chosen)
    u = {g.name: g.weighting.u for g in fit.groups}
    return _Stage(design, plan, exact, chosen, whole, taken.signals, taken.basis, channels(fit, plan),
                  row_numbers(fit), u)


def _design(scenario: str, g: np.random.Generator, small: bool = False) -> Design:
    """A design with enough readings for an effect of the size of the noise to be seen at all; small: or fewer."""
    for _ in range(DRAWS):
        design = DESIGNS[scenario](g)
        count = sum(mask.size for mask in design.check.values())
        if FEW <= count < FEWEST if small else count >= FEWEST:
            return design
    raise ValueError(f"{scenario} has no {'small ' * small}design with so many rows")


def _net(signal: np.ndarray, raw: np.ndarray) -> float:
    touched = np.abs(raw) > 1e-9 * np.max(np.abs(raw), initial=1e-300)
    return float(np.sqrt(signal @ signal / max(int(touched.sum()), 1)))


def hide_effects(
    scenario: str, seed: int, count: int, size: float, blunders: int = 0, factor: float = 1.0, small: bool = False
) -> Case:
    """A case with `count` effects of one size (count 0: clean), and blunders of 8 to 20 times the noise beside them.

    factor: of the noise to the stated one; small: a design with few readings.
    """
    g = np.random.default_rng([seed, 77])
    here = stage(_design(scenario, g, small))
    effects: dict[tuple[str, str], np.ndarray] = {}
    labels, truth = [], dict(here.design.truth)
    # A phase at half a wavelength is known on a fine line only; elsewhere nobody could find what turns with it.
    fine = min(float(u.min()) for u in here.u.values()) < 50 * nm
    visible = [i for i in g.permutation(len(here.chosen))
               if np.linalg.norm(here.signals[i]) > SEEN * np.linalg.norm(here.whole[i])
               and (fine or here.chosen[i].effect.name != "cyclic")]
    # By name first, so that a family of thirty straightnesses does not crowd out the rest.
    names = list(g.permutation(sorted({here.chosen[i].effect.name for i in visible})))
    stored: dict = {}
    taken = np.zeros((len(here.numbers), 0))
    for name in names:
        if len(effects) == count:
            break
        i = next(j for j in visible if here.chosen[j].effect.name == name)
        alone = np.linalg.qr(here.signals[i])[0]
        if np.linalg.norm(taken.T @ alone, 2) > np.sqrt(1 - APART**2) if taken.size else False:
            continue
        taken = np.linalg.qr(np.concatenate([taken, here.signals[i]], axis=1))[0]
        one = here.chosen[i]
        direction = g.normal(size=len(one.columns)) / np.maximum(np.linalg.norm(here.whole[i], axis=0), 1e-300)
        if one.effect.parameters[0].lower == 0.0:
            direction = np.abs(direction)
        value = direction * size / _net(here.signals[i] @ direction, here.whole[i] @ direction)
        effects[one.effect.name, one.channel] = value
        labels.append(one.label)
        values = stored.setdefault(one.unknown, np.zeros((one.unknown.count, one.unknown.freedom)))
        values[one.instance] = value
    for unknown, values in stored.items():
        truth[unknown] = values.reshape(np.shape(unknown.show(unknown.ambient)))
    exact = predict(here.plan, truth) if effects else here.exact
    noise = factor * g.standard_normal(len(here.numbers))
    rows = _blunder(g, here, noise, blunders, 8.0) if blunders else ()
    problem = here.design.build(here.readings(exact, noise))
    return Case(problem, here.design.check, "effects" if effects else "consistent",
                f"{len(effects)} effects of size {size}" if effects else "clean", effects, rows, tuple(labels), factor)


def _blunder(g: np.random.Generator, here: _Stage, noise: np.ndarray, count: int, size: float) -> tuple[int, ...]:
    """Put blunders into whitened noise (in place); rows of the file that they fall into."""
    redundancy = 1 - np.sum(here.basis**2, axis=1)
    places = g.choice(np.flatnonzero(redundancy > 0.3), count, replace=False)
    noise[places] += g.choice([-1, 1], count) * g.uniform(size, 2.5 * size, count)
    return tuple(sorted({int(here.numbers[p]) for p in places}))


def hide_structure(scenario: str, seed: int, size: float) -> Case:
    """A case with a structure in one channel that no effect and no sum of three explains."""
    g = np.random.default_rng([seed, 78])
    here = stage(_design(scenario, g))
    basis = np.linalg.qr(np.concatenate([here.basis, *here.whole], axis=1) if len(here.chosen) < 30 else here.basis)[0]
    for _ in range(40):
        channel = here.channels[g.integers(len(here.channels))]
        shape = str(g.choice(SHAPES))
        values = _shape(g, shape, channel)
        if values is None:
            continue
        if channel.component == "V" and g.random() < 0.7:  # in the zenith distance, before face 2 turns its sign
            values = values * channel.covariates.get("face", 1.0)
        raw = np.zeros(len(here.numbers))
        raw[channel.places] = values
        net = raw - here.basis @ (here.basis.T @ raw)
        left = raw - basis @ (basis.T @ raw)
        if _net(net, raw) > 0.2 * np.sqrt(np.mean(values**2)) and np.linalg.norm(left) > 0.5 * np.linalg.norm(net):
            raw *= size / _net(left, raw)
            noise = g.standard_normal(len(raw))
            return Case(here.design.build(here.readings(here.exact, raw + noise)), here.design.check,
                        "unknown-structure", f"{shape} in {channel.name}")
    raise ValueError(f"{scenario}, seed {seed}: no structure can be seen in this design")


def _shape(g: np.random.Generator, shape: str, channel: Channel) -> np.ndarray | None:
    cov = channel.covariates
    angle = next((cov[k] for k in ("angle", "command") if k in cov), None)
    if angle is None:  # along a straight guide: one turn over the travel
        travel = next((cov[k] for k in g.permutation(sorted(cov)) if k.split()[0] in ("position", "travel")), None)
        if travel is not None:
            angle = 2 * np.pi * (travel - travel.min()) / np.ptp(travel)
    time = cov["time"] - cov["time"][0]
    share = time / max(time[-1] if len(time) else 1.0, 1e-9)
    phase = g.uniform(0, 2 * np.pi)
    if shape == "wave in time":
        return np.sin(2 * np.pi * g.uniform(1.5, 3.5) * share + phase)
    if shape == "saturating":
        return np.exp(-share / g.uniform(0.05, 0.15))
    if shape == "step within":
        return (share > g.uniform(0.25, 0.75)).astype(float)
    if shape == "lagging":  # follows the temperature late
        kelvin, late = cov["temperature_difference"], np.zeros(len(share))
        for i in range(1, len(share)):
            late[i] = late[i - 1] + (1 - np.exp(-(share[i] - share[i - 1]) / 0.15)) * (kelvin[i] - late[i - 1])
        return late if np.ptp(kelvin) > 0 else None
    if shape == "square of temperature":
        return (cov["temperature_difference"] - np.median(cov["temperature_difference"])) ** 2
    if shape == "different by direction" and angle is not None:
        way = cov.get("direction", cov.get("approach x"))
        return None if way is None or len(np.unique(way)) < 2 else way * np.cos(2 * angle + phase)
    if shape == "growing hysteresis":
        way = cov.get("direction", cov.get("approach x"))
        return None if way is None or len(np.unique(way)) < 2 else way * (share - share.mean())
    if angle is None:
        return None
    if shape in ("fourth", "fifth"):
        return np.cos({"fourth": 4, "fifth": 5}[shape] * angle + phase)
    if shape == "triangle":
        return 2 * np.abs((angle * g.integers(1, 3) / np.pi + phase) % 2 - 1) - 1
    if shape == "bump":
        middle = g.uniform(np.quantile(angle, 0.2), np.quantile(angle, 0.8))
        return np.exp(-0.5 * ((angle - middle) / (0.12 * np.ptp(angle))) ** 2)
    return (share - 0.5) * np.cos(2 * angle + phase)


def hide_noise(scenario: str, seed: int, kind: str) -> Case:
    """A clean case with peculiar noise: larger, smaller, uneven by channel or block or time, heavy tails, serial."""
    g = np.random.default_rng([seed, 79])
    here = stage(_design(scenario, g))
    noise = g.standard_normal(len(here.numbers))
    if kind == "larger":
        noise *= g.uniform(1.5, 3)
    elif kind == "smaller":
        noise *= g.uniform(0.3, 0.6)
    elif kind == "heavy":
        noise = g.standard_t(3, len(noise))
    elif kind == "heavy of stated size":
        noise = g.standard_t(3, len(noise)) / np.sqrt(3)
    elif kind == "growing":  # along time, from somewhat less to much more than stated
        for channel in here.channels:
            time = channel.covariates["time"]
            noise[channel.places] *= 0.7 + g.uniform(2.0, 3.0) * (time - time.min()) / np.ptp(time)
    elif kind == "channel":
        if len(here.channels) < 2:
            kind = "block"
        else:
            noise[here.channels[g.integers(len(here.channels))].places] *= g.uniform(2, 3)
    if kind == "block":
        for channel in here.channels:
            keys = channel.covariates.get("block", np.zeros(len(channel.places)))
            late = keys == keys.max() if len(np.unique(keys)) > 1 else np.arange(len(keys)) > len(keys) / 2
            noise[channel.places[late]] *= 2.5
    if kind == "serial":
        memory = g.uniform(0.6, 0.85)
        for channel in here.channels:
            order = channel.places[channel.order]
            for before, after in pairwise(order):
                noise[after] = memory * noise[before] + np.sqrt(1 - memory**2) * noise[after]
    problem = here.design.build(here.readings(here.exact, noise))
    return Case(problem, here.design.check, "noise-misstated", kind)


def hide_blunders(scenario: str, seed: int, size: float) -> Case:
    """A clean case with one to three blunders of at least the given size."""
    g = np.random.default_rng([seed, 80])
    here = stage(_design(scenario, g))
    noise = g.standard_normal(len(here.numbers))
    rows = _blunder(g, here, noise, int(g.integers(1, 4)), size)
    problem = here.design.build(here.readings(here.exact, noise))
    return Case(problem, here.design.check, "outliers", f"{len(rows)} blunders", {}, rows)
