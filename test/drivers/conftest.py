# SPDX-License-Identifier: BSD-3-Clause
"""Cameras that can be unplugged, for processes that stream."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from fake_bench import STAND_IN, FakeBench


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """The cameras for processes that are started from here on: they load the stand-in for pyrealsense2."""
    monkeypatch.syspath_prepend(str(STAND_IN))
    bench = FakeBench(tmp_path / "bench")
    monkeypatch.setenv("FAKE_REALSENSE", str(bench.folder))
    return bench
