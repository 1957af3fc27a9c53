# SPDX-License-Identifier: BSD-3-Clause
"""Waiting goes by the monotonic clock: setting the realtime clock changes nothing."""

import ast
import threading
from pathlib import Path

import ceiling_dso_ros.ros
from ceiling_dso_ros.ros.waiting import wait_until

FOLDER = Path(ceiling_dso_ros.ros.__file__).parent
ONLY_SIMULATED = {"answers.py"}  # wakes up when it is answered


def test_it_ends_when_it_is_so():
    event = threading.Event()
    thread = threading.Timer(0.05, event.set)
    thread.start()
    assert wait_until(event.is_set, 60.0)
    thread.join()


def test_it_ends_when_the_time_is_over():
    assert not wait_until(lambda: False, 0.01)
    assert wait_until(lambda: True, 0.0)


def timed_waits(path):
    """Calls of `wait` with a timeout, and of `wait_for` with a second argument."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            allowed = {"wait": 0, "wait_for": 1}.get(node.func.attr)
            if allowed is not None and len(node.args) + len(node.keywords) > allowed:
                yield f"{path.name}:{node.lineno}"


def test_no_node_waits_for_a_lock_with_a_timeout():
    """Python 3.8 would wait an hour longer if the clock were set back by an hour."""
    paths = [path for path in FOLDER.glob("*.py") if path.name not in ONLY_SIMULATED]
    assert [place for path in paths for place in timed_waits(path)] == []
