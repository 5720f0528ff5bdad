"""Explain a disagreement: where it is, which effect or which kind of noise makes it, and how far the gap shrinks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib import units
from calib.analyse.score import Candidate, Field, candidates, field_of, orthonormal
from calib.blocks import Array
from calib.linearisation import Linearisation, linearise_system
from calib.problem import Problem
from calib.solve.estimate import Estimate, solve
from calib.system import System
from calib.workflow.discrepancy.alias import Hidden, aliases, hidden, what_would_tell
from calib.workflow.discrepancy.heldout import held_out
from calib.workflow.discrepancy.noise import NoiseTest, best_correlation, lagged, noise_tests, size_test
from calib.workflow.discrepancy.readings import Channel, channels, row_numbers
from calib.workflow.discrepancy.search import Finding, Shares, corrected, independent_looks, search, tail
from calib.workflow.discrepancy.structure import Pattern, patterns

ROUNDS = 4  # of naming and refitting, so that a curved model is judged where it is
MOST_NAMED = 3  # effects up to which a sum of them is an answer; more is structure without a name
CROWD = 0.06  # share of readings beyond which blunders are no blunders but heavy tails


@dataclass(frozen=True)
class NamedEffect:
    """One effect that explains the readings: parameters {name: (value, u, unit)} in display units, corrected p-value
    of its absence, aliases that these readings cannot tell from it, and a word on its size where that is unusual."""

    name: str
    channel: str
    parameters: Mapping[str, tuple[float, float, str]]
    p_value: float
    aliases: tuple[tuple[str, str], ...]
    plausibility: str


@dataclass(frozen=True)
class Place:
    """Where the nominal model disagrees: channel, covariate, shape of the disagreement, corrected p-value."""

    channel: str
    covariate: str
    shape: str
    p_value: float


@dataclass(frozen=True)
class Explanation:
    """What was found; sentence says it in plain words.

    verdict: consistent, effects, unknown-structure, noise-misstated or outliers; p_value: of nominal model and stated
    noise; effects; outlier_rows: of the data file; noise_factor: actual over stated standard deviation after the
    effects; rms, heldout_rms: (before, after), the latter None where no rows are held out; where; structure; noise:
    looks at the noise that failed; hidden; next_measurement; before, after: the estimates.
    """

    verdict: str
    sentence: str
    p_value: float
    effects: tuple[NamedEffect, ...]
    outlier_rows: tuple[int, ...]
    noise_factor: float
    rms: tuple[float, float]
    heldout_rms: tuple[float, float] | None
    where: tuple[Place, ...]
    structure: tuple[Place, ...]
    noise: tuple[NoiseTest, ...]
    hidden: tuple[Hidden, ...]
    next_measurement: str
    before: Estimate
    after: Estimate


@dataclass(frozen=True)
class _Scene:
    """The linear picture in which everything is judged: the nominal unknowns free, every effect a candidate."""

    fit: Linearisation
    chosen: tuple[Candidate, ...]
    columns: tuple[Array, ...]
    derivatives: Array
    residual: Array
    channels: tuple[Channel, ...]
    field: Field

    @property
    def readings(self) -> NDArray[np.int64]:
        """Places of the scalar readings that may be blunders."""
        return np.flatnonzero(row_numbers(self.fit) > 0)

    def seen_through(self, rows: Array) -> Field:
        """The field with every row divided by a scale (n,)."""
        return _field(self.derivatives / rows[:, None], self.residual / rows, [c / rows[:, None] for c in self.columns])

    def serial(self, correlation: float) -> Field:
        """The field with rows whitened for serial correlation."""
        return _field(
            lagged(self.derivatives, self.channels, correlation),
            lagged(self.residual[:, None], self.channels, correlation)[:, 0],
            [lagged(c, self.channels, correlation) for c in self.columns],
        )


def _field(derivatives: Array, residual: Array, columns: Sequence[Array]) -> Field:
    basis = orthonormal(derivatives, np.linalg.norm(derivatives, axis=0))
    left = residual - basis @ (basis.T @ residual)
    return Field(left, np.maximum(1 - np.sum(basis**2, axis=1), 0), basis, (), ()).with_signals(columns)


def _scene(problem: Problem, at: Estimate, named: Sequence[Candidate]) -> _Scene:
    """Linearise with the named effects held at their estimates and put back what they explain."""
    held = problem.hold(*[c.selection for c in named]) if named else problem
    fit = linearise_system(System(held), at.values)
    chosen = tuple(candidates(fit))
    columns = [fit.held_columns(c.columns) for c in chosen]
    derivatives, residual = fit.rows
    residual = residual.copy()
    labels = {c.label for c in named}
    for one, column in zip(chosen, columns, strict=True):
        if one.label in labels:
            residual += column @ at.values[one.unknown][one.instance]
    dense = derivatives.toarray()
    field = field_of(fit, ()) if not named else None
    whole = (
        _field(dense, residual, columns)
        if field is None
        else Field(field.residual, field.redundancy, field.basis, (), ()).with_signals(columns)
    )
    return _Scene(fit, chosen, tuple(columns), dense, residual, tuple(channels(fit)), whole)


def explain(
    problem: Problem, level: float = 0.01, check: Mapping[str, NDArray[np.bool_]] | None = None, seed: int = 20
) -> Explanation:
    """Find out why model and readings disagree, or that they do not.

    problem: with its effects attached as held candidates; level: probability of a false alarm; check: {group: (n,)
    true where a row is held out} to judge the gap on; seed: of the simulated looks.
    Returns the Explanation. Raises what `solve` raises where the nominal model cannot be estimated.
    """
    shares = Shares()
    before = solve(problem)
    scene = _scene(problem, before, ())
    nominal = scene
    named: tuple[Candidate, ...] = ()
    outliers: tuple[int, ...] = ()
    estimate, finding = before, search(scene.field, scene.readings, level, seed, shares)
    for _ in range(ROUNDS):
        chosen = tuple(scene.chosen[e] for e in finding.effects)
        rows = tuple(sorted({int(row_numbers(scene.fit)[b]) for b in finding.blunders}))
        if [c.label for c in chosen] == [c.label for c in named] and rows == outliers:
            break
        named, outliers = chosen, rows
        estimate = _refit(problem, named, outliers, before)
        scene = _scene(problem, estimate, named)
        finding = search(scene.field, scene.readings, level, seed, shares)
    finding, reweighted = _despite_uneven_noise(scene, finding, level, seed, shares)
    finding, serial = _despite_serial_noise(scene, finding, level, seed, shares)
    chosen = tuple(scene.chosen[e] for e in finding.effects)
    rows = tuple(sorted({int(row_numbers(scene.fit)[b]) for b in finding.blunders}))
    if [c.label for c in chosen] != [c.label for c in named] or rows != outliers:
        named, outliers = chosen, rows
        estimate = _refit(problem, named, outliers, before)
    structure = () if serial or reweighted else _structure(scene, finding, level * shares.structure, seed)
    noise = _noise(scene, finding, level * shares.noise, seed, serial)
    return _conclude(problem, before, estimate, nominal, scene, finding, named, outliers, structure, noise, check)


def _refit(problem: Problem, named: Sequence[Candidate], outliers: Sequence[int], start: Estimate) -> Estimate:
    """Solve with the named effects freed and the outlying rows left out."""
    freed = problem.free(*[c.selection for c in named]) if named else problem
    if outliers:
        freed = freed.keep({o.group: ~np.isin(o.rows, outliers) for o in freed.observations if not o.is_prior})
    return solve(freed, start=start)


def _despite_uneven_noise(
    scene: _Scene, finding: Finding, level: float, seed: int, shares: Shares
) -> tuple[Finding, bool]:
    """Search again with the noise scaled where its size is uneven; what is named must survive that."""
    if not finding.effects:
        return finding, False
    tests = [t for t in noise_tests(finding.left, scene.channels, finding.scale, seed) if t.what == "uneven size"]
    if not tests or min(t.p_value for t in tests) * len(tests) > 1e-3:
        return finding, False
    rows = _local_scale(finding.left, scene.channels)
    again = search(scene.seen_through(rows), scene.readings, level, seed, shares)
    lost = set(finding.effects) - set(again.effects)
    return (again, True) if lost else (finding, False)


def _local_scale(field: Field, channels: Sequence[Channel]) -> Array:
    """Standard deviation of what is left around each row, block by block of every channel."""
    scale = np.ones(len(field.residual))
    for channel in channels:
        keys = channel.covariates.get("block", channel.covariates.get("sweep"))
        ordered = channel.places[channel.order]
        groups = (
            [channel.places[keys == k] for k in np.unique(keys)]
            if keys is not None and len(np.unique(keys)) > 1
            else np.array_split(ordered, max(1, len(ordered) // 12))
        )
        for places in groups:
            seen = max(float(np.sum(field.redundancy[places])), 1.0)
            scale[places] = np.sqrt(max(float(np.sum(field.residual[places] ** 2)) / seen, 0.05))
    return scale


def _despite_serial_noise(
    scene: _Scene, finding: Finding, level: float, seed: int, shares: Shares
) -> tuple[Finding, float]:
    """Judge again with first-order serial correlation: noise that remembers must not become a discovery.

    Returns the finding to keep and the correlation where that noise explains the readings better (0 where it does not).
    """
    n = len(scene.residual)
    correlation, likelihood = best_correlation(scene.derivatives, scene.residual, scene.channels)
    white = n * np.log(max(finding.left.squares, 1e-12) / n) + (
        finding.left.basis.shape[1] - scene.field.basis.shape[1]
    ) * np.log(n)
    if abs(correlation) < 0.05 or likelihood + np.log(n) >= white:
        return finding, 0.0
    again = search(scene.serial(correlation), scene.readings, level, seed, shares)
    if again.effects and again.left.squares > 0:
        both = (
            n * np.log(again.left.squares / n)
            + sum(len(c.places) - 1 for c in scene.channels) * np.log(1 - correlation**2)
            + (again.left.basis.shape[1] - scene.field.basis.shape[1] + 1) * np.log(n)
        )
        if both < likelihood + np.log(n) - 10:
            return again, correlation
    plain = search(scene.field.with_signals([]), scene.readings, level, seed, shares)
    return Finding((), (), (), (), plain.scale, plain.left), correlation


def _structure(scene: _Scene, finding: Finding, level: float, seed: int) -> tuple[Place, ...]:
    """Patterns that are left over, largest first."""
    shapes = patterns(scene.channels, len(scene.residual))
    return tuple(p for p in _places(finding.left, shapes, seed) if p.p_value <= level)


def _places(field: Field, shapes: Sequence[Pattern], seed: int) -> list[Place]:
    looking = field.with_signals([s.columns for s in shapes])
    looks = independent_looks(looking, seed)
    drops, dofs = looking.statistics
    found = []
    for shape, drop, dof in zip(shapes, drops, dofs, strict=True):
        left = field.dof - int(dof)
        scale = max(1.0, (field.squares - drop) / left) if left > 0 else 1.0
        found.append(
            Place(shape.channel, shape.covariate, shape.kind, corrected(tail(drop, int(dof), scale, left), looks))
        )
    return sorted(found, key=lambda p: p.p_value)


def _noise(scene: _Scene, finding: Finding, level: float, seed: int, serial: float) -> tuple[NoiseTest, ...]:
    tests = [size_test(finding.left), *noise_tests(finding.left, scene.channels, finding.scale, seed)]
    failed = [t for t in tests if corrected(t.p_value, 2 if t.what == "size" else 2 * (len(tests) - 1)) <= level]
    if serial:
        failed.append(NoiseTest("serial correlation", "all channels", serial, 0.0))
    return tuple(sorted(failed, key=lambda t: t.p_value))


def _conclude(
    problem: Problem,
    before: Estimate,
    estimate: Estimate,
    nominal: _Scene,
    scene: _Scene,
    finding: Finding,
    named: tuple[Candidate, ...],
    outliers: tuple[int, ...],
    structure: tuple[Place, ...],
    noise: tuple[NoiseTest, ...],
    check: Mapping[str, NDArray[np.bool_]] | None,
) -> Explanation:
    crowd = len(outliers) > max(2, CROWD * len(np.unique(row_numbers(scene.fit))))
    if structure or len(named) > MOST_NAMED:
        verdict = "unknown-structure"
    elif named:
        verdict = "effects"
    elif crowd or noise:
        verdict = "noise-misstated"
    elif outliers:
        verdict = "outliers"
    else:
        verdict = "consistent"
    after = estimate if verdict in ("effects", "outliers") else before
    effects: tuple[NamedEffect, ...] = ()
    advice = ""
    if verdict == "effects":
        effects, advice = _named(scene, finding, named, after)
    rows = outliers if verdict in ("effects", "outliers") else ()
    size = size_test(nominal.field).p_value
    where = tuple(
        p for p in _places(nominal.field, patterns(nominal.channels, len(nominal.residual)), 1)[:8] if p.p_value < 0.01
    )
    p_value = min([size, *(p.p_value for p in where), *(e.p_value for e in effects)])
    spread = float(np.sqrt(after.objective / after.dof)) if after.dof > 0 else 1.0
    rms = (float(np.sqrt(before.objective / before.dof)) if before.dof > 0 else 0.0, spread)
    held = None
    if check is not None:
        first = held_out(problem, check, before)
        named_problem = problem.free(*[c.selection for c in named]) if verdict == "effects" else problem
        if rows:
            named_problem = named_problem.keep(
                {
                    o.group: ~np.isin(o.rows, rows) | check.get(o.group, np.zeros(o.n, bool))
                    for o in problem.observations
                    if not o.is_prior
                }
            )
            masks = {
                o.group: check[o.group][np.isin(p.rows, o.rows)]
                for o, p in zip(named_problem.observations, problem.observations, strict=True)
                if o.group in check
            }
        else:
            masks = dict(check)
        second = held_out(named_problem, masks, after) if verdict in ("effects", "outliers") else first
        held = (first.rms, second.rms) if first and second else None
    unseen = tuple(hidden(nominal.fit, nominal.field, nominal.chosen))
    return Explanation(
        verdict,
        _sentence(verdict, effects, rows, structure, noise, rms),
        p_value,
        effects,
        rows,
        spread,
        rms,
        held,
        where,
        structure,
        noise,
        unseen,
        advice,
        before,
        after,
    )


def _named(
    scene: _Scene, finding: Finding, named: Sequence[Candidate], after: Estimate
) -> tuple[tuple[NamedEffect, ...], str]:
    from calib.analyse.covariance import covariance
    from calib.linearisation import linearise

    fit = linearise(after)
    values = {
        place: after.values[scene.chosen[place].unknown][scene.chosen[place].instance] for place in finding.effects
    }
    standing_in = aliases(scene.field, finding.effects, values, scene.columns)
    effects, advice = [], []
    widened = np.sqrt(finding.scale)
    for place, p in zip(finding.effects, finding.p_effects, strict=True):
        one = scene.chosen[place]
        u = covariance(fit, one.selection).u * widened
        parameters = {
            q.name: (float(v / units.factor(q.unit)), float(s / units.factor(q.unit)), q.unit)
            for q, v, s in zip(one.effect.parameters, values[place], u, strict=True)
        }
        others = [scene.chosen[o] for o in standing_in[place]]
        effects.append(
            NamedEffect(
                one.effect.name,
                one.channel,
                parameters,
                p,
                tuple((o.effect.name, o.channel) for o in others),
                _plausibility(one, values[place]),
            )
        )
        if others:
            advice.append(what_would_tell(one, others))
    return tuple(effects), "; ".join(advice)


def _plausibility(one: Candidate, values: Array) -> str:
    words = []
    for parameter, value in zip(one.effect.parameters, values, strict=True):
        high = parameter.plausible[1]
        if abs(value) > 3 * high:
            factor = units.factor(parameter.unit)
            words.append(
                f"{parameter.name} = {value / factor:.3g} {parameter.unit} is implausible: up to {high / factor:.3g} "
                f"{parameter.unit} is usual"
            )
    return "; ".join(words)


def _sentence(
    verdict: str,
    effects: Sequence[NamedEffect],
    rows: Sequence[int],
    structure: Sequence[Place],
    noise: Sequence[NoiseTest],
    rms: tuple[float, float],
) -> str:
    if verdict == "consistent":
        return "Model and stated noise explain the readings."
    if verdict == "outliers":
        listed = ", ".join(map(str, rows))
        return f"The model holds and the noise is as stated, but {len(rows)} row(s) are blunders: {listed}."
    if verdict == "noise-misstated":
        kinds = ", ".join(f"{t.what} in {t.where}" for t in noise[:3]) or "more large residuals than normal noise has"
        return f"Nothing systematic is missing, but the noise is not what was stated: {kinds}."
    if verdict == "unknown-structure":
        if structure:
            p = structure[0]
            return (
                "There is systematic structure that no known effect explains, most clearly "
                f"{p.shape} over {p.covariate} in {p.channel}."
            )
        return "There is systematic structure that no sum of up to three known effects explains."
    names = " and ".join(f"{e.name} ({e.channel})" for e in effects)
    also = f" {len(rows)} row(s) are blunders." if rows else ""
    return (
        f"Missing in the model: {names}; with it the root mean square residual falls from {rms[0]:.3g} to "
        f"{rms[1]:.3g} u.{also}"
    )
