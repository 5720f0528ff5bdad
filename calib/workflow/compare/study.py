"""Formulations under simulation: bias, true spread against stated u, efficiency, under five kinds of noise."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from calib.blocks import Array
from calib.errors import CalibrationError
from calib.problem import Problem
from calib.solve.estimate import Estimate
from calib.system import System
from calib.workflow.compare.again import Again

Key = TypeVar("Key")
Draw = Callable[[np.random.Generator, tuple[int, int]], Array]


@dataclass(frozen=True)
class Noise:
    """Errors of readings before they take the stated covariance.

    name: in words; draw: from a generator and (n, dim) to (n, dim), of variance one where the noise is as stated.
    """

    name: str
    draw: Draw


def blunders(share: float = 0.1, factor: float = 8.0) -> Noise:
    """A share of the readings is worse by a factor, and nothing says which."""
    def draw(generator: np.random.Generator, shape: tuple[int, int]) -> Array:
        worse = generator.uniform(size=(shape[0], 1)) < share
        return generator.standard_normal(shape) * np.where(worse, factor, 1.0)
    return Noise(f"outliers ({100 * share:g} % of readings, {factor:g} u)", draw)


def uneven(factor: float = 3.0) -> Noise:
    """The second half of every group is worse by a factor than stated."""
    def draw(generator: np.random.Generator, shape: tuple[int, int]) -> Array:
        worse = np.arange(shape[0])[:, None] >= shape[0] / 2
        return generator.standard_normal(shape) * np.where(worse, factor, 1.0)
    return Noise(f"second half {factor:g} times worse, not stated", draw)


def correlated(coefficient: float = 0.8) -> Noise:
    """Each error remembers the one before it, in the order of the rows, which nothing states."""
    def draw(generator: np.random.Generator, shape: tuple[int, int]) -> Array:
        errors = generator.standard_normal(shape)
        for k in range(1, shape[0]):
            errors[k] = coefficient * errors[k - 1] + np.sqrt(1.0 - coefficient**2) * errors[k]
        return errors
    return Noise(f"correlated in order ({coefficient:g}), not stated", draw)


AS_STATED = Noise("as stated", lambda generator, shape: generator.standard_normal(shape))
UNIFORM = Noise("uniform of the same u", lambda generator, shape: generator.uniform(-np.sqrt(3), np.sqrt(3), shape))
NOISES = (AS_STATED, blunders(), uneven(), correlated(), UNIFORM)


@dataclass(frozen=True)
class Performance:
    """How the results of one formulation lie about the truth under one noise.

    names: (m,) results; u: (m,) [SI] the Cramer-Rao bound of the declared problem; errors: (k, m) [SI] of k trials;
    failures: how many further trials gave no answer.
    """

    noise: str
    names: tuple[str, ...]
    u: Array
    errors: Array
    failures: int

    @property
    def bias(self) -> Array:
        """Mean error (m,) in units of the bound."""
        return self.errors.mean(axis=0) / self.u

    @property
    def u_of_bias(self) -> Array:
        """Standard uncertainty (m,) of the bias, in units of the bound."""
        return self.spread / np.sqrt(len(self.errors))

    @property
    def spread(self) -> Array:
        """True standard deviation (m,) over the bound."""
        return self.errors.std(axis=0, ddof=1) / self.u

    @property
    def efficiency(self) -> Array:
        """Squared bound over mean square error (m,): 1 is as good as any unbiased estimator under the stated noise."""
        return self.u**2 / np.mean(self.errors**2, axis=0)


def study(truth: Estimate, bound: Mapping[str, float], values: Mapping[str, float], formulations: Mapping[Key, Again],
          trials: int, seed: int, noises: Sequence[Noise] = NOISES,
          step: Callable[[], None] = lambda: None) -> dict[Key, tuple[Performance, ...]]:
    """Run formulations on readings drawn around an estimate, the same readings for all of them.

    truth: the estimate that stands for it; bound, values: u and value {result: SI} there; formulations: {name: what it
    makes of drawn readings}; trials, seed: of each noise; step: called after each noise.
    Returns {name: a Performance for each noise}; none where fewer than two trials gave every result.
    """
    found: dict[Key, list[Performance]] = {name: [] for name in formulations}
    for noise in noises:
        errors: dict[Key, list[list[float]]] = {name: [] for name in formulations}
        names: dict[Key, tuple[str, ...]] = {}
        for problem in drawn(truth, noise, trials, seed):
            for name, run in formulations.items():
                try:
                    answer = run(problem)
                except CalibrationError:
                    continue
                told = tuple(one for one in answer if bound.get(one, 0.0) > 0.0)
                if told and names.setdefault(name, told) == told:
                    errors[name].append([answer[one] - values[one] for one in told])
        for name, its in errors.items():
            if len(its) >= 2:
                u = np.array([bound[one] for one in names[name]])
                found[name].append(Performance(noise.name, names[name], u, np.array(its), trials - len(its)))
        step()
    return {name: tuple(each) for name, each in found.items()}


def drawn(truth: Estimate, noise: Noise, trials: int, seed: int) -> Iterator[Problem]:
    """The problem of an estimate with readings drawn around it, trial by trial; priors always as stated."""
    system = System(truth.problem)
    weightings = system.weightings(truth.values)
    exact = [term.predict(truth.values) for term in system.terms]
    for trial in range(trials):
        generator = np.random.default_rng([seed, trial])
        readings = {}
        for term, weighting, predicted in zip(system.terms, weightings, exact, strict=True):
            kind = AS_STATED if term.bound.is_prior else noise
            readings[term.bound.group] = predicted + weighting.coloured(kind.draw(generator, predicted.shape))
        yield truth.problem.with_readings(readings)
