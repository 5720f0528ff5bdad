"""Positioning of a rotary table: harmonics and closure, scale against drift against slip, methods side by side.

A reading is the angle that some instrument gives the table at a commanded angle; the nominal model knows a zero only.
Everything else is an effect, so that one linearisation says which of them these readings can tell apart.
Source: Li, Cao, Qu 2020, tables 1 and 2; two-way figures: ISO 230-2 in `problems.two_way`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import (
    Effect,
    Gaussian,
    Linearisation,
    Observations,
    Parameter,
    Problem,
    Unknown,
    covariance,
    direct,
    estimability,
    linearise,
    simulate,
)
from calib.errors import InputError, RankDefect
from calib.table import written
from calib.units import arcsec, degree, hour, minute, ppm
from instruments import encoder, influence
from problems import two_way
from problems.recorded import recorded

if TYPE_CHECKING:
    from calib.job import Job

Array = NDArray[np.float64]
STAND = "warm-up of the instrument and its stand, bench experience"
HARMONICS = "ISO 230-7:2015, harmonic analysis"


# --- the physics -------------------------------------------------------------------------------------------------


def table_angle(command: Any, zero: Any, *, theta: Any = direct, reading: Any = direct) -> Any:
    """The angle [rad] read at a commanded angle [rad]; slots: `theta`, where the table turns to, and `reading`."""
    return reading(theta(command, command=command) + zero, command=command)


def angle_seen_by(command: Any, deviation: Any, growth: Any) -> Any:
    """The angle [rad] one method reads: command, the table's own deviation [rad], and what grows with the turn [1]."""
    return command + deviation + growth * command


def slip() -> Effect:
    """Reflector or polygon creep on the table with the turn made, whichever way; needs covariate `travel` [rad]."""
    return Effect("slip", "reading", lambda value, p, travel: p.rate * travel,
                  (Parameter("rate", "ppm", (1.0 * ppm, 300.0 * ppm)),), source="clamping of reflector nest or polygon")


def effects(blocks: Sequence[int] = (), orders: Sequence[int] = ()) -> tuple[Effect, ...]:
    """Eccentricity, second harmonic, scale and hysteresis of the table; drift, slip and steps of what reads it.

    blocks: values of covariate `block` at which a reading may have jumped; orders: further harmonics, waves in a turn.
    Inputs: covariates `direction`, `time` [s], `travel` [rad], `block`.
    """
    drift = influence.drift("reading", "arcsec", (0.5 * arcsec / hour, 100.0 * arcsec / hour), source=STAND)
    return (*encoder.axis_angle_effects("theta"), drift, slip(),
            *influence.steps("reading", "arcsec", (0.2 * arcsec, 100.0 * arcsec), blocks, source=STAND),
            *(influence.harmonic(f"harmonic_{k}", "theta", k, "arcsec", (0.1 * arcsec, 60.0 * arcsec), source=HARMONICS)
              for k in orders))


# --- the declarations --------------------------------------------------------------------------------------------


def travelled(command: ArrayLike) -> Array:
    """Angle turned since the first reading (n,) [rad], whichever way, by commands (n,) [rad] that follow each other."""
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(np.asarray(command, float))))])


def start(command: ArrayLike, measured: ArrayLike) -> float:
    """Start value of the zero [rad] from commands and readings (n,) [rad]."""
    return float(np.mean(np.asarray(measured, float) - np.asarray(command, float)))


def declare(command: ArrayLike, measured: ArrayLike, u: ArrayLike | Gaussian,
            covariates: Mapping[str, Any] | None = None, orders: Sequence[int] = (),
            rows: ArrayLike | None = None) -> Problem:
    """Readings of a rotary table in the order in which they were taken, with every effect that they could hold.

    command, measured: (n,) [rad], not reduced modulo a turn; u: standard uncertainty [rad] or Gaussian.
    covariates: time [s] (an even pace of a minute a reading where it is missing), direction (+1, -1; the sense of the
    moves where it is missing), block; orders: further harmonics offered as effects; rows: (n,) row numbers of the file.
    Raises InputError for fewer than two readings.
    """
    command, measured = np.asarray(command, float), np.asarray(measured, float)
    if len(command) < 2:
        raise InputError(f"{len(command)} readings say nothing about positioning; measure at two angles or more")
    moves = np.sign(np.diff(command, prepend=2.0 * command[0] - command[1]))
    given = {"time": (np.arange(len(command)) * minute, "min"), "direction": moves, **(covariates or {}),
             "travel": (travelled(command), "deg"), "command": (command, "deg")}
    zero = Unknown("zero", start(command, measured), unit="arcsec")
    seen = Observations(table_angle, command, zero, readings=measured, u=u, group="table", unit="deg",
                        components=("angle",), covariates=given, rows=rows)
    blocks = np.unique(seen.covariates["block"])[1:].tolist() if "block" in given else []
    both_ways = len(np.unique(seen.covariates["direction"])) > 1
    candidates = [e for e in effects(blocks, orders) if both_ways or e.name != "hysteresis"]
    return Problem([seen], effects=candidates, name="positioning of a rotary table")


