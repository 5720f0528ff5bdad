"""Options of commands whose work can be shared out: the processors of this machine, or a scheduler of Dask."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from calib.errors import InputError


def place_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --workers and --scheduler to a command, which receives them as `workers` and `scheduler`."""

    def with_place(workers: int | None, scheduler: str | None, **arguments: Any) -> Any:
        if workers is not None and scheduler is not None:
            raise InputError("--workers counts processors of this machine, --scheduler uses workers elsewhere; give "
                             "one of the two")
        return command(workers=workers, scheduler=scheduler, **arguments)

    with_place.__doc__, with_place.__name__ = command.__doc__, command.__name__
    with_place.__click_params__ = getattr(command, "__click_params__", [])  # type: ignore[attr-defined]
    for option in (
        click.option("--scheduler", metavar="ADDRESS", default=None,
                     help="Share the work out to the workers of the Dask scheduler there, as tcp://10.0.0.7:8786."),
        click.option("--workers", type=click.IntRange(1, 1024), default=None,
                     help="Processors of this machine to use; all if not given."),
    ):
        with_place = option(with_place)
    return with_place
