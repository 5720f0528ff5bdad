"""Monte Carlo: propagation of distributions through the whole estimation, trials in blocks (JCGM 101)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.blocks import Array
from calib.errors import CalibrationError
from calib.linearisation import Functions
from calib.observations import Quantity
from calib.solve.estimate import Estimate
from calib.system import System
from calib.unknown import Unknown
from calib.workflow.places import Place, Sampling, Threads
from calib.workflow.trials import prepared

CHUNK = 100_000  # samples that are correlated at a time
NAMED = 20  # trials that did not converge whose numbers are kept
USUAL = 200_000  # trials that stabilise two digits of most results


@dataclass(frozen=True)
class Adaptive:
    """As many trials as stabilise every result to the digits wanted.

    digits: of the standard uncertainties; probability: of the coverage intervals; largest: trials at most.
    Source: JCGM 101:2008, 7.9.
    """

    digits: int = 2
    probability: float = 0.95
    largest: int = 10_000_000

    @property
    def lot(self) -> int:
        """Trials between two looks; 7.9.4 b)."""
        return max(10_000, int(np.ceil(100 / (1 - self.probability))))

    def tolerance(self, u: Array) -> Array:
        """Numerical tolerance (k,) of standard uncertainties (k,); 7.9.2."""
        leading = np.floor(np.log10(np.where(u > 0, u, 1.0)))
        rounded = np.round(u / 10.0 ** (leading - self.digits + 1))  # 0.0996 to two digits is 0.10
        leading = leading + (rounded >= 10.0**self.digits)
        return np.where(u > 0, 0.5 * 10.0 ** (leading - self.digits + 1), 0.0)


@dataclass(frozen=True)
class Stability:
    """How still the results stand after an adaptive number of trials.

    tolerance (k,): allowed; spread (k, 4): twice the standard deviation of mean, u and both ends of the interval.
    """

    tolerance: Array
    spread: Array

    @property
    def reached(self) -> bool:
        """Whether every result stands still."""
        return bool(np.all(self.spread <= self.tolerance[:, None]))


@dataclass(frozen=True)
class MonteCarlo:
    """Simulated re-estimates of derived results.

    names, units: of the k results; samples: (trials, k) SI, only trials that converged; failures: trials that did not;
    linear, linear_u: value and u (k,) of the linear propagation at the truth; stability: where the number of trials was
    chosen adaptively; failed: numbers of the first trials that did not converge, from 1.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    samples: Array
    failures: int
    linear: Array
    linear_u: Array
    stability: Stability | None = None
    failed: tuple[int, ...] = ()

    @property
    def mean(self) -> Array:
        """Mean (k,)."""
        return self.samples.mean(axis=0)

    @property
    def u(self) -> Array:
        """Standard deviation (k,) of the samples."""
        return self.samples.std(axis=0, ddof=1)

    @property
    def correlation(self) -> Array:
        """Correlation (k, k) of the samples; 0 beside a result that never changes."""
        u, mean = self.u, self.mean
        scale, found = np.where(u > 0, u, 1.0), np.zeros((len(u), len(u)))
        for begin in range(0, len(self.samples), CHUNK):  # no second copy of all samples
            centred = (self.samples[begin : begin + CHUNK] - mean) / scale
            found += centred.T @ centred / max(1, len(self.samples) - 1)
        np.fill_diagonal(found, 1.0)
        return found

    def interval_symmetric(self, probability: float = 0.95) -> Array:
        """Probabilistically symmetric coverage interval (k, 2)."""
        return np.quantile(self.samples, [(1 - probability) / 2, (1 + probability) / 2], axis=0).T

    def interval_shortest(self, probability: float = 0.95) -> Array:
        """Shortest coverage interval (k, 2); JCGM 101:2008, 7.7."""
        ordered = np.sort(self.samples, axis=0)
        inside = int(np.ceil(probability * len(ordered)))
        widths = ordered[inside - 1 :] - ordered[: len(ordered) - inside + 1]
        begin = widths.argmin(axis=0)
        columns = np.arange(ordered.shape[1])
        return np.stack([ordered[begin, columns], ordered[begin + inside - 1, columns]], axis=1)


