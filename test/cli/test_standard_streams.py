# SPDX-License-Identifier: BSD-3-Clause
"""What becomes of a command whose output nobody reads."""

import os
import subprocess
import sys

import numpy as np
import pytest

from ceiling_dso_ros.cli.standard_streams import ForgivingStream
from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.trajectory import read_tum


@pytest.fixture
def collect(tmp_path, command):
    """Runs `collect` through a shell that does something to its output; returns its exit code and standard error."""
    with BagWriter(tmp_path / "a.bag") as writer:
        for second in range(1, 4):
            writer.odometry("/odometry/filtered", second * 10**9, "odom", "base", np.eye(4), np.zeros(3), np.zeros(3))

    def run(redirection, **environment):
        shell = f'"$0" -m ceiling_dso_ros collect "$1" --out "$2" {redirection}'
        result = subprocess.run(
            ["bash", "-o", "pipefail", "-c", shell, sys.executable, str(tmp_path / "a.bag"), str(tmp_path / "out")],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **environment},
            capture_output=True,
            text=True,
        )
        assert len(read_tum(tmp_path / "out" / "fused.tum")) == 3
        return result.returncode, result.stderr

    return run


@pytest.mark.parametrize("redirection", [">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-", "| head -0", "2>&1 | head -0"])
def test_streams_that_are_closed_change_nothing(collect, redirection):
    assert collect(redirection, PYTHONUNBUFFERED="1") == (0, "")


def test_an_output_that_cannot_be_written_is_said(collect):
    assert collect(">/dev/full") == (1, "error: cannot write the standard output: No space left on device\n")


def test_a_stream_takes_all_text_after_an_error(tmp_path):
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w", buffering=1) as pipe:
        stream = ForgivingStream(pipe)
        assert stream.error is None
        for _ in range(2):
            print("text", file=stream, flush=True)
        assert isinstance(stream.error, BrokenPipeError)
        assert not stream.isatty()
