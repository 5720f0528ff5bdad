"""The command `calib`: one module a command; errors become one message, results become files and text."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

import click

from calib.catalogue import check_companions
from calib.cli.compare import compare
from calib.cli.discover import discover
from calib.cli.epochs import epochs
from calib.cli.fleet import fleet
from calib.cli.lists import effects, example, problems
from calib.cli.montecarlo import montecarlo
from calib.cli.output import FAILED, INPUT, STOPPED
from calib.cli.reproduce import reproduce
from calib.cli.select import choose
from calib.cli.simulate import simulate
from calib.cli.solve import solve
from calib.errors import CalibrationError
from calib.report.provenance import version


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(version(), prog_name="calib")
def calib() -> None:
    """Calibrate from a declared model: estimate, uncertainty, reliability and verdict.

    Exit status: 0 done, 1 the job ran and its certificate failed, 2 the input cannot be used.
    """


for command in (reproduce, solve, compare, discover, epochs, montecarlo, simulate, example, problems, effects, choose,
                fleet):
    calib.add_command(command)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and leave with its exit status.

    arguments: words of the command line; those of the process where none are given.
    raises SystemExit always.
    """
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command; every error becomes one message on standard error.

    arguments: as for `main`.
    return: the exit status.
    """
    try:
        check_companions()
        return int(calib.main(arguments, prog_name="calib", standalone_mode=False) or 0)
    except click.ClickException as error:
        error.show()
        return INPUT
    except (click.Abort, KeyboardInterrupt):
        click.echo("calib: stopped; every file that was written is whole", err=True)
        return STOPPED
    except CalibrationError as error:
        click.echo(f"calib: {error.sentence}", err=True)
        return INPUT
    except BrokenPipeError:
        # The reader of a pipe has gone; what is left in the buffer must not raise again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except Exception as error:
        if os.environ.get("CALIB_TRACEBACK"):
            raise
        click.echo(f"calib: this is a fault of calib, not of your input: {type(error).__name__}: {error}. "
                   "Run again with CALIB_TRACEBACK=1 set and report what it prints", err=True)
        return INPUT