def montecarlo(
    estimate: Estimate, trials: int | Adaptive, seed: int, quantities: Sequence[Quantity] | None = None,
    progress: Callable[[int], None] = lambda done: None, place: Place | None = None,
) -> MonteCarlo:
    """Propagate the stated distributions through the whole estimation.

    estimate: taken as the truth; trials: how many re-estimates, or `Adaptive`; seed: of the errors; quantities: results
    to sample (all of the problem if not given); progress: called with the number of trials done, now and then; place:
    who makes the trials (`Threads()` of this program if not given). Readings and priors are drawn from the declared
    model; held unknowns with a prior are drawn from it. The samples follow from the seed alone, however many threads or
    machines there are, and a longer run begins with a shorter one.
    Raises CalibrationError where nothing is wanted. Problems with inequalities are solved trial by trial, slowly.
    Source: JCGM 101:2008, 7.
    """
    system = System(estimate.problem)
    chosen = tuple(quantities if quantities is not None else estimate.problem.quantities)
    if not chosen:
        raise CalibrationError(f"{estimate.problem.name} has no quantities; name the results that you want sampled.")
    from calib.analyse.covariance import covariance

    truth = dict(estimate.values)
    limit = trials.largest if isinstance(trials, Adaptive) else trials
    expected = min(limit, USUAL) if isinstance(trials, Adaptive) else trials
    ready, fit = prepared(system, truth, chosen, expected)
    linear = covariance(fit, *[_as_functions(system, q, truth) for q in chosen])
    sampling = Sampling(ready, truth, expected, seed, limit)
    watch = _Watch(trials) if isinstance(trials, Adaptive) else None
    done, failures, samples = 0, 0, []
    failed: list[int] = []
    for found, good in (place or Threads()).blocks(sampling):
        samples.append(found if good.all() else found[good])
        failures += int(np.sum(~good))
        failed += (done + 1 + np.flatnonzero(~good)).tolist()[: NAMED - len(failed)]
        done += len(good)
        progress(done)
        if watch is not None and watch.stands(samples[-1]):
            break
    stability = None if watch is None else watch.stability
    return MonteCarlo(
        linear.names, linear.units, np.concatenate(samples), failures, linear.values, linear.u, stability,
        tuple(failed),
    )


class _Watch:
    """How far mean, u and both ends of the interval differ from lot to lot; JCGM 101:2008, 7.9.4 b) to k)."""

    def __init__(self, wanted: Adaptive):
        self._wanted = wanted
        self._seen: list[list[Array]] = []
        self._waiting: list[Array] = []
        self.stability: Stability | None = None

    def stands(self, samples: Array) -> bool:
        """Whether all results stand still, with these samples besides."""
        self._waiting.append(samples)
        if sum(len(w) for w in self._waiting) < self._wanted.lot:
            return False
        lot, self._waiting = np.concatenate(self._waiting), []
        tail = (1 - self._wanted.probability) / 2
        ends = np.quantile(lot, [tail, 1 - tail], axis=0)
        self._seen.append([lot.mean(axis=0), lot.std(axis=0, ddof=1), *ends])
        if len(self._seen) < 2:
            return False
        seen: Array = np.array(self._seen)  # (lots, 4, k)
        u = np.sqrt((seen[:, 1] ** 2).mean(axis=0) + seen[:, 0].var(axis=0))
        spread = 2 * seen.std(axis=0, ddof=1).T / np.sqrt(len(seen))
        self.stability = Stability(self._wanted.tolerance(u), spread)
        return self.stability.reached


def _as_functions(system: System, quantity: Quantity, truth: dict[Unknown, Array]) -> Functions:
    value, derivatives = system.result(quantity, truth)
    return Functions(
        tuple(quantity.labels(value.shape[1])), quantity.units(value.shape[1]) * quantity.n, value.ravel(), derivatives
    )
