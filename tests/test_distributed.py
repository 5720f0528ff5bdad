"""Work shared out: parcels of text, order kept, a real scheduler with two workers of which one is killed."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from command import runner

from calib import catalogue, solve
from calib.cli.place import place_options
from calib.errors import InputError
from calib.job import Job
from calib.workflow.distributed import Distributed, connected
from calib.workflow.montecarlo import montecarlo
from calib.workflow.parcel import Parcel, packed
from calib.workflow.places import Threads, in_order
from calib.workflow.propagation import sampled
from calib.workflow.solution import declared, requested
from calib.workflow.trials import BLOCK


@pytest.fixture
def calib(capsys):
    return runner(capsys)


@pytest.fixture
def job(calib, tmp_path):
    assert calib("example", "circle", "--out", tmp_path / "job", "--quiet").status == 0
    return tmp_path / "job" / "job.toml"


# --- parcels ----------------------------------------------------------------------------------------------------------


def test_a_parcel_holds_what_the_job_reads_and_gives_it_back_byte_for_byte(job, tmp_path):
    (job.parent.parent / "shared.csv").write_bytes((job.parent / "points.csv").read_bytes())
    (job.parent / "further.bin").write_bytes(b"\xff\x00named in the options")
    job.write_text(job.read_text().replace('"points.csv"', '"../shared.csv"') + '[options]\nfurther = "further.bin"\n')
    parcel, contents = packed(Job.read(job))
    assert all(isinstance(text, str) for text in contents.values())
    again, own = Parcel.of_text(parcel.text()).unpacked(contents, tmp_path / "elsewhere")
    assert own is None
    assert [path.read_bytes() for path in again.files] == [path.read_bytes() for path in Job.read(job).files]
    assert (again.path.parent / "further.bin").read_bytes() == (job.parent / "further.bin").read_bytes()


def test_a_parcel_that_was_changed_on_the_way_is_refused(job, tmp_path):
    parcel, contents = packed(Job.read(job))
    first = next(iter(contents))
    with pytest.raises(InputError, match="arrived damaged"):
        parcel.unpacked({**contents, first: contents[first] + " "}, tmp_path / "elsewhere")


def test_a_parcel_never_writes_outside_its_folder(job, tmp_path):
    parcel, contents = packed(Job.read(job))
    digest = next(iter(contents))
    with pytest.raises(InputError, match="arrived damaged"):
        Parcel(parcel.job, {"../outside": digest}).unpacked(contents, tmp_path / "elsewhere")
    assert not (tmp_path / "outside").exists()


def test_a_file_named_by_its_place_on_this_machine_is_refused(job):
    table = job.parent / "points.csv"
    job.write_text(job.read_text() + f'[options]\nfurther = "{table}"\n')
    with pytest.raises(InputError, match="by its place on this machine"):
        packed(Job.read(job))


# --- order, choice ----------------------------------------------------------------------------------------------------


def test_results_come_in_order_and_no_more_than_the_room_are_under_way():
    running, most, lock = [0], [0], threading.Lock()

    def slow_first(number: int) -> int:
        with lock:
            running[0] += 1
            most[0] = max(most[0], running[0])
        time.sleep(0.02 if number == 0 else 0.001)
        with lock:
            running[0] -= 1
        return number

    with ThreadPoolExecutor(8) as pool:
        assert list(in_order(lambda n: pool.submit(slow_first, n), range(20), 3)) == list(range(20))
    assert most[0] <= 3


def test_workers_and_a_scheduler_exclude_each_other(calib, job):
    answer = calib("montecarlo", job, "--workers", 2, "--scheduler", "tcp://127.0.0.1:1")
    assert answer.status == 2
    assert "give one of the two" in answer.error


def test_without_the_library_the_option_says_what_to_install(calib, job, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    answer = calib("montecarlo", job, "--scheduler", "tcp://127.0.0.1:1")
    assert answer.status == 2
    assert 'pip install "calibration-framework[distributed]"' in answer.error


def test_options_are_added_without_losing_the_text_of_a_command():
    def command(workers, scheduler):
        """What it does."""

    assert place_options(command).__doc__ == "What it does."


# --- fleets on this machine -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_fleet_does_every_job_and_every_variant_and_says_which_cannot_be_used(calib, job, tmp_path):
    (job.parent / "wrong.toml").write_text(job.read_text().replace('"angle"', '"angel"'))
    (job.parent / "lacking.toml").write_text(job.read_text().replace("points.csv", "nothing.csv"))
    jobs = [job, job.parent / "wrong.toml", job.parent / "lacking.toml"]
    answer = calib("fleet", "solve", *jobs, "--workers", 1, "--out", tmp_path / "out", "--json")
    assert answer.status == 2
    found = json.loads(answer.out)["jobs"]
    assert [one["status"] for one in found] == [0, 2, 2]
    assert "did you mean" in found[1]["error"] or "There are" in found[1]["error"]
    assert "cannot be read" in found[2]["error"]
    direct = calib("solve", job, "--json")
    mine = json.loads((tmp_path / "out" / "job" / "result.json").read_text())
    assert mine["unknowns"] == json.loads(direct.out)["unknowns"]
    assert mine["provenance"]["command"] == "calib solve job.toml"
    varied = calib("fleet", "select", job, "--vary", "--keep 12", "--vary", "--keep 11", "--workers", 1, "--out",
                   tmp_path / "sweep")
    assert varied.status == 0
    for keep in (12, 11):
        selection = json.loads((tmp_path / "sweep" / "job" / f"keep-{keep}" / "selection.json").read_text())
        assert selection["keep"] == keep


# --- a scheduler ------------------------------------------------------------------------------------------------------


@pytest.fixture
def cluster(tmp_path):
    """Address of a scheduler on this machine, and the processes of its two workers."""
    distributed = pytest.importorskip("distributed")
    file = tmp_path / "scheduler.json"
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    common = ["--scheduler-file", str(file), "--host", "127.0.0.1", "--no-dashboard"]
    processes = []

    def start(program: str, *words: str) -> None:
        processes.append(subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{program}", *common, *words], cwd=tmp_path, env=environment,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))

    try:
        start("scheduler", "--port", "0")
        end = time.monotonic() + 30
        while not file.exists() and time.monotonic() < end:
            time.sleep(0.1)
        for _ in range(2):
            start("worker", "--nthreads", "1", "--no-nanny", "--local-directory", str(tmp_path))
        address = json.loads(file.read_text())["address"]
        with distributed.Client(address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        yield address, processes[1:]
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.wait()


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_worker_killed_in_mid_run_loses_nothing_and_changes_no_sample(cluster, job):
    address, workers = cluster
    read = Job.read(job)
    problem = declared(read, catalogue.module(read.problem))
    wanted = sampled(problem, requested(problem, read.quantities, ""))
    estimate, trials = solve(problem), 16 * BLOCK + 77
    here = montecarlo(estimate, trials, 3, wanted, place=Threads(1))
    told = []

    def progress(done: int) -> None:
        if not told:
            workers[0].kill()
        told.append(done)

    with connected(address) as scheduler:
        assert scheduler.workers == 2
        there = montecarlo(estimate, trials, 3, wanted, progress, Distributed(scheduler, *packed(read)))
        assert workers[0].wait(10) == -signal.SIGKILL
        end = time.monotonic() + 10
        while scheduler.workers > 1 and time.monotonic() < end:
            time.sleep(0.1)
        assert scheduler.workers == 1
    assert told[-1] == trials
    np.testing.assert_array_equal(there.samples, here.samples)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_fleet_on_a_scheduler_gives_the_files_of_the_single_command(cluster, calib, job, tmp_path):
    address, _ = cluster
    answer = calib("fleet", "simulate", job, "--vary", "--seed 5", "--vary", "--seed 6", "--scheduler", address,
                   "--out", tmp_path / "out")
    assert answer.error == ""
    assert answer.status == 0
    assert calib("simulate", job, "--seed", 6, "--out", tmp_path / "alone").status == 0
    alone = sorted((tmp_path / "alone").glob("*.csv"))
    assert alone
    for path in alone:
        assert (tmp_path / "out" / "job" / "seed-6" / path.name).read_bytes() == path.read_bytes(), path.name


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_an_address_where_nobody_or_somebody_else_answers_is_said_in_seconds(calib, job):
    pytest.importorskip("distributed")
    with socket.create_server(("127.0.0.1", 0)) as other:        # takes the call and says nothing
        silent = f"tcp://127.0.0.1:{other.getsockname()[1]}"
        for address in ("tcp://127.0.0.1:1", silent, "nonsense"):
            begin = time.monotonic()
            answer = calib("montecarlo", job, "--scheduler", address, "--out", Path(job).parent / "out")
            assert answer.status == 2
            assert f"no scheduler answers at '{address}'" in answer.error
            assert time.monotonic() - begin < 20
    assert not (job.parent / "out").exists()
