"""What every command shares: options, where text and files go, progress on a terminal."""

from __future__ import annotations

import shlex
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from calib import files
from calib.job import Job

DONE, FAILED, INPUT, STOPPED = 0, 1, 2, 130
WORDS: ContextVar[Sequence[str] | None] = ContextVar("words", default=None)     # of a command that another one runs
PAGE = 100      # characters of a line of prose


@dataclass(frozen=True)
class Output:
    """Where a command writes: folder of its files (None: no files), JSON or text on standard output, or neither."""

    folder: Path | None
    as_json: bool
    quiet: bool

    def say(self, text: str = "") -> None:
        """A line for people; nothing where JSON or silence was asked for."""
        if not (self.as_json or self.quiet):
            click.echo(text)

    def prose(self, text: str, indent: str = "") -> None:
        """A sentence for people, folded to the width of a page."""
        self.say(textwrap.fill(text, PAGE, initial_indent=indent, subsequent_indent=" " * len(indent)))

    def result(self, content: Any) -> None:
        """The result as JSON on standard output, where it was asked for."""
        if self.as_json:
            click.echo(files.json_text(content))

    def path(self, name: str) -> Path:
        """The path of a file in the folder."""
        assert self.folder is not None
        return self.folder / name

    def wrote(self, *paths: Path) -> None:
        """Name the files that were written."""
        if self.folder is not None:
            self.say(f"written to {self.folder}: {', '.join(path.name for path in paths)}")

    @contextmanager
    def progress(self, what: str, total: int) -> Iterator[Callable[[], None]]:
        """A progress bar on standard error, where that is a terminal.

        what: is being done; total: number of steps.
        return: a function to call after each step.
        """
        if self.quiet or not sys.stderr.isatty():
            yield lambda: None
            return
        from rich.console import Console
        from rich.progress import Progress

        with Progress(console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(what, total=total)
            yield lambda: bar.advance(task)


def output_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --out, --json and --quiet to a command, which receives them as `output`."""

    def with_output(out: Path | None, as_json: bool, quiet: bool, **arguments: Any) -> Any:
        return command(output=Output(out, as_json, quiet), **arguments)

    with_output.__doc__ = command.__doc__
    with_output.__name__ = command.__name__
    if hasattr(command, "__click_params__"):
        with_output.__click_params__ = command.__click_params__  # type: ignore[attr-defined]
    for option in (
        click.option("--quiet", is_flag=True, help="No text, only files, errors and the exit status."),
        click.option("--json", "as_json", is_flag=True, help="Only the result on standard output, as JSON."),
        click.option("--out", type=click.Path(file_okay=False, path_type=Path), metavar="DIR",
                     help="Folder for the files; it is created."),
    ):
        with_output = option(with_output)
    return with_output


problem_file_option = click.option(
    "--problem-file", type=click.Path(path_type=Path), metavar="FILE",
    help="Your own problem file; it replaces the problem that the job names.",
)
data_option = click.option(
    "--data", "data_folder", type=click.Path(path_type=Path), metavar="PATH",
    help="Folder of data files that the job's options name.",
)

job_argument = click.argument("job", type=click.Path(path_type=Path))


def job_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the argument JOB and the options --data and --problem-file to a command."""
    return job_argument(data_option(problem_file_option(command)))


def sources(job: Job, problem_file: Path | None) -> list[Path]:
    """All files behind a result, for its provenance: what the job reads and names, and a person's own problem file."""
    return [*job.everything_read, *([] if problem_file is None else [problem_file])]


def typed() -> str:
    """The command as it was typed, without the folder of the program."""
    return shlex.join(["calib", *(WORDS.get() or sys.argv[1:])])