def declare_methods(command: ArrayLike, readings: Mapping[str, ArrayLike], u: Mapping[str, Any]) -> Problem:
    """Several methods that read the same stops of one table: common deviations, and what grows with the turn for each.

    command: (n,) [rad], the first where all methods read zero; readings: {method: (n,) [rad]};
    u: {method: standard uncertainty [rad] or Gaussian}. Unknowns: `deviation` of each stop after the first, `growth` of
    each method; that of the first method is held at zero, because a growth common to all methods is one of the table.
    """
    command = np.asarray(command, float)
    n, names = len(command), list(readings)
    deviation = Unknown("deviation", np.zeros((n, 1)), unit="arcsec", keys=[f"{np.degrees(c):.6g}" for c in command])
    growth = Unknown("growth", np.zeros((len(names), 1)), unit="ppm", keys=names)
    groups = []
    for k, name in enumerate(names):
        turned = np.asarray(readings[name], float)
        groups.append(Observations(angle_seen_by, command[1:], deviation[np.arange(1, n)], growth[np.full(n - 1, k)],
                                   readings=turned[1:] - turned[0], u=u[name], group=name, unit="deg",
                                   covariates={"command": (command[1:], "deg")}, rows=np.arange(2, n + 1)))
    return Problem(groups, held=[growth[0], deviation[0]], name="methods on one table")


# --- what the readings can tell apart ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Candidate:
    """One effect among others: u of its parameter alone and beside the others [SI], None where that cannot be known.

    separability: (u alone / u beside the others)^2, 1 where the others do not touch it, 0 where they hide it.
    """

    effect: Effect
    u_alone: float | None
    u_together: float | None

    @property
    def separability(self) -> float:
        """From 0, hidden by the others, to 1, untouched by them."""
        return (self.u_alone / self.u_together) ** 2 if self.u_alone and self.u_together else 0.0


def told_apart(problem: Problem, *labels: str) -> tuple[tuple[Candidate, ...], tuple[str, ...]]:
    """Which of some effects of one parameter the readings tell apart, by their places alone (no reading value is used).

    problem: from `declare`; labels: of its effects. Returns a Candidate for each, and the directions that cannot be
    known when all are free together, in words.
    """
    chosen = [problem.attached_effect(label).effect for label in labels]
    together = linearise(problem.free(*chosen))

    def u(fit: Linearisation, effect: Effect) -> float | None:
        try:
            return float(covariance(fit, effect).u[0])
        except RankDefect:
            return None
    found = tuple(Candidate(e, u(linearise(problem.free(e)), e), u(together, e)) for e in chosen)
    return found, estimability(together).directions


# --- jobs and examples -------------------------------------------------------------------------------------------

accepts = ("positioning",)


def from_job(job: Job) -> Problem:
    """Positioning of a rotary table from a job.

    Table `readings`: command, measured (angles, not reduced modulo a turn), optionally time, direction, block. Its
    instrument: u. Options: figures = true for the figures of ISO 230-2 of two-way data (column direction needed; u is
    then the repeatability); harmonics = [3, 4], further orders offered as effects.
    """
    table, instrument = job.table("readings"), job.instrument("readings")
    command, measured = table.number("command", "angle"), table.number("measured", "angle")
    u = instrument.quantity("u", "angle")
    if job.options.flag("figures", False):
        return two_way.declare(command, measured, table.whole("direction"), u, table.row_numbers)
    orders = job.options.numbers("harmonics", ())
    return declare(command, measured, u, recorded(job, table), [int(k) for k in orders], table.row_numbers)


def example(seed: int) -> Problem:
    """Two runs of a table up and down in 30 degree steps with a pause between them; simulated readings."""
    sweep = np.arange(0.0, 361.0, 30.0) * degree
    command = np.tile(np.concatenate([sweep, sweep[::-1]]), 2)
    n = len(command)
    second = np.arange(n) >= n // 2
    given = {"time": (np.arange(n) * minute + second * hour, "min"), "block": 1 + second,
             "direction": np.tile(np.repeat([1, -1], len(sweep)), 2)}
    return simulate(declare(command, command, 0.5 * arcsec, given, (3,)), None, seed)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job that asks for the figures of ISO 230-2 of the readings of `example`: {file name: text}."""
    seen = example(seed).observations[0]
    c = seen.covariates
    readings = {"command_deg": c["command"], "measured_deg": seen.recorded[:, 0], "time_min": c["time"],
                "direction": c["direction"], "block": c["block"]}
    return {
        "job.toml": 'problem = "problems.positioning"\n\n[data.readings]\nfile = "readings.csv"\n'
                    'instrument = "table"\n\n[instruments.table]\nu = "0.5 arcsec"\n\n[options]\nfigures = true\n\n'
                    '[report]\nquantities = ["A", "E", "M", "R", "B"]\n',
        "readings.csv": written(f"simulated, seed {seed}", readings)}
