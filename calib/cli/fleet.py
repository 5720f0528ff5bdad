"""`calib fleet`: one command for many jobs, or many variants of a job, side by side on this machine or on others."""

from __future__ import annotations

import re
import shlex
import signal
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from calib import files
from calib.cli.output import DONE, FAILED, INPUT, WORDS, Output, output_options
from calib.cli.place import place_options
from calib.compiled import threads
from calib.errors import CalibrationError, InputError
from calib.job import Job
from calib.workflow.parcel import Parcel, in_bytes, in_text, packed
from calib.workflow.places import in_order

COMMANDS = ("solve", "compare", "discover", "select", "montecarlo", "simulate")
RESTARTS = 3        # times that lost processes of this machine are replaced


@dataclass(frozen=True)
class Piece:
    """One command on one job: name of its folder, the job as text, the words but for the job, and what is wrong with a
    job that cannot be read."""

    name: str
    job: str
    parcel: str
    contents: Mapping[str, str]
    words: tuple[str, ...]
    error: str = ""


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("command", type=click.Choice(COMMANDS))
@click.argument("words", nargs=-1, metavar="JOB... [-- OPTIONS]", type=click.UNPROCESSED)
@click.option("--vary", multiple=True, metavar="OPTIONS",
              help='Do every job once with each of these, as in --vary "--keep 4" --vary "--keep 6".')
@place_options
@output_options
def fleet(
    command: str, words: tuple[str, ...], vary: tuple[str, ...], workers: int | None, scheduler: str | None,
    output: Output,
) -> int:
    """Run COMMAND on many jobs at once: calib fleet discover cases/* --out DIR [-- --level 0.05].

    With --out: a folder of files for each job, and fleet.json.
    """
    begin = next((i for i, word in enumerate(words) if word.startswith("-")), len(words))
    jobs, options = [Path(word) for word in words[:begin]], tuple(words[begin:])
    if not jobs:
        raise InputError("no job is named; write them after the command, as in calib fleet solve a.toml b.toml")
    pieces = list(_pieces(command, jobs, options, vary))
    found: list[dict[str, Any]] = []
    with output.progress(f"{command}, {len(pieces)} times", len(pieces)) as step:
        answers = _answers([piece for piece in pieces if not piece.error], workers, scheduler)
        for piece in pieces:
            refused: dict[str, Any] = {"status": INPUT, "error": piece.error, "seconds": 0.0, "files": {}}
            answer = refused if piece.error else next(answers)
            found.append({"name": piece.name, "job": piece.job, "command": shlex.join(piece.words),
                          **{key: answer[key] for key in ("status", "error", "seconds")}})
            for name, text in answer["files"].items() if output.folder is not None else ():
                files.write_bytes(output.path(f"{piece.name}/{name}"), in_bytes(text))
            step()
    content = {"format": 1, "command": command, "jobs": found}
    output.result(content)
    words_of = {DONE: "done", FAILED: "its certificate failed", INPUT: "cannot be used"}
    width = max(len(one["name"]) for one in found)
    for one in found:
        output.prose(f"{one['name']:<{width}}  {words_of.get(one['status'], one['status'])}"
                     + (f": {one['error']}" if one["error"] else ""))
    if output.folder is not None:
        output.wrote(files.write_json(output.path("fleet.json"), content))
    return max(one["status"] for one in found)


def _pieces(command: str, jobs: Sequence[Path], options: tuple[str, ...], vary: Sequence[str]) -> Iterator[Piece]:
    variants = [tuple(shlex.split(one)) for one in vary] or [()]
    taken: dict[str, int] = {}
    for job, name in zip(jobs, _names(jobs)):
        wrong, parcel, contents = "", Parcel("", {}), dict[str, str]()
        try:
            parcel, contents = packed(Job.read(job))
        except CalibrationError as error:  # the other jobs can be done
            wrong = error.sentence
        for variant in variants:
            label = "/".join(filter(None, (name, re.sub(r"[^\w.+]+", "-", " ".join(variant)).strip("-"))))
            taken[label] = taken.get(label, 0) + 1
            again = f" ({taken[label]})" if taken[label] > 1 else ""
            yield Piece(label + again, str(job), parcel.text(), contents, (command, *options, *variant), wrong)


