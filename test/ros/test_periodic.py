# SPDX-License-Identifier: BSD-3-Clause
"""An exception beside the callbacks is logged once and ends nothing."""

import threading

import pytest

pytest.importorskip("rospy", reason="needs ROS")
pytestmark = pytest.mark.ros

from ceiling_dso_ros.ros import diagnostics, periodic  # noqa: E402
from ceiling_dso_ros.ros.periodic import Periodic  # noqa: E402

PATIENCE_S = 60.0


@pytest.fixture
def logged(monkeypatch):
    """What is logged as an error. Threads end with the test."""
    lines, ends = [], []
    monkeypatch.setattr(periodic.rospy, "logerr", lambda text, *values: lines.append(text % values))
    monkeypatch.setattr(periodic.rospy, "on_shutdown", ends.append)
    monkeypatch.setattr(periodic.rospy, "is_shutdown", lambda: False)
    yield lines
    for end in ends:
        end()


def test_it_goes_on_after_an_exception_which_is_logged_once(logged):
    done, count = threading.Event(), []

    def work():
        count.append(1)
        if len(count) == 10:
            done.set()
        raise ValueError(f"wrong {len(count)}")

    Periodic(work, 0.0, "the work")
    assert done.wait(PATIENCE_S)
    assert len(logged) == 1
    assert logged[0].startswith("the work failed and goes on: ")
    assert "ValueError: wrong 1" in logged[0]


def test_another_exception_is_logged_too(logged):
    done, count = threading.Event(), []

    def work():
        count.append(1)
        if len(count) == 3:
            done.set()
            return
        if len(count) == 1:
            raise ValueError
        raise KeyError

    Periodic(work, 0.0, "the work")
    assert done.wait(PATIENCE_S)
    assert ["ValueError" in line for line in logged] == [True, False]


class FakeUpdater:
    """Runs the task of a node."""

    def __init__(self):
        self.sent, self._task = [], None

    def setHardwareID(self, _):
        pass

    def add(self, _name, task):
        self._task = task

    def force_update(self):
        self.sent.append(self._task(diagnostics.DiagnosticStatusWrapper()))


def test_diagnostics_that_fail_say_so_and_come_back(logged, monkeypatch):
    works = []
    monkeypatch.setattr(diagnostics, "Updater", FakeUpdater)
    monkeypatch.setattr(diagnostics, "Periodic", lambda work, *_: works.append(work))
    broken = True

    def report(status):
        if broken:
            raise RuntimeError("a bug")
        status.summary(diagnostics.OK, "fine")
        return status

    made = diagnostics.Diagnostics(report, "robot")
    with pytest.raises(RuntimeError, match="a bug"):
        works[0]()
    broken = False
    works[0]()
    levels = [(status.level, status.message) for status in made._updater.sent]
    assert levels == [(diagnostics.ERROR, "the diagnostics fail: RuntimeError: a bug"), (diagnostics.OK, "fine")]
