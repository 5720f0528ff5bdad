"""A command that is stopped leaves whole files or none, and no traceback."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest
from command import runner

pytestmark = pytest.mark.slow


def test_an_interrupt_ends_the_command_with_one_line_and_no_half_written_file(capsys, tmp_path):
    assert runner(capsys)("example", "plumb", "--out", tmp_path, "--quiet").status == 0
    words = ["montecarlo", str(tmp_path / "job.toml"), "--trials", "5000000", "--out", str(tmp_path / "out")]
    # Tests that a shell started in the background ignore Ctrl-C, and so would what they start: heard again here.
    with subprocess.Popen([sys.executable, "-m", "calib", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                          text=True, env={**os.environ, "OMP_NUM_THREADS": "1"},
                          preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)) as process:
        time.sleep(6.0)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        try:
            out, error = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert out == ""
    assert error.strip() == "calib: stopped; every file that was written is whole"
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())
