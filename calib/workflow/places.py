"""Where trials are made: by the threads of this program, or by others that keep the same order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from calib.blocks import Array
from calib.compiled import threads
from calib.unknown import Unknown
from calib.workflow.trials import Trials

Item = TypeVar("Item")
Made = tuple[Array, NDArray[np.bool_]]  # results (count, k) of a block, and which trials of it converged


@dataclass(frozen=True)
class Sampling:
    """What is to be sampled: trials around the truth (stored values of the unknowns); expected: number of trials that
    they were made ready for; seed; count: trials at most."""

    trials: Trials
    truth: Mapping[Unknown, Array]
    expected: int
    seed: int
    count: int

    @property
    def sizes(self) -> list[int]:
        """Trials of each block, in order."""
        block = self.trials.block
        return [min(block, self.count - begin) for begin in range(0, self.count, block)]


class Place(Protocol):
    """Somewhere that makes trials."""

    def blocks(self, sampling: Sampling) -> Iterator[Made]:
        """All blocks in order; whoever wants no more may stop."""


@dataclass(frozen=True)
class Threads:
    """Threads of this program; workers: how many, None for one a processor (or CALIB_THREADS)."""

    workers: int | None = None

    def blocks(self, sampling: Sampling) -> Iterator[Made]:
        """All blocks in order."""
        sizes = sampling.sizes
        workers = min(self.workers or threads(), len(sizes))

        def made(number: int) -> Made:
            return sampling.trials.sample(sampling.seed, number, sizes[number])

        if workers < 2:
            yield from map(made, range(len(sizes)))
            return
        pool = ThreadPoolExecutor(workers, thread_name_prefix="trials")
        try:
            yield from in_order(lambda number: pool.submit(made, number), range(len(sizes)), 2 * workers)
        finally:  # also where the caller has enough, or is interrupted
            pool.shutdown(wait=True, cancel_futures=True)


def in_order(submit: Callable[[Item], Any], items: Iterable[Item], room: int) -> Iterator[Any]:
    """Results in the order of the items, with some under way ahead of the one that is waited for.

    submit: starts one and returns a future with `result()`; items; room: how many may be under way.
    """
    rest, coming = iter(items), deque[Any]()
    while True:
        while len(coming) < room:
            try:
                coming.append(submit(next(rest)))
            except StopIteration:
                break
        if not coming:
            return
        yield coming.popleft().result()
