"""Run the command as a user does, in this process: exit status, standard output, standard error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from calib.cli import run


@dataclass(frozen=True)
class Answer:
    """What a command left: exit status and the text of both streams."""

    status: int
    out: str
    error: str


def runner(capsys: pytest.CaptureFixture[str]) -> Callable[..., Answer]:
    """A function that runs `calib` with words and returns its answer."""

    def calib(*words: object) -> Answer:
        capsys.readouterr()
        status = run([str(word) for word in words])
        captured = capsys.readouterr()
        return Answer(status, captured.out, captured.err)

    return calib