def _names(jobs: Sequence[Path]) -> list[str]:
    """A name for each job: of its folder where that tells jobs apart, else of its file."""
    stems = [job.name if job.is_dir() else job.parent.name if job.name == "case.toml" else job.stem for job in jobs]
    if len(set(stems)) == len(stems):
        return stems
    return [f"{job.resolve().parent.name}/{stem}" for job, stem in zip(jobs, stems)]


def _answers(pieces: Sequence[Piece], workers: int | None, scheduler: str | None) -> Iterator[dict[str, Any]]:
    """What each piece gave, in order."""
    if not pieces:
        return
    if scheduler is None:
        yield from _here(pieces, min(workers or threads(), len(pieces)))
        return
    from calib.workflow.distributed import connected, version

    with connected(scheduler) as there:
        texts = there.texts({digest: text for piece in pieces for digest, text in piece.contents.items()})
        needed = [{digest: texts[digest] for digest in piece.contents} for piece in pieces]
        yield from there.each(carried_out, (
            (piece.parcel, held, piece.words, version()) for piece, held in zip(pieces, needed)))


def _here(pieces: Sequence[Piece], workers: int) -> Iterator[dict[str, Any]]:
    """In processes of this machine; what a process that dies was doing is done again."""
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import get_context

    if workers < 2:
        for piece in pieces:
            yield carried_out(piece.parcel, dict(piece.contents), piece.words)
        return
    done = 0
    for attempt in range(RESTARTS + 1):
        with ExitStack() as stack:
            pool = ProcessPoolExecutor(workers, get_context("spawn"), signal.signal,
                                       (signal.SIGINT, signal.SIG_IGN))
            stack.callback(pool.shutdown, wait=False, cancel_futures=True)

            def submit(piece: Piece, pool: ProcessPoolExecutor = pool) -> Any:
                return pool.submit(carried_out, piece.parcel, dict(piece.contents), piece.words)

            try:
                for answer in in_order(submit, pieces[done:], len(pieces)):
                    yield answer
                    done += 1
                return
            except BrokenProcessPool:
                if attempt == RESTARTS:
                    raise CalibrationError(f"'{pieces[done].name}', or a job beside it, ended its process "
                                           f"{RESTARTS + 1} times; run it alone, or look at the memory") from None


def carried_out(
    parcel: str, contents: Mapping[str, str], words: Sequence[str], version: str | None = None
) -> dict[str, Any]:
    """One command on one job, wherever this runs.

    parcel, contents: the job as text; words: command and options; version: that the work must be done with.
    return: status as of the command, error (empty if none), seconds, files {name: text}.
    """
    from calib.cli import calib as group

    if version is not None:
        from calib.workflow.distributed import same_version

        same_version(version)
    begin, command, *options = time.perf_counter(), *words
    with tempfile.TemporaryDirectory(prefix="calib-") as folder:
        place, out = Path(folder) / "in", Path(folder) / "out"
        description = Parcel.of_text(parcel)
        status, error = INPUT, ""
        try:
            job, _ = description.unpacked(contents, place)
            path = job.path.parent if job.path.name == "case.toml" else job.path
            data = ["--data", str(place / "data")] if description.data else []
            typed = [command, path.name, *options]
            asked = WORDS.set(typed)
            try:
                status = int(group.main([command, str(path), *options, *data, "--out", str(out), "--quiet"],
                                        prog_name="calib", standalone_mode=False) or DONE)
            finally:
                WORDS.reset(asked)
        except click.ClickException as problem:
            error = problem.format_message()
        except CalibrationError as problem:
            error = problem.sentence
        except Exception as problem:
            error = f"this is a fault of calib, not of your input: {type(problem).__name__}: {problem}"
        written = sorted(path for path in out.rglob("*") if path.is_file())
        return {"status": status, "error": error.replace(f"{place}/job/", ""), "seconds": time.perf_counter() - begin,
                "files": {str(path.relative_to(out)): in_text(path.read_bytes()) for path in written}}
