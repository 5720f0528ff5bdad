"""More than one machine: the work of a job on the workers of a Dask scheduler.

What travels is text: the job and its files by their hash, the estimate taken as the truth in full digits, seeds and
numbers of blocks. A worker that dies takes nothing with it: the scheduler holds every text, and gives the block to
another worker, which draws the same numbers. Needs the optional library `distributed`.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import logging
import tempfile
import threading
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib import catalogue
from calib.errors import CalibrationError, InputError
from calib.system import System
from calib.workflow.parcel import Parcel
from calib.workflow.places import Made, Sampling, in_order
from calib.workflow.propagation import sampled
from calib.workflow.solution import declared, requested
from calib.workflow.trials import Trials, prepared

ANSWER = 5.0  # seconds that a scheduler has to answer
PATIENCE = 60.0  # seconds without any worker after which a run ends
LOT_TRIALS = 20_000  # trials of one message at most
KEPT = 4  # jobs that a worker keeps ready
DISTRIBUTION = "calibration-framework"
INSTALL = 'pip install "calibration-framework[distributed]"'


class Scheduler:
    """A connection to the scheduler of Dask at an address; `connected` makes it."""

    def __init__(self, address: str, client: Any):
        self.address, self._client = address, client

    @property
    def workers(self) -> int:
        """Threads of all workers together."""
        return sum(self._client.nthreads().values())

    def texts(self, contents: Mapping[str, str]) -> dict[str, Any]:
        """Texts that tasks name: held by the scheduler, made again where the worker that had them dies.

        contents: {SHA-256: text}. return: the same keys with what stands for each text in a task.
        """
        return {digest: self._client.submit(_itself, text, key=f"calib-text-{digest}", pure=False)
                for digest, text in contents.items()}

    def each(self, task: Callable[..., Any], items: Iterable[tuple[Any, ...]], room: int | None = None
             ) -> Iterator[Any]:
        """Results of a task in the order of its items.

        task: a function of calib that takes an item's parts; items; room: how many may be under way, none for all.
        raises InputError where a task does, and where the scheduler or the last worker is gone.
        """
        under_way: list[Any] = []

        def submit(item: tuple[Any, ...]) -> _Waiting:
            under_way[:] = [future for future in under_way if not future.done()]
            under_way.append(self._client.submit(task, *item, pure=False))
            return _Waiting(under_way[-1], self)

        items = list(items)
        try:
            yield from in_order(submit, items, room or max(1, len(items)))
        finally:
            if self.alive:
                self._client.cancel([future for future in under_way if not future.done()])

    @property
    def alive(self) -> bool:
        """Whether the scheduler still answers."""
        return self._client.status == "running"


@dataclass(frozen=True)
class _Waiting:
    """A result that is on its way, waited for as long as anybody works on it."""

    future: Any
    scheduler: Scheduler

    def result(self) -> Any:
        import distributed

        alone = None
        while True:
            try:
                return self.future.result(timeout=1.0)
            except (TimeoutError, distributed.TimeoutError):
                alone = None if self.scheduler.workers else alone or time.monotonic()
                if alone and time.monotonic() - alone > PATIENCE:
                    raise InputError(f"no worker has been left at {self.scheduler.address} for {PATIENCE:.0f} s; start "
                                     f"some (dask worker {self.scheduler.address}) and run again") from None
            except CalibrationError:
                raise
            except distributed.KilledWorker as error:
                raise InputError(f"one piece of the work ended every worker that took it ({error}); look at their "
                                 "memory, or run without --scheduler") from None
            except (distributed.CancelledError, distributed.comm.CommClosedError, OSError) as error:
                raise InputError(f"the scheduler at {self.scheduler.address} is gone ({type(error).__name__}); nothing "
                                 "was written: start it and run again") from None
            except (ImportError, RuntimeError, AttributeError) as error:
                raise InputError(f"a worker at {self.scheduler.address} cannot do this work "
                                 f"({type(error).__name__}: {error}); install there what is installed here") from None


@contextmanager
def connected(address: str) -> Iterator[Scheduler]:
    """A connection to a scheduler, closed again in any case.

    address: such as "tcp://10.0.0.7:8786".
    raises InputError where Dask is missing, nothing answers at the address within seconds, or no worker is there.
    """
    try:
        import distributed
    except ImportError:
        raise InputError(f"--scheduler needs the library `distributed`; install it: {INSTALL}") from None

    for name in list(logging.root.manager.loggerDict):  # what matters is said in a sentence
        if name.split(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of versions that differ: what cannot work says so
        client = _client(distributed.Client, address)
        try:
            scheduler = Scheduler(address, client)
            if not _within(ANSWER, lambda: scheduler.workers > 0):
                raise InputError(f"the scheduler at {address} has no workers; start some: dask worker {address}")
            yield scheduler
        finally:
            client.close(timeout=2.0)


def _client(of_dask: Any, address: str) -> Any:
    class Client(of_dask):  # type: ignore[misc]
        def __del__(self) -> None:
            """Half made where nobody answers, a client would wait long for its end, and then complain."""

    found: list[Any] = []

    def connect() -> None:
        try:
            found.append(Client(address, timeout=ANSWER, set_as_default=False))
        except Exception as error:  # whatever sits at a wrong address may answer anything
            found.append(error)

    attempt = threading.Thread(target=connect, daemon=True)  # another server may take the call and say nothing
    attempt.start()
    attempt.join(2.0 * ANSWER)
    if found and not isinstance(found[0], Exception):
        return found[0]
    why = _first(found[0]) if found else "something else took the call"
    raise InputError(f"no scheduler answers at '{address}' ({why}); start one (dask scheduler), check the address "
                     "(such as tcp://10.0.0.7:8786), or leave --scheduler out")


def _first(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:120]


def _within(seconds: float, there: Callable[[], bool]) -> bool:
    end = time.monotonic() + seconds
    while not there():
        if time.monotonic() > end:
            return False
        time.sleep(0.1)
    return True


def version() -> str:
    """Version of the installed distribution; empty in a bare checkout."""
    try:
        return importlib.metadata.version(DISTRIBUTION)
    except importlib.metadata.PackageNotFoundError:
        return ""


def same_version(there: str) -> None:
    """Raise InputError where a task comes from another version than the one that shall do it."""
    if there != version():
        raise InputError(f"a worker has version {version() or 'unknown'} of {DISTRIBUTION}, the work comes from "
                         f"{there or 'unknown'}; install the same on all machines")


def _itself(text: str) -> str:
    return text


# --- Monte Carlo ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Distributed:
    """Trials made by the workers of a scheduler.

    scheduler; parcel, contents: the job as `parcel.packed` returns it. The samples are those of this machine, whoever
    draws them, as far as both compute the same digits.
    """

    scheduler: Scheduler
    parcel: Parcel
    contents: Mapping[str, str]

    def blocks(self, sampling: Sampling) -> Iterator[Made]:
        """All blocks in order, lot by lot."""
        values = [array.tolist() for array in sampling.truth.values()]
        head = json.dumps({"version": version(), "parcel": self.parcel.text(), "expected": sampling.expected,
                           "names": [unknown.name for unknown in sampling.truth], "truth": values})
        digest = hashlib.sha256(head.encode()).hexdigest()
        texts = self.scheduler.texts({**self.contents, digest: head})
        sizes, workers = sampling.sizes, self.scheduler.workers
        together = max(1, min(LOT_TRIALS // sampling.trials.block, len(sizes) // (8 * workers)))
        lots = [json.dumps({"seed": sampling.seed, "first": first, "counts": sizes[first : first + together]})
                for first in range(0, len(sizes), together)]
        for lot in self.scheduler.each(sample_lot, ((digest, texts, lot) for lot in lots), 4 * workers):
            yield from lot


_ready: OrderedDict[str, Trials] = OrderedDict()
_making = threading.Lock()


def sample_lot(head: str, contents: Mapping[str, str], lot: str) -> list[Made]:
    """Blocks of trials, made on a worker.

    head: hash of the text with the job and its truth; contents: {SHA-256: text} of that and of the job's files; lot:
    seed, number of the first block and the counts of all, as JSON.
    return: (results, which converged) of each block.
    raises InputError where this machine cannot do it.
    """
    wanted = json.loads(lot)
    with _making:
        trials = _ready.get(head) or _made_ready(contents[head], contents)
        _ready[head] = trials
        _ready.move_to_end(head)
        while len(_ready) > KEPT:
            _ready.popitem(last=False)
    return [trials.sample(wanted["seed"], wanted["first"] + i, count) for i, count in enumerate(wanted["counts"])]


def _made_ready(head: str, contents: Mapping[str, str]) -> Trials:
    described = json.loads(head)
    same_version(described["version"])
    with tempfile.TemporaryDirectory(prefix="calib-") as folder:
        job, problem_file = Parcel.of_text(described["parcel"]).unpacked(contents, Path(folder))
        try:
            problem = declared(job, catalogue.module(job.problem, problem_file))
            wanted = sampled(problem, requested(problem, job.quantities, job.report.where("quantities")))
        except CalibrationError as error:  # those with more to say than a sentence do not travel
            raise InputError(error.sentence) from None
    system = System(problem)
    unknowns = {unknown.name: unknown for unknown in system.layout.unknowns}
    truth = {unknowns[name]: np.array(value) for name, value in zip(described["names"], described["truth"])}
    return prepared(system, truth, wanted, described["expected"])[0]


